//! Runs the tasks of a strategy, and undoes an operator that raised a count of defects that it promises not to raise.

use std::sync::Arc;
use std::time::Duration;

use glam::DVec3;

use super::change::{Change, ChangeKind};
use super::operators::remesh::reduce_remeshed;
use super::operators::{Applied, Failure, Scope};
use super::options::{Operator, Options};
use super::presets::{remesh_action, tier_of};
use super::red_flags::AddedSurface;
use super::remesher::{RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher};
use super::report::{
    Action, NotAppliedCause, OmittedSection, OptionNotApplied, Step, StepStatus, Strategy, UnfixedFaces,
};
use super::tasks::{IndexedStrategy, SurfaceState, Task, closes_sheets, pairing_and_winding_rule};
use super::time_budget::TimeBudget;
use crate::context::{Cancelled, Context, Stage};
use crate::format::Format;
use crate::inspect::{Analysis, doubled_areas, thin_walls};
use crate::mesh::{NO_SOURCE, Surface, is_generated};
use crate::scene::{LengthUnit, Up};

/// Triangles of a remesh per area of a voxel's side: a surface of area A crosses at most 1.74 A / size^2 sides, and each side makes two
/// triangles.
const TRIANGLES_PER_VOXEL_AREA: f64 = 3.5;

/// Voxels across a thin wall. With fewer than two, a remesh has holes in the wall.
const VOXELS_PER_WALL: f64 = 3.0;
/// Largest factor by which thin walls may make voxels smaller than the resolution asks.
const MAX_REFINEMENT: f64 = 4.0;
/// Fewest voxels along the diagonal; with fewer, a model is no longer recognisable.
const MIN_VOXELS_ALONG_DIAGONAL: f64 = 16.0;

/// Largest share of the remaining time that is reserved for verifying Blender's result.
const MAX_RESERVED_SHARE: f64 = 0.5;

/// Runs the tasks of strategies.
#[derive(Clone, Copy)]
pub(super) struct Runner<'a> {
    /// The options of the repair.
    pub options: &'a Options,
    /// The input.
    pub input: &'a Analysis<'a>,
    /// The judging format.
    pub format: Format,
    /// Blender, if it is available.
    pub remesher: Option<&'a dyn Remesher>,
    /// The context of the repair.
    pub context: &'a Context<'a>,
    /// The division of the repair's time.
    pub time: &'a TimeBudget,
    /// The unit of the model.
    pub unit: &'a LengthUnit,
}

/// The result of running a task.
pub(super) struct TaskRun {
    /// The step for the report.
    pub step: Step,
    /// Why the operator could not do its work.
    pub failure: Option<Failure>,
    /// How the task ended.
    pub end: TaskEnd,
    /// Whether the surface changed.
    pub has_changed: bool,
}

/// The ending of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TaskEnd {
    /// The task ran; the strategy continues.
    Finished,
    /// A task that the rest of the strategy needs failed; the strategy has no result.
    Nothing,
    /// The deadline passed; the strategy's result is the surface so far.
    OutOfTime,
}

