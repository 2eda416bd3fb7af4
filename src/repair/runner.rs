//! Runs the tasks of a strategy, and takes back an operator that broke its claim.

use std::time::Duration;

use super::change::{Change, ChangeKind};
use super::operators::remesh::reduce_remeshed;
use super::operators::{Applied, Counts, Failure, Scope};
use super::options::{Operator, Options};
use super::presets::{remesh_action, tier_of};
use super::red_flags::Invented;
use super::remesher::{RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher};
use super::report::{
    Action, NotAppliedCause, OmittedSection, OptionNotApplied, Step, StepStatus, Strategy, UnfixedFaces,
};
use super::tasks::{IndexedStrategy, State, Task, closes_sheets, ways_of};
use super::time_budget::TimeBudget;
use crate::context::{Cancelled, Context, Stage};
use crate::format::Format;
use crate::inspect::{Analysis, doubled_areas, thin_walls};
use crate::mesh::{NO_SOURCE, Surface, is_generated};

/// Shares of a voxel's side in a triangle: a surface of area A meets at most 1.74 A / size^2 voxel sides, each two
/// triangles.
const TRIANGLES_PER_VOXEL_AREA: f64 = 3.5;

/// Voxels that go across thin walls: with fewer than two a remesh has holes there.
const VOXELS_A_WALL: f64 = 3.0;
/// How much smaller than the resolution says thin walls may make voxels.
const MOST_FINER: f64 = 4.0;
/// Voxels along the diagonal below which nothing of a model would be left to see.
const LEAST_VOXELS: f64 = 16.0;

/// Share of the time left that is kept for verifying what Blender makes, at most.
const MOST_RESERVED: f64 = 0.5;

/// Runs what strategies are made of.
#[derive(Clone, Copy)]
pub(super) struct Runner<'a> {
    pub options: &'a Options,
    pub format: Format,
    pub remesher: Option<&'a dyn Remesher>,
    pub context: &'a Context<'a>,
    pub time: &'a TimeBudget,
}

/// How a task went.
pub(super) struct TaskRun {
    pub step: Step,
    /// Why its operator did nothing, where it should have.
    pub failure: Option<Failure>,
    pub end: End,
    pub has_changed: bool,
}

/// How a task ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    /// It did what it could.
    Finished,
    /// What the rest leans on did not run; there is no result.
    Nothing,
    /// The time was over; the surface is as far as it came.
    OutOfTime,
}

