use glam::DVec3;

use crate::math::Box3;

/// Where a tree's boxes are: the model's middle is the origin, and half of its longest side is 1, so that f32 holds
/// as much as it can. Trees that are searched together have one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    centre: DVec3,
    scale: f64,
}

impl Frame {
    /// The frame of triangles, given by numbers in `positions`. All positions that are used must be finite.
    ///
    /// # Panics
    /// When a number is not one of `positions`.
    #[must_use]
    pub fn around(positions: &[DVec3], faces: &[[u32; 3]]) -> Self {
        let bounds = Box3::of(faces.iter().flatten().map(|&v| positions[v as usize]));
        let half = (bounds.max * 0.5 - bounds.min * 0.5).max_element();
        let scale = if half > 0.0 && half.is_finite() && (1.0 / half).is_finite() { 1.0 / half } else { 1.0 };
        Self { centre: bounds.centre(), scale }
    }

    /// A point in the frame. Along each axis the order of numbers is kept.
    #[inline]
    #[must_use]
    pub fn to_tree(&self, p: DVec3) -> DVec3 {
        (p - self.centre) * self.scale
    }

    /// The length in the frame of a length of 1.
    #[must_use]
    pub fn scale(&self) -> f64 {
        self.scale
    }
}
