//! Wall thickness and gaps of a solid, decided over whole faces.
//!
//! Two faces are opposed if their planes enclose at most 36.87 degrees. The thickness at a point of a face is the
//! smaller of two lengths: the perpendicular through the material to an opposed face, and the diameter of the ball that
//! touches both faces. Both are linear between two planes, so their least values lie at corners of the overlap of two
//! projections. No place falls between samples. At concave edges, where two faces need not be opposed, the shortest
//! chord between two faces counts.

mod concave;
mod facing;
mod prepared;
mod search;

use crate::context::{Cancelled, Context};
use crate::mesh::Surface;
use glam::DVec3;

use prepared::Prepared;

/// What is measured: the solid, or the space around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// Walls, wires and pins.
    Material,
    /// Gaps, slots and holes.
    Air,
}

/// Two points on two faces that face away from each other across material, or towards each other across air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OpposedPair {
    /// The two faces; the first one is the face that this pair is the thinnest place of.
    pub faces: [u32; 2],
    /// A point on each face. The segment between them lies in the material, or in air.
    pub points: [DVec3; 2],
    /// The distance between the points.
    pub distance: f64,
    /// The thickness at the points, at least `distance`: the diameter of the ball that touches both faces.
    pub thickness: f64,
}

/// The thinnest places of the faces of a surface.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct OpposedPairs {
    /// For each face that is part of a thin wall, its thinnest place, in the order of the faces.
    pub walls: Vec<OpposedPair>,
    /// For each face that is thin towards a sharp edge or point, its thinnest place there. A face may be in both lists.
    pub tips: Vec<OpposedPair>,
    /// Faces whose search ended at its budget; they may be thinner than found.
    pub undecided_faces: Vec<u32>,
    /// Whether all faces are decided.
    pub is_complete: bool,
}

/// The thinnest place of every face that is thinner than `below`, in the model's unit. A wall of exactly `below` is not
/// thin; for a model whose coordinates were rounded, pass [`rounded_limit`].
///
/// The surface must be closed, consistently oriented with normals out of the material, and free of intersections.
/// Faces smaller than the rounding of f32 coordinates are skipped. O(n log n) for n faces if few are thin.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn opposed_pairs(
    surface: &Surface,
    below: f64,
    side: Side,
    context: &Context<'_>,
) -> Result<OpposedPairs, Cancelled> {
    let prepared = Prepared::new(surface, side);
    let found = prepared.thinnest(below * prepared.scale, context)?;
    Ok(prepared.pairs(&found))
}

/// The limit for a model whose coordinates were rounded to f32: a wall of `limit` stays at or above this.
#[must_use]
pub fn rounded_limit(surface: &Surface, limit: f64) -> f64 {
    let largest = surface.positions.iter().fold(0.0f64, |m, p| m.max(p.abs().max_element()));
    limit * (1.0 - 1.0 / f64::from(1 << 20)) - largest / f64::from(1 << 22)
}

#[cfg(test)]
mod tests;
