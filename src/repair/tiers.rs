use std::ops::Range;
use std::time::Duration;

use super::cut::{Pairing, Pinches, cut_apart};
use super::debris::remove_debris;
use super::degenerate::{remove_caps, remove_collapsed};
use super::duplicates::remove_duplicates;
use super::holes::FillHoles;
use super::orient::orient;
use super::presets::{remesh_action, tier_of};
use super::quantise::quantise;
use super::resolve::resolve;
use super::separate::separate;
use super::weld::Weld;
use super::{
    Action, Cancelled, Change, Context, Options, RemeshError, RemeshRequest, Remesher, Rung, Stage, Step, StepStatus,
};
use crate::arrange::{Inside, ManifoldRust};
use crate::format::Format;
use crate::inspect::doubled_areas;
use crate::math::Box3;
use crate::mesh::Surface;

/// Shares of a voxel's side in a triangle: a surface of area A meets at most 1.74 A / size^2 voxel sides, each two
/// triangles.
const TRIANGLES_PER_VOXEL_AREA: f64 = 3.5;

/// Runs the actions of rungs and writes down what each did.
pub(super) struct Runner<'a> {
    pub options: &'a Options,
    pub format: Format,
    pub remesher: Option<&'a dyn Remesher>,
    pub context: &'a Context<'a>,
    pub steps: Vec<Step>,
}

/// How a list of actions ended.
pub(super) enum End {
    /// All that could run did.
    Finished,
    /// An action that the rest leans on did not run; there is no result.
    Nothing,
    /// The time was over; the surface is as far as it came.
    OutOfTime,
}

