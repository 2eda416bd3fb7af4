//! The result of a thickening: what was thin before, and what is thin after it.

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree, nearest_within};
use crate::mesh::Surface;
use crate::printing::thickness::{
    Earlier, OpposedPair, OpposedPairs, Space, opposed_pairs, opposed_pairs_after, rounded_limit,
};
use glam::DVec3;
use rayon::prelude::*;

use super::outcome::{PlaceResult, Thickened, ThickenedPlace, Thickening, ThinReason};
use super::places::Places;
use super::walls::Opposed;

/// The share of the limit below which a wall has hardly any thickness. Rounding can leave slivers as thin as that.
const WITHOUT_THICKNESS: f64 = 0.005;
/// The share of the least thickness before below which a result counts as thinner.
pub const MAX_THINNER: f64 = 0.98;

/// The thin walls and sharp edges of a surface, by the measure that decides.
#[derive(Debug, Clone, Default)]
pub struct Thin {
    pairs: OpposedPairs,
    /// The sum over all thin faces of the area times the lacking share of the thickness.
    pub lack: f64,
    /// The least thickness that is enough.
    limit: f64,
    /// The number of faces of the surface.
    faces: usize,
}

impl Thin {
    /// Measures a surface.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn of(surface: &Surface, min_wall: f64, context: &Context<'_>) -> Result<Self, Cancelled> {
        let limit = rounded_limit(surface, min_wall);
        Ok(Self::new(surface, limit, opposed_pairs(surface, limit, Space::Material, context)?))
    }

    /// Measures a surface where it is not the same as an earlier one.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn after(earlier: &Grown, surface: &Surface, min_wall: f64, context: &Context<'_>) -> Result<Self, Cancelled> {
        let limit = rounded_limit(surface, min_wall);
        let earlier = Earlier { surface: &earlier.surface, pairs: &earlier.thin.pairs };
        Ok(Self::new(surface, limit, opposed_pairs_after(earlier, surface, limit, Space::Material, context)?))
    }

    fn new(surface: &Surface, limit: f64, pairs: OpposedPairs) -> Self {
        let area = |pair: &OpposedPair| surface.area_vector(pair.faces[0] as usize).length() / 2.0;
        let lack = |pair: &OpposedPair| area(pair) * (1.0 - pair.thickness / limit).max(0.0);
        let lack = pairs.walls.iter().chain(&pairs.tips).map(lack).sum();
        Self { pairs, lack, limit, faces: surface.faces.len() }
    }

    /// The thinnest place of each face in a thin wall.
    pub fn walls(&self) -> &[OpposedPair] {
        &self.pairs.walls
    }

    /// The thinnest place of each face at a sharp edge.
    pub fn tips(&self) -> &[OpposedPair] {
        &self.pairs.tips
    }

    /// Whether nothing is thin.
    pub fn is_empty(&self) -> bool {
        self.walls().is_empty() && self.tips().is_empty()
    }

    /// The least thickness of a wall; infinite if no wall is thin.
    pub fn least(&self) -> f64 {
        self.walls().iter().map(|pair| pair.thickness).fold(f64::INFINITY, f64::min)
    }

    /// The number of thin faces.
    pub fn count(&self) -> usize {
        self.walls().len() + self.tips().len()
    }

    /// The thinnest place of each face of a surface; sharp edges only where no wall is thin.
    fn of_faces(&self, faces: usize) -> Vec<Vec<Opposed>> {
        let mut thin: Vec<Vec<Opposed>> = vec![Vec::new(); faces];
        for pair in self.walls().iter().chain(self.tips()) {
            let [face, other] = pair.faces;
            if thin[face as usize].is_empty() {
                let &OpposedPair { points, distance, thickness, .. } = pair;
                thin[face as usize].push(Opposed { face: other, points, distance, thickness });
            }
        }
        thin
    }
}

/// A surface on the way to a result. Sources are faces of the input; those of added faces are larger by the number of
/// the input's faces.
#[derive(Debug, Clone, Default)]
pub struct Grown {
    /// The surface.
    pub surface: Surface,
    /// Its thin places.
    pub thin: Thin,
    /// Points at which a gap limited the growth.
    pub limited: Vec<DVec3>,
    /// Why growth ended before everything was thick.
    pub reason: Option<ThinReason>,
    /// Through holes of the input that were closed.
    pub through_holes_closed: u64,
    /// Narrow gaps that were filled, since added material closed them on all sides.
    pub narrow_gaps_filled: u64,
    /// Whether a wall grew on both sides although one side should stay.
    pub grew_on_equal_sides: bool,
}

