//! Wall thickness and gaps of a solid, decided over whole faces.
//!
//! Two faces are opposed if their planes enclose at most 36.87 degrees. The thickness at a point of a face is the
//! smaller of two lengths: the perpendicular through the material to an opposed face, and the diameter of the ball that
//! touches both faces. Both are linear between two planes, so their least values lie at corners of the overlap of two
//! projections. No place falls between samples. At concave edges, where two faces need not be opposed, the shortest
//! chord between two faces counts.

mod concave;
mod earlier;
mod facing;
mod field;
mod kinds;
mod places;
mod prepared;
mod regions;
mod search;

use crate::context::{Cancelled, Context};
use crate::mesh::Surface;
pub use earlier::Earlier;
pub use places::{
    FeatureKind, LeastThickness, OpposedPair, OpposedPairs, Space, ThicknessField, ThinFeatures, ThinRegion,
};

use prepared::{FLAT, Prepared, largest_coordinate};
use regions::Grouping;
use search::Thinnest;

/// Finds all places thinner than `below`, and their kinds. Parameters and precondition as in [`opposed_pairs`].
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn thin_features(
    surface: &Surface,
    below: f64,
    side: Space,
    context: &Context<'_>,
) -> Result<ThinFeatures, Cancelled> {
    let prepared = Prepared::new(surface, side);
    let all = prepared.thinnest(below * prepared.scale, context)?;
    features((&prepared, side), &all, below, context)
}

/// Like [`thin_features`], for a surface that was measured before it was changed in places. Only faces near a
/// change are measured; the kinds of all places are decided anew.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn thin_features_after(
    earlier: Earlier<'_>,
    surface: &Surface,
    below: f64,
    side: Space,
    context: &Context<'_>,
) -> Result<ThinFeatures, Cancelled> {
    let prepared = Prepared::new(surface, side);
    let all = earlier.thinnest_after((surface, &prepared), below, context)?;
    features((&prepared, side), &all, below, context)
}

/// The places thinner than `below` and their kinds, from the thinnest place of each face.
fn features(
    (prepared, side): (&Prepared<'_>, Space),
    all: &[Thinnest],
    below: f64,
    context: &Context<'_>,
) -> Result<ThinFeatures, Cancelled> {
    let grouping = Grouping { prepared, all, limit: below * prepared.scale, side };
    Ok(ThinFeatures { regions: grouping.regions(context)?, pairs: prepared.pairs(all) })
}

/// Finds the thinnest place of a surface. Precondition as in [`opposed_pairs`].
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn least_thickness(surface: &Surface, side: Space, context: &Context<'_>) -> Result<LeastThickness, Cancelled> {
    let prepared = Prepared::new(surface, side);
    // The margin keeps the place itself below the bound in spite of rounding.
    let bound = prepared.least_ray(context)? * (1.0 + 1e-9);
    let found = prepared.thinnest(bound, context)?;
    let pairs = prepared.pairs(&found);
    let pair = pairs.walls.into_iter().min_by(|a, b| a.thickness.total_cmp(&b.thickness));
    Ok(LeastThickness { pair, is_complete: pairs.is_complete })
}

/// Measures the thickness at every vertex and face with inscribed balls, for pictures and statistics. Decisions use
/// [`opposed_pairs`], whose precondition holds here too.
///
/// A ball that touches the surface at two places less than 143 degrees apart lies in an edge or corner. There the
/// perpendicular chord counts, if it ends at an opposed face.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn thickness_field(surface: &Surface, side: Space, context: &Context<'_>) -> Result<ThicknessField, Cancelled> {
    Prepared::new(surface, side).field(context)
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
    side: Space,
    context: &Context<'_>,
) -> Result<OpposedPairs, Cancelled> {
    let prepared = Prepared::new(surface, side);
    let found = prepared.thinnest(below * prepared.scale, context)?;
    Ok(prepared.pairs(&found))
}

/// Like [`opposed_pairs`], for a surface that was measured before it was changed in places. Only faces near a change are
/// measured.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn opposed_pairs_after(
    earlier: Earlier<'_>,
    surface: &Surface,
    below: f64,
    side: Space,
    context: &Context<'_>,
) -> Result<OpposedPairs, Cancelled> {
    let prepared = Prepared::new(surface, side);
    let found = earlier.thinnest_after((surface, &prepared), below, context)?;
    Ok(prepared.pairs(&found))
}

/// The height below which the rounding of coordinates to f32 decides a face's normal. Such faces are not measured.
#[must_use]
pub fn least_height(surface: &Surface) -> f64 {
    FLAT * largest_coordinate(surface)
}

/// The limit for a model whose coordinates were rounded to f32: a wall of `limit` stays at or above this.
#[must_use]
pub fn rounded_limit(surface: &Surface, limit: f64) -> f64 {
    limit * (1.0 - 1.0 / f64::from(1 << 20)) - largest_coordinate(surface) / f64::from(1 << 22)
}

#[cfg(test)]
mod tests;
