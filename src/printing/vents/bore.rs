//! The prism that a bore removes.

use glam::DVec3;

use super::options::VentOptions;
use crate::mesh::Surface;

/// Number of sides.
pub(super) const SIDES: u32 = 24;
/// By how much the prism is wider than the circumscribed one, relatively and in units of the coordinates' rounding, so
/// that rounding its corners leaves the cylinder whole.
const WIDER: f64 = 1e-6;
const WIDER_ULPS: f64 = 4.0;

/// The prism that a bore removes.
#[derive(Debug, Clone)]
pub(super) struct Bore {
    /// The corners of both ends, counter-clockwise seen from the end in the bore's direction.
    ring: [Vec<DVec3>; 2],
    /// The ends of its axis.
    pub axis: [DVec3; 2],
    /// The radius of the cylinder that passes through it.
    pub radius: f64,
}

/// Two directions at right angles to a unit direction and to each other: the three are right-handed.
pub(super) fn across(direction: DVec3) -> [DVec3; 2] {
    let (a, b) = direction.any_orthonormal_pair();
    if a.cross(b).dot(direction) > 0.0 { [a, b] } else { [b, a] }
}

/// The radius of the prism's corners for a cylinder of radius 1.
pub(super) fn corner_radius() -> f64 {
    1.0 / (std::f64::consts::PI / f64::from(SIDES)).cos()
}

impl Bore {
    /// The prism of a bore along an axis with a unit direction.
    pub fn new(axis: [DVec3; 2], direction: DVec3, options: &VentOptions) -> Self {
        let radius = options.diameter / 2.0;
        let largest = axis.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
        let corners = (radius * (1.0 + WIDER) + WIDER_ULPS * largest * f64::from(f32::EPSILON)) * corner_radius();
        let [a, b] = across(direction);
        let ring = axis.map(|end| {
            let corner = |i: u32| {
                let angle = std::f64::consts::TAU * (f64::from(i) + 0.5) / f64::from(SIDES);
                options.precision.round(end + (a * angle.cos() + b * angle.sin()) * corners)
            };
            (0..SIDES).map(corner).collect()
        });
        Self { ring, axis, radius }
    }

    /// The corners.
    pub fn corners(&self) -> impl Iterator<Item = DVec3> + '_ {
        self.ring.iter().flatten().copied()
    }

    /// Appends the prism with its faces turned inward, so that it takes away what it covers.
    pub fn append_to(&self, surface: &mut Surface) {
        let [low, high] = &self.ring;
        surface.push_prism([low, high], true);
    }
}
