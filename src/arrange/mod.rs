//! Surfaces that intersect resolved into the boundary of what they enclose: the trait, and our exact arrangement behind it.
//!
//! After Zhou, Grinspun, Zorin and Jacobson 2016, "Mesh Arrangements for Solid Geometry": every face is cut where it meets
//! others, the cells between the pieces are labelled by winding number, and the walls with the inside on one side only
//! are kept.

mod exact;

use crate::context::{Cancelled, Context};
use crate::mesh::{ClosedSurface, NotClosed, Surface};

pub use exact::Exact;

/// Which cells are inside, by their winding number `w`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Inside {
    /// `w >= 1`: what the surface winds around outward. An inverted part is no material.
    #[default]
    Positive,
    /// `w != 0`: inverted parts are solid as well.
    Nonzero,
    /// `w` odd: what is wound around twice is outside again, whichever way its walls are turned.
    Odd,
}

/// What becomes of the cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Rule {
    /// Which are inside.
    pub inside: Inside,
    /// Whether patches are doubted: faces without a source. What is inside only because holes were closed, and would hide
    /// surface that can be seen through those holes, is outside then.
    pub doubts_patches: bool,
}

impl From<Inside> for Rule {
    fn from(inside: Inside) -> Self {
        Self { inside, doubts_patches: false }
    }
}

/// Why there is no arrangement.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ArrangeError {
    /// The surface is not closed.
    #[error(transparent)]
    NotClosed(#[from] NotClosed),
    /// It could not be done.
    #[error("the faces that intersect could not be resolved: {0}")]
    Failed(String),
    /// Nothing is inside.
    #[error("the surface encloses nothing")]
    Empty,
    /// The work was stopped.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// What comes of an arrangement.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Solid {
    /// The boundary of what is inside.
    pub surface: Surface,
    /// Walls of no thickness outside, where surface lies on surface that looks the other way: they enclose nothing, so the
    /// boundary has nothing of them.
    pub flaps: Surface,
    /// The faces with the outside on either side, since patches were taken for wrong: what they were the skin of is open. In
    /// order, turned so that what was inside is behind them.
    pub opened: Surface,
}

/// Resolves intersections.
pub trait Arrangement {
    /// The boundary of what `surface` encloses: closed, and oriented outward. Its positions are f64; rounding them may
    /// make faces intersect again. Each face's source is that of the face that it was cut from. It is empty only where what was
    /// inside is all `opened`.
    ///
    /// # Errors
    /// [`ArrangeError`].
    fn solid(&self, surface: ClosedSurface<'_>, rule: Rule, context: &Context<'_>) -> Result<Solid, ArrangeError>;
}
