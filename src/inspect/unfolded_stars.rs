//! Vertices whose faces lie side by side, as seen from some direction. No two faces at such a vertex intersect, so the search
//! for intersecting faces need not compare the faces with each other. Nearly all neighbours in clean surface are of this kind.

use glam::{DVec2, DVec3};

use crate::math::threads;
use crate::mesh::Stars;

/// Most faces at a vertex that are examined. Vertices with more faces are rare, and need no answer.
const MOST_FACES: usize = 16;
/// Least sine between two edges of a face in the projection, with the edges at their full length. Rounding changes the sine by
/// less than 1e-14.
const LEAST_SINE: f64 = 1e-9;

/// For each vertex, whether its faces certainly have no common points besides the vertices and edges that they share by index.
/// False if in doubt. O(n), in parallel.
///
/// The faces at a vertex are projected along a mean of their normals. If every face keeps its orientation, and each edge ends one
/// face and begins another, the projected faces cover all directions around the vertex equally often. If they cover them once, they
/// do not overlap, and neither do the faces.
pub(super) fn unfolded_stars(positions: &[DVec3], faces: &[[u32; 3]]) -> Vec<bool> {
    let stars = Stars::new(positions.len(), faces);
    threads::map_cheap(positions.len(), |vertex| {
        #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
        let vertex = vertex as u32;
        is_unfolded(positions, faces, vertex, stars.of(vertex))
    })
}

/// Whether the faces at a vertex certainly lie side by side, see [`unfolded_stars`].
fn is_unfolded(positions: &[DVec3], faces: &[[u32; 3]], vertex: u32, star: &[u32]) -> bool {
    if star.len() < 3 || star.len() > MOST_FACES {
        return false;
    }
    let at = positions[vertex as usize];
    let (mut corners, mut edges) = ([[0; 2]; MOST_FACES], [[DVec3::ZERO; 2]; MOST_FACES]);
    let (corners, edges) = (&mut corners[..star.len()], &mut edges[..star.len()]);
    let mut normals = DVec3::ZERO;
    for ((corners, edges), &face) in corners.iter_mut().zip(edges.iter_mut()).zip(star) {
        let [a, b, c] = faces[face as usize];
        *corners = if a == vertex {
            [b, c]
        } else if b == vertex {
            [c, a]
        } else {
            [a, b]
        };
        *edges = corners.map(|corner| positions[corner as usize] - at);
        let [p, q] = *edges;
        normals += p.cross(q) / (p.length_squared() + q.length_squared());
    }
    if !is_closed(corners) {
        return false;
    }
    let Some(direction) = normals.try_normalize() else { return false };
    let (x, y) = direction.any_orthonormal_pair();
    let mut turns = 0;
    for &[p, q] in &*edges {
        let [a, b] = [p, q].map(|edge| DVec2::new(edge.dot(x), edge.dot(y)));
        let sine = a.perp_dot(b);
        let is_certain = sine * sine > LEAST_SINE * LEAST_SINE * (p.length_squared() * q.length_squared());
        if sine <= 0.0 || !is_certain {
            return false;
        }
        // The face covers the direction of the x-axis.
        turns += u32::from(a.y < 0.0 && b.y >= 0.0);
    }
    turns == 1
}

