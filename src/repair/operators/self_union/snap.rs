//! Snapping of vertices to a grid, where faces intersect again after rounding and in dense clusters.

use glam::DVec3;
use rustc_hash::FxHashSet;

use crate::inspect::{Intersections, doubled_areas};
use crate::math::Precision;
use crate::mesh::{Surface, weld_exactly};
use crate::repair::operators::degenerate::remove_collapsed;
use crate::repair::operators::free_positions::key;

/// The number of intersecting faces from which a face belongs to a dense cluster.
const DENSE_PARTNERS: u64 = 32;
/// The number of pairs of such faces from which clusters are snapped.
const MIN_DENSE_PAIRS: usize = 2_000;
/// The number of pieces up to which dense clusters are not snapped, and up to which an attempt without snapping is made. A
/// thousand faces through one point would otherwise be split into more pieces than there are positions.
const FEW_PIECES: u64 = 1_000_000;
const MAX_PIECES: u64 = 20_000_000;
/// The share of the surface's area from which dense faces count as solids that pass through each other. Less is a tangle,
/// whose faces are small and nearly coincide: without snapping, rounding makes them intersect again.
const MIN_SOLID_SHARE: f64 = 0.1;

/// The dense clusters of a surface.
pub(super) struct Dense {
    /// Marks their faces.
    pub faces: Vec<bool>,
    /// Whether a union without snapping is of no use.
    pub needs_snapping: bool,
}

impl Dense {
    /// Finds faces that intersect many others which do so too. `None` where these are few, or where the surface splits into
    /// few pieces in any case: `k` planes divide a face into at most `(k^2 + k + 2) / 2` pieces.
    pub fn of(surface: &Surface, intersections: &Intersections) -> Option<Self> {
        let [takes_part, _] = &intersections.takes_part;
        let mut partners = vec![0u64; takes_part.len()];
        for pair in &intersections.pairs {
            pair.faces.iter().for_each(|&f| partners[f as usize] += 1);
        }
        let pieces: u64 = partners.iter().map(|k| (k * k + k + 2) / 2).sum();
        let is_dense = |f: u32| partners[f as usize] >= DENSE_PARTNERS;
        let pairs = || intersections.pairs.iter().filter(|pair| pair.faces.iter().all(|&f| is_dense(f)));
        if pieces <= FEW_PIECES || pairs().count() < MIN_DENSE_PAIRS {
            return None;
        }
        let mut faces = vec![false; partners.len()];
        pairs().flat_map(|pair| pair.faces).for_each(|f| faces[f as usize] = true);
        let areas = doubled_areas(surface);
        let dense: f64 = areas.iter().zip(&faces).filter(|(_, dense)| **dense).map(|(area, _)| area).sum();
        let is_tangle = dense < MIN_SOLID_SHARE * areas.iter().sum::<f64>();
        Some(Self { faces, needs_snapping: is_tangle || pieces > MAX_PIECES })
    }
}

/// The step of a grid with `2^bits` steps up to the largest coordinate.
pub(super) fn grid_step(surface: &Surface, bits: i32) -> f64 {
    let bounds = surface.bounds();
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    #[expect(clippy::cast_possible_truncation, reason = "an exponent")]
    2f64.powi(largest.log2().ceil() as i32 - bits)
}

/// Snaps the vertices of the marked faces to a grid, and with them every vertex in the same cells. A coordinate in which all
/// corners of a face agree stays, so that axis-aligned surface stays flat. Returns the number of moved vertices and the
/// largest displacement.
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
