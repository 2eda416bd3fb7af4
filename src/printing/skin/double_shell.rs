//! Recognises a double shell: two nested, nearly parallel skins close together around a void.

use glam::DVec3;
use rayon::prelude::*;

use super::lids::Lids;
use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree, hit, threads};
use crate::printing::reach::{ReachOptions, Reached};

/// Number of faces sampled, spread evenly over the area.
const SAMPLES: usize = 512;
/// Largest median wall, as a share of the diagonal.
const MAX_WALL: f64 = 0.01;
/// Least median wall, as a share of the diagonal. Closer skins are duplicate faces.
const MIN_WALL: f64 = 1e-5;
/// Least cosine, without sign, between the normals of the two skins.
const MIN_PARALLEL: f64 = 0.8;
/// Least share of the samples that have a second skin behind them.
const MIN_DOUBLE: f64 = 0.6;
/// Least share of the space within the outer skin that is void.
const MIN_VOID: f64 = 0.5;
/// A void is this many walls wide, at least.
const MIN_VOID_WALLS: f64 = 3.0;
/// Openings wider than this share of the diagonal make a vessel.
const OPENING: f64 = 0.024;
/// The most octree nodes spent on finding such an opening.
const MAX_NODES: usize = 4_000_000;
/// Boxes and faces that one ray or ball may visit.
const STEPS: u64 = 1 << 20;

/// A double shell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubleShell {
    /// The median diameter of the largest balls between the two skins, in the model's unit.
    pub median_wall: f64,
    /// The share of the space within the outer skin that is void, along the sampled rays: 0 to 1.
    pub void_share: f64,
    /// The share of the sampled area that has a second skin: 0 to 1.
    pub double_share: f64,
}

/// A sample: the wall in front of the second skin, and the void behind it.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// The diameter of the largest ball between the skins that touches the sample.
    wall: f64,
    /// The distance to the second skin along the normal, which is longer than the wall on a surface of steps.
    distance: f64,
    /// The width and the middle of the void.
    void: Option<(f64, DVec3)>,
}

/// Recognises a double shell: most of the surface has a parallel second skin, the median diameter of the largest balls
/// between the two is below 1 % of the diagonal, and no ball of 2.4 % of the diagonal can reach the void beyond from
/// outside, openings of a few missing faces aside. Vases, boxes with an opening, tubes and bottles are none. Without thin
/// double walls the answer takes the time of 512 rays. `tree` is the tree of the faces. Lengths of the answer are in the unit of `positions`.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn recognise_double_shell(
    positions: &[DVec3],
    faces: &[[u32; 3]],
    tree: &Tree,
    context: &Context<'_>,
) -> Result<Option<DoubleShell>, Cancelled> {
    let Some((shell, voids)) = double_walls(positions, faces, tree, context)? else {
        return Ok(None);
    };
    let bounds = Box3::of_faces(positions, faces);
    let diameter = OPENING * bounds.diagonal();
    let options = ReachOptions { diameter, cells_per_diameter: 4, refinements: 2, max_nodes: MAX_NODES };
    let lids = Lids::new((positions, faces), (positions, faces));
    let Some(reach) = lids.reach((positions, faces, tree), options, context)? else {
        return Ok(None);
    };
    let (mut hidden, mut open) = (0usize, 0usize);
    for middle in voids {
        match reach.at(middle) {
            Reached::Hidden(_) => hidden += 1,
            Reached::Outside | Reached::Doubtful => open += 1,
            Reached::Blocked => {}
        }
    }
    Ok((hidden > open).then_some(shell))
}

