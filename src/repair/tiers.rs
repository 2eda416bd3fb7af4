use std::time::Duration;

use super::invented::Invented;
use super::operators::cut::Pairing;
use super::operators::simplify::reduce_remeshed;
use super::operators::{Applied, Counts, Operator, Scope};
use super::options_not_applied::limits_of;
use super::presets::{remesh_action, tier_of};
use super::time_budget::TimeBudget;
use super::{
    Action, Cancelled, Change, ChangeKind, Context, InsideRule, LeftOut, NotAppliedCause, OptionNotApplied, Options,
    RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, Rung, Stage, Step, StepStatus, UnfixedFaces,
};
use crate::arrange::Inside;
use crate::format::Format;
use crate::inspect::{Analysis, doubled_areas, thin_walls};
use crate::mesh::{NO_SOURCE, Surface, is_made};

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

/// Runs what rungs are made of.
pub(super) struct Runner<'a> {
    pub options: &'a Options,
    pub format: Format,
    pub remesher: Option<&'a dyn Remesher>,
    pub context: &'a Context<'a>,
    pub time: &'a TimeBudget,
}

/// An operator of an action, or the action's remesh.
#[derive(Debug, Clone, Copy)]
pub(super) struct Task {
    pub action: Action,
    pub operator: Option<Operator>,
}

/// What tells, beside the surface, what an operator makes of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Key {
    operator: Operator,
    pairing: Option<Pairing>,
    inside: Option<Inside>,
    closes_sheets: Option<bool>,
}

/// How far a rung came.
#[derive(Debug, Clone)]
pub(super) struct Place {
    pub surface: Surface,
    /// The counts of the surface, where they are known.
    pub counts: Option<Counts>,
    /// How far operators since the input may have moved a vertex, in the model's unit.
    pub moved: f64,
    /// Holes of solids that stay open, since the options close none so large or so many.
    pub over_limit: u64,
    /// What was invented before the surface was made anew, which leaves no trace of it.
    pub invented: Option<Invented>,
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

impl Place {
    /// Where repairs start.
    pub fn new(surface: Surface) -> Self {
        Self { surface, counts: None, moved: 0.0, over_limit: 0, invented: None }
    }

    /// Notes which holes a step left open, also one that was reused from an earlier strategy.
    pub fn note_holes(&mut self, step: &Step) {
        if step.operator == Some(Operator::FillHoles) {
            self.over_limit =
                step.changed.iter().find(|it| it.what == ChangeKind::HolesOverLimit).map_or(0, |it| it.count);
        }
    }

    /// Why nothing may close the holes that are open; none where nothing speaks against it.
    fn why_left_open(&self) -> Option<String> {
        (self.over_limit > 0).then(|| {
            format!(
                "it would close {} holes that max_hole_edges, max_hole_size or max_holes leaves open",
                self.over_limit
            )
        })
    }
}

impl Task {
    /// What a rung does, but for `Validate`, in order; its first `from` actions left out.
    pub fn of(rung: &Rung, from: usize) -> Vec<Self> {
        let tasks = rung.actions.get(from..).unwrap_or_default().iter().flat_map(|planned| {
            let remesh = remesh_action(planned.action).map(|_| None);
            let operators = planned.operators.iter().map(|&o| Some(o)).chain(remesh);
            operators.map(|operator| Self { action: planned.action, operator })
        });
        tasks.collect()
    }

