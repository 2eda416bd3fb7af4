//! Differences between an input mesh and a result: counts, bounding box, volume, and lost, added and moved surface.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::super::analysis::Pair;
use super::super::matching::Common;
use super::super::sampling::{Patches, Sample, visible};
use super::super::{Analysis, Measures, Solid, Volume, percent};
use super::deviation::{
    Deviation, Distances, INSIDE_WINDING, Measured, are_buried, buried_pct, distances, inside_agreement,
};
use super::original::{FAR, Original};
use super::provenance::SurfaceShares;
use crate::context::{Cancelled, Context};
use crate::math::Box3;

/// Volume up to this fraction of area times diagonal is rounding error of parts that cancel.
const VOLUME_ROUNDING: f64 = 1e-12;
/// Maximum number of coincident samples that are tested for visibility.
const VISIBILITY_SAMPLES: usize = 400;
/// Limits of a faithful result in percent of the diagonal: distance of 99 % of the visible surface, and displacement
/// of a side of the box.
const FAITHFUL_PCT: [f64; 2] = [0.5, 1.0];
/// Number of points for comparing what is inside, where the input's volume is not reliable.
const INSIDE_POINTS: u32 = 1000;
/// Minimum number of these points inside the input for a meaningful comparison.
pub(super) const MIN_INSIDE_POINTS: u64 = 20;
/// Winding number from which a point is certainly inside an open mesh. Near a large hole, winding numbers are about
/// 0.5.
const CERTAINLY_INSIDE_WINDING: f64 = 0.75;
/// Volume change in percent from which winding numbers check whether the input's volume counted space twice.
const DOUBTED_VOLUME_PCT: f64 = 5.0;
/// Overlap in percent from which the enclosed points are the same, so that the input's volume counted space twice.
const SAME_INSIDE_PCT: f64 = 99.0;

/// Differences between an input mesh and a result. Percentages are relative to the input's value, and `null` if the
/// input's value is zero or not reliable.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Changes {
    /// Number of faces, after minus before.
    pub faces: i64,
    /// Number of vertices, after minus before.
    pub vertices: i64,
    /// Number of parts, after minus before.
    pub parts: i64,
    /// Decrease of the number of faces, in percent; negative if the number increased.
    pub face_loss_pct: f64,
    /// Faces of the input that the result has at the same three positions, in percent.
    pub faces_kept_pct: f64,
    /// Share of the input's missing faces that would lie inside the result's solid, in percent.
    /// Such faces were internal walls of united parts. `null` if the result has at least as many faces, or is not closed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub enclosed_faces_pct: Option<f64>,
    /// Share of the input's surface visible from outside that the result lost, in percent. Surface is lost if the
    /// result is farther than 0.5 % of the diagonal or has material on both sides. Sampled; the resolution is about
    /// 0.1 %.
    pub surface_lost_pct: Option<f64>,
    /// Distance from the input's surface visible from outside to the result: lost surface.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost: Option<Deviation>,
    /// Distance from the result's surface to the input: added surface.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub added: Option<Deviation>,
    /// Distance from the result's surface without hole patches to the input: moved surface. `null` if the patches are
    /// unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moved: Option<Deviation>,
    /// Amounts of surface kept, moved, added and removed. `null` for a candidate that was not chosen, and if the time
    /// ran out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceShares>,
    /// Largest displacement of a side of the bounding box, in percent of the input's diagonal. Ignores faces without
    /// area.
    pub bounding_box_change_pct: Option<f64>,
    /// Change of the surface area, in percent.
    pub area_change_pct: Option<f64>,
    /// Change of the volume, in percent of the input's volume with all closed parts facing outward. `null` if that
    /// volume is no more than rounding error.
    pub volume_change_pct: Option<f64>,
    /// Overlap of the enclosed points of input and result (intersection over union), in percent, by winding numbers
    /// at sampled points. Given if the input is closed but its volume is unreliable because faces intersect or parts
    /// overlap. For an open input, the share of the points inside the input that are inside the result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub volume_overlap_pct: Option<f64>,
}

impl Changes {
    /// Whether 99 % of the visible surface and the bounding box are kept, as
    /// [`Comparison::faithful`](super::Comparison::faithful) requires.
    #[must_use]
    pub fn keeps_visible_surface(&self) -> bool {
        let coincident =
            self.lost.map_or(self.surface_lost_pct == Some(0.0), |lost| lost.percent.p99 <= FAITHFUL_PCT[0]);
        coincident && self.bounding_box_change_pct.is_some_and(|moved| moved <= FAITHFUL_PCT[1])
    }

