use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Deviation, SurfaceShares};
use crate::inspect::{BoundingBox, Measures};

/// How one mesh, the result, differs from another, the input. Percentages are of the input's value; none where the input's
/// value is zero or not reliable.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Changes {
    /// Faces after minus before.
    pub faces: i64,
    /// Vertices after minus before.
    pub vertices: i64,
    /// Parts after minus before.
    pub parts: i64,
    /// Share of the faces lost; negative where faces were added.
    pub face_loss_pct: f64,
    /// Faces of the input that stand in the result at the same three positions, in percent.
    pub faces_kept_pct: f64,
    /// Of the input's faces that the result has not, the share with the result's material on both sides, in percent: walls inside
    /// parts that were united. None where the result has no fewer faces, or is not closed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub faces_buried_pct: Option<f64>,
    /// Share of the surface that can be seen from outside with nothing of the result within 0.5 % of the diagonal, or
    /// material of it on both sides: sampled, so 0.1 is about the least that is seen.
    pub surface_lost_pct: Option<f64>,
    /// Distance from the input's surface that can be seen from outside to the result: what was lost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost: Option<Deviation>,
    /// Distance from the result's surface to the input: what was made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub made: Option<Deviation>,
    /// The same for all of the result but the patches of holes: how far surface was moved. None where it is not known what is a
    /// patch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moved: Option<Deviation>,
    /// How much of the surface was kept, moved, added and removed. None of a candidate that was not chosen, and where the time
    /// was over.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceShares>,
    /// Largest move of a side of the bounding box, over its diagonal before.
    pub box_change_pct: Option<f64>,
    /// Change of the surface area.
    pub area_change_pct: Option<f64>,
    /// Change of the volume.
    pub volume_change_pct: Option<f64>,
    /// Of what is inside the input or the result the share that is inside both, in percent, by winding numbers at sampled points:
    /// where the volume of the input can't tell, since it is closed but its faces intersect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inside_overlap_pct: Option<f64>,
}

impl Changes {
    /// What the measures of both alone tell.
    pub(super) fn of(before: &Measures, after: &Measures, faces_kept_pct: f64) -> Self {
        let volume = before.volume.reliable && after.volume.reliable;
        Self {
            faces: difference(after.faces, before.faces),
            vertices: difference(after.vertices, before.vertices),
            parts: difference(after.parts, before.parts),
            face_loss_pct: percent(before.faces as f64 - after.faces as f64, before.faces as f64).unwrap_or(0.0),
            faces_kept_pct,
            faces_buried_pct: None,
            surface_lost_pct: None,
            lost: None,
            made: None,
            moved: None,
            surface: None,
            box_change_pct: box_change_pct(before.bounding_box, after.bounding_box),
            area_change_pct: percent(after.area - before.area, before.area),
            volume_change_pct: percent(after.volume.value - before.volume.value, before.volume.value)
                .filter(|_| volume),
            inside_overlap_pct: None,
        }
    }
}

fn difference(after: u64, before: u64) -> i64 {
    after.cast_signed().saturating_sub(before.cast_signed())
}

/// A part in percent of a whole's size; none where that is no number.
#[must_use]
pub fn percent(part: f64, whole: f64) -> Option<f64> {
    let value = part / whole.abs() * 100.0;
    (whole != 0.0 && value.is_finite()).then_some(value)
}

/// The largest move of a side of the box over its diagonal before, in percent.
fn box_change_pct(before: Option<BoundingBox>, after: Option<BoundingBox>) -> Option<f64> {
    let (b, a) = (before?, after?);
    // By halves, since the difference of the largest numbers overflows.
    let moved = |a: f64, b: f64| (a * 0.5 - b * 0.5).abs();
    let most = (0..3).map(|k| moved(a.min[k], b.min[k]).max(moved(a.max[k], b.max[k]))).fold(0.0, f64::max);
    percent(most, b.diagonal() * 0.5)
}
