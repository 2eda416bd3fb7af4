//! The surface as a contour of the samples, and its vertices moved to where they are best.

use glam::DVec3;
use rayon::prelude::*;

use super::band::Sampling;
use super::field::Stop;
use super::grid::{Grid, Samples, along, around_edge};
use super::vertices::{BEYOND, Crossing, Vertex};
use crate::math::{Box3, Crossing as Meeting, Rounding, collinear, contact, crossing, nearest_on_triangle};
use crate::mesh::Stars;

/// How far from the surface, in cells, two triangles may pass the edge that they stand for, before a vertex is put there.
const NEAR: f64 = 0.05;
/// Distances from it that differ by less, in cells, are the same.
const SAME: f64 = 1e-3;
/// The least height of a triangle, in cells, that is not taken for a part of a line.
const FLAT: f64 = 1.0 / 256.0;

/// Vertices that are wanted nearer to where they are than this share of a cell stay.
const LEAST: f64 = 1e-3;
/// Shares of the way that are tried.
const SHARES: [f64; 3] = [1.0, 0.5, 0.25];
/// Times that every vertex is tried; a neighbour's move may make way for it.
const ROUNDS: usize = 2;
/// Triangles that one try may look at.
const MOST: usize = 4096;
/// Vertices between two looks at the clock.
const TOGETHER: usize = 1024;
/// Cosine of the angle by which a face may turn in a move.
const TURN: f64 = -0.25;

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
fn height([a, b, c]: [DVec3; 3]) -> f64 {
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    if longest > 0.0 { (b - a).cross(c - a).length() / longest } else { 0.0 }
}

/// Moves vertices that are wanted outside of their cells, such as those on sharp edges, where no triangle then meets another
/// beside their common vertices and edges, exactly. So a surface without intersections stays one. Answers how many it
/// moved.
///
/// # Errors
/// [`Stop::Cancelled`] when the context says stop.
pub(super) fn move_out(
    sampling: &Sampling<'_>,
    vertices: &[Vertex],
    contour: &mut Contour,
    rounding: Rounding,
) -> Result<u64, Stop> {
    let Sampling { grid, samples, context, .. } = sampling;
    let least = LEAST * grid.cell;
    let mut waiting: Vec<u32> = (0u32..)
        .zip(vertices)
        .filter(|(_, vertex)| vertex.point.distance(vertex.wanted) > least)
        .map(|(v, _)| v)
        .collect();
    let around = Stars::new(contour.points.len(), &contour.faces);
    let mut mover = Mover { grid, samples, contour, around };
    let mut moved = 0;
    for _ in 0..ROUNDS {
        let mut left = Vec::new();
        for (number, &v) in waiting.iter().enumerate() {
            if number % TOGETHER == 0 {
                context.check()?;
            }
            let (old, wanted) = (mover.contour.points[v as usize], vertices[v as usize].wanted);
            let done = SHARES.iter().position(|&share| {
                let to = rounding.of(old.lerp(wanted, share));
                let valid = to != old && mover.is_valid(v, to);
                if valid {
                    mover.contour.points[v as usize] = to;
                }
                valid
            });
            moved += u64::from(done.is_some());
            if done != Some(0) {
                left.push(v);
            }
        }
        waiting = left;
    }
    Ok(moved)
}

/// Tries moves of vertices.
struct Mover<'a> {
    grid: &'a Grid,
    samples: &'a Samples,
    contour: &'a mut Contour,
    around: Stars,
}

impl Mover<'_> {
    /// Whether the surface has no intersection with vertex `v` at `to`, where it had none before.
    fn is_valid(&mut self, v: u32, to: DVec3) -> bool {
        let star = self.around.of(v);
        let old = self.contour.points[v as usize];
        let normal = |contour: &Contour, face: u32| {
            let [a, b, c] = contour.faces[face as usize].map(|v| contour.points[v as usize]);
            (b - a).cross(c - a).normalize_or_zero()
        };
        let flat = |contour: &Contour| {
            let of = |&face: &u32| height(contour.faces[face as usize].map(|v| contour.points[v as usize]));
            star.iter().map(of).fold(f64::INFINITY, f64::min)
        };
        let before: Vec<DVec3> = star.iter().map(|&face| normal(self.contour, face)).collect();
        let least = flat(self.contour).min(FLAT * self.grid.cell);
        self.contour.points[v as usize] = to;
        let turned = star.iter().zip(before).any(|(&face, before)| normal(self.contour, face).dot(before) < TURN);
        let valid = !turned && flat(self.contour) >= least && self.star_is_clear(star);
        self.contour.points[v as usize] = old;
        valid
    }

    fn star_is_clear(&self, star: &[u32]) -> bool {
        let contour = &*self.contour;
        let points = &contour.points;
        let corners = |face: u32| contour.faces[face as usize].map(|v| points[v as usize]);
        let box_of = |face: u32| Box3::of(corners(face));
        if star.iter().any(|&face| {
            let [a, b, c] = corners(face);
            collinear(a, b, c)
        }) {
            return false;
        }
        let mut slow = 0;
        let mut apart = |a: u32, b: u32| {
            let [a, b] = [a, b].map(|face| contour.faces[face as usize]);
            contact(points, a, b, &mut slow).is_apart()
        };
        for (i, &a) in star.iter().enumerate() {
            if star[..i].iter().any(|&b| !apart(a, b)) {
                return false;
            }
        }
        let bounds = Box3::of(star.iter().flat_map(|&face| corners(face)));
        let Some(others) = self.faces_near(&bounds) else { return false };
        let boxes: Vec<Box3> = star.iter().map(|&face| box_of(face)).collect();
        others.into_iter().filter(|face| star.binary_search(face).is_err()).all(|other| {
            let of_other = box_of(other);
            star.iter().zip(&boxes).all(|(&face, of_face)| !of_face.meets(&of_other) || apart(face, other))
        })
    }

    /// The faces that may meet a box: all whose cells, and what is within reach of them, come near it. None where they are very
    /// many.
    fn faces_near(&self, bounds: &Box3) -> Option<Vec<u32>> {
        let Self { grid, samples, contour, around } = self;
        // A face stays within BEYOND of the two by two cells around an edge, two of which are those of its vertices.
        let reach = 1.0 + BEYOND;
        let range = |axis: usize| {
            let low = (grid.in_cells(axis, bounds.min[axis]) - reach).floor().max(0.0);
            let high = (grid.in_cells(axis, bounds.max[axis]) + reach).floor().max(0.0);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
            (low as u32..=(high as u32).min(grid.size[axis] - 1))
        };
        let mut faces = Vec::new();
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    let Some(v) = samples.vertex([x, y, z]) else { continue };
                    faces.extend(around.of(v).iter().copied().filter(|&face| {
                        let corners = contour.faces[face as usize].map(|v| contour.points[v as usize]);
                        Box3::of(corners).meets(bounds)
                    }));
                    if faces.len() > MOST {
                        return None;
                    }
                }
            }
        }
        faces.sort_unstable();
        faces.dedup();
        Some(faces)
    }
}