impl Runner<'_> {
    /// Runs a task. `percent` is the progress of the whole repair before the task.
    ///
    /// # Errors
    /// [`Cancelled`] if the job was canceled. A passed deadline is not an error here.
    pub fn run(
        &self,
        IndexedStrategy { index, strategy }: IndexedStrategy<'_>,
        Task { action, operator }: Task,
        percent: u8,
        state: &mut SurfaceState,
    ) -> Result<TaskRun, Cancelled> {
        let start = self.context.now();
        self.context.report(Stage::Repair, Some(strategy.tier), percent);
        let step = Step::new(index, tier_of(action), action, operator);
        let mut run = TaskRun { step, failure: None, end: TaskEnd::Finished, has_changed: false };
        let ended = match operator {
            Some(operator) => {
                let ended = self.run_operator(operator, strategy, state, &mut run);
                state.record_holes(&run.step);
                ended
            }
            None => self.remesh(action, percent, state, &mut run),
        };
        run.step.milliseconds = (self.context.now().saturating_sub(start)).as_secs_f64() * 1e3;
        match ended {
            Ok(()) => {}
            Err(Cancelled) if self.context.is_cancelled() => return Err(Cancelled),
            Err(Cancelled) => {
                self.time.omit(OmittedSection::Repair);
                run.fail("the deadline passed", TaskEnd::OutOfTime);
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
        let task = step.operator.map_or_else(|| format!("{:?}", step.action), |o| format!("{:?}/{o:?}", step.action));
        let mut line = format!("strategy {} {task}: {status} in {:.1} ms", step.strategy, step.milliseconds);
        for Change { kind, count } in &step.changed {
            line.push_str(&format!(", {kind} {count}"));
        }
        if let Some(note) = &step.note {
            line.push_str(&format!(" ({note})"));
        }
        self.context.log(&line);
    }

    /// Runs one operator, and undoes it if it raised a count that it promises not to raise.
    fn run_operator(
        &self,
        operator: Operator,
        strategy: &Strategy,
        state: &mut SurfaceState,
        run: &mut TaskRun,
    ) -> Result<(), Cancelled> {
        let context = &self.time.for_operators(state.surface.faces.len(), self.context);
        context.check()?;
        let scope = self.scope(strategy, state.moved);
        if let Some(why) = state.why_no_remesh().filter(|_| operator == Operator::Remesh) {
            run.fail(why, TaskEnd::Nothing);
            return Ok(());
        }
        let before = state.counts();
        let surface = &mut state.surface;
        if operator.is_needless(&before) && !surface.faces.is_empty() {
            let limits = limits_of(operator, self.options, surface.bounds().diagonal(), scope.max_deviation);
            run.step.options_not_applied = self.limited(limits);
            return Ok(());
        }
        let kept = Arc::clone(surface);
        let edges = state.edges();
        if operator.is_heavy() {
            state.edges = None;
        }
        let surface = &mut state.surface;
        let applied = operator.run(&scope, surface, edges, context);
        let mut applied = applied.inspect_err(|_| surface.clone_from(&kept))?;
        let limits = limits_of(operator, self.options, kept.bounds().diagonal(), scope.max_deviation);
        run.step.options_not_applied = self.limited(std::mem::take(&mut applied.limited).into_iter().chain(limits));
        let (moved, searched) = (applied.moved, applied.searched.take());
        self.record(applied, surface, run);
        run.has_changed = !Arc::ptr_eq(surface, &kept) && *surface != kept;
        if !run.has_changed {
            surface.clone_from(&kept);
        }
        if operator == Operator::Remesh && run.has_changed {
            state.added_surface = Some(AddedSurface::of(&kept));
        }
        if run.has_changed
            && let Some(note) = state.complete_change(operator, &before, kept)
        {
            run.step.status = StepStatus::Reverted;
            run.step.note = Some(note);
            run.has_changed = false;
        } else if run.has_changed {
            state.moved += moved;
            state.searched = searched.or(state.searched.take());
        }
        if let Some(why) = &run.failure {
            run.step.status = StepStatus::Failed;
            run.step.note = Some(why.to_string());
        }
        if state.surface.faces.is_empty() {
            run.fail("no face is left", TaskEnd::Nothing);
        }
        Ok(())
    }

    /// The entries of a step for options that its operator followed in part.
    fn limited(&self, limits: impl IntoIterator<Item = (&'static str, String)>) -> Vec<OptionNotApplied> {
        let entry = |(option, reason)| OptionNotApplied::new(self.options, option, NotAppliedCause::Limited, reason);
        limits.into_iter().map(entry).collect()
    }

    /// Records in a step what its operator changed.
    fn record(&self, applied: Applied, surface: &Surface, run: &mut TaskRun) {
        let step = &mut run.step;
        step.unfixed = unfixed_faces(&applied.unfixed, surface);
        (step.changed, step.moved, step.note) = (applied.changes, applied.moved, applied.left);
        (step.voxel_size, step.thickening, step.vents) = (applied.voxel_size, applied.thickening, applied.vents);
        run.failure = applied.failed;
        if applied.is_late {
            self.time.omit(OmittedSection::Repair);
        }
    }

    /// The scope of a strategy's operators, after vertices were already moved by up to `moved`.
    pub fn scope(&self, strategy: &Strategy, moved: f64) -> Scope<'_> {
        let (pairing, winding_rule) = pairing_and_winding_rule(strategy, self.options);
        let max_deviation = self.options.max_deviation.map_or(f64::INFINITY, |most| (most - moved).max(0.0));
        Scope {
            options: self.options,
            input: self.input,
            format: self.format,
            pairing,
            winding_rule,
            closes_sheets: closes_sheets(strategy),
            millimetres: self.unit.used.millimetres(),
            up: if self.unit.up == Some(Up::Y) { DVec3::Y } else { DVec3::Z },
            max_deviation,
        }
    }

    /// Remeshes the surface with Blender.
    fn remesh(
        &self,
        action: Action,
        percent: u8,
        state: &mut SurfaceState,
        run: &mut TaskRun,
    ) -> Result<(), Cancelled> {
        (state.counts, state.edges) = (None, None);
        let context = self.time.for_operators(state.surface.faces.len(), self.context);
        if let Some(why) = state.why_no_remesh() {
            run.fail(why, TaskEnd::Nothing);
            return Ok(());
        }
        state.added_surface = Some(AddedSurface::of(&state.surface));
        context.check()?;
        run.has_changed = true;
        let surface = &mut state.surface;
        let (Some(remesher), Some(action)) = (self.remesher, remesh_action(action)) else {
            run.end = TaskEnd::Nothing;
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
        run.step.voxel_size = voxels.as_ref().map(|voxels| voxels.size);
        if let Some(why) = voxels.as_ref().and_then(|voxels| voxels.too_coarse(self.options)) {
            run.fail(why, TaskEnd::Nothing);
            return Ok(());
        }
        let Voxels { size: voxel_size, coarsest, faces } = voxels.unwrap_or_default();
        // An unverified result is useless, so time is reserved. Most of its faces may be removed before the verification.
        let reserve = self.time.verification(faces).min(self.context.remaining().mul_f64(MAX_RESERVED_SHARE));
        let time_limit = self.context.leaving(reserve).remaining().max(Duration::from_millis(1));
        let max_faces = self.options.max_remesh_faces;
        let request = RemeshRequest { soup: &soup, action, voxel_size, coarsest, max_faces, time_limit, percent };
        let runs = remesher.runs();
        let result = remesher.remesh(&request, self.context).and_then(|remeshed| {
            let (new_surface, _) = Surface::from_soup(&remeshed.soup);
            if new_surface.faces.is_empty() { Err(RemeshError::Empty) } else { Ok((new_surface, remeshed)) }
        });
        run.step.runs = remesher.runs() - runs;
        match result {
            Ok((mut new_surface, remeshed)) => {
                self.reduce(&mut new_surface, remeshed, surface, &mut run.step)?;
                *surface = Arc::new(new_surface);
            }
            Err(error) => run.fail(error.to_string(), TaskEnd::Nothing),
        }
        Ok(())
    }

    /// Removes needless faces of a remesh: a voxel grid makes small faces everywhere, even in flat areas.
    fn reduce(
        &self,
        remesh: &mut Surface,
        remeshed: Remeshed,
        before: &Surface,
        step: &mut Step,
    ) -> Result<(), Cancelled> {
        remesh.source.fill(NO_SOURCE);
        step.voxel_size = remeshed.voxel_size.or(step.voxel_size);
        step.note = remeshed.note;
        step.changed = Change::list([(ChangeKind::FacesCreated, remesh.faces.len() as u64)]);
        let Some(voxel) = step.voxel_size.filter(|_| !self.options.without.contains(&Operator::Simplify)) else {
            return Ok(());
        };
        let context = &self.time.for_operators(remesh.faces.len(), self.context);
        let reduced = reduce_remeshed(remesh, before, voxel, self.format.precision(), context)?;
        step.changed.extend(reduced.changes);
        step.note = step.note.take().into_iter().chain(reduced.left).reduce(|a, b| format!("{a}; {b}"));
        if reduced.is_late {
            self.time.omit(OmittedSection::Repair);
        }
        Ok(())
    }
}

impl TaskRun {
    /// Marks the step as failed, with the reason and the ending of the task.
    fn fail(&mut self, why: impl Into<String>, end: TaskEnd) {
        self.step.status = StepStatus::Failed;
        self.step.note = Some(why.into());
        self.end = end;
    }
}

/// The options that an operator could follow only in part, because vertices may move by no more than `reach`, with the reasons.
fn limits_of(operator: Operator, options: &Options, diagonal: f64, reach: f64) -> Vec<(&'static str, String)> {
    let defaults = Options::default();
    let threshold = options.stitch_threshold.filter(|_| options.stitch_distance.is_none());
    let requested = match operator {
        Operator::MergeVertices => ("merge_distance", options.merge_distance),
        Operator::Weld if options.weld_tolerance != defaults.weld_tolerance => {
            ("weld_tolerance", Some(options.weld_tolerance * diagonal))
        }
        Operator::Stitch if threshold.is_some() => ("stitch_threshold", threshold.map(|share| share * diagonal)),
        Operator::Stitch => ("stitch_distance", options.stitch_distance),
        Operator::RemoveSlivers if options.degenerate_tolerance != defaults.degenerate_tolerance => {
            ("degenerate_tolerance", Some(options.degenerate_tolerance * diagonal))
        }
        Operator::ThickenSheets | Operator::AddBase => ("thickness", options.thickness),
        _ => return Vec::new(),
    };
    let (name, Some(length)) = requested else { return Vec::new() };
    if length <= reach {
        return Vec::new();
    }
    vec![(
        name,
        format!(
            "`max_deviation` allows surface to move by only {reach} more; this length was used instead of {length}"
        ),
    )]
}

/// Most faces that a step lists.
const MAX_UNFIXED: usize = 1000;

/// The faces that an operator could not fix, as indices of the input faces that they come from; none if there are none.
fn unfixed_faces(unfixed: &[u32], surface: &Surface) -> Option<UnfixedFaces> {
    let source = |&f: &u32| surface.source.get(f as usize).copied().filter(|&source| !is_generated(source));
    let mut faces: Vec<u32> = unfixed.iter().filter_map(source).collect();
    faces.sort_unstable();
    faces.dedup();
    let count = faces.len() as u64;
    faces.truncate(MAX_UNFIXED);
    (count > 0).then_some(UnfixedFaces { count, faces })
}

/// The voxel size of a remesh. Lengths are in the model's unit.
#[derive(Default)]
struct Voxels {
    /// Edge length.
    size: f64,
    /// Largest useful edge length.
    coarsest: f64,
    /// Estimate of the most faces that the remesh makes.
    faces: usize,
}

impl Voxels {
    /// Chooses the voxel size: `voxel_size`, or a size from `voxel_resolution` that shrinks for thin walls. The size then grows until
    /// the estimated number of faces is within `max_remesh_faces`.
    fn of(surface: &Surface, options: &Options, context: &Context<'_>) -> Result<Self, Cancelled> {
        let diagonal = surface.bounds().diagonal();
        let wanted = match options.voxel_size {
            Some(size) => size,
            None => {
                let defaults = diagonal / f64::from(options.voxel_resolution);
                let thin = thin_walls(&Analysis::new((&surface.to_soup()).into(), context)?, context)?;
                thin.map_or(defaults, |thin| (thin / VOXELS_PER_WALL).clamp(defaults / MAX_REFINEMENT, defaults))
            }
        };
        let area: f64 = doubled_areas(surface).iter().sum::<f64>() / 2.0;
        let size = wanted.max((TRIANGLES_PER_VOXEL_AREA * area / options.max_remesh_faces as f64).sqrt());
        let faces = (TRIANGLES_PER_VOXEL_AREA * area / (size * size)).min(options.max_remesh_faces as f64) as usize;
        Ok(Self { size, coarsest: size.max(diagonal / MIN_VOXELS_ALONG_DIAGONAL), faces })
    }

    /// Why no remesh starts: the voxels would have to be too large. None if they are small enough.
    fn too_coarse(&self, options: &Options) -> Option<String> {
        let is_requested = options.voxel_size.is_some_and(|requested| requested >= self.size);
        (!is_requested && self.size >= self.coarsest && self.size > 0.0).then(|| {
            format!(
                "a remesh with at most {} faces needs voxels of size {}, too large for this model; raise `max_remesh_faces`",
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
    fn unfixed_faces_do_not_include_faces_that_the_repair_created() {
        let source = vec![7, NO_SOURCE, SKIN_SOURCE, OPENED_SKIN_SOURCE, BASE_SOURCE, 3];
        let surface = Surface { faces: vec![[0, 1, 2]; source.len()], source, ..Surface::default() };
        assert_eq!(unfixed_faces(&[0, 1, 2, 3, 4, 5], &surface), Some(UnfixedFaces { count: 2, faces: vec![3, 7] }));
        assert_eq!(unfixed_faces(&[1, 2], &surface), None);
    }
}
