use glam::DVec3;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Deviation, FAITHFUL_PCT, SurfaceShares};
use crate::inspect::{Measures, Solid, Volume, percent};
use crate::math::Box3;

/// A volume below this share of area times diagonal is what rounding leaves of parts that cancel.
const VOLUME_ROUNDING: f64 = 1e-12;

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
    /// Largest move of a side of the box around all faces with an area, over its diagonal before.
    pub box_change_pct: Option<f64>,
    /// Change of the surface area.
    pub area_change_pct: Option<f64>,
    /// Change of the volume, in percent of what the input encloses once its closed parts look outward; none where that is no more
    /// than rounding.
    pub volume_change_pct: Option<f64>,
    /// Of what is inside the input or the result the share that is inside both, in percent, by winding numbers at sampled points:
    /// where the volume of the input can't tell, since it is closed but its faces intersect or its parts overlap. Of an open
    /// input, the share of what is inside it that is inside the result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inside_overlap_pct: Option<f64>,
}

impl Changes {
    /// Whether 99 % of the visible surface still has surface nearby and the box stands, as [`super::Comparison::faithful`] asks.
    #[must_use]
    pub fn keeps_visible_surface(&self) -> bool {
        let near = self.lost.map_or(self.surface_lost_pct == Some(0.0), |lost| lost.percent.p99 <= FAITHFUL_PCT[0]);
        near && self.box_change_pct.is_some_and(|moved| moved <= FAITHFUL_PCT[1])
    }

    /// Those of a mesh that has the very faces of the input.
    #[must_use]
    pub fn none(before: &Measures, after: &Measures) -> Self {
        let box_change_pct = before.bounding_box.map(|_| 0.0);
        Self { surface_lost_pct: Some(0.0), box_change_pct, ..Self::of(before, before.volume, after, 100.0) }
    }

    /// What the measures of both alone tell.
    ///
    /// `settled` is the input's volume when its orientation is settled.
    pub(super) fn of(before: &Measures, settled: Volume, after: &Measures, faces_kept_pct: f64) -> Self {
        let told = settled.reliable && after.volume.reliable && !is_rounding(settled.value, before);
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
            box_change_pct: None,
            area_change_pct: percent(after.area - before.area, before.area),
            volume_change_pct: percent(after.volume.value - settled.value, settled.value).filter(|_| told),
            inside_overlap_pct: None,
        }
    }
}

impl Changes {
    /// Measures the change of the box and of the volume from those parts of the input alone that `stay`.
    pub(super) fn leave_out_others<'a>(
        &mut self,
        before: &Measures,
        after: &Measures,
        stay: impl Iterator<Item = &'a Solid>,
    ) {
        let (mut bounds, mut volume) = (Box3::EMPTY, 0.0);
        for solid in stay.filter(|solid| solid.area > 0.0) {
            bounds.extend(solid.bounds.min);
            bounds.extend(solid.bounds.max);
            volume += solid.volume;
        }
        let after_bounds = after.bounding_box.map_or(Box3::EMPTY, |it| Box3::of([it.min, it.max].map(DVec3::from)));
        self.box_change_pct = box_change_pct(bounds, after_bounds);
        let reliable = before.volume.reliable && after.volume.reliable;
        self.volume_change_pct = percent(after.volume.value - volume, volume).filter(|_| reliable);
    }
}

fn difference(after: u64, before: u64) -> i64 {
    after.cast_signed().saturating_sub(before.cast_signed())
}

/// Whether a volume is no more than what rounding leaves of parts that cancel.
fn is_rounding(volume: f64, of: &Measures) -> bool {
    let diagonal = of.bounding_box.map_or(0.0, |it| it.diagonal());
    volume.abs() <= VOLUME_ROUNDING * of.area * diagonal
}

/// The largest move of a side of the box over its diagonal before, in percent. None where a box is empty.
pub(super) fn box_change_pct(before: Box3, after: Box3) -> Option<f64> {
    if before.is_empty() || after.is_empty() {
        return None;
    }
    // By halves, since the difference of the largest numbers overflows.
    let moved = |a: DVec3, b: DVec3| (a * 0.5 - b * 0.5).abs().max_element();
    percent(moved(after.min, before.min).max(moved(after.max, before.max)), before.diagonal() * 0.5)
}