/// Whether each of the edges from a vertex to its faces' other corners begins one face and ends another.
fn is_closed(corners: &[[u32; 2]]) -> bool {
    corners.iter().enumerate().all(|(at, &[first, _])| {
        let is_repeated = corners[..at].iter().any(|other| other[0] == first);
        !is_repeated && corners.iter().any(|other| other[1] == first)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::contact;

    /// A fan of faces around vertex 0, whose other vertices have the given angle in degrees and height.
    fn fan(rim: &[(f64, f64)]) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let on_rim = |&(degrees, z): &(f64, f64)| DVec3::new(degrees.to_radians().cos(), degrees.to_radians().sin(), z);
        let positions = std::iter::once(DVec3::ZERO).chain(rim.iter().map(on_rim)).collect();
        let count = u32::try_from(rim.len()).unwrap();
        (positions, (0..count).map(|at| [0, 1 + at, 1 + (at + 1) % count]).collect())
    }

    fn centre_is_unfolded((positions, faces): (Vec<DVec3>, Vec<[u32; 3]>)) -> bool {
        unfolded_stars(&positions, &faces)[0]
    }

    #[test]
    fn flat_and_pointed_fans_that_turn_once_are_unfolded() {
        for height in [0.0, -3.0, 3.0] {
            assert!(centre_is_unfolded(fan(&[(0.0, height), (90.0, height), (200.0, height), (270.0, height)])));
        }
    }

    #[test]
    fn fans_that_turn_twice_fold_over_or_are_steep_are_in_doubt() {
        let twice: Vec<(f64, f64)> = (0..8).map(|at| (f64::from(at) * 90.0, f64::from(at) * 0.1)).collect();
        assert!(!centre_is_unfolded(fan(&twice)));
        assert!(!centre_is_unfolded(fan(&[(0.0, 0.0), (90.0, 0.0), (80.0, 0.1), (170.0, 0.0), (270.0, 0.0)])));
        assert!(!centre_is_unfolded(fan(&[(0.0, 0.0), (90.0, 0.0), (180.0, 0.0)])));
    }

    #[test]
    fn open_fans_and_fans_beside_another_are_in_doubt() {
        let (positions, mut faces) = fan(&[(0.0, 0.0), (90.0, 0.0), (200.0, 0.0), (270.0, 0.0)]);
        let last = faces.pop().unwrap();
        assert!(!unfolded_stars(&positions, &faces)[0]);
        faces.extend([last, last]);
        assert!(!unfolded_stars(&positions, &faces)[0], "a face that occurs twice");
        let (mut both, mut all) = fan(&[(0.0, 0.0), (120.0, 0.0), (240.0, 0.0)]);
        let (other, faces) = fan(&[(0.0, 1.0), (120.0, 1.0), (240.0, 1.0)]);
        both.extend(&other[1..]);
        all.extend(faces.iter().map(|face| face.map(|v| if v == 0 { 0 } else { v + 3 })));
        assert!(!unfolded_stars(&both, &all)[0], "two fans");
    }

    /// A closed grid around a torus whose vertices are moved at random by up to a tenth of `noise` along each axis.
    fn crumpled_torus(noise: f64, seed: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let side = 12u32;
        let number =
            |at: u32| f64::from(at.wrapping_mul(2_654_435_761).wrapping_add(seed) >> 16 & 0xfff) / 4096.0 - 0.5;
        let at = |x: u32, y: u32| y % side * side + x % side;
        let position = |v: u32| {
            let [u, w] = [v % side, v / side].map(|part| f64::from(part) / f64::from(side) * std::f64::consts::TAU);
            let moved = DVec3::new(number(3 * v), number(3 * v + 1), number(3 * v + 2)) * (noise * 0.2);
            DVec3::new((1.0 + 0.4 * w.cos()) * u.cos(), (1.0 + 0.4 * w.cos()) * u.sin(), 0.4 * w.sin()) * 0.5 + moved
        };
        let squares = (0..side).flat_map(|y| (0..side).map(move |x| (x, y)));
        let faces = squares.flat_map(|(x, y)| {
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            [[a, b, c], [a, c, d]]
        });
        ((0..side * side).map(position).collect(), faces.collect())
    }

    #[test]
    fn faces_at_an_unfolded_vertex_never_intersect() {
        let (mut certain, mut doubtful, mut intersecting) = (0, 0, 0);
        for (noise, seed) in
            [0.0, 1.0, 2.0, 4.0].into_iter().flat_map(|noise| (0..8).map(move |seed| (noise, seed * 977)))
        {
            let (positions, faces) = crumpled_torus(noise, seed);
            let stars = Stars::new(positions.len(), &faces);
            for (vertex, is_unfolded) in (0u32..).zip(unfolded_stars(&positions, &faces)) {
                let star = stars.of(vertex);
                let pairs = star.iter().enumerate().flat_map(|(i, &f)| star[..i].iter().map(move |&g| [f, g]));
                let meets =
                    |[f, g]: [u32; 2]| !contact(&positions, faces[f as usize], faces[g as usize], &mut 0).is_apart();
                let has_intersection = pairs.into_iter().any(meets);
                assert!(!(is_unfolded && has_intersection), "vertex {vertex}, noise {noise}, seed {seed}");
                *(if is_unfolded { &mut certain } else { &mut doubtful }) += 1;
                intersecting += u32::from(has_intersection);
            }
        }
        assert!(certain > 1000 && doubtful > 1000 && intersecting > 100, "{certain} {doubtful} {intersecting}");
    }
}
