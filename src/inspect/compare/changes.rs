//! How one mesh, the result, differs from another, the input.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::super::analysis::Pair;
use super::super::matching::Common;
use super::super::sampling::{Sample, samples};
use super::super::{Analysis, Measures, Solid, Volume, percent};
use super::deviation::{
    Deviation, Distances, INSIDE_WINDING, Measured, are_buried, buried_pct, distances, inside_agreement,
};
use super::original::{FAR, Original};
use super::provenance::SurfaceShares;
use crate::context::{Cancelled, Context};
use crate::math::Box3;

/// A volume below this share of area times diagonal is what rounding leaves of parts that cancel.
const VOLUME_ROUNDING: f64 = 1e-12;
/// Samples at no distance from the other mesh that are asked whether they can be seen.
const NEAR_ASKED: usize = 400;
/// What a faithful result may lose: the distance that 99 % of the visible surface keeps to, and the move of a side of the
/// box, in percent of the diagonal.
const FAITHFUL_PCT: [f64; 2] = [0.5, 1.0];
/// Points at which the inside of a result is compared, where the input's volume can't tell.
const INSIDE: u32 = 1000;
/// Of them as many must be inside the input for the comparison to say anything.
pub(super) const LEAST_INSIDE: u64 = 20;
/// The winding number from which on a point is certainly inside an open mesh: near a large hole it is about a half.
const CERTAINLY_INSIDE: f64 = 0.75;
/// Change of the volume, in percent, from which on winding numbers are asked whether space was counted twice.
const DOUBTED_VOLUME_PCT: f64 = 5.0;
/// They say so where this share of the inside is common to both, in percent.
const SAME_INSIDE_PCT: f64 = 99.0;

/// How one mesh, the result, differs from another, the input. Percentages are of the input's value; none where the input's
/// value is zero or not reliable.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
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
    pub enclosed_faces_pct: Option<f64>,
    /// Share of the surface that can be seen from outside with nothing of the result within 0.5 % of the diagonal, or
    /// material of it on both sides: sampled, so 0.1 is about the least that is seen.
    pub surface_lost_pct: Option<f64>,
    /// Distance from the input's surface that can be seen from outside to the result: what was lost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost: Option<Deviation>,
    /// Distance from the result's surface to the input: what was made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub added: Option<Deviation>,
    /// The same for all of the result but the patches of holes: how far surface was moved. None where it is not known what is a
    /// patch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moved: Option<Deviation>,
    /// How much of the surface was kept, moved, added and removed. None of a candidate that was not chosen, and where the time
    /// was over.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceShares>,
    /// Largest move of a side of the box around all faces with an area, over its diagonal before.
    pub bounding_box_change_pct: Option<f64>,
    /// Change of the surface area.
    pub area_change_pct: Option<f64>,
    /// Change of the volume, in percent of what the input encloses once its closed parts look outward; none where that is no more
    /// than rounding.
    pub volume_change_pct: Option<f64>,
    /// Of what is inside the input or the result the share that is inside both, in percent, by winding numbers at sampled points:
    /// where the volume of the input can't tell, since it is closed but its faces intersect or its parts overlap. Of an open
    /// input, the share of what is inside it that is inside the result.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub volume_overlap_pct: Option<f64>,
}

impl Changes {
    /// Whether 99 % of the visible surface still has surface nearby and the box stands, as [`Comparison::faithful`](super::Comparison::faithful) asks.
    #[must_use]
    pub fn keeps_visible_surface(&self) -> bool {
        let near = self.lost.map_or(self.surface_lost_pct == Some(0.0), |lost| lost.percent.p99 <= FAITHFUL_PCT[0]);
        near && self.bounding_box_change_pct.is_some_and(|moved| moved <= FAITHFUL_PCT[1])
    }

    /// Those of a mesh that has the very faces of the input.
    #[must_use]
    pub fn none(before: &Measures, after: &Measures) -> Self {
        let bounding_box_change_pct = before.bounding_box.map(|_| 0.0);
        Self { surface_lost_pct: Some(0.0), bounding_box_change_pct, ..Self::of(before, before.volume, after, 100.0) }
    }

    /// What the measures of both alone tell.
    ///
    /// `settled` is the input's volume when its orientation is settled.
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
        self.bounding_box_change_pct = bounding_box_change_pct(bounds, after_bounds);
        let reliable = before.volume.reliable && after.volume.reliable;
        self.volume_change_pct = percent(after.volume.value - volume, volume).filter(|_| reliable);
    }
}

