use std::time::Duration;

use super::operators::cut::Pairing;
use super::operators::simplify::reduce_remeshed;
use super::operators::{Applied, Counts, Operator, Scope};
use super::presets::{remesh_action, tier_of};
use super::{
    Action, Cancelled, Change, Context, InsideRule, Options, RemeshAction, RemeshError, RemeshRequest, Remeshed,
    Remesher, Rung, Stage, Step, StepStatus,
};
use crate::arrange::Inside;
use crate::format::Format;
use crate::inspect::{Analysis, doubled_areas, thin_walls};
use crate::mesh::Surface;

/// Shares of a voxel's side in a triangle: a surface of area A meets at most 1.74 A / size^2 voxel sides, each two
/// triangles.
const TRIANGLES_PER_VOXEL_AREA: f64 = 3.5;

/// Voxels that go across thin walls: with fewer than two a remesh has holes there.
const VOXELS_A_WALL: f64 = 3.0;
/// How much smaller than the resolution says thin walls may make voxels.
const MOST_FINER: f64 = 4.0;
/// Voxels along the diagonal below which nothing of a model would be left to see.
const LEAST_VOXELS: f64 = 16.0;

/// Runs what rungs are made of.
pub(super) struct Runner<'a> {
    pub options: &'a Options,
    pub format: Format,
    pub remesher: Option<&'a dyn Remesher>,
    pub context: &'a Context<'a>,
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

/// Whether a rung makes open sheets solid.
fn closes_sheets(rung: &Rung) -> bool {
    rung.actions.iter().any(|planned| planned.action == Action::CloseSheets)
}

impl Runner<'_> {
    /// Runs a task. `percent` of the whole repair is taken to be done before it. Answers what it did, how it ended, and whether
    /// it changed the surface.
    ///
    /// # Errors
    /// [`Cancelled`] when the job was cancelled; the end of time is no error here.
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
            Some(operator) => self.operate(operator, rung, place, &mut step),
            None => {
                place.counts = None;
                let remeshed =
                    self.context.check().and_then(|()| self.remesh(action, percent, &mut place.surface, &mut step));
                remeshed.map(|end| (end, true))
            }
        };
        step.milliseconds = (self.context.now().saturating_sub(start)).as_secs_f64() * 1e3;
        let (end, changed) = match end {
            Ok(end) => end,
            Err(Cancelled) if self.context.is_cancelled() => return Err(Cancelled),
            Err(Cancelled) => {
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
        self.context.check()?;
        let scope = self.scope(rung, place.moved);
        let Place { surface, counts, moved: moved_before } = place;
        let before = counts.get_or_insert_with(|| Counts::of(surface)).to_owned();
        let kept = surface.clone();
        let applied = operator.run(&scope, surface, self.context);
        let Applied { changes, moved, left, failed } = applied.inspect_err(|_| surface.clone_from(&kept))?;
        step.changed = changes;
        step.moved = moved;
        step.note = left;
        let mut changed = *surface != kept;
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
            step.note = Some(why);
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
        let reach = self.options.max_deviation.map_or(f64::INFINITY, |most| (most - moved).max(0.0));
        Scope { options: self.options, format: self.format, pairing, inside, closes_sheets: closes_sheets(rung), reach }
    }

    fn remesh(&self, action: Action, percent: u8, surface: &mut Surface, step: &mut Step) -> Result<End, Cancelled> {
        let (Some(remesher), Some(remesh)) = (self.remesher, remesh_action(action)) else { return Ok(End::Nothing) };
        step.program = remesher.info().ok().cloned();
        let soup = surface.to_soup();
        let voxels = match remesh {
            RemeshAction::VoxelRemesh => Some(Voxels::of(surface, self.options, self.context)?),
            RemeshAction::BooleanUnion => None,
        };
        step.voxel_size = voxels.as_ref().map(|it| it.size);
        if let Some(why) = voxels.as_ref().and_then(|it| it.too_coarse(self.options)) {
            step.status = StepStatus::Failed;
            step.note = Some(why);
            return Ok(End::Nothing);
        }
        let Voxels { size: voxel_size, coarsest, .. } = voxels.unwrap_or_default();
        let request = RemeshRequest {
            soup: &soup,
            action: remesh,
            voxel_size,
            coarsest,
            max_faces: self.options.max_remesh_faces,
            time_limit: self.context.remaining().max(Duration::from_millis(1)),
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
                made.source.fill(crate::mesh::NO_SOURCE);
                step.voxel_size = voxel_size.or(step.voxel_size);
                step.note = note;
                step.changed = Change::list([("faces_made", made.faces.len() as u64)]);
                if let Some(voxel) = step.voxel_size {
                    let to_f32 = self.format.is_single();
                    // What it makes has faces along the axes everywhere; the same lines, with as few faces as they need.
                    let (removed, _) = reduce_remeshed(&mut made, surface, voxel, to_f32, self.context)?;
                    step.changed.extend(removed);
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

/// How large voxels are to be.
#[derive(Default)]
struct Voxels {
    /// Their edge.
    size: f64,
    /// The largest edge that still makes sense.
    coarsest: f64,
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
        Ok(Self { size, coarsest: size.max(diagonal / LEAST_VOXELS) })
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
