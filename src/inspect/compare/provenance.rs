//! Provenance of surface: which surface of an input a result keeps or moves, and what the result adds or removes.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::original::{FAR, Original, ROUNDING};
use crate::context::{Cancelled, Context};
use crate::inspect::analysis::Pair;
use crate::inspect::sampling::run_coherent_queries;
use crate::inspect::{Analysis, finite};
use crate::math::{Tree, threads};

/// Up to this number of faces without an identical counterpart, each is sampled at four points; above, at its centre
/// only.
const FOUR_SAMPLE_FACES: usize = 60_000;
/// Face pieces are at most 1/4096 of the input's area, limited by the number of recursive four-way splits of one
/// face.
const PIECES_PER_AREA: f64 = 4096.0;
const MAX_SPLITS: u32 = 4;
/// Budget of all searches in one direction: boxes and triangles visited, plus an allowance per point.
const BUDGET: u64 = 10_000_000;
const BUDGET_PER_POINT: u64 = 500;

/// Origin of a piece of surface when one mesh, the input, becomes another, the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Provenance {
    /// Present in both meshes at the same place, whole or with different triangles.
    Kept,
    /// In the result; its counterpart in the input is nearby, but farther away than rounding explains.
    Moved,
    /// In the result, without a counterpart in the input, for example a hole's patch.
    Added,
    /// In the input, without a counterpart in the result, for example an internal face.
    Removed,
}

impl Provenance {
    /// All variants, in the order of legends.
    pub const ALL: [Self; 4] = [Self::Kept, Self::Moved, Self::Added, Self::Removed];
}

/// Amount of surface with one provenance.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SurfaceShare {
    /// Number of faces of the result. For `removed`, faces of the input of which at least a piece is missing.
    pub faces: u64,
    /// Area in square model units. For a removed face, only the area of its missing pieces.
    pub area: f64,
}

/// Amounts of surface that were kept, moved, added and removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SurfaceShares {
    /// Surface of the result that the input has at the same place.
    pub kept: SurfaceShare,
    /// Surface of the result whose counterpart in the input is nearby, but farther away than rounding explains.
    pub moved: SurfaceShare,
    /// Surface of the result without a counterpart in the input.
    pub added: SurfaceShare,
    /// Surface of the input without a counterpart in the result.
    pub removed: SurfaceShare,
    /// Whether the search covered all surface. False if it ran out of its budget; surface not covered counts as kept.
    pub complete: bool,
}

/// Provenance of all surface of an input and a result.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfaceProvenance {
    /// For each face of the result's file its provenance; `None` for a face with a non-finite corner.
    pub of_face: Vec<Option<Provenance>>,
    /// Removed surface of the input as triangles: whole faces, and pieces of larger faces.
    pub removed: Vec<[DVec3; 3]>,
    /// Totals by provenance.
    pub shares: SurfaceShares,
}

impl Original<'_> {
    /// Determines the provenance of all surface of this mesh and of the result `after`.
    ///
    /// Kept: a face at the same three positions in both meshes, or surface within rounding distance of the other
    /// mesh. Added: other surface of the result farther than 0.5 % of the diagonal from the input, or near only to
    /// input surface that is kept, which already has its counterpart. Moved: the remaining surface of the result.
    /// Removed: surface of the input with only kept and added surface within that distance. Large input faces are
    /// split into pieces, so that of a face running into a solid only the internal piece is removed. O(n log n).
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn provenance(&self, after: &Analysis<'_>, context: &Context<'_>) -> Result<SurfaceProvenance, Cancelled> {
        let mut removed = Vec::new();
        let unit = self.analysis.unit_length();
        let (kinds, shares) = self.trace(after, |piece| removed.push(piece.map(|p| p * unit)), context)?;
        let mut of_face = vec![None; after.file_faces().len()];
        for (&source, kind) in after.surface.source.iter().zip(kinds) {
            of_face[source as usize] = Some(kind);
        }
        Ok(SurfaceProvenance { of_face, removed, shares })
    }

    /// The totals of [`Original::provenance`], in less memory.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn surface_shares(&self, after: &Analysis<'_>, context: &Context<'_>) -> Result<SurfaceShares, Cancelled> {
        Ok(self.trace(after, |_| {}, context)?.1)
    }

    /// The provenance of each face of the result's surface, and the totals. Calls `remove` with each removed piece of surface, in unit
    /// coordinates of this mesh.
    fn trace(
        &self,
        after: &Analysis<'_>,
        mut remove: impl FnMut([DVec3; 3]),
        context: &Context<'_>,
    ) -> Result<(Vec<Provenance>, SurfaceShares), Cancelled> {
        let before = self.analysis;
        let common = before.common_faces(after);
        context.check()?;
        let pieces = pieces_of(before, &common.first);
        let pair = Pair::new(before, after);
        let most = (FAR * before.unit_diagonal()).max(ROUNDING) * pair.ratio;
        let new_faces = NewFaces::of(after, &common.second);
        let reach = |point: DVec3, steps: &mut u64| match &new_faces {
            Some(new_faces) => new_faces.reach(point, most, steps).max(2.0 * ROUNDING * pair.ratio),
            None => most,
        };
        let centre = |piece: usize| centre(pieces[piece].corners(before));
        let nearby = find_nearby(pair, reach, (pieces.len(), centre), context)?;
        // An input face with at least half of its pieces kept is no counterpart for nearby surface of the result.
        let mut kept_balance = vec![0i32; before.surface.faces.len()];
        for (piece, matched) in pieces.iter().zip(&nearby.matches) {
            let is_kept = matched.is_some_and(|found| found.is_within(ROUNDING));
            kept_balance[piece.face as usize] += if is_kept { 1 } else { -1 };
        }
        let is_kept = |face: u32| common.first[face as usize] || kept_balance[face as usize] > 0;
        let (of_face, complete) = of_result(before, after, &common.second, is_kept, context)?;
        let mut shares = SurfaceShares { complete: nearby.complete && complete, ..SurfaceShares::default() };
        for (&kind, area) in of_face.iter().zip(areas_of(after)) {
            shares.add(kind, 1, area * after.unit_length().powi(2));
        }
        let unit = before.unit_length();
        let mut last = None;
        for (piece, matched) in pieces.iter().zip(&nearby.matches) {
            let has_counterpart = match *matched {
                Some(Match::Unknown) => true,
                Some(Match::Found { face, distance }) => {
                    distance <= ROUNDING || of_face[face as usize] == Provenance::Moved
                }
                None => false,
            };
            if !has_counterpart {
                let corners = piece.corners(before);
                shares.add(Provenance::Removed, u64::from(last != Some(piece.face)), area(corners) * unit * unit);
                last = Some(piece.face);
                remove(corners);
            }
        }
        Ok((of_face, shares))
    }
}

