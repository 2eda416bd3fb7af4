//! The options `max_faces` and `voxel_size`, checked on the finished report: whether the result keeps to them, and if not, why.

use super::options::Operator;
use super::report::{Candidate, NotAppliedCause, OptionNotApplied, Report, Step};
use crate::inspect::{BoundingBox, Inspection};
use crate::remesh::FINEST;

/// Factor within which two voxel sizes count as equal.
const SAME_SIZE: f64 = 1.0 + 1e-6;

/// The entries for `max_faces` and `voxel_size` if the result does not follow them, each with the reason.
pub(super) fn limited_options(report: &Report) -> Vec<OptionNotApplied> {
    let mut all: Vec<OptionNotApplied> = too_many_faces(report).into_iter().collect();
    let mut larger = other_voxel_size(report, &report.steps, &report.candidates, &report.before);
    for object in &report.objects {
        larger = larger.or_else(|| other_voxel_size(report, &object.steps, &object.candidates, &object.before));
    }
    all.extend(larger);
    all
}

/// The entry for a result with more faces than `max_faces`.
fn too_many_faces(report: &Report) -> Option<OptionNotApplied> {
    let most = report.options.max_faces?;
    let faces = report.after.as_ref()?.measures.faces;
    if faces <= most {
        return None;
    }
    let of_objects = report.objects.iter().flat_map(|object| &object.steps);
    let mut steps = report.steps.iter().chain(of_objects).filter(|step| step.operator == Some(Operator::Simplify));
    let why = match steps.next_back() {
        None => "no result with fewer faces was produced".to_owned(),
        Some(step) => step.note.clone().unwrap_or_else(|| "no more faces could be removed".to_owned()),
    };
    let hint = match report.options.max_error {
        None => {
            "; without `max_error`, the surface may change by 0.5 % of the bounding box's diagonal, so set a larger `max_error`"
        }
        Some(_) => "; a larger `max_error` allows fewer faces",
    };
    Some(limited(report, "max_faces", format!("the result has {faces} faces ({why}){hint}")))
}

/// The entry for a result whose voxels are not of `voxel_size`.
fn other_voxel_size(
    report: &Report,
    steps: &[Step],
    candidates: &[Candidate],
    before: &Inspection,
) -> Option<OptionNotApplied> {
    let requested = report.options.voxel_size?;
    let strategy = candidates.iter().find(|candidate| candidate.chosen)?.strategy?;
    let step = steps.iter().rev().find(|step| step.strategy == strategy && step.voxel_size.is_some())?;
    let used = step.voxel_size?;
    if used <= requested * SAME_SIZE && requested <= used * SAME_SIZE {
        return None;
    }
    let diagonal = before.measures.bounding_box.as_ref().map_or(0.0, BoundingBox::diagonal);
    let is_native = step.operator == Some(Operator::Remesh);
    let why = if used < requested {
        "larger voxels would be too coarse for the model".to_owned()
    } else if is_native && used <= diagonal / FINEST * SAME_SIZE {
        format!("voxels cannot be smaller than 1/{FINEST} of the bounding box's diagonal")
    } else {
        let most = report.options.max_remesh_faces;
        format!("smaller voxels would need more than the {most} faces of `max_remesh_faces`, or too much memory")
    };
    Some(limited(report, "voxel_size", format!("the result was made with voxels of size {used:.6} because {why}")))
}

/// The entry of an option that was applied in part.
fn limited(report: &Report, option: &str, reason: String) -> OptionNotApplied {
    OptionNotApplied::new(&report.options, option, NotAppliedCause::Limited, reason)
}