impl Grown {
    /// Whether more is thick than in another result, and no wall with added faces is much thinner than the thinnest one `before`, unless
    /// that had hardly any thickness. Between two faces of the input no wall got thinner, but a sharp edge can count as a wall now.
    pub fn is_better_than(&self, other: &Self, before: &Thin) -> bool {
        let least = before.least();
        let had_none = least < WITHOUT_THICKNESS * before.limit;
        let is_added = |face: &u32| self.surface.source[*face as usize] as usize >= before.faces;
        let is_thinner = |wall: &OpposedPair| wall.thickness < MAX_THINNER * least && wall.faces.iter().any(is_added);
        self.thin.lack < other.thin.lack && (had_none || !self.thin.walls().iter().any(is_thinner))
    }
}

/// The frame of a result.
pub struct Results<'a> {
    pub settings: Thickening,
    pub input: &'a Surface,
    pub before: &'a Thin,
}

impl Results<'_> {
    /// Assembles the result.
    pub fn finish(&self, grown: Grown) -> Thickened {
        let count = self.input.faces.len();
        let Grown { mut surface, thin, limited, reason: last, grew_on_equal_sides, .. } = grown;
        let Grown { through_holes_closed, narrow_gaps_filled, .. } = grown;
        let before = self.before.of_faces(count);
        let places = Places::new(self.input, &before);
        let mut results = self.places_before(&before, &places);
        for (pair, is_tip) in
            thin.tips().iter().map(|pair| (pair, true)).chain(thin.walls().iter().map(|pair| (pair, false)))
        {
            let source = surface.source[pair.faces[0] as usize] as usize % count.max(1);
            let Some(number) = places.of_face[source].or_else(|| places.nearest(self.input, pair.points[0])) else {
                continue;
            };
            let place = &mut results[number as usize];
            place.least_after = place.least_after.min(pair.thickness);
            let reason = if is_tip { ThinReason::SharpEdge } else { self.reason(&limited, last, pair) };
            place.result = PlaceResult::LeftThin(reason);
        }
        results.sort_by(|a, b| b.area.total_cmp(&a.area));
        let added_faces = added_faces(&surface, count);
        let tree = Tree::new(&self.input.positions, &self.input.faces);
        let max_deviation = deviation((self.input, &tree), &surface, &added_faces);
        let added_volume = volume(&surface) - volume(self.input);
        for source in &mut surface.source {
            *source = self.input.source[*source as usize % count.max(1)];
        }
        Thickened {
            surface,
            added_volume,
            max_deviation,
            through_holes_closed,
            narrow_gaps_filled,
            grew_on_equal_sides,
            places: results,
            added_faces,
            thin: thin.pairs,
        }
    }

    /// Why a wall stays thin: a gap limited the growth near it, or `last` ended the growth.
    fn reason(&self, limited: &[DVec3], last: Option<ThinReason>, pair: &OpposedPair) -> ThinReason {
        let middle = pair.points[0].midpoint(pair.points[1]);
        let is_near = |point: &DVec3| point.distance(middle) < self.settings.min_wall;
        if limited.iter().any(is_near) { ThinReason::Gap } else { last.unwrap_or(ThinReason::Rounds) }
    }

    /// The places of the input, all proved.
    fn places_before(&self, before: &[Vec<Opposed>], places: &Places) -> Vec<ThickenedPlace> {
        let none = ThickenedPlace {
            at: DVec3::ZERO,
            least_before: f64::INFINITY,
            least_after: self.settings.min_wall,
            area: 0.0,
            result: PlaceResult::Proved,
        };
        let mut results = vec![none; places.count as usize];
        for (face, walls) in before.iter().enumerate() {
            let (Some(number), Some(wall)) = (places.of_face[face], walls.first()) else { continue };
            let place = &mut results[number as usize];
            place.area += self.input.area_vector(face).length() / 2.0;
            if wall.thickness < place.least_before {
                (place.least_before, place.at) = (wall.thickness, wall.points[0]);
            }
        }
        results
    }
}

/// The enclosed volume, relative to the centre of the box.
fn volume(surface: &Surface) -> f64 {
    let origin = surface.bounds().centre();
    let part = |face: usize| {
        let [a, b, c] = surface.corners(face).map(|p| p - origin);
        a.dot(b.cross(c))
    };
    (0..surface.faces.len()).map(part).sum::<f64>() / 6.0
}