impl SurfaceShares {
    fn add(&mut self, provenance: Provenance, faces: u64, area: f64) {
        let share = match provenance {
            Provenance::Kept => &mut self.kept,
            Provenance::Moved => &mut self.moved,
            Provenance::Added => &mut self.added,
            Provenance::Removed => &mut self.removed,
        };
        share.faces += faces;
        share.area = finite(share.area + area);
    }
}

/// Result of searching the other mesh around a point.
#[derive(Clone, Copy)]
enum Match {
    /// The search ran out of its budget.
    Unknown,
    /// The face with the nearest point within the search radius, and its distance in unit coordinates of the point's own mesh.
    Found { face: u32, distance: f64 },
}

impl Match {
    fn is_within(&self, within: f64) -> bool {
        matches!(self, Self::Found { distance, .. } if *distance <= within)
    }
}

struct Nearby {
    /// For each point, the match; `None` if the other mesh has no surface within the search radius.
    matches: Vec<Option<Match>>,
    complete: bool,
}

/// The faces of a result that its input does not have, in unit coordinates of the result.
///
/// A face that both meshes have is a counterpart at the same place only. So a search for the counterpart of a removed part must
/// reach only as far as the nearest new face, and there is none near most of the part.
struct NewFaces {
    corners: Vec<[DVec3; 3]>,
    tree: Tree,
}

impl NewFaces {
    /// `None` if most faces are new, so that a search for the nearest of them would save nothing.
    fn of(result: &Analysis<'_>, is_common: &[bool]) -> Option<Self> {
        if is_common.iter().filter(|is_common| **is_common).count() * 2 < is_common.len() {
            return None;
        }
        let (faces, unit) = (&result.surface.faces, result.unit());
        let new: Vec<[u32; 3]> =
            faces.iter().zip(is_common).filter(|(_, is_common)| !**is_common).map(|(face, _)| *face).collect();
        let corners = new.iter().map(|face| face.map(|v| unit[v as usize])).collect();
        Some(Self { corners, tree: Tree::new(unit, &new) })
    }

    /// How far a search around a point must reach, up to `most`.
    fn reach(&self, point: DVec3, most: f64, steps: &mut u64) -> f64 {
        let nearest = self.tree.nearest(point, most, steps, |f| self.corners[f as usize]);
        // Slightly farther than the face, so that rounding does not hide it.
        nearest.map_or(0.0, |nearest| nearest.distance * (1.0 + 1e-9))
    }
}

