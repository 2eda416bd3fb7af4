//! Builds the surface as a contour of the samples, and moves its vertices to their optimal positions.

use glam::DVec3;
use rayon::prelude::*;

use super::band::Sampling;
use super::field::Stop;
use super::grid::{Grid, GridIndex, Samples, along, around_edge};
use super::region::Region;
use super::vertices::{BEYOND, Crossing, Vertex, place_vertices};
use crate::math::{Box3, Crossing as Meeting, Rounding, collinear, contact, crossing, nearest_on_triangle};
use crate::mesh::Stars;

/// Maximum distance, in cells, between two triangles and the surface point of their grid edge. Beyond it a vertex is
/// added on the edge.
const MAX_EDGE_DISTANCE: f64 = 0.05;
/// Distances that differ by less than this, in cells, count as equal.
const TIE_DISTANCE: f64 = 1e-3;
/// Minimum height of a triangle, in cells; flatter triangles count as degenerate.
const MIN_HEIGHT: f64 = 1.0 / 256.0;

/// A vertex stays if its optimal position is nearer than this share of a cell.
const MIN_MOVE: f64 = 1e-3;
/// Fractions of a move that are tried.
const MOVE_FRACTIONS: [f64; 3] = [1.0, 0.5, 0.25];
/// Number of attempts per vertex; a neighbour's move may make one possible.
const ROUNDS: usize = 2;
/// Maximum triangles tested per attempted move.
const MAX_TRIANGLES: usize = 4096;
/// Vertices between two checks for cancellation.
const CHECK_INTERVAL: usize = 1024;
/// Cosine of the largest angle by which a move may turn a face.
const MIN_TURN_COSINE: f64 = -0.25;

/// The surface as vertices and faces. The first vertices are those of the cells, in the order of the cells.
pub(super) struct Contour {
    /// Vertex positions.
    pub points: Vec<DVec3>,
    /// Faces as indices into `points`.
    pub faces: Vec<[u32; 3]>,
}

/// How the four vertices around a grid edge are connected.
enum Connection {
    /// Two triangles with the diagonal from vertex 0 to 2, or from 1 to 3.
    Diagonal(usize),
    /// A fan around an additional vertex on the edge.
    Fan,
}

/// Places the vertices of the cells that the surface passes through, and connects them. No vertex has moved yet.
///
/// # Errors
/// [`Stop::Faces`] if the surface needs more than `max_faces` faces, and other stops of the sampling.
pub(super) fn unmoved_contour<R: Region>(
    sampling: &mut Sampling<'_, R>,
    cells: &[GridIndex],
    max_faces: u64,
    rounding: Rounding,
) -> Result<(Vec<Vertex>, Contour), Stop> {
    // A surface with V vertices of four edges each has 2 V triangles.
    let least = 2 * cells.len() as u64;
    if least > max_faces {
        return Err(Stop::Faces(least));
    }
    let crossings = sampling.crossings()?;
    let vertices = place_vertices(&sampling.grid, &mut sampling.samples, cells, &crossings, rounding);
    let crossings: Vec<_> =
        crossings.into_iter().map(|crossing| Crossing { point: rounding.of(crossing.point), ..crossing }).collect();
    let contour = contour(&sampling.grid, &sampling.samples, &vertices, &crossings);
    Ok((vertices, contour))
}

