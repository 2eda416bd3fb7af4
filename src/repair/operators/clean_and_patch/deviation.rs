use glam::DVec3;

use crate::math::Tree;

/// Boxes and triangles that one search for a nearest point may look at.
const STEPS: u64 = 100_000;

/// How far the farthest of some points is from triangles; infinity where there are no triangles or a search was given up.
pub(super) fn farthest(points: impl Iterator<Item = DVec3>, positions: &[DVec3], faces: &[[u32; 3]]) -> f64 {
    let tree = Tree::new(positions, faces);
    let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
    let distance = |point| {
        let mut steps = STEPS;
        let nearest = tree.nearest(point, f64::INFINITY, &mut steps, corners);
        nearest.filter(|_| steps > 0).map_or(f64::INFINITY, |nearest| nearest.distance)
    };
    points.map(distance).fold(0.0, f64::max)
}
