//! The sizes that a designer chose: distances between parallel planes, and diameters of circles in planes.

use glam::DVec3;
use rustc_hash::FxHashMap;

use crate::inspect::doubled_areas;
use crate::math::threads;
use crate::mesh::{Edges, Surface, UnionFind};

/// Faces are coplanar if the cosine between their normals is at least 1 minus this: 45 microradians.
const COPLANAR: f64 = 1e-9;
/// Directions are parallel if their cosine, without sign, is at least 1 minus this.
const PARALLEL: f64 = 1e-8;
/// Directions count if their planes have at least this share of the surface area.
const DIRECTION_SHARE: f64 = 0.1;
/// A plane counts, with its circles, if it has at least this share of the surface area.
const PLANE_SHARE: f64 = 0.002;
/// Parallel planes closer than this share of the bounding box's diagonal count as one plane.
const SAME_PLANE: f64 = 1e-6;
/// Most directions that are examined.
const MAX_DIRECTIONS: usize = 8;
/// Most planes that are examined in each direction.
const MAX_PLANES: usize = 64;
/// Fewest vertices of a circle.
const CIRCLE_VERTICES: usize = 8;
/// Largest distance of a vertex from a circle, as a share of the radius.
const ROUNDNESS: f64 = 1e-4;

/// Sizes that a designer chose, in the model's unit.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DesignedSizes {
    /// Distances between neighbouring parallel planes, and diameters of discs and bosses.
    pub lengths: Vec<f64>,
    /// Diameters of round holes in planes.
    pub holes: Vec<f64>,
}

/// A flat, connected patch of the surface.
struct Plane {
    /// The patch's number.
    patch: u32,
    area: f64,
    normal: DVec3,
    /// A corner of the patch.
    at: DVec3,
}

/// Finds the sizes that a designer chose. Organic and scanned models have few or none. O(n log n) in the number of faces.
#[must_use]
pub fn designed_sizes(surface: &Surface, edges: &Edges) -> DesignedSizes {
    let normals = threads::map_cheap(surface.faces.len(), |face| surface.area_vector(face).normalize_or_zero());
    let coplanar_beside = |edge: usize| match *edges.half_edges(edge) {
        [a, b] if normals[a as usize / 3].dot(normals[b as usize / 3]) >= 1.0 - COPLANAR => Some([a / 3, b / 3]),
        _ => None,
    };
    let joined = threads::filter_map(edges.len(), coplanar_beside);
    drop(normals);
    let mut sets = UnionFind::new(surface.faces.len());
    joined.into_iter().for_each(|[a, b]| sets.unite(a, b));
    let patch_of = sets.into_roots();
    let areas = doubled_areas(surface);
    let total: f64 = areas.iter().sum();
    let planes = large_planes(surface, &patch_of, &areas, total);
    let mut sizes = DesignedSizes { lengths: distances(surface, &planes, total), holes: Vec::new() };
    add_circles(surface, edges, (&planes, &patch_of), &mut sizes);
    sizes
}

/// The flat patches with enough area, the largest first.
fn large_planes(surface: &Surface, patch_of: &[u32], areas: &[f64], total: f64) -> Vec<Plane> {
    let mut area_of = vec![0.0; patch_of.len()];
    patch_of.iter().zip(areas).for_each(|(&patch, area)| area_of[patch as usize] += area);
    let least = PLANE_SHARE * total;
    // Only patches of that area can have an area vector of that length, up to rounding.
    let mut sums: FxHashMap<u32, DVec3> = FxHashMap::default();
    for (face, &patch) in patch_of.iter().enumerate().filter(|&(_, &patch)| area_of[patch as usize] >= 0.99 * least) {
        *sums.entry(patch).or_default() += surface.area_vector(face);
    }
    let mut planes: Vec<Plane> = sums
        .into_iter()
        .filter(|(_, sum)| sum.length() > 0.0 && sum.length() >= least)
        .map(|(patch, sum)| {
            let at = surface.corners(patch as usize)[0];
            Plane { patch, area: sum.length(), normal: sum.normalize_or_zero(), at }
        })
        .collect();
    planes.sort_by(|a, b| b.area.total_cmp(&a.area).then(a.patch.cmp(&b.patch)));
    planes
}

