//! The solid skin of a model: what a ball of one diameter, the seal, cannot reach from outside is solid.
//!
//! [`outer_skin`] finds the faces that bound the outside air. Here their openings are closed with patches, overlaps are
//! united. Faces that nothing crosses keep their vertices bit for bit.

mod close;

use crate::context::{Cancelled, Context};
use crate::inspect::solids;
use crate::math::Precision;
use crate::mesh::{Edges, Parts, Surface, is_generated};
pub use close::SealedPlace;
pub(super) use close::resolve;
use close::{Closed, close};
use glam::DVec3;

use super::split_non_manifold::{Pairing, Pinches, split_non_manifold};
use crate::printing::skin::{DropReason, DroppedPiece, OuterSkin, OuterSkinError, kept_exactly_pct, outer_skin};

/// The widest patch, in seals. A ball that passes an opening has more room than the flat patch across it shows.
const MAX_WIDTH: f64 = 2.0;
/// The largest share of the outer surface's area in parts that could not be closed, in percent.
const MAX_OPEN_PCT: f64 = 5.0;
/// A part with less than this share of the largest part's volume encloses nothing.
const MIN_SHARE: f64 = 1e-12;

/// Options of [`solid_skin`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SkinOptions {
    /// Openings narrower than this are closed, in the model's unit. None chooses a seal, and also closes openings of a few
    /// missing faces.
    pub seal: Option<f64>,
    /// The precision of the output file.
    pub precision: Precision,
}

/// The result of [`solid_skin`].
#[derive(Debug, Clone, PartialEq)]
pub struct SkinResult {
    /// The outer surface: closed, oriented outward. `source` is that of the input.
    pub surface: Surface,
    /// The seal, in the model's unit.
    pub seal: f64,
    /// A wider seal with which a space that air reaches now would be filled, in the model's unit, if there is one.
    pub filling_seal: Option<f64>,
    /// The patches.
    pub sealed: Vec<SealedPlace>,
    /// The result's volume less the signed volume of the input, about the centre of its box, in cubic units. Meaningful
    /// if the input's faces are oriented.
    pub filled_volume: f64,
    /// The dropped pieces.
    pub dropped: Vec<DroppedPiece>,
    /// The share of the result's area in faces of the input that are unchanged, in percent.
    pub kept_exactly_pct: f64,
}

/// Why there is no solid skin.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SkinError {
    /// There is no outer skin.
    #[error(transparent)]
    OuterSkin(#[from] OuterSkinError),
    /// Nothing is enclosed at this seal.
    #[error("the surface encloses nothing: air reaches both sides of every face through openings wider than {0:.4}")]
    Empty(f64),
    /// Some openings could not be closed.
    #[error("openings around {0:.1} % of the outer surface could not be closed")]
    Open(f64),
    /// A patch is wider than the seal allows.
    #[error("an opening {width:.4} wide would have to be closed, which is too wide for a seal of {seal:.4}")]
    Wide {
        /// The opening's width, in the model's unit.
        width: f64,
        /// The seal, in the model's unit.
        seal: f64,
        /// A seal that fills the model, in the model's unit, if one is known.
        filling: Option<f64>,
    },
    /// The faces still intersect.
    #[error("the outer surface still intersects itself after its openings were closed")]
    Intersecting,
    /// The work was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Computes the solid skin of a model: the boundary of all that a ball with the seal's diameter cannot reach from
/// outside, with the input's faces where they bound it.
///
/// The surface should be welded; it may be open, intersect itself and have any orientation. Openings that a ball of the
/// seal's diameter passes stay open, but for those of a few missing faces where the seal is not given: another patch of
/// more than twice that width is an error. Crevices stay, unless the space behind them must be cut off anyway.
///
/// # Errors
/// [`SkinError`]: nothing is enclosed, the faces cannot be arranged, or the work was cancelled.
pub fn solid_skin(surface: &Surface, options: &SkinOptions, context: &Context<'_>) -> Result<SkinResult, SkinError> {
    let OuterSkin { surface: open, seal, widest_lid, mut accounting, filling_seal } =
        outer_skin(surface, options.seal, context)?;
    if open.faces.is_empty() {
        return Err(SkinError::Empty(seal));
    }
    let Closed { surface: mut skin, sealed, sheets, open_pct } = close(open, options.precision, context)?;
    accounting.drop(&sheets, DropReason::Sheet);
    if skin.faces.is_empty() || open_pct > MAX_OPEN_PCT {
        return Err(SkinError::Open(open_pct));
    }
    let width = sealed.iter().map(|place| place.width).fold(0.0, f64::max);
    if width > (MAX_WIDTH * seal).max(widest_lid) {
        return Err(SkinError::Wide { width, seal, filling: filling_seal });
    }
    if !resolve(&mut skin, context)? {
        return Err(SkinError::Intersecting);
    }
    accounting.drop(&drop_remains(&mut skin), DropReason::Sheet);
    if Edges::new(&skin.faces).iter().any(|half_edges| half_edges.len() > 2) {
        split_non_manifold(&mut skin, Pairing::Angular, Pinches::Cut, context)?;
    }
    let kept_exactly_pct = kept_exactly_pct(&skin, surface);
    let dropped = accounting.pieces(surface);
    for source in skin.source.iter_mut().filter(|source| !is_generated(**source)) {
        *source = surface.source[*source as usize];
    }
    let centre = surface.bounds().centre();
    let filled_volume = signed_volume(&skin, centre) - signed_volume(surface, centre);
    Ok(SkinResult { surface: skin, seal, filling_seal, sealed, filled_volume, dropped, kept_exactly_pct })
}

/// The signed volume between the faces and a point.
fn signed_volume(surface: &Surface, about: DVec3) -> f64 {
    let of_face = |f: usize| {
        let [a, b, c] = surface.corners(f).map(|p| p - about);
        a.dot(b.cross(c)) / 6.0
    };
    (0..surface.faces.len()).map(of_face).sum()
}

/// Removes the parts that enclose nothing or are inside out: remains of patches. Returns the sources of the removed faces.
fn drop_remains(surface: &mut Surface) -> Vec<u32> {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let solids = solids(surface, &edges, &parts);
    let largest = solids.iter().map(|solid| solid.volume).fold(0.0, f64::max);
    let is_removed: Vec<bool> = solids.iter().map(|solid| solid.volume <= MIN_SHARE * largest).collect();
    if !is_removed.contains(&true) {
        return Vec::new();
    }
    let faces = surface.source.iter().zip(&parts.of_face);
    let is_dropped = |part: u32| part != Parts::NONE && is_removed[part as usize];
    let dropped = faces.filter(|&(_, &part)| is_dropped(part)).map(|(&source, _)| source).collect();
    parts.remove(&is_removed, surface);
    dropped
}

#[cfg(test)]
mod tests;