impl Runner<'_> {
    /// Runs all actions but `Validate` on `surface`, from number `from` on. `span` is the share of the whole repair, in
    /// percent, that they are taken to be.
    ///
    /// # Errors
    /// [`Cancelled`] when the job was cancelled; the end of time is no error here.
    pub fn run(
        &mut self,
        index: u32,
        rung: &Rung,
        from: usize,
        span: &Range<u8>,
        surface: &mut Surface,
    ) -> Result<End, Cancelled> {
        let actions = &rung.actions[from..];
        for (done, &action) in actions.iter().enumerate() {
            if action == Action::Validate {
                continue;
            }
            let start = self.context.now();
            let mut step = Step {
                rung: index,
                tier: tier_of(action),
                action,
                status: StepStatus::Done,
                milliseconds: 0.0,
                changed: Vec::new(),
                note: None,
                program: None,
                voxel_size: None,
            };
            self.context.report(Stage::Repair, Some(rung.tier), percent(span, done, actions.len()));
            let end = self.act(action, surface, &mut step);
            step.milliseconds = (self.context.now().saturating_sub(start)).as_secs_f64() * 1e3;
            let end = match end {
                Ok(end) => end,
                Err(Cancelled) if self.context.is_cancelled() => return Err(Cancelled),
                Err(Cancelled) => {
                    step.status = StepStatus::Failed;
                    step.note = Some("the time was over".to_owned());
                    End::OutOfTime
                }
            };
            self.log(&step);
            self.steps.push(step);
            if !matches!(end, End::Finished) {
                return Ok(end);
            }
        }
        Ok(End::Finished)
    }

    /// Writes a step to the job's log.
    pub fn log(&self, step: &Step) {
        let status = match step.status {
            StepStatus::Done => "done",
            StepStatus::Failed => "failed",
            StepStatus::Skipped => "skipped",
        };
        let mut line = format!("rung {} {:?}: {status} in {:.1} ms", step.rung, step.action, step.milliseconds);
        for Change { what, count } in &step.changed {
            line.push_str(&format!(", {what} {count}"));
        }
        if let Some(note) = &step.note {
            line.push_str(&format!(" ({note})"));
        }
        self.context.log(&line);
    }

    fn act(&self, action: Action, surface: &mut Surface, step: &mut Step) -> Result<End, Cancelled> {
        self.context.check()?;
        match action {
            Action::BasicCleanup => self.clean(surface, step)?,
            Action::FixNormals => step.changed = orient(surface, self.context)?,
            Action::FillHoles => {
                let filled = FillHoles { max_edges: self.options.max_hole_edges }.apply(surface, self.context)?;
                step.changed = filled.changes;
                // A crack whose border lies on a line is closed by a face without area, which the flip takes out.
                step.changed.extend(remove_caps(surface, self.context)?);
                step.note = match (filled.holes_left, filled.open_sheets) {
                    (0, 0) => None,
                    (0, sheets) => {
                        Some(format!("{sheets} parts are open sheets that enclose nothing; they were left open"))
                    }
                    (holes, 0) => Some(format!("{holes} holes could not be closed")),
                    (holes, sheets) => Some(format!(
                        "{holes} holes could not be closed; {sheets} parts are open sheets and were left open"
                    )),
                };
            }
            Action::Mend | Action::MendConservative | Action::MakeManifold => {
                let pairing = if action == Action::Mend { Pairing::Angular } else { Pairing::FinsLast };
                step.changed = cut_apart(surface, pairing, Pinches::KeepAtBoundaries, self.context)?;
            }
            Action::Resolve => {
                let resolved = resolve(surface, &ManifoldRust, Inside::Positive, self.context)?;
                step.changed = resolved.changes;
                step.note = resolved.error.map(|error| {
                    step.status = StepStatus::Failed;
                    error.to_string()
                });
            }
            Action::Separate => {
                step.changed = remove_debris(surface, self.context)?;
                step.changed.extend(separate(surface, self.context)?);
            }
            Action::VoxelRemesh | Action::BooleanUnion => return Ok(self.remesh(action, surface, step)),
            Action::Validate => {}
        }
        if surface.faces.is_empty() {
            step.status = StepStatus::Failed;
            step.note = Some("no face was left".to_owned());
            return Ok(End::Nothing);
        }
        Ok(End::Finished)
    }

    fn clean(&self, surface: &mut Surface, step: &mut Step) -> Result<(), Cancelled> {
        let mut changed = Vec::new();
        if self.format == Format::Stl {
            changed.extend(Change::list([("vertices_rounded_to_f32", quantise(surface))]));
        }
        let result = (|| {
            changed.extend(remove_collapsed(surface));
            changed.extend(Weld { tolerance: self.options.weld_tolerance }.apply(surface, self.context)?);
            changed.extend(remove_collapsed(surface));
            changed.extend(remove_duplicates(surface));
            changed.extend(remove_caps(surface, self.context)?);
            changed.extend(Change::list([("unreferenced_vertices_removed", surface.drop_unreferenced())]));
            Ok(())
        })();
        step.changed = changed;
        result
    }

    fn remesh(&self, action: Action, surface: &mut Surface, step: &mut Step) -> End {
        let (Some(remesher), Some(remesh)) = (self.remesher, remesh_action(action)) else { return End::Nothing };
        let voxel_size = voxel_size(surface, self.options);
        step.program = remesher.info().ok().cloned();
        step.voxel_size = (action == Action::VoxelRemesh).then_some(voxel_size);
        let soup = surface.to_soup();
        let request = RemeshRequest {
            soup: &soup,
            action: remesh,
            voxel_size,
            max_faces: self.options.max_remesh_faces,
            time_limit: self.context.remaining().max(Duration::from_millis(1)),
        };
        let made = remesher.remesh(&request, self.context).and_then(|made| {
            let (made, ingest) = Surface::from_soup(&made.soup);
            if made.faces.is_empty() { Err(RemeshError::Empty) } else { Ok((made, ingest)) }
        });
        match made {
            Ok((mut made, _)) => {
                made.source.fill(crate::mesh::NO_SOURCE);
                step.changed = Change::list([("faces_made", made.faces.len() as u64)]);
                *surface = made;
                End::Finished
            }
            Err(error) => {
                step.status = StepStatus::Failed;
                step.note = Some(error.to_string());
                End::Nothing
            }
        }
    }
}

/// The voxel edge: as asked or from the resolution, and large enough that the estimate of faces keeps the limit.
fn voxel_size(surface: &Surface, options: &Options) -> f64 {
    let diagonal = Box3::of(surface.positions.iter().copied()).diagonal();
    let wanted = options.voxel_size.unwrap_or(diagonal / f64::from(options.voxel_resolution));
    let area: f64 = doubled_areas(surface).iter().sum::<f64>() / 2.0;
    wanted.max((TRIANGLES_PER_VOXEL_AREA * area / options.max_remesh_faces as f64).sqrt())
}

/// How far the whole is when `done` of `actions` of a rung are done.
fn percent(span: &Range<u8>, done: usize, actions: usize) -> u8 {
    let width = usize::from(span.end.saturating_sub(span.start));
    span.start + u8::try_from(width * done / actions.max(1)).unwrap_or(0)
}