impl Runner<'_> {
    /// Runs a task. `percent` of the whole repair is taken to be done before it.
    ///
    /// # Errors
    /// [`Cancelled`] when the job was canceled; the end of time is no error here.
    pub fn run(
        &self,
        IndexedStrategy { index, strategy }: IndexedStrategy<'_>,
        Task { action, operator }: Task,
        percent: u8,
        state: &mut State,
    ) -> Result<TaskRun, Cancelled> {
        let start = self.context.now();
        self.context.report(Stage::Repair, Some(strategy.tier), percent);
        let step = Step::new(index, tier_of(action), action, operator);
        let mut run = TaskRun { step, failure: None, end: End::Finished, has_changed: false };
        let ended = match operator {
            Some(operator) => {
                let ended = self.operate(operator, strategy, state, &mut run);
                state.note_holes(&run.step);
                ended
            }
            None => self.remesh(action, percent, state, &mut run),
        };
        run.step.milliseconds = (self.context.now().saturating_sub(start)).as_secs_f64() * 1e3;
        match ended {
            Ok(()) => {}
            Err(Cancelled) if self.context.is_cancelled() => return Err(Cancelled),
            Err(Cancelled) => {
                self.time.leave_out(OmittedSection::Repair);
                run.fail("the time was over", End::OutOfTime);
                run.has_changed = false;
            }
        }
        self.log(&run.step);
        Ok(run)
    }

    /// Writes a step to the job's log.
    pub fn log(&self, step: &Step) {
        let status = match step.status {
            StepStatus::Done => "done",
            StepStatus::Reverted => "undone",
            StepStatus::Failed => "failed",
            StepStatus::Skipped => "skipped",
        };
        let what = step.operator.map_or_else(|| format!("{:?}", step.action), |o| format!("{:?}/{o:?}", step.action));
        let mut line = format!("strategy {} {what}: {status} in {:.1} ms", step.strategy, step.milliseconds);
        for Change { kind: what, count } in &step.changed {
            line.push_str(&format!(", {what} {count}"));
        }
        if let Some(note) = &step.note {
            line.push_str(&format!(" ({note})"));
        }
        self.context.log(&line);
    }

    /// Runs one operator, and takes it back where it broke its claim.
    fn operate(
        &self,
        operator: Operator,
        strategy: &Strategy,
        state: &mut State,
        run: &mut TaskRun,
    ) -> Result<(), Cancelled> {
        let context = &self.time.for_operators(state.surface.faces.len(), self.context);
        context.check()?;
        let scope = self.scope(strategy, state.moved);
        if let Some(why) = state.why_left_open().filter(|_| operator == Operator::Remesh) {
            run.fail(why, End::Nothing);
            return Ok(());
        }
        let State { surface, counts, .. } = state;
        let before = counts.get_or_insert_with(|| Counts::of(surface)).to_owned();
        let kept = surface.clone();
        let applied = operator.run(&scope, surface, context);
        let mut applied = applied.inspect_err(|_| surface.clone_from(&kept))?;
        let limits = limits_of(operator, self.options, kept.bounds().diagonal(), scope.max_deviation);
        let limited = std::mem::take(&mut applied.limited).into_iter().chain(limits);
        run.step.options_not_applied = limited
            .map(|(option, reason)| OptionNotApplied::new(self.options, option, NotAppliedCause::Limited, reason))
            .collect();
        let moved = applied.moved;
        self.note(applied, surface, run);
        run.has_changed = *surface != kept;
        if operator == Operator::Remesh && run.has_changed {
            state.invented = Some(Invented::of(&kept));
        }
        if run.has_changed {
            surface.drop_unreferenced();
            let after = Counts::of(surface);
            if let Some((counter, was, is)) = operator.broken_claim(&before, &after) {
                run.step.status = StepStatus::Reverted;
                run.step.note = Some(format!("undone: it would have made {} out of {was} {}", is, counter.in_words()));
                *surface = kept;
                run.has_changed = false;
            } else {
                *counts = Some(after);
                state.moved += moved;
            }
        }
        if let Some(why) = &run.failure {
            run.step.status = StepStatus::Failed;
            run.step.note = Some(why.to_string());
        }
        if surface.faces.is_empty() {
            run.fail("no face was left", End::Nothing);
        }
        Ok(())
    }

    /// Notes in a step what its operator did.
    fn note(&self, applied: Applied, surface: &Surface, run: &mut TaskRun) {
        let Applied { changes, moved, left, failed, unfixed, voxel_size, is_late, limited: _ } = applied;
        let step = &mut run.step;
        step.unfixed = unfixed_faces(&unfixed, surface);
        (step.changed, step.moved, step.note, step.voxel_size) = (changes, moved, left, voxel_size);
        run.failure = failed;
        if is_late {
            self.time.leave_out(OmittedSection::Repair);
        }
    }

    /// What the parameters of a strategy's operators follow from, where vertices were moved so far already.
    fn scope(&self, strategy: &Strategy, moved: f64) -> Scope<'_> {
        let (pairing, winding_rule) = ways_of(strategy, self.options);
        let max_deviation = self.options.max_deviation.map_or(f64::INFINITY, |most| (most - moved).max(0.0));
        Scope {
            options: self.options,
            format: self.format,
            pairing,
            winding_rule,
            closes_sheets: closes_sheets(strategy),
            max_deviation,
        }
    }

    /// Has Blender make the surface anew.
    fn remesh(&self, action: Action, percent: u8, state: &mut State, run: &mut TaskRun) -> Result<(), Cancelled> {
        state.counts = None;
        let context = self.time.for_operators(state.surface.faces.len(), self.context);
        if let Some(why) = state.why_left_open() {
            run.fail(why, End::Nothing);
            return Ok(());
        }
        state.invented = Some(Invented::of(&state.surface));
        context.check()?;
        run.has_changed = true;
        let surface = &mut state.surface;
        let (Some(remesher), Some(action)) = (self.remesher, remesh_action(action)) else {
            run.end = End::Nothing;
            return Ok(());
        };
        run.step.program = remesher.info().ok().cloned();
        let soup = surface.to_soup();
        let voxels = match action {
            RemeshAction::VoxelRemesh => {
                let context = self.time.for_operators(surface.faces.len(), self.context);
                Some(Voxels::of(surface, self.options, &context)?)
            }
            RemeshAction::BooleanUnion => None,
        };
        run.step.voxel_size = voxels.as_ref().map(|it| it.size);
        if let Some(why) = voxels.as_ref().and_then(|it| it.too_coarse(self.options)) {
            run.fail(why, End::Nothing);
            return Ok(());
        }
        let Voxels { size: voxel_size, coarsest, faces } = voxels.unwrap_or_default();
        // A result that can't be verified is worth nothing, and most of its faces may go before that.
        let reserve = self.time.verification(faces).min(self.context.remaining().mul_f64(MOST_RESERVED));
        let time_limit = self.context.leaving(reserve).remaining().max(Duration::from_millis(1));
        let max_faces = self.options.max_remesh_faces;
        let request = RemeshRequest { soup: &soup, action, voxel_size, coarsest, max_faces, time_limit, percent };
        let runs = remesher.runs();
        let made = remesher.remesh(&request, self.context).and_then(|remeshed| {
            let (made, _) = Surface::from_soup(&remeshed.soup);
            if made.faces.is_empty() { Err(RemeshError::Empty) } else { Ok((made, remeshed)) }
        });
        run.step.runs = remesher.runs() - runs;
        match made {
            Ok((mut made, remeshed)) => {
                self.reduce(&mut made, remeshed, surface, &mut run.step)?;
                *surface = made;
            }
            Err(error) => run.fail(error.to_string(), End::Nothing),
        }
        Ok(())
    }

    /// Removes the faces of a remesh that it does not need: it has faces along the axes everywhere; the same lines, with as few faces as
    /// they need.
    fn reduce(
        &self,
        made: &mut Surface,
        remeshed: Remeshed,
        before: &Surface,
        step: &mut Step,
    ) -> Result<(), Cancelled> {
        made.source.fill(NO_SOURCE);
        step.voxel_size = remeshed.voxel_size.or(step.voxel_size);
        step.note = remeshed.note;
        step.changed = Change::list([(ChangeKind::FacesCreated, made.faces.len() as u64)]);
        let Some(voxel) = step.voxel_size.filter(|_| !self.options.without.contains(&Operator::Simplify)) else {
            return Ok(());
        };
        let context = &self.time.for_operators(made.faces.len(), self.context);
        let reduced = reduce_remeshed(made, before, voxel, self.format.precision(), context)?;
        step.changed.extend(reduced.changes);
        step.note = step.note.take().into_iter().chain(reduced.left).reduce(|a, b| format!("{a}; {b}"));
        if reduced.is_late {
            self.time.leave_out(OmittedSection::Repair);
        }
        Ok(())
    }
}

