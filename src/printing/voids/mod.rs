//! Sealed voids: spaces inside a solid without any opening to the outside.
//!
//! A sealed void keeps powder or resin inside, and nobody sees it from outside.

mod neck;
mod nesting;
mod rays;
mod regions;
mod sealed;
mod widest;

pub use neck::{Neck, narrowest_neck};
pub(crate) use rays::{Passage, RegionRays};
pub use regions::{NO_REGION, OUTSIDE, Regions, RegionsError, around_edge};
#[cfg(test)]
pub use sealed::voids_in;
pub use sealed::{SealedVoid, sealed_voids, voids_of};
pub use widest::{RegionFaces, WidestBall};

#[cfg(test)]
mod tests;
