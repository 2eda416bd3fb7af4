//! The side of a wall that keeps its faces: the inner side faces a cavity or concave air.

use std::collections::BTreeMap;

use crate::context::{Cancelled, Context};
use crate::mesh::{Edges, Surface, UnionFind};
use glam::DVec3;
use rayon::prelude::*;

use super::outcome::Growth;
use super::walls::{Opposed, Walls};

/// Cosine of the angle up to which faces at an edge belong to one smooth patch.
const SMOOTH: f64 = 0.866_025_403_784_438_6;
/// Directions, spread over half a turn, in which the material around the middle of a wall is measured.
const DIRECTIONS: u32 = 8;
/// The vote up to which a patch is undecided, in squares of the longest way.
const LEAST_VOTE: f64 = 1e-6;

/// Which faces may not grow, so that walls grow on one side only.
pub struct KeptSide {
    /// For each face, whether it may not grow.
    pub faces: Vec<bool>,
    /// Whether a thin wall has no inner side, such as a plate or a wire, so that it grows on both.
    pub has_equal_sides: bool,
}

/// The side of a thin wall that a smooth patch of faces is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Inner,
    Outer,
}

impl Side {
    /// The side for which a vote is; positive for the inner side.
    fn of(vote: f64) -> Self {
        if vote > 0.0 { Self::Inner } else { Self::Outer }
    }
}

/// Finds the faces that may not grow: with outward growth those on the inner side, with inward growth those on the outer
/// side.
///
/// A face is on the inner side of a wall if the free way in front of it is shorter than in front of the opposed face.
/// Whole smooth patches are decided by the area of their faces. Where both ways are equal, the neighbours decide: inner sides
/// meet in concave edges, outer sides in convex ones. Where that makes both sides of a wall inner or both outer, the wall has
/// no inner side. Wires and pins have no inner side.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn kept_side(
    surface: &Surface,
    walls: &Walls<'_>,
    thin: &[Vec<Opposed>],
    (growth, min_wall): (Growth, f64),
    context: &Context<'_>,
) -> Result<KeptSide, Cancelled> {
    let reach = 2.0 * surface.bounds().diagonal();
    let of_wall = |(face, thin): (usize, &Vec<Opposed>)| {
        thin.first()?;
        let (centre, face) = (surface.corners(face).into_iter().sum::<DVec3>() / 3.0, index(face));
        Some((free_way(walls, (centre, face), reach), is_of_wire(walls, (centre, face), min_wall)))
    };
    context.check()?;
    let measured: Vec<Option<(f64, bool)>> = thin.par_iter().enumerate().map(of_wall).collect();
    context.check()?;
    let way = |face: usize| measured[face].map_or(reach, |(way, _)| way);
    let mut patches = UnionFind::new(surface.faces.len());
    let edges = Edges::new(&surface.faces);
    for [f, g] in edges.pairs().map(|pair| pair.map(|half_edge| half_edge / 3)) {
        if walls.normal(f).dot(walls.normal(g)) >= SMOOTH {
            patches.unite(f, g);
        }
    }
    let patch = patches.into_roots();
    // For each patch with thin walls, its vote, which is positive for an inner side, and the area of its walls less that of its wires.
    let mut votes: BTreeMap<u32, f64> = BTreeMap::new();
    let mut areas: BTreeMap<u32, f64> = BTreeMap::new();
    for (face, (thin, measured)) in thin.iter().zip(&measured).enumerate() {
        if let (Some(wall), Some((own, is_wire))) = (thin.first(), measured) {
            let other = way(wall.face as usize);
            let area = surface.area_vector(face).length();
            *votes.entry(patch[face]).or_insert(0.0) += area * (other - own) / (other + own).max(f64::MIN_POSITIVE);
            *areas.entry(patch[face]).or_insert(0.0) += if *is_wire { -area } else { area };
        }
    }
    let walls_before = votes.len();
    votes.retain(|patch, _| areas[patch] >= 0.0);
    let has_wires = votes.len() < walls_before;
    let least = LEAST_VOTE * reach.powi(2);
    let mut sides: BTreeMap<u32, Option<Side>> =
        votes.iter().map(|(&patch, &vote)| (patch, (vote.abs() > least).then(|| Side::of(vote)))).collect();
    if sides.values().any(Option::is_none) {
        let borders: Vec<Border> = edges.pairs().filter_map(|pair| Border::new(surface, &patch, pair)).collect();
        decide_by_neighbours(&borders, &mut sides, context)?;
        let equal = equal_walls(surface, (&patch, thin), &sides);
        // A wall whose sides are both inner or both outer has equal sides after all.
        let is_equal = |patch: &u32| votes[patch].abs() <= least && equal.get(patch).is_some_and(|&area| area > 0.0);
        sides.iter_mut().filter(|(patch, _)| is_equal(patch)).for_each(|(_, side)| *side = None);
    }
    let kept = match growth {
        Growth::Both => None,
        Growth::Outward => Some(Side::Inner),
        Growth::Inward => Some(Side::Outer),
    };
    let of_patch = |patch: &u32| sides.get(patch).copied().flatten();
    Ok(KeptSide {
        faces: patch.iter().map(|patch| kept.is_some() && of_patch(patch) == kept).collect(),
        has_equal_sides: kept.is_some() && (has_wires || sides.values().any(Option::is_none)),
    })
}

