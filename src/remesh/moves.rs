use glam::DVec3;

use super::Stop;
use super::contour::{Contour, FLAT, height};
use super::grid::Grid;
use super::place::{BEYOND, Vertex};
use super::samples::Samples;
use crate::context::Context;
use crate::math::{Box3, Rounding, collinear, contact};
use crate::mesh::Stars;

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

/// Moves vertices that are wanted outside of their cells, such as those on sharp edges, where no triangle then meets another
/// beside their common vertices and edges, exactly. So a surface without intersections stays one. Answers how many it
/// moved.
///
/// # Errors
/// [`Stop::Cancelled`] when the context says stop.
pub(super) fn move_out(
    grid: &Grid,
    samples: &Samples,
    vertices: &[Vertex],
    contour: &mut Contour,
    rounding: Rounding,
    context: &Context<'_>,
) -> Result<u64, Stop> {
    let least = LEAST * grid.cell;
    let mut waiting: Vec<u32> = (0u32..)
        .zip(vertices)
        .filter(|(_, vertex)| vertex.point.distance(vertex.wanted) > least)
        .map(|(v, _)| v)
        .collect();
    let around = Stars::new(contour.points.len(), &contour.faces);
    let mut moved = 0;
    for _ in 0..ROUNDS {
        let mut left = Vec::new();
        for (number, &v) in waiting.iter().enumerate() {
            if number % TOGETHER == 0 {
                context.check()?;
            }
            let (old, wanted) = (contour.points[v as usize], vertices[v as usize].wanted);
            let done = SHARES.iter().position(|&share| {
                let to = rounding.of(old.lerp(wanted, share));
                let valid = to != old && is_valid(grid, samples, contour, &around, v, to);
                if valid {
                    contour.points[v as usize] = to;
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

/// Whether the surface has no intersection with vertex `v` at `to`, where it had none before.
fn is_valid(grid: &Grid, samples: &Samples, contour: &mut Contour, around: &Stars, v: u32, to: DVec3) -> bool {
    let star = around.of(v);
    let old = contour.points[v as usize];
    let normal = |contour: &Contour, face: u32| {
        let [a, b, c] = contour.faces[face as usize].map(|v| contour.points[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    let flat = |contour: &Contour| {
        let of = |&face: &u32| height(contour.faces[face as usize].map(|v| contour.points[v as usize]));
        star.iter().map(of).fold(f64::INFINITY, f64::min)
    };
    let before: Vec<DVec3> = star.iter().map(|&face| normal(contour, face)).collect();
    let least = flat(contour).min(FLAT * grid.cell);
    contour.points[v as usize] = to;
    let turned = star.iter().zip(before).any(|(&face, before)| normal(contour, face).dot(before) < TURN);
    let valid = !turned && flat(contour) >= least && star_is_clear(grid, samples, contour, around, star);
    contour.points[v as usize] = old;
    valid
}

fn star_is_clear(grid: &Grid, samples: &Samples, contour: &Contour, around: &Stars, star: &[u32]) -> bool {
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
    let Some(others) = faces_near(grid, samples, contour, around, &bounds) else { return false };
    let boxes: Vec<Box3> = star.iter().map(|&face| box_of(face)).collect();
    others.into_iter().filter(|face| star.binary_search(face).is_err()).all(|other| {
        let of_other = box_of(other);
        star.iter().zip(&boxes).all(|(&face, of_face)| !of_face.meets(&of_other) || apart(face, other))
    })
}

/// The faces that may meet a box: all whose cells, and what is within reach of them, come near it. None where they are very
/// many.
fn faces_near(grid: &Grid, samples: &Samples, contour: &Contour, around: &Stars, bounds: &Box3) -> Option<Vec<u32>> {
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