    /// Changes of a mesh with exactly the faces of the input.
    #[must_use]
    pub fn none(before: &Measures, after: &Measures) -> Self {
        let bounding_box_change_pct = before.bounding_box.map(|_| 0.0);
        Self { surface_lost_pct: Some(0.0), bounding_box_change_pct, ..Self::of(before, before.volume, after, 100.0) }
    }

    /// Changes that follow from the measures of both meshes alone.
    ///
    /// `settled` is the input's volume after its orientation is settled.
    pub(super) fn of(before: &Measures, settled: Volume, after: &Measures, faces_kept_pct: f64) -> Self {
        let is_known = settled.reliable && after.volume.reliable && !is_rounding(settled.value, before);
        Self {
            faces: difference(after.faces, before.faces),
            vertices: difference(after.vertices, before.vertices),
            parts: difference(after.parts, before.parts),
            face_loss_pct: percent(before.faces as f64 - after.faces as f64, before.faces as f64).unwrap_or(0.0),
            faces_kept_pct,
            area_change_pct: percent(after.area - before.area, before.area),
            volume_change_pct: percent(after.volume.value - settled.value, settled.value).filter(|_| is_known),
            ..Self::default()
        }
    }

    /// Recomputes the changes of the bounding box and the volume from the input parts in `stay` alone.
    pub(super) fn restrict_to_parts<'a>(
        &mut self,
        before: &Measures,
        after: &Measures,
        stay: impl Iterator<Item = &'a Solid>,
    ) {
        let (mut bounds, mut volume) = (Box3::EMPTY, 0.0);
        for solid in stay.filter(|solid| solid.area > 0.0) {
            bounds = bounds.joined(&solid.bounds);
            volume += solid.volume;
        }
        let after_bounds = after.bounding_box.map_or(Box3::EMPTY, |b| Box3::of([b.min, b.max].map(DVec3::from)));
        self.bounding_box_change_pct = bounding_box_change_pct(bounds, after_bounds);
        let reliable = before.volume.reliable && after.volume.reliable;
        self.volume_change_pct = percent(after.volume.value - volume, volume).filter(|_| reliable);
    }
}

/// A result to compare with the original, and additional knowledge about the result.
#[derive(Clone, Copy)]
pub struct ComparedMesh<'c> {
    /// Analysis of the result.
    pub analysis: &'c Analysis<'c>,
    /// Measures of the result.
    pub measures: &'c Measures,
    /// For each face of the result's soup, whether the face is a hole's patch; `None` if unknown.
    pub patches: Option<&'c [bool]>,
    /// For each part of the original, whether the request removes that part; empty if no part is removed.
    pub gone: &'c [bool],
    /// Finds for each face of the result's soup whether surface of the original counts as hidden if it is visible only
    /// through the opening that this face closes; empty if no face hides any. Called only where surface is lost.
    pub opaque: &'c (dyn Fn() -> Vec<bool> + Sync),
}

