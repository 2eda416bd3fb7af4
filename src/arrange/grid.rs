use glam::DVec3;

use crate::math::Box3;

/// A position in steps of the grid.
pub(super) type Whole = [i64; 3];

/// Coordinates lie within `2^BITS` steps of the grid's origin: so many that f32 numbers of a model's size are kept exactly, and
/// so few that the plane of three positions and the side of a fourth fit in `i128`.
const BITS: i32 = 40;

/// The grid of whole numbers on which all is decided: a power of two of steps over the model's half side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    origin: DVec3,
    /// The step, in the model's unit: a power of two.
    step: f64,
}

impl Grid {
    /// The grid of positions, which must be finite and within 1e300 of 0.
    pub fn around(positions: &[DVec3]) -> Self {
        let bounds = Box3::of(positions.iter().copied());
        if positions.is_empty() {
            return Self { origin: DVec3::ZERO, step: 1.0 };
        }
        let half = ((bounds.max - bounds.min).max_element() * 0.5).max(f64::MIN_POSITIVE * 1e20);
        #[expect(clippy::cast_possible_truncation, reason = "an exponent")]
        let step = 2f64.powi((half.log2().ceil() as i32 - BITS).max(-1000));
        // A multiple of the step, so that positions on the grid stay so.
        let origin = ((bounds.min * 0.5 + bounds.max * 0.5) / step).round() * step;
        Self { origin, step }
    }

    /// The nearest place on the grid.
    pub fn to_grid(self, p: DVec3) -> Whole {
        let q = (p - self.origin) / self.step;
        let limit = f64::from(2u32).powi(BITS + 1);
        #[expect(clippy::cast_possible_truncation, reason = "within the limit")]
        q.to_array().map(|x| x.round().clamp(-limit, limit) as i64)
    }

    /// A place in steps as a position of the model.
    pub fn to_model(self, p: DVec3) -> DVec3 {
        p * self.step + self.origin
    }
}