/// The distances between neighbouring planes of the main directions.
fn distances(surface: &Surface, planes: &[Plane], total: f64) -> Vec<f64> {
    let same = SAME_PLANE * surface.bounds().diagonal();
    let mut directions: Vec<(DVec3, Vec<&Plane>)> = Vec::new();
    for plane in planes {
        let is_parallel = |(direction, _): &(DVec3, Vec<&Plane>)| direction.dot(plane.normal).abs() >= 1.0 - PARALLEL;
        match directions.iter().position(is_parallel) {
            Some(number) => directions[number].1.push(plane),
            None if directions.len() < MAX_DIRECTIONS => directions.push((plane.normal, vec![plane])),
            None => {}
        }
    }
    let mut lengths = Vec::new();
    for (direction, mut of) in directions {
        if of.iter().map(|plane| plane.area).sum::<f64>() < DIRECTION_SHARE * total {
            continue;
        }
        of.truncate(MAX_PLANES);
        let mut offsets: Vec<f64> = of.iter().map(|plane| direction.dot(plane.at)).collect();
        offsets.sort_by(f64::total_cmp);
        lengths.extend(offsets.windows(2).map(|pair| pair[1] - pair[0]).filter(|&length| length > same));
    }
    lengths
}

/// Adds the diameters of the circles that bound the planes.
fn add_circles(surface: &Surface, edges: &Edges, (planes, patch_of): (&[Plane], &[u32]), sizes: &mut DesignedSizes) {
    if planes.is_empty() {
        return;
    }
    // For each patch, the half-edges on its boundary by their first vertex: the second vertex, and the third vertex of the face across.
    let mut rims: FxHashMap<u32, FxHashMap<u32, (u32, u32)>> =
        planes.iter().map(|plane| (plane.patch, FxHashMap::default())).collect();
    for of_edge in edges.iter() {
        let &[a, b] = of_edge else { continue };
        for (own, other) in [(a, b), (b, a)] {
            let patch = patch_of[own as usize / 3];
            if patch == patch_of[other as usize / 3] {
                continue;
            }
            if let Some(rim) = rims.get_mut(&patch) {
                let [from, to] = Edges::ends(&surface.faces, own);
                rim.insert(from, (to, Edges::opposite(&surface.faces, other)));
            }
        }
    }
    for plane in planes {
        let Some(rim) = rims.get_mut(&plane.patch) else { continue };
        let mut starts: Vec<u32> = rim.keys().copied().collect();
        starts.sort_unstable();
        for start in starts {
            let Some((points, across)) = take_loop(surface, rim, start) else { continue };
            let Some(diameter) = circle(&points) else { continue };
            // Seen from outside, the rim of a hole runs clockwise, and the faces of its wall go down from the plane.
            let turn: DVec3 =
                (1..points.len() - 1).map(|i| (points[i] - points[0]).cross(points[i + 1] - points[0])).sum();
            let is_inner = turn.dot(plane.normal) < 0.0;
            let goes_down = (surface.positions[across as usize] - plane.at).dot(plane.normal) < 0.0;
            if is_inner && goes_down { sizes.holes.push(diameter) } else { sizes.lengths.push(diameter) }
        }
    }
}

/// Removes the loop that begins at a vertex from a rim. Returns the loop's points and the vertex across its first edge; `None` if the
/// loop does not close.
fn take_loop(surface: &Surface, rim: &mut FxHashMap<u32, (u32, u32)>, start: u32) -> Option<(Vec<DVec3>, u32)> {
    let &(_, across) = rim.get(&start)?;
    let (mut points, mut at) = (Vec::new(), start);
    while let Some((to, _)) = rim.remove(&at) {
        points.push(surface.positions[at as usize]);
        at = to;
    }
    (at == start).then_some((points, across))
}