impl Original<'_> {
    /// Computes the changes from this mesh to `after`. `patches` holds for each face of its soup whether the face is
    /// a hole's patch; `None` if unknown.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn changes(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        patches: Option<&[bool]>,
        context: &Context<'_>,
    ) -> Result<Changes, Cancelled> {
        self.changes_but_for(
            &ComparedMesh { analysis: after, measures, patches, gone: &[], opaque: &Vec::new },
            context,
        )
    }

    /// Computes the changes, ignoring parts whose removal was requested.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn changes_but_for(&self, after: &ComparedMesh<'_>, context: &Context<'_>) -> Result<Changes, Cancelled> {
        let ComparedMesh { measures, gone, .. } = *after;
        let (mut changes, _) = self.changes_and_distances(after, context)?;
        if gone.contains(&true) {
            let solids = self.settled.unwrap_or(self.analysis).solids.iter().zip(gone);
            let stays = solids.filter(|(_, gone)| !**gone).map(|(solid, _)| solid);
            changes.restrict_to_parts(self.measures, measures, stays);
        }
        Ok(changes)
    }

    /// Computes the changes, and the distances from this mesh to the other.
    pub(super) fn changes_and_distances(
        &self,
        candidate: &ComparedMesh<'_>,
        context: &Context<'_>,
    ) -> Result<(Changes, Distances), Cancelled> {
        let &ComparedMesh { analysis: after, measures, gone, .. } = candidate;
        let common = self.analysis.common_faces(after);
        context.check()?;
        let kept = common.first.iter().filter(|&&is_kept| is_kept).count() as f64;
        let kept_pct = percent(kept, common.first.len() as f64).unwrap_or(100.0);
        let settled = self.settled_volume(context)?;
        let mut changes = Changes::of(self.measures, settled, measures, kept_pct);
        let there = Pair::new(self.analysis, after);
        let Box3 { min, max } = after.extent();
        let extent = Box3 { min: min / there.ratio, max: max / there.ratio };
        changes.bounding_box_change_pct = bounding_box_change_pct(self.analysis.extent(), extent);
        let is_kept = |face: u32| common.fine && common.first[face as usize];
        let mut lost_distances = distances(there, self.samples(), self.options.vertices, is_kept, context)?;
        if gone.contains(&true) {
            let parts = &self.analysis.parts.of_face;
            let is_gone = |sample: &Sample| gone.get(parts[sample.face as usize] as usize) == Some(&true);
            for (distance, _) in
                lost_distances.samples.iter_mut().zip(self.samples()).filter(|(_, sample)| is_gone(sample))
            {
                *distance = None;
            }
        }
        (changes.surface_lost_pct, changes.lost) = self.lost(&lost_distances, candidate, context)?;
        if !self.analysis.surface.faces.is_empty() {
            [changes.added, changes.moved] = self.added_and_moved(candidate, &common, context)?;
        }
        if after.surface.faces.len() < self.analysis.surface.faces.len() && measures.closed {
            changes.enclosed_faces_pct = buried_pct(there, |f| common.first[f as usize], context)?;
        }
        changes.volume_overlap_pct = self.volume_overlap_pct(after, measures, changes.volume_change_pct, context)?;
        Ok((changes, lost_distances))
    }

    /// The values of [`Changes::added`] and [`Changes::moved`].
    fn added_and_moved(
        &self,
        candidate: &ComparedMesh<'_>,
        common: &Common,
        context: &Context<'_>,
    ) -> Result<[Option<Deviation>; 2], Cancelled> {
        let &ComparedMesh { analysis: after, patches, .. } = candidate;
        let (back, points) = (Pair::new(after, self.analysis), self.samples_of(after));
        let is_kept = |face: u32| common.fine && common.second[face as usize];
        let distances = distances(back, &points, self.options.vertices, is_kept, context)?;
        let diagonal = self.analysis.unit_diagonal() / back.ratio;
        let measured = Measured { analysis: after, samples: &points, distances: &distances, diagonal };
        let added = measured.deviation(|_| true, |_| true);
        let Some(patches) = patches else { return Ok([added, None]) };
        if patches.is_empty() {
            return Ok([added, added]);
        }
        let is_patch = |f: u32| patches.get(after.surface.source[f as usize] as usize) == Some(&true);
        let mut counted = vec![false; after.surface.positions.len()];
        for (face, _) in after.surface.faces.iter().zip(0u32..).filter(|&(_, f)| !is_patch(f)) {
            face.iter().for_each(|&v| counted[v as usize] = true);
        }
        let moved = measured.deviation(|i| !is_patch(points[i].face), |v| counted[v as usize]);
        Ok([added, moved])
    }

    /// The value of [`Changes::volume_overlap_pct`]. Computed only if the input's volume is unreliable: its faces
    /// intersect, or it counted overlapping parts twice. The latter is assumed if the volume changed while the
    /// enclosed points did not.
    fn volume_overlap_pct(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        volume_change_pct: Option<f64>,
        context: &Context<'_>,
    ) -> Result<Option<f64>, Cancelled> {
        let crossed = self.measures.self_intersections.pairs.is_some_and(|pairs| pairs > 0);
        let doubted = volume_change_pct.is_some_and(|change| change.abs() > DOUBTED_VOLUME_PCT);
        let is_open = self.is_open();
        if !((is_open || crossed || doubted) && measures.printable()) {
            return Ok(None);
        }
        // Winding numbers of an open surface mean nothing if neighbouring faces have opposite winding.
        if is_open && self.measures.misoriented_edges > 0 {
            return Ok(None);
        }
        let before = self.settled.unwrap_or(self.analysis);
        let least = if is_open { CERTAINLY_INSIDE_WINDING } else { INSIDE_WINDING };
        let agreement = inside_agreement(Pair::new(before, after), least, INSIDE_POINTS, context)?;
        // A wall whose two sides both face away from the material encloses nothing by winding number.
        let agreement = agreement.filter(|a| a.inside_before >= MIN_INSIDE_POINTS);
        if is_open {
            // Near a hole the open input encloses nothing, and a patch rightly adds enclosed points.
            return Ok(agreement.and_then(|a| a.kept_pct()));
        }
        let overlap = agreement.and_then(|a| a.overlap_pct);
        Ok(overlap.filter(|&overlap| crossed || overlap >= SAME_INSIDE_PCT))
    }

    /// Clears the marks of samples that are visible only through openings that the candidate's patches close.
    fn hide_behind_patches(
        &self,
        marks: &mut [bool],
        candidate: &ComparedMesh<'_>,
        context: &Context<'_>,
    ) -> Result<(), Cancelled> {
        let meshes = Pair::new(self.analysis, candidate.analysis);
        let opaque = (candidate.opaque)();
        if !opaque.contains(&true) {
            return Ok(());
        }
        let patches = Patches { meshes, is_patch: &opaque };
        let marked: Vec<usize> = (0..marks.len()).filter(|&i| marks[i]).collect();
        let points: Vec<Sample> = marked.iter().map(|&i| self.samples()[i]).collect();
        for (&i, is_visible) in marked.iter().zip(visible(self.analysis, &points, Some(&patches), context)?) {
            marks[i] = is_visible != Some(false);
        }
        Ok(())
    }

    /// Lost visible surface: its share in percent, and the distances.
    fn lost(
        &self,
        distances: &Distances,
        candidate: &ComparedMesh<'_>,
        context: &Context<'_>,
    ) -> Result<(Option<f64>, Option<Deviation>), Cancelled> {
        let &ComparedMesh { analysis: after, measures, .. } = candidate;
        if self.samples().is_empty() {
            return Ok((None, None));
        }
        if after.surface.faces.is_empty() {
            return Ok((Some(100.0), None));
        }
        if distances.samples.iter().all(Option::is_none) {
            return Ok((None, None));
        }
        // If all samples coincide with the result, visibility is irrelevant. Otherwise each distant sample is tested
        // for visibility; for the coincident samples only the number of visible ones matters, and a subset estimates
        // that number.
        let (distant, coincident): (Vec<usize>, Vec<usize>) = (0..distances.samples.len())
            .filter(|&i| distances.samples[i].is_some())
            .partition(|&i| distances.samples[i] != Some(0.0));
        let mut counts = vec![false; distances.samples.len()];
        let (mut visible_coincident, mut enclosed) = (coincident.len(), 0);
        // Closing holes can enclose a part that is in the result, inside another part.
        let may_be_enclosed = measures.closed && measures.parts > 1 && self.is_open();
        if !distant.is_empty() || may_be_enclosed {
            // A sample with unknown visibility counts as visible.
            for (&i, is_visible) in distant.iter().zip(self.visible(&distant, context)?) {
                counts[i] = is_visible != Some(false);
            }
            if counts.contains(&true) {
                self.hide_behind_patches(&mut counts, candidate, context)?;
            }
            let subset: Vec<usize> =
                coincident.iter().copied().step_by(coincident.len().div_ceil(VISIBILITY_SAMPLES).max(1)).collect();
            let visibility = self.visible(&subset, context)?;
            let visible: Vec<usize> = subset
                .iter()
                .zip(visibility)
                .filter(|(_, is_visible)| *is_visible != Some(false))
                .map(|(&i, _)| i)
                .collect();
            let share_of = |count: usize| coincident.len() * count / subset.len().max(1);
            visible_coincident = share_of(visible.len());
            if may_be_enclosed {
                let points = visible.iter().map(|&i| (self.samples()[i].point, self.samples()[i].normal));
                let buried = are_buried(Pair::new(self.analysis, after), &points.collect::<Vec<_>>(), context)?;
                enclosed = share_of(buried.into_iter().filter(|&buried| buried == Some(true)).count());
            }
        }
        // Coincident samples are interchangeable.
        coincident.iter().take(visible_coincident).for_each(|&i| counts[i] = true);
        let diagonal = self.analysis.unit_diagonal();
        let measured = Measured { analysis: self.analysis, samples: self.samples(), distances, diagonal };
        let lost = measured.deviation(|i| counts[i], |_| false);
        let counted = distances.samples.iter().zip(&counts).filter(|(_, counts)| **counts).filter_map(|(&d, _)| d);
        let (mut total, mut lost_count) = (0, enclosed);
        for distance in counted {
            total += 1;
            lost_count += usize::from(distance > FAR * diagonal);
        }
        Ok((percent(lost_count as f64, total.max(1) as f64), lost))
    }
}

fn difference(after: u64, before: u64) -> i64 {
    after.cast_signed().saturating_sub(before.cast_signed())
}

/// Whether a volume is no more than the rounding error of parts that cancel.
fn is_rounding(volume: f64, of: &Measures) -> bool {
    let diagonal = of.bounding_box.map_or(0.0, |bounds| bounds.diagonal());
    volume.abs() <= VOLUME_ROUNDING * of.area * diagonal
}

/// Largest displacement of a side of the bounding box, in percent of the diagonal before. `None` if a box is empty.
fn bounding_box_change_pct(before: Box3, after: Box3) -> Option<f64> {
    if before.is_empty() || after.is_empty() {
        return None;
    }
    // Halved operands, since the difference of the largest numbers overflows.
    let moved = |a: DVec3, b: DVec3| (a * 0.5 - b * 0.5).abs().max_element();
    percent(moved(after.min, before.min).max(moved(after.max, before.max)), before.diagonal() * 0.5)
}