impl TaskRun {
    /// Says why it failed, and how it ended.
    fn fail(&mut self, why: impl Into<String>, end: End) {
        self.step.status = StepStatus::Failed;
        self.step.note = Some(why.into());
        self.end = end;
    }
}

/// The options of which an operator could follow only a part, since vertices may move by no more than `reach`.
fn limits_of(operator: Operator, options: &Options, diagonal: f64, reach: f64) -> Vec<(&'static str, String)> {
    let usual = Options::default();
    let threshold = options.stitch_threshold.filter(|_| options.stitch_distance.is_none());
    let asked = match operator {
        Operator::MergeVertices => ("merge_distance", options.merge_distance),
        Operator::Weld if options.weld_tolerance != usual.weld_tolerance => {
            ("weld_tolerance", Some(options.weld_tolerance * diagonal))
        }
        Operator::Stitch if threshold.is_some() => ("stitch_threshold", threshold.map(|it| it * diagonal)),
        Operator::Stitch => ("stitch_distance", options.stitch_distance),
        Operator::RemoveSlivers if options.degenerate_tolerance != usual.degenerate_tolerance => {
            ("degenerate_tolerance", Some(options.degenerate_tolerance * diagonal))
        }
        Operator::ThickenSheets | Operator::AddBase => ("thickness", options.thickness),
        _ => return Vec::new(),
    };
    let (name, Some(length)) = asked else { return Vec::new() };
    if length <= reach {
        return Vec::new();
    }
    vec![(name, format!("`max_deviation` lets surface move by {reach} more, so that was used instead of {length}"))]
}