/// Connects the vertices of the cells around every edge that the surface crosses: by two triangles, or by a fan around
/// a vertex on the edge.
///
/// ```text
///     1 ------ 0       1 ------ 0       e, seen along it, is the edge of the grid;
///     |  .     |       |  .  .  |       0 to 3 are the vertices of its four cells
///     |     e .|       |    e   |
///     2 ------ 3       2 -.--.- 3
/// ```
///
/// The envelope of an edge consists of the four tetrahedra between the edge and each two neighbouring vertices. Each
/// vertex lies in its own cell, so the envelope lies in the four cells. The envelopes of different edges have disjoint
/// interiors (Ju and Udeshi 2006). A fan around a point of the edge lies in the envelope; for two triangles this is
/// tested exactly. Therefore no two triangles intersect, wherever the vertices lie. The surface is manifold because the
/// samples are well-composed.
fn contour(grid: &Grid, samples: &Samples, vertices: &[Vertex], crossings: &[Crossing]) -> Contour {
    let connected: Vec<Option<([u32; 4], Connection)>> = crossings
        .par_iter()
        .map(|crossing| {
            let cells = around_edge(crossing.index, crossing.axis)?;
            let [a, b, c, d] = cells.map(|cell| samples.vertex(cell));
            let mut around = [a?, b?, c?, d?];
            if !crossing.inside_below {
                around.swap(1, 3);
            }
            let ends = [crossing.index, along(crossing.index, crossing.axis)].map(|index| grid.point(index));
            let of = around.map(|v| vertices[v as usize]);
            Some((around, choose_connection(ends, crossing, of.map(|v| v.point), of.map(|v| v.optimal))))
        })
        .collect();
    let mut contour = Contour { points: vertices.iter().map(|v| v.point).collect(), faces: Vec::new() };
    for (crossing, connected) in crossings.iter().zip(connected) {
        let Some(([a, b, c, d], connected)) = connected else { continue };
        match connected {
            Connection::Diagonal(0) => contour.faces.extend([[a, b, c], [a, c, d]]),
            Connection::Diagonal(_) => contour.faces.extend([[b, c, d], [b, d, a]]),
            Connection::Fan => {
                #[expect(clippy::cast_possible_truncation, reason = "a grid's edges are far fewer than 2^32")]
                let e = contour.points.len() as u32;
                contour.points.push(crossing.point);
                contour.faces.extend([[e, a, b], [e, b, c], [e, c, d], [e, d, a]]);
            }
        }
    }
    contour
}

/// Chooses how to connect the vertices around an edge. `corners` are their current positions, `optimal` the positions
/// they may move to.
fn choose_connection(ends: [DVec3; 2], crossing: &Crossing, corners: [DVec3; 4], optimal: [DVec3; 4]) -> Connection {
    let cell = ends[0].distance(ends[1]);
    let mut best: Option<(f64, f64, usize)> = None;
    for first in [0, 1] {
        let rotated = |of: [DVec3; 4]| [0, 1, 2, 3].map(|i| of[(first + i) % 4]);
        let [a, b, c, d] = rotated(optimal);
        let triangles = [[a, b, c], [a, c, d]];
        if !within_envelope(ends, rotated(corners)) || triangles.iter().any(|&t| height(t) < MIN_HEIGHT * cell) {
            continue;
        }
        let distance = triangles.map(|t| nearest_on_triangle(crossing.point, t).distance(crossing.point) / cell);
        let (distance, length) = (distance[0].min(distance[1]), a.distance(c));
        // On ties the shorter diagonal wins.
        let better = best.is_none_or(|(best_distance, best_length, _)| {
            if (distance - best_distance).abs() > TIE_DISTANCE {
                distance < best_distance
            } else {
                length < best_length
            }
        });
        if better {
            best = Some((distance, length, first));
        }
    }
    match best {
        Some((distance, _, first)) if distance <= MAX_EDGE_DISTANCE || crossing.normal.is_none() => {
            Connection::Diagonal(first)
        }
        _ => Connection::Fan,
    }
}

/// Whether both triangles of the diagonal from `a` to `c` lie in the envelope of the edge. The diagonal must pass
/// between an end of the edge and the vertex on one side. The edge must pass through the triangle on the other side.
fn within_envelope([p, q]: [DVec3; 2], [a, b, c, d]: [DVec3; 4]) -> bool {
    let through = |from, to, triangle| matches!(crossing(from, to, triangle), Meeting::Enters | Meeting::Leaves);
    [(b, d), (d, b)].into_iter().any(|(near, far)| through(a, c, [p, q, near]) && through(p, q, [a, c, far]))
}

