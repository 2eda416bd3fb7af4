//! The reasons to skip a strategy or its remesh: no time, no Blender, or nothing to gain.

use std::time::Duration;

use super::Escalation;
use crate::context::Cancelled;
use crate::mesh::Surface;
use crate::repair::estimate::least_duration;
use crate::repair::forecast::Forecast;
use crate::repair::judge::{Judging, rank_of_input};
use crate::repair::method_agreement::Method;
use crate::repair::operators::remesh::RemeshInside;
use crate::repair::operators::{Counter, Counts};
use crate::repair::options::Operator;
use crate::repair::presets::{remesh_of, tier_of};
use crate::repair::red_flags::AddedSurface;
use crate::repair::report::{Action, OmittedSection, RedFlag, RedFlagCode, SkipReason, Step, Strategy, When};
use crate::repair::runner::Runner;
use crate::repair::tasks::{IndexedStrategy, SurfaceState, Task};

impl Escalation<'_> {
    /// The step of a strategy that is skipped because there is no time to run it and to verify its result.
    pub(super) fn skipped_for_time(&self, IndexedStrategy { index, strategy }: IndexedStrategy<'_>) -> Option<Step> {
        let Runner { context, time, .. } = self.runner;
        let faces = self.common_start.state.surface.faces.len();
        let time_left = time.for_operators(faces, context).remaining();
        // Without a result, even a strategy that is cut short may leave one.
        let least = match self.attempts.best {
            Some(_) => least_duration(strategy, self.input.original.measures()),
            None => Duration::ZERO,
        };
        if context.is_cancelled() || (!time_left.is_zero() && time_left >= least) {
            return None;
        }
        time.omit(OmittedSection::Repair);
        // The surface after the common start is better than no result.
        let has_improved_start = self.attempts.candidates.is_empty()
            && self.common_start.state.surface.faces != self.input.analysis.surface.faces;
        if has_improved_start && remesh_of(strategy).is_none() && time.can_verify(faces, context) {
            return None;
        }
        let last = last_action(strategy)?;
        let note = if time_left.is_zero() {
            "the deadline passed before this strategy could start".to_owned()
        } else {
            format!(
                "this strategy would overrun the deadline: it is expected to take at least {:.0} s",
                least.as_secs_f64()
            )
        };
        Some(Step::new(index, strategy.tier, last, None).skipped(SkipReason::OutOfTime, note))
    }

    /// The step of a strategy that is skipped because earlier results make it needless.
    pub(super) fn skipped_as_needless(&self, IndexedStrategy { index, strategy }: IndexedStrategy<'_>) -> Option<Step> {
        let whole = || self.attempts.best.as_ref().is_some_and(|(_, best)| best.is_whole());
        let why = match strategy.when {
            When::OpenSheetsRemain if !self.attempts.candidates.is_empty() && !self.may_have_open_sheets => {
                "earlier strategies left no surface open and lost no surface"
            }
            When::OpenSheetsRemain if self.is_tangled => {
                "too many faces intersected after another strategy had closed the open sheets"
            }
            _ if self.is_shredded && !matches!(Method::of(strategy), Some(Method::Grid | Method::Blender)) => {
                "an earlier strategy left the surface non-manifold nearly everywhere, which only a remesh can mend"
            }
            When::NothingClosed if whole() => "the best earlier result is closed and complete",
            _ if self.methods_agree && Method::of(strategy) == Some(Method::Blender) => {
                "independent methods agree on the red flags, so the input causes them"
            }
            _ if remesh_of(strategy) == Some(Action::VoxelRemesh) && self.has_printable_remesh => {
                "the native remesh already made a printable solid of the same space, so Blender would raise the same red flags"
            }
            _ if remesh_of(strategy) == Some(Action::VoxelRemesh) && self.is_remesh_hopeless => {
                "coarse remeshes showed that no remesh on a grid can reach a better result"
            }
            _ if remesh_of(strategy) == Some(Action::BooleanUnion)
                && has_boundary(&self.common_start.state.surface) =>
            {
                "a boolean union needs closed parts, and the parts have holes"
            }
            _ if self.encloses_other_volume()
                && matches!(Method::of(strategy), Some(Method::Grid | Method::Blender)) =>
            {
                "the strategy starts from the same closed holes, so it would enclose the same space"
            }
            _ => return None,
        };
        let last = last_action(strategy)?;
        Some(Step::new(index, strategy.tier, last, None).skipped(SkipReason::Needless, why.to_owned()))
    }

    /// Whether the best result's only red flags concern the space that an open input's closed holes enclose.
    fn encloses_other_volume(&self) -> bool {
        let is_of_holes =
            |flag: &RedFlag| matches!(flag.code, RedFlagCode::VolumeChange | RedFlagCode::SurfaceInvented);
        let best = self.attempts.best.as_ref().map(|(_, best)| best);
        self.input.original.is_open()
            && best.is_some_and(|best| best.measures.printable() && best.red_flags.iter().all(is_of_holes))
    }

    /// The step of a strategy that is skipped because it needs Blender and Blender is missing.
    pub(super) fn skipped_without_blender(
        &self,
        IndexedStrategy { index, strategy }: IndexedStrategy<'_>,
    ) -> Option<Step> {
        let action = remesh_of(strategy)?;
        let remesher = self.runner.remesher;
        let missing = remesher.map_or(Err("Blender is not installed on this server"), |r| r.info().map(drop)).err()?;
        let why = format!("{missing}; the best result without tier 3 is returned");
        Some(Step::new(index, 3, action, None).skipped(SkipReason::Unavailable, why))
    }

    /// The step of a native remesh that is skipped because a forecast shows that it cannot beat the best result. The first result of a
    /// repair is never skipped.
    pub(super) fn skipped_by_forecast(
        &mut self,
        IndexedStrategy { index, strategy }: IndexedStrategy<'_>,
        task: Task,
        state: &SurfaceState,
    ) -> Result<Option<Step>, Cancelled> {
        let Runner { options, format, context, time, .. } = self.runner;
        let faces = state.surface.faces.len();
        let is_forecast = task.operator == Some(Operator::Remesh)
            && !self.attempts.candidates.is_empty()
            && state.why_no_remesh().is_none()
            && time.can_verify(faces, context);
        if !is_forecast {
            return Ok(None);
        }
        let start = context.now();
        let context = &time.for_operators(faces, context);
        let judging = Judging { format, input: self.input.original, options, context };
        let remesh = RemeshInside::for_scope(&self.runner.scope(strategy, state.moved), &state.surface);
        let added = AddedSurface::of(&state.surface);
        let forecast = context.unless_late(Forecast::of(&remesh, &state.surface, &added, &judging))?.flatten();
        let Some(forecast) = forecast else { return Ok(None) };
        let input = rank_of_input(self.input.original.measures());
        let (class, _, lost, _) = self.attempts.best.as_ref().map_or(input, |(_, best)| best.rank().min(input));
        let is_better = forecast.class < class || (forecast.class == class && forecast.lost_tenths < lost);
        let may_be_explained = !self.findings.is_empty() && forecast.is_explainable();
        self.is_remesh_hopeless = !is_better && !may_be_explained;
        let milliseconds = context.now().saturating_sub(start).as_secs_f64() * 1e3;
        Ok(self.is_remesh_hopeless.then(|| {
            let note = format!("coarse remeshes show that a finer one would be no better: {}", forecast.text());
            let step = Step::new(index, tier_of(task.action), task.action, task.operator);
            Step { milliseconds, ..step.skipped(SkipReason::Needless, note) }
        }))
    }
}

/// The last action of a strategy before its validation.
fn last_action(strategy: &Strategy) -> Option<Action> {
    strategy.actions.iter().rev().map(|planned| planned.action).find(|&action| action != Action::Validate)
}

fn has_boundary(surface: &Surface) -> bool {
    Counts::of(surface).get(Counter::BoundaryEdges) > 0
}