/// The number of faces of a surface.
#[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
pub fn face_count(surface: &Surface) -> u32 {
    surface.faces.len() as u32
}

/// The input as the start of a way to a result: each face is its own source.
pub fn with_own_sources(input: &Surface) -> Surface {
    Surface { source: (0..face_count(input)).collect(), ..input.clone() }
}

/// The faces of a surface on the way to a result that are not faces of the input, which has `count` faces.
fn added_faces(surface: &Surface, count: usize) -> Vec<u32> {
    let is_added = |&(_, source): &(u32, &u32)| *source as usize >= count;
    (0u32..).zip(&surface.source).filter(is_added).map(|(face, _)| face).collect()
}

/// The largest distance of the added faces of a surface on the way to a result from the input.
pub fn deviation_of_added(input: (&Surface, &Tree), surface: &Surface) -> f64 {
    deviation(input, surface, &added_faces(surface, input.0.faces.len()))
}

/// Whether all added faces of a surface on the way to a result are within a distance of the input.
pub fn is_added_within(reach: f64, (input, tree): (&Surface, &Tree), surface: &Surface) -> bool {
    let is_near = |p: DVec3| {
        let is_at = |face: u32| nearest_within(p, input.corners(face as usize), reach).is_some();
        tree.any_overlapping(&Box3::of([p]).grown(reach), is_at)
    };
    points_of(surface, &added_faces(surface, input.faces.len())).all(is_near)
}

/// Whether a closed surface encloses the corners and the centres of another one's faces, except for a distance.
pub fn encloses(outer: &Surface, inner: &Surface, tolerance: f64) -> bool {
    let tree = Tree::new(&outer.positions, &outer.faces);
    let corners = |face: u32| outer.corners(face as usize);
    let dipoles = tree.dipoles(corners);
    let is_at = |p: DVec3| tree.nearest(p, tolerance, &mut u64::MAX.clone(), corners).is_some();
    let is_inside = |p: DVec3| is_at(p) || tree.winding(&dipoles, p, &mut u64::MAX.clone(), corners) > 0.5;
    let all: Vec<u32> = (0..face_count(inner)).collect();
    points_of(inner, &all).all(is_inside)
}

/// The largest distance of the corners and the centres of some faces from another surface, given with its tree.
fn deviation((from, tree): (&Surface, &Tree), of: &Surface, faces: &[u32]) -> f64 {
    let distance = |p: DVec3| {
        let nearest = tree.nearest(p, f64::INFINITY, &mut u64::MAX.clone(), |face| from.corners(face as usize));
        nearest.map_or(0.0, |nearest| nearest.distance)
    };
    points_of(of, faces).map(distance).reduce(|| 0.0, f64::max)
}

/// The corners and the centres of some faces.
fn points_of<'a>(surface: &'a Surface, faces: &'a [u32]) -> impl ParallelIterator<Item = DVec3> + 'a {
    let mut is_corner = vec![false; surface.positions.len()];
    faces.iter().flat_map(|&face| surface.faces[face as usize]).for_each(|v| is_corner[v as usize] = true);
    let corners = surface.positions.par_iter().zip(is_corner).filter(|(_, is_corner)| *is_corner).map(|(&p, _)| p);
    let centres = faces.par_iter().map(|&face| surface.corners(face as usize).into_iter().sum::<DVec3>() / 3.0);
    corners.chain(centres)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A result with a lack, and a wall of a thickness between a face that was not added and another one.
    fn grown(lack: f64, thickness: f64, other: u32) -> Grown {
        let wall = OpposedPair { faces: [0, other], points: [DVec3::ZERO; 2], distance: thickness, thickness };
        let pairs = OpposedPairs { walls: vec![wall], ..OpposedPairs::default() };
        let surface = Surface { source: vec![0, 1, 2, 3], ..Surface::default() };
        Grown { surface, thin: Thin { pairs, lack, limit: 1.0, faces: 3 }, ..Grown::default() }
    }

    #[test]
    fn a_better_result_lacks_less_and_makes_no_wall_thinner_than_any_before() {
        let before = grown(8.0, 0.5, 1);
        let is_better = |grown: Grown| grown.is_better_than(&before, &before.thin);
        assert!(is_better(grown(2.0, 0.5, 3)));
        assert!(!is_better(grown(8.0, 0.5, 3)), "it lacks as much");
        assert!(!is_better(grown(2.0, 0.4, 3)), "a wall with an added face is thinner");
        assert!(is_better(grown(2.0, 0.4, 2)), "a wall of the input, which was a sharp edge");
    }
}
