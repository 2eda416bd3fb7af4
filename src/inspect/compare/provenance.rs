use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::original::{FAR, Original, ROUNDING};
use crate::context::{Cancelled, Context};
use crate::inspect::analysis::Pair;
use crate::inspect::matching::Common;
use crate::inspect::sampling::ask;
use crate::inspect::{Analysis, finite};
use crate::math::Nearest;

/// Faces of a result up to which each is looked at in four places; of more, each in its middle.
const FEW: usize = 60_000;
/// Pieces into which the whole input would be cut were all of it one face, and the most cuts in four of one face.
const PIECES: f64 = 4096.0;
const MOST_CUTS: u32 = 4;
/// Boxes and triangles that all searches of one direction together may look at: so many, and so many more for each point.
const BUDGET: u64 = 10_000_000;
const BUDGET_A_POINT: u64 = 500;

/// What became of a piece of surface on the way from one mesh, the input, to another, the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Provenance {
    /// It is in both, whole or cut anew.
    Kept,
    /// It is in the result, and its counterpart in the input is near, but away by more than rounding.
    Moved,
    /// It is in the result, and the input has no counterpart, such as a hole's patch.
    Added,
    /// It is in the input, and the result has no counterpart, such as a wall within a solid.
    Removed,
}

impl Provenance {
    /// All of them, in the order of legends.
    pub const ALL: [Self; 4] = [Self::Kept, Self::Moved, Self::Added, Self::Removed];
}

/// How much surface had one provenance.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SurfaceShare {
    /// Faces: of the result, and for what was removed those of the input of which at least a piece is gone.
    pub faces: u64,
    /// Their area, in the square of the model's unit; of a removed face only that of the pieces that are gone.
    pub area: f64,
}

/// How much of the surface was kept, moved, added and removed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SurfaceShares {
    /// Surface of the result that the input has in the same place.
    pub kept: SurfaceShare,
    /// Surface of the result whose counterpart in the input is near, but away by more than rounding.
    pub moved: SurfaceShare,
    /// Surface of the result without a counterpart in the input.
    pub added: SurfaceShare,
    /// Surface of the input without a counterpart in the result.
    pub removed: SurfaceShare,
    /// Whether all of it was looked at; not on meshes made to be slow. What was not counts as kept.
    pub complete: bool,
}

/// What became of every piece of surface.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfaceProvenance {
    /// For each face of the result's file; none where it is no face of finite corners.
    pub of_face: Vec<Option<Provenance>>,
    /// What was removed of the input, as triangles: whole faces, and pieces of larger ones.
    pub removed: Vec<[DVec3; 3]>,
    /// The sums.
    pub shares: SurfaceShares,
}