/// Most faces that a step lists.
const MAX_UNFIXED: usize = 1000;

/// Faces that an operator could not fix, as the faces of the input that they come from.
fn unfixed_faces(unfixed: &[u32], surface: &Surface) -> Option<UnfixedFaces> {
    let source = |&f: &u32| surface.source.get(f as usize).copied().filter(|&source| !is_generated(source));
    let mut faces: Vec<u32> = unfixed.iter().filter_map(source).collect();
    faces.sort_unstable();
    faces.dedup();
    let count = faces.len() as u64;
    faces.truncate(MAX_UNFIXED);
    (count > 0).then_some(UnfixedFaces { count, faces })
}

/// How large voxels are to be.
#[derive(Default)]
struct Voxels {
    /// Their edge.
    size: f64,
    /// The largest edge that still makes sense.
    coarsest: f64,
    /// How many faces they make at most, about.
    faces: usize,
}

impl Voxels {
    /// The voxel edge: as asked, or from the resolution, and smaller where walls are thin; then as large as the estimate of
    /// faces needs to keep the limit.
    fn of(surface: &Surface, options: &Options, context: &Context<'_>) -> Result<Self, Cancelled> {
        let diagonal = surface.bounds().diagonal();
        let wanted = match options.voxel_size {
            Some(size) => size,
            None => {
                let usual = diagonal / f64::from(options.voxel_resolution);
                let thin = thin_walls(&Analysis::new((&surface.to_soup()).into(), context)?, context)?;
                thin.map_or(usual, |thin| (thin / VOXELS_A_WALL).clamp(usual / MOST_FINER, usual))
            }
        };
        let area: f64 = doubled_areas(surface).iter().sum::<f64>() / 2.0;
        let size = wanted.max((TRIANGLES_PER_VOXEL_AREA * area / options.max_remesh_faces as f64).sqrt());
        let faces = (TRIANGLES_PER_VOXEL_AREA * area / (size * size)).min(options.max_remesh_faces as f64) as usize;
        Ok(Self { size, coarsest: size.max(diagonal / LEAST_VOXELS), faces })
    }

    /// Why no remesh is begun, where voxels would have to be too large.
    fn too_coarse(&self, options: &Options) -> Option<String> {
        let asked = options.voxel_size.is_some_and(|asked| asked >= self.size);
        (!asked && self.size >= self.coarsest && self.size > 0.0).then(|| {
            format!(
                "a remesh of at most {} faces would need voxels of {}, too large for the model; allow more faces with \
                 max_remesh_faces",
                options.max_remesh_faces, self.size
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{BASE_SOURCE, OPENED_SKIN_SOURCE, SKIN_SOURCE};

    #[test]
    fn faces_that_were_made_are_not_among_the_input_faces_that_could_not_be_fixed() {
        let source = vec![7, NO_SOURCE, SKIN_SOURCE, OPENED_SKIN_SOURCE, BASE_SOURCE, 3];
        let surface = Surface { faces: vec![[0, 1, 2]; source.len()], source, ..Surface::default() };
        assert_eq!(unfixed_faces(&[0, 1, 2, 3, 4, 5], &surface), Some(UnfixedFaces { count: 2, faces: vec![3, 7] }));
        assert_eq!(unfixed_faces(&[1, 2], &surface), None);
    }
}