/// For each patch, twice the area of its thin walls whose two sides are the same, less that of its other thin walls. Undecided sides are
/// the same.
fn equal_walls(
    surface: &Surface,
    (patch, thin): (&[u32], &[Vec<Opposed>]),
    sides: &BTreeMap<u32, Option<Side>>,
) -> BTreeMap<u32, f64> {
    let side = |face: usize| sides.get(&patch[face]).copied().flatten();
    let mut areas = BTreeMap::new();
    for (face, wall) in thin.iter().enumerate().filter_map(|(face, thin)| Some((face, thin.first()?))) {
        let area = surface.area_vector(face).length();
        *areas.entry(patch[face]).or_insert(0.0) += if side(face) == side(wall.face as usize) { area } else { -area };
    }
    areas
}

/// An edge between two patches.
struct Border {
    patches: [u32; 2],
    is_convex: bool,
    length: f64,
}

impl Border {
    /// The border between faces of different patches at an edge with these half-edges.
    fn new(surface: &Surface, patch: &[u32], [g, h]: [u32; 2]) -> Option<Self> {
        let patches = [g, h].map(|half_edge| patch[half_edge as usize / 3]);
        let at = |v: u32| surface.positions[v as usize];
        let [from, to] = Edges::ends(&surface.faces, g).map(at);
        let apex = at(Edges::opposite(&surface.faces, h));
        let is_convex = (apex - from).dot(surface.area_vector(g as usize / 3)) < 0.0;
        (patches[0] != patches[1]).then(|| Self { patches, is_convex, length: from.distance(to) })
    }
}

/// Decides the patches of equal sides by the lengths of the edges between them and decided patches.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
fn decide_by_neighbours(
    borders: &[Border],
    sides: &mut BTreeMap<u32, Option<Side>>,
    context: &Context<'_>,
) -> Result<(), Cancelled> {
    loop {
        context.check()?;
        let mut votes: BTreeMap<u32, f64> = BTreeMap::new();
        for &Border { patches: [one, other], is_convex, length } in borders {
            for [own, beside] in [[one, other], [other, one]] {
                let vote = match (sides.get(&own), sides.get(&beside)) {
                    (Some(None), Some(Some(Side::Inner))) if !is_convex => length,
                    (Some(None), Some(Some(Side::Outer))) if is_convex => -length,
                    _ => continue,
                };
                *votes.entry(own).or_insert(0.0) += vote;
            }
        }
        votes.retain(|_, vote| *vote != 0.0);
        if votes.is_empty() {
            return Ok(());
        }
        sides.extend(votes.into_iter().map(|(patch, vote)| (patch, Some(Side::of(vote)))));
    }
}

/// The length of the free way in front of a point of a face, at most `reach`.
fn free_way(walls: &Walls<'_>, (point, face): (DVec3, u32), reach: f64) -> f64 {
    walls.first_hit(point, walls.normal(face) * reach, face).map_or(reach, |share| share * reach)
}

/// Whether the material behind a point of a face is thinner than the least wall in a second direction, across the first one.
fn is_of_wire(walls: &Walls<'_>, (point, face): (DVec3, u32), min_wall: f64) -> bool {
    let inward = -walls.normal(face) * min_wall;
    let Some(share) = walls.first_hit(point, inward, face) else { return false };
    let middle = point + inward * (share / 2.0);
    let (u, v) = walls.normal(face).any_orthonormal_pair();
    let to_surface = |way: DVec3| walls.first_hit(middle, way * min_wall, u32::MAX).unwrap_or(1.0) * min_wall;
    (0..DIRECTIONS).any(|number| {
        let (sine, cosine) = (f64::from(number) * std::f64::consts::PI / f64::from(DIRECTIONS)).sin_cos();
        let way = u * cosine + v * sine;
        to_surface(way) + to_surface(-way) < min_wall
    })
}

#[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
fn index(face: usize) -> u32 {
    face as u32
}