    /// What tells what its operator makes of a surface, in a rung; none for a remesh.
    pub fn key(self, rung: &Rung, options: &Options) -> Option<Key> {
        let operator = self.operator?;
        let (pairing, inside) = ways_of(rung, options);
        Some(Key {
            operator,
            pairing: (operator == Operator::CutApart).then_some(pairing),
            inside: matches!(operator, Operator::Resolve | Operator::Remesh).then_some(inside),
            closes_sheets: (operator == Operator::Resolve).then(|| closes_sheets(rung)),
        })
    }
}

/// The two ways of `auto` differ in how faces are paired around edges, and in what is turned inside out: one keeps it, the
/// other drops it, unless the options say what is inside.
fn ways_of(rung: &Rung, options: &Options) -> (Pairing, Inside) {
    let mends = rung.actions.iter().any(|planned| planned.action == Action::Mend);
    let (pairing, inside) =
        if mends { (Pairing::Angular, Inside::Nonzero) } else { (Pairing::FinsLast, Inside::Positive) };
    let inside = match options.inside {
        InsideRule::Auto => inside,
        InsideRule::Positive => Inside::Positive,
        InsideRule::Nonzero => Inside::Nonzero,
        InsideRule::Odd => Inside::Odd,
    };
    (pairing, inside)
}

/// Whether a rung takes parts that are inside out for solid.
pub(super) fn takes_inverted_for_solid(rung: &Rung, options: &Options) -> bool {
    ways_of(rung, options).1 != Inside::Positive
}

/// Whether a rung makes open sheets solid.
fn closes_sheets(rung: &Rung) -> bool {
    rung.actions.iter().any(|planned| planned.action == Action::CloseSheets)
}

impl Runner<'_> {
    /// Runs a task. `percent` of the whole repair is taken to be done before it. Answers what it did, how it ended, and whether
    /// it changed the surface.
    ///
    /// # Errors
    /// [`Cancelled`] when the job was canceled; the end of time is no error here.
    pub fn run(
        &self,
        index: u32,
        rung: &Rung,
        Task { action, operator }: Task,
        percent: u8,
        place: &mut Place,
    ) -> Result<(Step, End, bool), Cancelled> {
        let start = self.context.now();
        let mut step = Step::new(index, tier_of(action), action, operator);
        self.context.report(Stage::Repair, Some(rung.tier), percent);
        let end = match operator {
            Some(operator) => {
                let ended = self.operate(operator, rung, place, &mut step);
                place.note_holes(&step);
                ended
            }
            None => {
                place.counts = None;
                let context = self.time.for_operators(place.surface.faces.len(), self.context);
                if let Some(why) = place.why_left_open() {
                    step.status = StepStatus::Failed;
                    step.note = Some(why);
                    Ok((End::Nothing, false))
                } else {
                    place.invented = Some(Invented::of(&place.surface));
                    let remeshed =
                        context.check().and_then(|()| self.remesh(action, percent, &mut place.surface, &mut step));
                    remeshed.map(|end| (end, true))
                }
            }
        };
        step.milliseconds = (self.context.now().saturating_sub(start)).as_secs_f64() * 1e3;
        let (end, changed) = match end {
            Ok(end) => end,
            Err(Cancelled) if self.context.is_cancelled() => return Err(Cancelled),
            Err(Cancelled) => {
                self.time.leave_out(LeftOut::Repair);
                step.status = StepStatus::Failed;
                step.note = Some("the time was over".to_owned());
                (End::OutOfTime, false)
            }
        };
        self.log(&step);
        Ok((step, end, changed))
    }

    /// Writes a step to the job's log.
    pub fn log(&self, step: &Step) {
        let status = match step.status {
            StepStatus::Done => "done",
            StepStatus::Undone => "undone",
            StepStatus::Failed => "failed",
            StepStatus::Skipped => "skipped",
        };
        let what = step.operator.map_or_else(|| format!("{:?}", step.action), |o| format!("{:?}/{o:?}", step.action));
        let mut line = format!("rung {} {what}: {status} in {:.1} ms", step.rung, step.milliseconds);
        for Change { what, count } in &step.changed {
            line.push_str(&format!(", {what} {count}"));
        }
        if let Some(note) = &step.note {
            line.push_str(&format!(" ({note})"));
        }
        self.context.log(&line);
    }

    /// Runs one operator, and takes it back where it broke its claim. Whether it changed the surface.
    fn operate(
        &self,
        operator: Operator,
        rung: &Rung,
        place: &mut Place,
        step: &mut Step,
    ) -> Result<(End, bool), Cancelled> {
        let context = &self.time.for_operators(place.surface.faces.len(), self.context);
        context.check()?;
        let scope = self.scope(rung, place.moved);
        if let Some(why) = place.why_left_open().filter(|_| operator == Operator::Remesh) {
            step.status = StepStatus::Failed;
            step.note = Some(why);
            return Ok((End::Nothing, false));
        }
        let Place { surface, counts, moved: moved_before, invented, .. } = place;
        let before = counts.get_or_insert_with(|| Counts::of(surface)).to_owned();
        let kept = surface.clone();
        let applied = operator.run(&scope, surface, context);
        let Applied { changes, moved, left, failed, limited, unfixed, voxel_size, is_late } =
            applied.inspect_err(|_| surface.clone_from(&kept))?;
        let limits = limits_of(operator, self.options, kept.bounds().diagonal(), scope.max_deviation);
        let limited = limited.into_iter().chain(limits);
        step.options_not_applied = limited
            .map(|(option, reason)| OptionNotApplied::new(self.options, option, NotAppliedCause::Limited, reason))
            .collect();
        step.unfixed = unfixed_faces(&unfixed, surface);
        step.changed = changes;
        step.moved = moved;
        step.note = left;
        step.voxel_size = voxel_size;
        if is_late {
            self.time.leave_out(LeftOut::Repair);
        }
        let mut changed = *surface != kept;
        if operator == Operator::Remesh && changed {
            *invented = Some(Invented::of(&kept));
        }
        if changed {
            surface.drop_unreferenced();
            let after = Counts::of(surface);
            if let Some((counter, was, is)) = operator.broken_claim(&before, &after) {
                step.status = StepStatus::Undone;
                step.note = Some(format!("undone: it would have made {} out of {was} {}", is, counter.in_words()));
                *surface = kept;
                changed = false;
            } else {
                *counts = Some(after);
                *moved_before += moved;
            }
        }
        if let Some(why) = failed {
            step.status = StepStatus::Failed;
            step.note = Some(why.to_string());
            step.failure = Some(why);
        }
        if surface.faces.is_empty() {
            step.status = StepStatus::Failed;
            step.note = Some("no face was left".to_owned());
            return Ok((End::Nothing, changed));
        }
        Ok((End::Finished, changed))
    }

