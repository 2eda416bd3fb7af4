use glam::DVec3;
use rayon::prelude::*;

use super::crossings::Crossing;
use super::grid::Grid;
use super::place::Vertex;
use super::samples::{Samples, along, around_edge};
use crate::math::{Crossing as Meeting, crossing, nearest_on_triangle};

/// How far from the surface, in cells, two triangles may pass the edge that they stand for, before a vertex is put there.
const NEAR: f64 = 0.05;
/// Distances from it that differ by less, in cells, are the same.
const SAME: f64 = 1e-3;
/// The least height of a triangle, in cells, that is not taken for a part of a line.
pub(super) const FLAT: f64 = 1.0 / 256.0;

/// The surface as vertices and faces. The first vertices are those of the cells, in their order.
pub(super) struct Contour {
    pub points: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
}

/// How the four vertices around an edge are joined.
enum Joined {
    /// By the diagonal from vertex 0 to 2, or that from 1 to 3.
    Across(usize),
    /// To a vertex on the edge.
    Fan,
}

/// Joins the vertices of the cells around every edge that the surface passes, by two triangles or by a fan around a vertex on
/// the edge.
///
/// ```text
///     1 ------ 0       1 ------ 0       e, seen along it, is the edge of the grid;
///     |  .     |       |  .  .  |       0 to 3 are the vertices of its four cells
///     |     e .|       |    e   |
///     2 ------ 3       2 -.--.- 3
/// ```
///
/// The four tetrahedra between the edge and each two neighbouring vertices, its envelope, lie in its four cells, since each
/// vertex lies within its own, and the envelopes of different edges have no inside in common (Ju and Udeshi 2006). A fan
/// around a point of the edge lies in the envelope; whether two triangles do is asked exactly. So no two triangles
/// intersect, whatever the vertices are. That the surface is manifold follows from the samples, which are well-composed.
pub(super) fn contour(grid: &Grid, samples: &Samples, vertices: &[Vertex], crossings: &[Crossing]) -> Contour {
    let joined: Vec<Option<([u32; 4], Joined)>> = crossings
        .par_iter()
        .map(|crossing| {
            let cells = around_edge(crossing.place, crossing.axis)?;
            let [a, b, c, d] = cells.map(|cell| samples.vertex(cell));
            let mut around = [a?, b?, c?, d?];
            if !crossing.inside_below {
                around.swap(1, 3);
            }
            let ends = [crossing.place, along(crossing.place, crossing.axis)].map(|place| grid.point(place));
            let of = around.map(|v| vertices[v as usize]);
            Some((around, join(ends, crossing, of.map(|v| v.point), of.map(|v| v.wanted))))
        })
        .collect();
    let mut contour = Contour { points: vertices.iter().map(|v| v.point).collect(), faces: Vec::new() };
    for (crossing, joined) in crossings.iter().zip(joined) {
        let Some(([a, b, c, d], joined)) = joined else { continue };
        match joined {
            Joined::Across(0) => contour.faces.extend([[a, b, c], [a, c, d]]),
            Joined::Across(_) => contour.faces.extend([[b, c, d], [b, d, a]]),
            Joined::Fan => {
                #[expect(clippy::cast_possible_truncation, reason = "a grid's edges are far fewer than 2^32")]
                let e = contour.points.len() as u32;
                contour.points.push(crossing.point);
                contour.faces.extend([[e, a, b], [e, b, c], [e, c, d], [e, d, a]]);
            }
        }
    }
    contour
}

/// How to join the vertices around an edge. `corners` are where they are, and `wanted` where they may be moved to.
fn join(ends: [DVec3; 2], crossing: &Crossing, corners: [DVec3; 4], wanted: [DVec3; 4]) -> Joined {
    let cell = ends[0].distance(ends[1]);
    let mut best: Option<(f64, f64, usize)> = None;
    for first in [0, 1] {
        let turned = |of: [DVec3; 4]| [0, 1, 2, 3].map(|i| of[(first + i) % 4]);
        let [a, b, c, d] = turned(wanted);
        let triangles = [[a, b, c], [a, c, d]];
        if !within_envelope(ends, turned(corners)) || triangles.iter().any(|&t| height(t) < FLAT * cell) {
            continue;
        }
        let off = triangles.map(|t| nearest_on_triangle(crossing.point, t).distance(crossing.point) / cell);
        let (off, length) = (off[0].min(off[1]), a.distance(c));
        // Where both are as near, the shorter.
        let better = best.is_none_or(
            |(best_off, best_length, _)| {
                if (off - best_off).abs() > SAME { off < best_off } else { length < best_length }
            },
        );
        if better {
            best = Some((off, length, first));
        }
    }
    match best {
        Some((off, _, first)) if off <= NEAR || crossing.normal.is_none() => Joined::Across(first),
        _ => Joined::Fan,
    }
}

/// Whether the triangles on either side of the diagonal from `a` to `c` lie in the envelope of the edge: where the diagonal
/// passes between an end of the edge and the vertex on one side, and the edge through the triangle on the other.
fn within_envelope([p, q]: [DVec3; 2], [a, b, c, d]: [DVec3; 4]) -> bool {
    let through = |from, to, triangle| matches!(crossing(from, to, triangle), Meeting::Enters | Meeting::Leaves);
    [(b, d), (d, b)].into_iter().any(|(near, far)| through(a, c, [p, q, near]) && through(p, q, [a, c, far]))
}

/// The least height of a triangle. In f64: a measure.
pub(super) fn height([a, b, c]: [DVec3; 3]) -> f64 {
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    if longest > 0.0 { (b - a).cross(c - a).length() / longest } else { 0.0 }
}