/// A mesh that is compared with the original, and what is known of it.
#[derive(Clone, Copy)]
pub struct ComparedMesh<'c> {
    /// Its structure.
    pub analysis: &'c Analysis<'c>,
    /// Its measures.
    pub measures: &'c Measures,
    /// For each face of its soup whether it is a hole's patch, where that is known.
    pub patches: Option<&'c [bool]>,
    /// For each part of the original whether it was asked to go; empty where none was.
    pub gone: &'c [bool],
}

impl Original<'_> {
    /// How another mesh differs. `patches` tells for each face of its soup whether it is a hole's patch, where that is known.
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn changes(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        patches: Option<&[bool]>,
        context: &Context<'_>,
    ) -> Result<Changes, Cancelled> {
        self.changes_but_for(&ComparedMesh { analysis: after, measures, patches, gone: &[] }, context)
    }

    /// The same where some parts were asked to go: what went with them is no change.
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn changes_but_for(&self, after: &ComparedMesh<'_>, context: &Context<'_>) -> Result<Changes, Cancelled> {
        let ComparedMesh { measures, gone, .. } = *after;
        let (mut changes, _) = self.changes_and_distances(after, context)?;
        if gone.contains(&true) {
            let solids = self.settled.unwrap_or(self.analysis).solids.iter().zip(gone);
            let stays = solids.filter(|(_, gone)| !**gone).map(|(solid, _)| solid);
            changes.leave_out_others(self.measures, measures, stays);
        }
        Ok(changes)
    }

    /// How another mesh differs, and the distances from this one to it.
    pub(super) fn changes_and_distances(
        &self,
        candidate: &ComparedMesh<'_>,
        context: &Context<'_>,
    ) -> Result<(Changes, Distances), Cancelled> {
        let &ComparedMesh { analysis: after, measures, patches, gone } = candidate;
        let scale = self.analysis.scale();
        let common = Common::new(&self.analysis.keys(scale), &after.keys(scale));
        context.check()?;
        let kept = common.first.iter().filter(|&&stands| stands).count() as f64;
        let kept_pct = percent(kept, common.first.len() as f64).unwrap_or(100.0);
        let settled = self.settled_volume(context)?;
        let mut changes = Changes::of(self.measures, settled, measures, kept_pct);
        let (there, back) = (Pair::new(self.analysis, after), Pair::new(after, self.analysis));
        let Box3 { min, max } = after.extent();
        let extent = Box3 { min: min / there.ratio, max: max / there.ratio };
        changes.bounding_box_change_pct = bounding_box_change_pct(self.analysis.extent(), extent);
        let stands = |faces: &[bool], f: u32| common.fine && faces[f as usize];
        let options = self.options;
        let mut found = distances(there, self.samples(), options.vertices, |f| stands(&common.first, f), context)?;
        if gone.contains(&true) {
            let parts = &self.analysis.parts.of_face;
            let is_gone = |sample: &Sample| gone.get(parts[sample.face as usize] as usize) == Some(&true);
            for (distance, _) in found.samples.iter_mut().zip(self.samples()).filter(|(_, sample)| is_gone(sample)) {
                *distance = None;
            }
        }
        (changes.surface_lost_pct, changes.lost) = self.lost(&found, candidate, context)?;
        if !self.analysis.surface.faces.is_empty() {
            let points = samples(after, options.samples);
            let made = distances(back, &points, options.vertices, |f| stands(&common.second, f), context)?;
            let diagonal = self.analysis.unit_diagonal() * there.ratio;
            let made = Measured { analysis: after, samples: &points, found: &made, diagonal };
            changes.added = made.deviation(|_| true, |_| true);
            if let Some(patches) = patches {
                let is_patch = |f: u32| patches.get(after.surface.source[f as usize] as usize) == Some(&true);
                let mut moved = vec![false; after.surface.positions.len()];
                for (face, _) in after.surface.faces.iter().zip(0u32..).filter(|&(_, f)| !is_patch(f)) {
                    face.iter().for_each(|&v| moved[v as usize] = true);
                }
                let (counts, vertices) = (|i: usize| !is_patch(points[i].face), |v: u32| moved[v as usize]);
                changes.moved = made.deviation(counts, vertices);
            }
        }
        if after.surface.faces.len() < self.analysis.surface.faces.len() && measures.closed {
            changes.enclosed_faces_pct = buried_pct(there, |f| common.first[f as usize], context)?;
        }
        changes.volume_overlap_pct = self.volume_overlap_pct(after, measures, changes.volume_change_pct, context)?;
        Ok((changes, found))
    }

    /// Of what is inside this mesh or the other the share inside both, in percent, where the volume can't tell: faces intersect, or the
    /// volume changed and what is inside did not, since parts within others were counted twice.
    fn volume_overlap_pct(
        &self,
        after: &Analysis<'_>,
        measures: &Measures,
        volume_change_pct: Option<f64>,
        context: &Context<'_>,
    ) -> Result<Option<f64>, Cancelled> {
        let crossed = self.measures.self_intersections.pairs.is_some_and(|pairs| pairs > 0);
        let doubted = volume_change_pct.is_some_and(|change| change.abs() > DOUBTED_VOLUME_PCT);
        let is_open = !self.measures.closed;
        if !((is_open || crossed || doubted) && measures.printable()) {
            return Ok(None);
        }
        // Where neighbours of an open surface are turned against each other, its winding numbers say nothing.
        if is_open && self.measures.misoriented_edges > 0 {
            return Ok(None);
        }
        let before = self.settled.unwrap_or(self.analysis);
        let least = if is_open { CERTAINLY_INSIDE } else { INSIDE_WINDING };
        let found = inside_agreement(Pair::new(before, after), least, INSIDE, context)?;
        // Walls of two sides that look apart enclose nothing by winding, and there is nothing to compare.
        let found = found.filter(|it| it.inside_before >= LEAST_INSIDE);
        if is_open {
            // Near a hole the open surface has nothing inside, and a patch that closes it rightly adds to that.
            return Ok(found.and_then(|it| it.kept_pct()));
        }
        let overlap = found.and_then(|it| it.overlap_pct);
        Ok(overlap.filter(|&overlap| crossed || overlap >= SAME_INSIDE_PCT))
    }

    /// What was lost of the visible surface: the share in percent, and how far it is away.
    fn lost(
        &self,
        found: &Distances,
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
        if found.samples.iter().all(Option::is_none) {
            return Ok((None, None));
        }
        // Where nothing is apart, it does not matter what can be seen. Elsewhere it matters of each sample that is, and of the
        // others only how many can be seen, which some of them tell.
        let (apart, near): (Vec<usize>, Vec<usize>) = (0..found.samples.len())
            .filter(|&i| found.samples[i].is_some())
            .partition(|&i| found.samples[i] != Some(0.0));
        let mut counts = vec![false; found.samples.len()];
        let (mut seen_near, mut walled_in) = (near.len(), 0);
        // What stands in the result but within another part of it was walled in when holes were closed.
        let may_be_walled_in = measures.closed && measures.parts > 1 && !self.measures.closed;
        if !apart.is_empty() || may_be_walled_in {
            // What could not be told to be hidden counts as seen.
            for (&i, seen) in apart.iter().zip(self.visible(&apart, context)?) {
                counts[i] = seen != Some(false);
            }
            let some: Vec<usize> = near.iter().copied().step_by(near.len().div_ceil(NEAR_ASKED).max(1)).collect();
            let seen = self.visible(&some, context)?;
            let seen: Vec<usize> =
                some.iter().zip(seen).filter(|(_, seen)| *seen != Some(false)).map(|(&i, _)| i).collect();
            let share_of = |few: usize| near.len() * few / some.len().max(1);
            seen_near = share_of(seen.len());
            if may_be_walled_in {
                let points = seen.iter().map(|&i| (self.samples()[i].point, self.samples()[i].normal));
                let buried = are_buried(Pair::new(self.analysis, after), &points.collect::<Vec<_>>(), context)?;
                walled_in = share_of(buried.into_iter().filter(|&buried| buried == Some(true)).count());
            }
        }
        // One at no distance is as good as another.
        near.iter().take(seen_near).for_each(|&i| counts[i] = true);
        let diagonal = self.analysis.unit_diagonal();
        let measured = Measured { analysis: self.analysis, samples: self.samples(), found, diagonal };
        let lost = measured.deviation(|i| counts[i], |_| false);
        let visible = found.samples.iter().zip(&counts).filter(|(_, counts)| **counts).filter_map(|(&d, _)| d);
        let (mut all, mut far) = (0, walled_in);
        for distance in visible {
            all += 1;
            far += usize::from(distance > FAR * diagonal);
        }
        Ok((percent(far as f64, all.max(1) as f64), lost))
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
fn bounding_box_change_pct(before: Box3, after: Box3) -> Option<f64> {
    if before.is_empty() || after.is_empty() {
        return None;
    }
    // By halves, since the difference of the largest numbers overflows.
    let moved = |a: DVec3, b: DVec3| (a * 0.5 - b * 0.5).abs().max_element();
    percent(moved(after.min, before.min).max(moved(after.max, before.max)), before.diagonal() * 0.5)
}
