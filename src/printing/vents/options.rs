//! What to drill.

use glam::DVec3;

use crate::math::Precision;

/// What to drill. Lengths are in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VentOptions {
    /// Diameter of a cylinder that passes through each bore.
    pub diameter: f64,
    /// Number of bores for each void.
    pub per_void: u32,
    /// Thickness of the wall that is kept around each bore where the model has such a place.
    pub wall: f64,
    /// The upward direction in which the model stands or is built. Bores are placed low and on the underside.
    pub up: DVec3,
    /// Precision of the positions in the output.
    pub precision: Precision,
}
