use glam::DVec3;

use crate::math::Box3;
use crate::mesh::{Edges, Parts, Surface};

/// What one part or patch of a surface is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solid {
    /// Whether each of its edges is used by exactly two of its faces, once in each direction.
    pub closed: bool,
    /// Signed volume by the divergence theorem, about the middle of its box; it means little where it is not closed.
    pub volume: f64,
    /// Area.
    pub area: f64,
    /// Box.
    pub bounds: Box3,
}

/// Measures every part of `parts`. Linear but for the sort within `edges`.
#[must_use]
pub fn solids(surface: &Surface, edges: &Edges, parts: &Parts) -> Vec<Solid> {
    let mut all = vec![Solid { closed: true, volume: 0.0, area: 0.0, bounds: Box3::EMPTY }; parts.count];
    let each = |f: usize| {
        let part = parts.of_face[f];
        (part != Parts::NONE).then_some(part as usize)
    };
    for f in 0..surface.faces.len() {
        if let Some(part) = each(f) {
            for p in surface.corners(f) {
                all[part].bounds.extend(p);
            }
        }
    }
    for f in 0..surface.faces.len() {
        if let Some(part) = each(f) {
            let it = &mut all[part];
            let about = it.bounds.centre();
            let [a, b, c] = surface.corners(f).map(|p| p - about);
            it.volume += a.dot(b.cross(c)) / 6.0;
            it.area += (b - a).cross(c - a).length() / 2.0;
        }
    }
    for half_edges in edges.iter() {
        mark_open(surface, parts, half_edges, &mut all);
    }
    all
}

/// Marks the parts open that do not use this edge twice, once in each direction.
fn mark_open(surface: &Surface, parts: &Parts, half_edges: &[u32], all: &mut [Solid]) {
    let part = |h: u32| parts.of_face[h as usize / 3];
    if let &[a, b] = half_edges
        && part(a) == part(b)
    {
        if Edges::is_forward(&surface.faces, a) == Edges::is_forward(&surface.faces, b) {
            all[part(a) as usize].closed = false;
        }
        return;
    }
    let mut uses: Vec<(u32, bool)> =
        half_edges.iter().map(|&h| (part(h), Edges::is_forward(&surface.faces, h))).collect();
    uses.sort_unstable();
    for of_part in uses.chunk_by(|x, y| x.0 == y.0) {
        if of_part.len() != 2 || of_part[0].1 == of_part[1].1 {
            all[of_part[0].0 as usize].closed = false;
        }
    }
}

/// Twice the area of each face.
#[must_use]
pub fn doubled_areas(surface: &Surface) -> Vec<f64> {
    (0..surface.faces.len()).map(|f| DVec3::length(surface.area_vector(f))).collect()
}