/// The diameter of the circle through all points; `None` if they are not on a circle.
fn circle(points: &[DVec3]) -> Option<f64> {
    let n = points.len();
    if n < CIRCLE_VERTICES {
        return None;
    }
    let [a, b, c] = [points[0], points[n / 3], points[2 * n / 3]];
    let (u, v) = (b - a, c - a);
    let normal = u.cross(v);
    let denominator = 2.0 * normal.length_squared();
    if denominator <= 0.0 {
        return None;
    }
    let centre = a + (v.length_squared() * normal.cross(u) + u.length_squared() * v.cross(normal)) / denominator;
    let radius = centre.distance(a);
    let is_round = points.iter().all(|point| (point.distance(centre) - radius).abs() <= ROUNDNESS * radius);
    is_round.then_some(2.0 * radius)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Soup;

    /// A plate with a round hole of diameter 2 r through its middle. Each rim has n vertices.
    fn drilled_plate([x, y, z]: [f64; 3], r: f64, n: u32) -> Surface {
        let mut soup = Soup::default();
        let corner = |k: u32| [[-x, -y], [x, -y], [x, y], [-x, y]][k as usize % 4].map(|side: f64| side / 2.0);
        let round = |k: u32| {
            let angle = (f64::from(k % n) / f64::from(n) + 0.5) * std::f64::consts::TAU;
            [r * angle.cos(), r * angle.sin()]
        };
        for height in [0.0, z] {
            soup.positions.extend((0..4).map(corner).map(|[x, y]| DVec3::new(x, y, height)));
            soup.positions.extend((0..n).map(round).map(|[x, y]| DVec3::new(x, y, height)));
        }
        let (outer, inner) = (|top: u32, k: u32| top * (4 + n) + k % 4, |top: u32, k: u32| top * (4 + n) + 4 + k % n);
        for k in 0..4 {
            soup.faces.push([outer(1, k), outer(1, k + 1), inner(1, (k + 1) * n / 4)]);
            soup.faces.push([outer(0, k), inner(0, (k + 1) * n / 4), outer(0, k + 1)]);
            soup.faces.push([outer(0, k), outer(0, k + 1), outer(1, k + 1)]);
            soup.faces.push([outer(0, k), outer(1, k + 1), outer(1, k)]);
            for i in k * n / 4..(k + 1) * n / 4 {
                soup.faces.push([outer(1, k), inner(1, i + 1), inner(1, i)]);
                soup.faces.push([outer(0, k), inner(0, i), inner(0, i + 1)]);
            }
        }
        for i in 0..n {
            soup.faces.push([inner(0, i), inner(1, i), inner(1, i + 1)]);
            soup.faces.push([inner(0, i), inner(1, i + 1), inner(0, i + 1)]);
        }
        Surface::from_soup(&soup).0
    }

    #[test]
    fn a_drilled_plate_has_its_thickness_and_both_rims_of_its_hole() {
        let plate = drilled_plate([40.0, 30.0, 3.0], 1.65, 24);
        let sizes = designed_sizes(&plate, &Edges::new(&plate.faces));
        let mut lengths = sizes.lengths.clone();
        lengths.sort_by(f64::total_cmp);
        // The short sides have less than a tenth of the area.
        assert_eq!(lengths, [3.0]);
        assert_eq!(sizes.holes.len(), 2, "both rims");
        assert!(sizes.holes.iter().all(|hole| (hole - 3.3).abs() < 1e-9), "{sizes:?}");
    }

    #[test]
    fn a_round_disc_has_a_diameter_and_a_height() {
        let mut soup = Soup::default();
        let n = 32u32;
        let angle = |k: u32| f64::from(k) / f64::from(n) * std::f64::consts::TAU;
        for height in [0.0, 5.0] {
            soup.positions.extend((0..n).map(|k| DVec3::new(10.0 * angle(k).cos(), 10.0 * angle(k).sin(), height)));
        }
        for k in 1..n - 1 {
            soup.faces.extend([[0, k + 1, k], [n, n + k, n + k + 1]]);
        }
        for k in 0..n {
            let next = (k + 1) % n;
            soup.faces.extend([[k, next, n + next], [k, n + next, n + k]]);
        }
        let disc = Surface::from_soup(&soup).0;
        let sizes = designed_sizes(&disc, &Edges::new(&disc.faces));
        let near = |length: f64| sizes.lengths.iter().any(|found| (found - length).abs() < 1e-9);
        assert!(near(5.0) && near(20.0) && sizes.holes.is_empty(), "{sizes:?}");
    }
}
