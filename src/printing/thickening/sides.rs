//! The side of a wall that keeps its faces: the inner side faces a cavity or concave air.

use crate::context::{Cancelled, Context};
use crate::mesh::{Edges, Surface, UnionFind};
use glam::DVec3;
use rayon::prelude::*;

use super::outcome::Growth;
use super::walls::{Opposed, Walls};

/// Cosine of the angle up to which faces at an edge belong to one smooth patch.
const SMOOTH: f64 = 0.866_025_403_784_438_6;

/// The faces that may not grow: with outward growth those on the inner side, with inward growth those on the outer side.
///
/// A face is on the inner side of a wall if the free way in front of it is shorter than in front of the opposed face.
/// Whole smooth patches are decided by the area of their faces.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn kept_faces(
    surface: &Surface,
    walls: &Walls<'_>,
    thin: &[Vec<Opposed>],
    growth: Growth,
    context: &Context<'_>,
) -> Result<Vec<bool>, Cancelled> {
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
    for half_edges in edges.iter().filter(|half_edges| half_edges.len() == 2) {
        let [f, g] = [half_edges[0] / 3, half_edges[1] / 3];
        if walls.normal(f).dot(walls.normal(g)) >= SMOOTH {
            patches.unite(f, g);
        }
    }
    let patch = patches.into_roots();
    // Positive: the patch is an inner side.
    let mut vote = vec![0.0; surface.faces.len()];
    for (face, thin) in thin.iter().enumerate() {
        if let Some(wall) = thin.first() {
            let [own, other] = [way[face], way[wall.face as usize]];
            let area = surface.area_vector(face).length();
            vote[patch[face] as usize] += area * (other - own) / (other + own).max(f64::MIN_POSITIVE);
        }
    }
    let keeps = |vote: f64| match growth {
        Growth::Both => false,
        Growth::Outward => vote > 1e-6,
        Growth::Inward => vote < -1e-6,
    };
    // Votes are sums of shares of area; a patch that is undecided grows on both sides.
    Ok((0..surface.faces.len()).map(|face| keeps(vote[patch[face] as usize] / reach.powi(2))).collect())
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
