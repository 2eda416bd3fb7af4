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
/// The vote up to which a patch is undecided, in squares of the longest way.
const LEAST_VOTE: f64 = 1e-6;

/// Which faces may not grow, so that walls grow on one side only.
pub struct KeptSide {
    /// For each face, whether it may not grow.
    pub faces: Vec<bool>,
    /// Whether a thin wall has no inner side, such as a plate, so that it grows on both.
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
/// meet in concave edges, outer sides in convex ones.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn kept_side(
    surface: &Surface,
    walls: &Walls<'_>,
    thin: &[Vec<Opposed>],
    growth: Growth,
    context: &Context<'_>,
) -> Result<KeptSide, Cancelled> {
    let reach = 2.0 * surface.bounds().diagonal();
    let is_thin = |face: usize| !thin[face].is_empty();
    context.check()?;
    let way: Vec<f64> = (0..surface.faces.len())
        .into_par_iter()
        .map(|face| if is_thin(face) { free_way(surface, walls, index(face), reach) } else { reach })
        .collect();
    context.check()?;
    let mut patches = UnionFind::new(surface.faces.len());
    let edges = Edges::new(&surface.faces);
    for [f, g] in half_edges_of_pairs(&edges).map(|pair| pair.map(|half_edge| half_edge / 3)) {
        if walls.normal(f).dot(walls.normal(g)) >= SMOOTH {
            patches.unite(f, g);
        }
    }
    let patch = patches.into_roots();
    // For each patch with thin walls, its vote, which is positive for an inner side.
    let mut votes: BTreeMap<u32, f64> = BTreeMap::new();
    for (face, thin) in thin.iter().enumerate() {
        if let Some(wall) = thin.first() {
            let [own, other] = [way[face], way[wall.face as usize]];
            let area = surface.area_vector(face).length();
            *votes.entry(patch[face]).or_insert(0.0) += area * (other - own) / (other + own).max(f64::MIN_POSITIVE);
        }
    }
    let least = LEAST_VOTE * reach.powi(2);
    let mut sides: BTreeMap<u32, Option<Side>> =
        votes.iter().map(|(&patch, &vote)| (patch, (vote.abs() > least).then(|| Side::of(vote)))).collect();
    if sides.values().any(Option::is_none) {
        let borders: Vec<Border> =
            half_edges_of_pairs(&edges).filter_map(|pair| Border::new(surface, &patch, pair)).collect();
        decide_by_neighbours(&borders, &mut sides, context)?;
    }
    let kept = match growth {
        Growth::Both => None,
        Growth::Outward => Some(Side::Inner),
        Growth::Inward => Some(Side::Outer),
    };
    let of_patch = |patch: &u32| sides.get(patch).copied().flatten();
    Ok(KeptSide {
        faces: patch.iter().map(|patch| kept.is_some() && of_patch(patch) == kept).collect(),
        has_equal_sides: kept.is_some() && sides.values().any(Option::is_none),
    })
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

/// The half-edges of each edge that joins two faces.
fn half_edges_of_pairs(edges: &Edges) -> impl Iterator<Item = [u32; 2]> {
    edges.iter().filter_map(|half_edges| <[u32; 2]>::try_from(half_edges).ok())
}

/// The length of the free way in front of a face, at most `reach`.
fn free_way(surface: &Surface, walls: &Walls<'_>, face: u32, reach: f64) -> f64 {
    let centre = surface.corners(face as usize).into_iter().sum::<DVec3>() / 3.0;
    walls.first_hit(centre, walls.normal(face) * reach, face).map_or(reach, |share| share * reach)
}

#[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
fn index(face: usize) -> u32 {
    face as u32
}