    /// What the parameters of a rung's operators follow from, where vertices were moved so far already.
    fn scope(&self, rung: &Rung, moved: f64) -> Scope<'_> {
        let (pairing, inside) = ways_of(rung, self.options);
        let max_deviation = self.options.max_deviation.map_or(f64::INFINITY, |most| (most - moved).max(0.0));
        Scope {
            options: self.options,
            format: self.format,
            pairing,
            inside,
            closes_sheets: closes_sheets(rung),
            max_deviation,
        }
    }

    fn remesh(&self, action: Action, percent: u8, surface: &mut Surface, step: &mut Step) -> Result<End, Cancelled> {
        let (Some(remesher), Some(remesh)) = (self.remesher, remesh_action(action)) else { return Ok(End::Nothing) };
        step.program = remesher.info().ok().cloned();
        let soup = surface.to_soup();
        let voxels = match remesh {
            RemeshAction::VoxelRemesh => {
                let context = self.time.for_operators(surface.faces.len(), self.context);
                Some(Voxels::of(surface, self.options, &context)?)
            }
            RemeshAction::BooleanUnion => None,
        };
        step.voxel_size = voxels.as_ref().map(|it| it.size);
        if let Some(why) = voxels.as_ref().and_then(|it| it.too_coarse(self.options)) {
            step.status = StepStatus::Failed;
            step.note = Some(why);
            return Ok(End::Nothing);
        }
        let Voxels { size: voxel_size, coarsest, faces } = voxels.unwrap_or_default();
        // A result that can't be verified is worth nothing, and most of its faces may go before that.
        let reserve = self.time.verification(faces).min(self.context.remaining().mul_f64(MOST_RESERVED));
        let time_limit = self.context.leaving(reserve).remaining().max(Duration::from_millis(1));
        let request = RemeshRequest {
            soup: &soup,
            action: remesh,
            voxel_size,
            coarsest,
            max_faces: self.options.max_remesh_faces,
            time_limit,
            percent,
        };
        let runs = remesher.runs();
        let made = remesher.remesh(&request, self.context).and_then(|remeshed| {
            let (made, _) = Surface::from_soup(&remeshed.soup);
            if made.faces.is_empty() { Err(RemeshError::Empty) } else { Ok((made, remeshed)) }
        });
        step.runs = remesher.runs() - runs;
        Ok(match made {
            Ok((mut made, Remeshed { voxel_size, note, .. })) => {
                made.source.fill(NO_SOURCE);
                step.voxel_size = voxel_size.or(step.voxel_size);
                step.note = note;
                step.changed = Change::list([(ChangeKind::FacesMade, made.faces.len() as u64)]);
                if let Some(voxel) = step.voxel_size.filter(|_| !self.options.without.contains(&Operator::Simplify)) {
                    let precision = self.format.precision();
                    // What it makes has faces along the axes everywhere; the same lines, with as few faces as they need.
                    let context = &self.time.for_operators(made.faces.len(), self.context);
                    let reduced = reduce_remeshed(&mut made, surface, voxel, precision, context)?;
                    step.changed.extend(reduced.changes);
                    step.note = step.note.take().into_iter().chain(reduced.left).reduce(|a, b| format!("{a}; {b}"));
                    if reduced.is_late {
                        self.time.leave_out(LeftOut::Repair);
                    }
                }
                *surface = made;
                End::Finished
            }
            Err(error) => {
                step.status = StepStatus::Failed;
                step.note = Some(error.to_string());
                End::Nothing
            }
        })
    }
}

/// Most faces that a step lists.
const MAX_UNFIXED: usize = 1000;

/// Faces that an operator could not fix, as the faces of the input that they come from.
fn unfixed_faces(unfixed: &[u32], surface: &Surface) -> Option<UnfixedFaces> {
    let source = |&f: &u32| surface.source.get(f as usize).copied().filter(|&source| !is_made(source));
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