/// The double walls of a surface, and points in the voids behind them; none if most of it has no thin double wall
/// around a void. Costs 512 samples.
pub fn double_walls(
    positions: &[DVec3],
    faces: &[[u32; 3]],
    tree: &Tree,
    context: &Context<'_>,
) -> Result<Option<(DoubleShell, Vec<DVec3>)>, Cancelled> {
    context.check()?;
    let diagonal = Box3::of_faces(positions, faces).diagonal();
    let chosen = spread(positions, faces);
    let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
    let samples: Vec<Option<Sample>> = chosen.par_iter().map(|&face| sample(&corners, tree, face, diagonal)).collect();
    context.check()?;
    let found: Vec<Sample> = samples.iter().flatten().copied().collect();
    if chosen.is_empty() || (found.len() as f64) < MIN_DOUBLE * chosen.len() as f64 {
        return Ok(None);
    }
    let mut walls: Vec<f64> = found.iter().map(|sample| sample.wall).collect();
    walls.sort_unstable_by(f64::total_cmp);
    let median_wall = walls[walls.len() / 2];
    let voids: Vec<(f64, DVec3, f64)> =
        found.iter().filter_map(|sample| sample.void.map(|(width, middle)| (width, middle, sample.distance))).collect();
    let void: f64 = voids.iter().map(|(width, ..)| width).sum();
    let walls: f64 = voids.iter().map(|(.., distance)| 2.0 * distance).sum();
    let void_share = if void > 0.0 { void / (void + walls) } else { 0.0 };
    // About half of the samples are on the outer skin, and the void is behind their second skin.
    let most_have_void = 4 * voids.len() >= found.len();
    if !(MIN_WALL * diagonal..MAX_WALL * diagonal).contains(&median_wall) || void_share < MIN_VOID || !most_have_void {
        return Ok(None);
    }
    let double_share = found.len() as f64 / chosen.len() as f64;
    let shell = DoubleShell { median_wall, void_share, double_share };
    Ok(Some((shell, voids.into_iter().map(|(_, middle, _)| middle).collect())))
}

/// Faces spread evenly over the area.
fn spread(positions: &[DVec3], faces: &[[u32; 3]]) -> Vec<u32> {
    let areas = threads::map_cheap(faces.len(), |face| {
        let [a, b, c] = faces[face].map(|v| positions[v as usize]);
        (b - a).cross(c - a).length()
    });
    let total: f64 = areas.iter().sum();
    let step = total / SAMPLES as f64;
    let (mut chosen, mut sum, mut next) = (Vec::with_capacity(SAMPLES), 0.0, step / 2.0);
    for (area, index) in areas.into_iter().zip(0u32..) {
        sum += area;
        if sum > next {
            chosen.push(index);
            next += ((sum - next) / step).ceil().max(1.0) * step;
        }
    }
    chosen
}

/// The second skin behind a face, in the direction in which it is nearer, and the void beyond it.
fn sample(corners: &impl Fn(u32) -> [DVec3; 3], tree: &Tree, face: u32, diagonal: f64) -> Option<Sample> {
    let normal_of = |f: u32| {
        let [a, b, c] = corners(f);
        (b - a).cross(c - a).normalize_or_zero()
    };
    let normal = normal_of(face);
    let middle = corners(face).into_iter().sum::<DVec3>() / 3.0;
    let reach = MAX_WALL * 2.0 * diagonal;
    let near = [normal, -normal].map(|direction| {
        let first = tree.first_hit([middle, direction * reach], Some(face), &mut STEPS.clone(), corners);
        first.map(|(at, f)| (at * reach, f))
    });
    let (direction, (distance, second)) = match near {
        [Some(front), Some(back)] if front.0 <= back.0 => (normal, front),
        [_, Some(back)] => (-normal, back),
        [Some(front), None] => (normal, front),
        [None, None] => return None,
    };
    if distance <= 0.0 || normal_of(second).dot(normal).abs() < MIN_PARALLEL {
        return None;
    }
    // Beyond the second skin.
    let step = direction * diagonal;
    let from = middle + direction * distance;
    let mut steps = STEPS;
    let next = tree.first_along([from, from + step], None, &mut steps, |f| {
        if f == face || f == second {
            None
        } else {
            hit(from, step, corners(f)).filter(|at| at * diagonal > 1e-3 * distance)
        }
    });
    let void = next
        .map(|(at, _)| at * diagonal)
        .filter(|&width| width >= MIN_VOID_WALLS * distance)
        .map(|width| (width, from + direction * (width / 2.0)));
    let ball = tree.shrunk_ball([middle, direction], distance / 2.0, &mut STEPS.clone(), corners);
    let wall = ball.map_or(distance, |ball| 2.0 * ball.radius);
    Some(Sample { wall, distance, void })
}