/// Finds the nearest point of the other mesh for each of `count` points. `reach` gives how far to search around a point of the other mesh,
/// and counts down the steps that this takes.
fn find_nearby(
    pair: Pair<'_>,
    reach: impl Fn(DVec3, &mut u64) -> f64 + Sync,
    (count, point): (usize, impl Fn(usize) -> DVec3 + Sync),
    context: &Context<'_>,
) -> Result<Nearby, Cancelled> {
    if count == 0 {
        return Ok(Nearby { matches: Vec::new(), complete: true });
    }
    let (tree, ratio) = (pair.to.tree(), pair.ratio);
    let budget = BUDGET + BUDGET_PER_POINT * count as u64;
    let answers = run_coherent_queries(count, budget, context, |i, (), steps| {
        let point = point(i) * ratio;
        let within = reach(point, steps);
        let nearest = tree.nearest(point, within, steps, |f| pair.to.unit_corners(f));
        let found = nearest.map(|n| Match::Found { face: n.face, distance: n.distance / ratio });
        Some(if *steps == 0 { Some(Match::Unknown) } else { found })
    })?;
    let matches = answers.values.into_iter().map(|answer| answer.unwrap_or(Some(Match::Unknown))).collect();
    Ok(Nearby { matches, complete: answers.complete })
}

/// Returns the provenance of each face of the result's surface, and whether the search finished.
fn of_result(
    before: &Analysis<'_>,
    after: &Analysis<'_>,
    identical: &[bool],
    is_kept: impl Fn(u32) -> bool,
    context: &Context<'_>,
) -> Result<(Vec<Provenance>, bool), Cancelled> {
    let unmatched: Vec<u32> = (0u32..).zip(identical).filter(|&(_, &kept)| !kept).map(|(f, _)| f).collect();
    let samples_per_face = if unmatched.len() <= FOUR_SAMPLE_FACES { 4 } else { 1 };
    let sample = |i: usize| {
        let [a, b, c] = after.unit_corners(unmatched[i / samples_per_face]);
        let centre = centre([a, b, c]);
        // Halfway from the centre to each corner, since the corners themselves are often shared with kept faces.
        [centre, (centre + a) / 2.0, (centre + b) / 2.0, (centre + c) / 2.0][i % samples_per_face]
    };
    let count = unmatched.len() * samples_per_face;
    let pair = Pair::new(after, before);
    let reach = (FAR * before.unit_diagonal() / pair.ratio).max(ROUNDING) * pair.ratio;
    let nearby = find_nearby(pair, |_, _| reach, (count, sample), context)?;
    let mut provenance = vec![Provenance::Kept; identical.len()];
    for (&f, matches) in unmatched.iter().zip(nearby.matches.chunks(samples_per_face)) {
        let is_on_input = |found: &Option<Match>| {
            found.is_some_and(|found| matches!(found, Match::Unknown) || found.is_within(ROUNDING))
        };
        let is_counterpart = |found: &Option<Match>| match *found {
            Some(Match::Found { face, distance }) => !is_kept(face) && distance > ROUNDING,
            _ => false,
        };
        provenance[f as usize] = if matches.iter().all(is_on_input) {
            Provenance::Kept
        } else if matches.iter().all(Option::is_some) && matches.iter().any(is_counterpart) {
            Provenance::Moved
        } else {
            Provenance::Added
        };
    }
    Ok((provenance, nearby.complete))
}

/// A piece of a face. A face is split into four triangles at the midpoints of its edges, and so is each of them, several times.
struct Piece {
    face: u32,
    /// The number of times that the face was split.
    splits: u8,
    /// For each split, which of the four triangles holds the piece: two bits, those of the last split lowest.
    path: u16,
}

const _: () = assert!(2 * MAX_SPLITS < u16::BITS, "a path has two bits for each split");

impl Piece {
    /// The corners in unit coordinates of the face's mesh.
    fn corners(&self, analysis: &Analysis<'_>) -> [DVec3; 3] {
        (0..self.splits).rev().fold(analysis.unit_corners(self.face), |[a, b, c], split| {
            let [ab, bc, ca] = [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0];
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]][usize::from(self.path >> (2 * split) & 3)]
        })
    }
}

/// The pieces of the input's faces without an identical face in the result. Large faces are split.
fn pieces_of(analysis: &Analysis<'_>, kept: &[bool]) -> Vec<Piece> {
    if !kept.contains(&false) {
        return Vec::new();
    }
    let total: f64 = areas_of(analysis).iter().sum();
    let lost = (0u32..).zip(kept).filter(|&(_, &kept)| !kept).map(|(face, _)| face);
    let pieces_of_face = |face: u32| {
        let (mut splits, mut left) = (0, area(analysis.unit_corners(face)));
        while u32::from(splits) < MAX_SPLITS && left > total / PIECES_PER_AREA {
            (splits, left) = (splits + 1, left / 4.0);
        }
        (0..1u16 << (2 * splits)).map(move |path| Piece { face, splits, path })
    };
    lost.flat_map(pieces_of_face).collect()
}

fn centre([a, b, c]: [DVec3; 3]) -> DVec3 {
    (a + b + c) / 3.0
}

/// The area of each face, in square unit coordinates.
fn areas_of(analysis: &Analysis<'_>) -> Vec<f64> {
    #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
    threads::map_cheap(analysis.surface.faces.len(), |face| area(analysis.unit_corners(face as u32)))
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).cross(c - a).length() / 2.0
}