/// The smallest height of a triangle. Computed in f64: a measurement, not a topological predicate.
fn height([a, b, c]: [DVec3; 3]) -> f64 {
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    if longest > 0.0 { (b - a).cross(c - a).length() / longest } else { 0.0 }
}

/// Moves vertices whose optimal position is outside of their cell, such as those on sharp edges. Before each move,
/// exact tests confirm that no triangle then meets another except in shared vertices and edges. The surface thus stays
/// free of intersections. Returns the number of moved vertices.
///
/// # Errors
/// [`Stop::Cancelled`] if the work is cancelled.
pub(super) fn move_out<R>(
    sampling: &Sampling<'_, R>,
    vertices: &[Vertex],
    contour: &mut Contour,
    rounding: Rounding,
) -> Result<u64, Stop> {
    let Sampling { grid, samples, context, .. } = sampling;
    let least = MIN_MOVE * grid.cell;
    let mut pending: Vec<u32> = (0u32..)
        .zip(vertices)
        .filter(|(_, vertex)| vertex.point.distance(vertex.optimal) > least)
        .map(|(v, _)| v)
        .collect();
    let around = Stars::new(contour.points.len(), &contour.faces);
    let mut mover = Mover { grid, samples, contour, around };
    let mut moved = 0;
    for _ in 0..ROUNDS {
        let mut left = Vec::new();
        for (number, &v) in pending.iter().enumerate() {
            if number % CHECK_INTERVAL == 0 {
                context.check()?;
            }
            let (old, optimal) = (mover.contour.points[v as usize], vertices[v as usize].optimal);
            let done = MOVE_FRACTIONS.iter().position(|&share| {
                let to = rounding.of(old.lerp(optimal, share));
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
        pending = left;
    }
    Ok(moved)
}

/// Tests and applies moves of vertices.
struct Mover<'a> {
    grid: &'a Grid,
    samples: &'a Samples,
    contour: &'a mut Contour,
    around: Stars,
}

impl Mover<'_> {
    /// Whether moving vertex `v` to `to` creates no intersection, in a surface that had none.
    fn is_valid(&mut self, v: u32, to: DVec3) -> bool {
        let star = self.around.of(v);
        let old = self.contour.points[v as usize];
        let normal = |contour: &Contour, face: u32| {
            let [a, b, c] = contour.faces[face as usize].map(|v| contour.points[v as usize]);
            (b - a).cross(c - a).normalize_or_zero()
        };
        let least_height = |contour: &Contour| {
            let of = |&face: &u32| height(contour.faces[face as usize].map(|v| contour.points[v as usize]));
            star.iter().map(of).fold(f64::INFINITY, f64::min)
        };
        let before: Vec<DVec3> = star.iter().map(|&face| normal(self.contour, face)).collect();
        let least = least_height(self.contour).min(MIN_HEIGHT * self.grid.cell);
        self.contour.points[v as usize] = to;
        let turns_over =
            star.iter().zip(before).any(|(&face, before)| normal(self.contour, face).dot(before) < MIN_TURN_COSINE);
        let valid = !turns_over && least_height(self.contour) >= least && self.star_is_clear(star);
        self.contour.points[v as usize] = old;
        valid
    }

    /// Whether the faces around a vertex intersect neither each other nor other faces.
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

    /// The faces that may meet a box: faces of all vertices whose cells are within reach of it. None if there are too
    /// many.
    fn faces_near(&self, bounds: &Box3) -> Option<Vec<u32>> {
        let Self { grid, samples, contour, around } = self;
        // A face extends at most BEYOND past the two by two cells around an edge, and two of those cells belong to its
        // vertices.
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
                    if faces.len() > MAX_TRIANGLES {
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
