//! The side of a wall that keeps its faces: the inner side faces a cavity or concave air.

use std::collections::BTreeMap;

use crate::context::{Cancelled, Context};
use crate::mesh::{Edges, Surface, UnionFind};
use glam::DVec3;
use rayon::prelude::*;
use smallvec::SmallVec;

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
    for [f, g] in neighbours(&edges) {
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
    let side = |vote: f64| if vote > 0.0 { Side::Inner } else { Side::Outer };
    let mut sides: BTreeMap<u32, Option<Side>> =
        votes.iter().map(|(&patch, &vote)| (patch, (vote.abs() > least).then(|| side(vote)))).collect();
    decide_by_neighbours(surface, &edges, &patch, &mut sides);
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

/// Decides the patches of equal sides by the lengths of the edges between them and decided patches.
fn decide_by_neighbours(surface: &Surface, edges: &Edges, patch: &[u32], sides: &mut BTreeMap<u32, Option<Side>>) {
    loop {
        let mut votes: BTreeMap<u32, f64> = BTreeMap::new();
        for [f, g] in neighbours(edges) {
            for [own, other] in [[f, g], [g, f]] {
                let (own, side) = (patch[own as usize], sides.get(&patch[other as usize]).copied().flatten());
                let (Some(None), Some(side)) = (sides.get(&own), side) else { continue };
                let (is_convex, length) = shared_edge(surface, [f, g]);
                match side {
                    Side::Inner if !is_convex => *votes.entry(own).or_insert(0.0) += length,
                    Side::Outer if is_convex => *votes.entry(own).or_insert(0.0) -= length,
                    Side::Inner | Side::Outer => {}
                }
            }
        }
        votes.retain(|_, vote| *vote != 0.0);
        if votes.is_empty() {
            return;
        }
        for (patch, vote) in votes {
            sides.insert(patch, Some(if vote > 0.0 { Side::Inner } else { Side::Outer }));
        }
    }
}

/// The pairs of faces with a common edge.
fn neighbours(edges: &Edges) -> impl Iterator<Item = [u32; 2]> {
    edges.iter().filter_map(|half_edges| if let &[g, h] = half_edges { Some([g / 3, h / 3]) } else { None })
}

/// Whether the edge between two faces is convex, and its length.
fn shared_edge(surface: &Surface, [f, g]: [u32; 2]) -> (bool, f64) {
    let [own, other] = [f, g].map(|face| surface.faces[face as usize]);
    let apex = other.into_iter().find(|v| !own.contains(v)).unwrap_or(other[0]);
    let at = |v: u32| surface.positions[v as usize];
    let is_convex = (at(apex) - at(own[0])).dot(surface.area_vector(f as usize)) < 0.0;
    let shared: SmallVec<[DVec3; 3]> = own.into_iter().filter(|v| other.contains(v)).map(at).collect();
    (is_convex, shared.first().zip(shared.get(1)).map_or(0.0, |(p, q)| p.distance(*q)))
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
