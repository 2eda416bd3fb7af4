//! Options that the result follows only in part.

use super::{Candidate, NotAppliedCause, Operator, OptionNotApplied, Report, Step};
use crate::inspect::{BoundingBox, Inspection};
use crate::remesh::FINEST;

/// How much larger than asked for a voxel may be before it counts as another size.
const SAME_SIZE: f64 = 1.0 + 1e-6;

/// What the report says of `max_faces` and `voxel_size` where the result does not keep to them, each with the reason.
pub(super) fn limited_options(report: &Report) -> Vec<OptionNotApplied> {
    let mut all: Vec<OptionNotApplied> = too_many_faces(report).into_iter().collect();
    let mut larger = larger_voxels(report, &report.steps, &report.candidates, &report.before);
    for object in &report.objects {
        larger = larger.or_else(|| larger_voxels(report, &object.steps, &object.candidates, &object.before));
    }
    all.extend(larger);
    all
}

/// Says why the result has more faces than `max_faces`.
fn too_many_faces(report: &Report) -> Option<OptionNotApplied> {
    let most = report.options.max_faces?;
    let faces = report.after.as_ref()?.measures.faces;
    if faces <= most {
        return None;
    }
    let of_objects = report.objects.iter().flat_map(|object| &object.steps);
    let mut steps = report.steps.iter().chain(of_objects).filter(|step| step.operator == Some(Operator::Simplify));
    let why = match steps.next_back() {
        None => "no result with fewer faces was made".to_owned(),
        Some(step) => step.note.clone().unwrap_or_else(|| "no more faces could be removed".to_owned()),
    };
    let hint = match report.options.max_error {
        None => "; without `max_error` faces go only within 0.5 % of the bounding box's diagonal, so set a larger one",
        Some(_) => "; a larger `max_error` lets more faces go",
    };
    Some(limited(report, "max_faces", format!("the result has {faces} faces ({why}){hint}")))
}

/// Says why the voxels of the result are not of `voxel_size`.
fn larger_voxels(
    report: &Report,
    steps: &[Step],
    candidates: &[Candidate],
    before: &Inspection,
) -> Option<OptionNotApplied> {
    let asked = report.options.voxel_size?;
    let rung = candidates.iter().find(|candidate| candidate.chosen)?.rung?;
    let step = steps.iter().rev().find(|step| step.rung == rung && step.voxel_size.is_some())?;
    let used = step.voxel_size?;
    if used <= asked * SAME_SIZE && asked <= used * SAME_SIZE {
        return None;
    }
    let diagonal = before.measures.bounding_box.as_ref().map_or(0.0, BoundingBox::diagonal);
    let is_native = step.operator == Some(Operator::Remesh);
    let why = if used < asked {
        "larger ones would leave nothing of the model to see".to_owned()
    } else if is_native && used <= diagonal / FINEST * SAME_SIZE {
        format!("no finer ones than 1/{FINEST} of the bounding box's diagonal are made")
    } else {
        let most = report.options.max_remesh_faces;
        format!("smaller ones would take more than the {most} faces of `max_remesh_faces`, or too much memory")
    };
    Some(limited(report, "voxel_size", format!("the result was made with voxels of {used:.6}, since {why}")))
}

fn limited(report: &Report, option: &str, reason: String) -> OptionNotApplied {
    OptionNotApplied::new(&report.options, option, NotAppliedCause::Limited, reason)
}
