//! Vertices moved to coarser grids.

use glam::DVec3;
use rustc_hash::FxHashSet;

use super::super::degenerate::remove_collapsed;
use super::super::places::key;
use crate::inspect::Intersections;
use crate::math::Precision;
use crate::mesh::{Surface, weld_exactly};

/// So many others a face of a dense cluster intersects.
const DENSE: u32 = 32;
/// Clusters are looked at from so many pairs on.
const MANY_DENSE: usize = 2_000;

/// The step of the grid of `2^bits` steps over the largest coordinate.
pub(super) fn grid_step(surface: &Surface, bits: i32) -> f64 {
    let bounds = surface.bounds();
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    #[expect(clippy::cast_possible_truncation, reason = "an exponent")]
    2f64.powi(largest.log2().ceil() as i32 - bits)
}

/// Moves the vertices of faces to a grid, and with them all vertices of the same cells. A coordinate in which a whole face agrees
/// stays, so that surface along the axes stays flat. Answers how many moved, and how far at most.
pub(super) fn snap(surface: &mut Surface, takes_part: &[bool], step: f64) -> (u64, f64) {
    let (mut moved, mut far) = (0, 0.0f64);
    let mut pinned = vec![[false; 3]; surface.positions.len()];
    for (face, corners) in surface.faces.iter().zip((0..surface.faces.len()).map(|f| surface.corners(f))) {
        for k in 0..3 {
            if corners[0][k] == corners[1][k] && corners[1][k] == corners[2][k] {
                face.iter().for_each(|&v| pinned[v as usize][k] = true);
            }
        }
    }
    let on_grid = |p: DVec3, pins: [bool; 3]| {
        let q = Precision::F32.round((p / step).round() * step);
        DVec3::from_array([0, 1, 2].map(|k| if pins[k] { p[k] } else { q[k] }))
    };
    let mut cells: FxHashSet<[u32; 3]> = FxHashSet::default();
    for (face, _) in surface.faces.iter().zip(takes_part).filter(|(_, t)| **t) {
        cells.extend(face.iter().map(|&v| key(on_grid(surface.positions[v as usize], pinned[v as usize]))));
    }
    for (p, &pins) in surface.positions.iter_mut().zip(&pinned) {
        let q = on_grid(*p, pins);
        if q != *p && cells.contains(&key(q)) {
            moved += 1;
            far = far.max(p.distance(q));
            *p = q;
        }
    }
    weld_exactly(surface);
    remove_collapsed(surface);
    (moved, far)
}

/// Faces of dense clusters: those that intersect many faces which do so too. None where so few pairs are dense that it is no
/// matter.
pub(super) fn dense_faces(found: &Intersections) -> Option<Vec<bool>> {
    let [takes_part, _] = &found.takes_part;
    let mut partners = vec![0u32; takes_part.len()];
    for pair in &found.pairs {
        pair.faces.iter().for_each(|&f| partners[f as usize] += 1);
    }
    let is_dense = |f: u32| partners[f as usize] >= DENSE;
    let mut dense = vec![false; takes_part.len()];
    let mut count = 0;
    for pair in found.pairs.iter().filter(|pair| pair.faces.iter().all(|&f| is_dense(f))) {
        pair.faces.iter().for_each(|&f| dense[f as usize] = true);
        count += 1;
    }
    (count >= MANY_DENSE).then_some(dense)
}