impl Original<'_> {
    /// What became of every piece of surface.
    ///
    /// A face that both have at the same three positions is kept, and so is surface that lies on the other mesh's within what
    /// rounding moves. Of the rest of the result, what is farther than 0.5 % of the diagonal from the input is added, and also
    /// what is nearer only to surface that still stands, since that has its counterpart already; the others are moved. Input
    /// surface is removed where nothing but kept and added surface is that near. Large faces of the input are cut into
    /// pieces, so that of a face that runs into a solid the inner piece is removed. O(n log n).
    ///
    /// # Errors
    /// [`Cancelled`] when the context says stop.
    pub fn provenance(&self, after: &Analysis<'_>, context: &Context<'_>) -> Result<SurfaceProvenance, Cancelled> {
        let before = self.analysis;
        let common = if std::ptr::eq(before, after) {
            Common::whole(before.surface.faces.len())
        } else {
            Common::new(&before.keys(before.scale()), &after.keys(before.scale()))
        };
        context.check()?;
        let pieces = Pieces::of(before, &common.first);
        let there = find_nearby(Pair::new(before, after), before.unit_diagonal(), &pieces.middles, context)?;
        // Half of a face that stands is enough for it to be no counterpart of what is near it.
        let mut standing = vec![0i64; before.surface.faces.len()];
        for (piece, found) in pieces.all.iter().zip(&there.places) {
            standing[piece.face as usize] += if found.is_some_and(|it| it.near(ROUNDING)) { 1 } else { -1 };
        }
        let stands = |face: u32| common.first[face as usize] || standing[face as usize] > 0;
        let (of_face, complete) = of_result(before, after, &common.second, stands, context)?;
        let mut provenance =
            SurfaceProvenance { of_face: vec![None; after.subject.soup.faces.len()], ..SurfaceProvenance::default() };
        provenance.shares.complete = there.complete && complete;
        for (f, &kind) in (0u32..).zip(&of_face) {
            provenance.of_face[after.surface.source[f as usize] as usize] = Some(kind);
            provenance.shares.add(kind, 1, area(after.unit_corners(f)) * after.unit_length().powi(2));
        }
        let unit = before.unit_length();
        let mut last = None;
        for (piece, found) in pieces.all.iter().zip(&there.places) {
            let counterpart = match found {
                Some(Place::Unknown) => true,
                Some(Place::Found(it)) => it.distance <= ROUNDING || of_face[it.face as usize] == Provenance::Moved,
                None => false,
            };
            if !counterpart {
                provenance.shares.add(
                    Provenance::Removed,
                    u64::from(last != Some(piece.face)),
                    area(piece.corners) * unit * unit,
                );
                last = Some(piece.face);
                provenance.removed.push(piece.corners.map(|p| p * unit));
            }
        }
        Ok(provenance)
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

/// What was found of the other mesh around a point.
#[derive(Clone, Copy)]
enum Place {
    /// The search was given up.
    Unknown,
    /// The nearest point within reach, its distance in the asking mesh's unit coordinates.
    Found(Nearest),
}

impl Place {
    fn near(&self, within: f64) -> bool {
        matches!(self, Self::Found(it) if it.distance <= within)
    }
}

struct Nearby {
    /// None where nothing is within reach.
    places: Vec<Option<Place>>,
    complete: bool,
}

/// The nearest place of the other mesh for each point, within [`FAR`] of the diagonal.
fn find_nearby(pair: Pair<'_>, diagonal: f64, points: &[DVec3], context: &Context<'_>) -> Result<Nearby, Cancelled> {
    let mut places = vec![Some(Place::Unknown); points.len()];
    if points.is_empty() {
        return Ok(Nearby { places, complete: true });
    }
    let (tree, ratio) = (pair.to.tree(), pair.ratio);
    let reach = (FAR * diagonal).max(ROUNDING);
    let budget = BUDGET + BUDGET_A_POINT * points.len() as u64;
    let answers = ask(points.len(), budget, context, |i, steps| {
        let nearest = tree.nearest(points[i] * ratio, reach * ratio, steps, |f| pair.to.unit_corners(f));
        let found = nearest.map(|it| Place::Found(Nearest { distance: it.distance / ratio, ..it }));
        Some(if *steps == 0 { Some(Place::Unknown) } else { found })
    })?;
    for (place, answer) in places.iter_mut().zip(answers.values) {
        *place = answer.unwrap_or(Some(Place::Unknown));
    }
    Ok(Nearby { places, complete: answers.complete })
}

/// The provenance of each face of the result's surface.
fn of_result(
    before: &Analysis<'_>,
    after: &Analysis<'_>,
    verbatim: &[bool],
    stands: impl Fn(u32) -> bool,
    context: &Context<'_>,
) -> Result<(Vec<Provenance>, bool), Cancelled> {
    let open: Vec<u32> = (0u32..).zip(verbatim).filter(|&(_, &kept)| !kept).map(|(f, _)| f).collect();
    let each = if open.len() <= FEW { 4 } else { 1 };
    let places_in = |&f: &u32| {
        let [a, b, c] = after.unit_corners(f);
        let middle = (a + b + c) / 3.0;
        // Halfway from the middle to each corner: corners themselves are often shared with what stands.
        [middle, (middle + a) / 2.0, (middle + b) / 2.0, (middle + c) / 2.0].into_iter().take(each)
    };
    let points: Vec<DVec3> = open.iter().flat_map(places_in).collect();
    let pair = Pair::new(after, before);
    let nearby = find_nearby(pair, before.unit_diagonal() / pair.ratio, &points, context)?;
    let mut provenance = vec![Provenance::Kept; verbatim.len()];
    for (&f, places) in open.iter().zip(nearby.places.chunks(each)) {
        let on = |place: &Option<Place>| place.is_some_and(|it| matches!(it, Place::Unknown) || it.near(ROUNDING));
        let counterpart = |place: &Option<Place>| matches!(place, Some(Place::Found(it)) if !stands(it.face) && it.distance > ROUNDING);
        provenance[f as usize] = if places.iter().all(on) {
            Provenance::Kept
        } else if places.iter().all(Option::is_some) && places.iter().any(counterpart) {
            Provenance::Moved
        } else {
            Provenance::Added
        };
    }
    Ok((provenance, nearby.complete))
}

/// The faces of the input that are not in the result as they were, the larger ones cut.
#[derive(Default)]
struct Pieces {
    all: Vec<Piece>,
    middles: Vec<DVec3>,
}

struct Piece {
    face: u32,
    corners: [DVec3; 3],
}

impl Pieces {
    fn of(analysis: &Analysis<'_>, stands: &[bool]) -> Self {
        let total: f64 = analysis.surface.faces.iter().zip(0u32..).map(|(_, f)| area(analysis.unit_corners(f))).sum();
        let mut pieces = Self::default();
        for (face, _) in (0u32..).zip(stands).filter(|&(_, &stands)| !stands) {
            let corners = analysis.unit_corners(face);
            let (mut cuts, mut left) = (0, area(corners));
            while cuts < MOST_CUTS && left > total / PIECES {
                (cuts, left) = (cuts + 1, left / 4.0);
            }
            pieces.cut(face, corners, cuts);
        }
        pieces
    }

    /// Cuts a triangle in four at the middles of its edges, again and again.
    fn cut(&mut self, face: u32, corners: [DVec3; 3], cuts: u32) {
        let [a, b, c] = corners;
        if cuts == 0 {
            self.middles.push((a + b + c) / 3.0);
            self.all.push(Piece { face, corners });
            return;
        }
        let [ab, bc, ca] = [(a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0];
        for piece in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
            self.cut(face, piece, cuts - 1);
        }
    }
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    (b - a).cross(c - a).length() / 2.0
}
