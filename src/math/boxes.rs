//! Axis-aligned bounding boxes in f64, safe against overflow and underflow of huge and tiny coordinates.

use glam::DVec3;

use super::threads;

/// An axis-aligned box in f64. The empty box has `min` at plus infinity and `max` at minus infinity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Box3 {
    /// Smallest coordinates.
    pub min: DVec3,
    /// Largest coordinates.
    pub max: DVec3,
}

impl Box3 {
    /// The empty box.
    pub const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// The smallest box that contains all points.
    pub fn of(points: impl IntoIterator<Item = DVec3>) -> Self {
        let mut bounds = Self::EMPTY;
        for p in points {
            bounds.extend(p);
        }
        bounds
    }

    /// The smallest box that contains all faces, given as indices into `positions`. Computed in parallel if the faces are many.
    ///
    /// # Panics
    /// If a face has an index that is out of range.
    pub fn of_faces(positions: &[DVec3], faces: &[[u32; 3]]) -> Self {
        let of_chunks = threads::map_chunks(faces.len(), |range| {
            Self::of(faces[range].iter().flatten().map(|&v| positions[v as usize]))
        });
        of_chunks.into_iter().fold(Self::EMPTY, |all, of_chunk| all.joined(&of_chunk))
    }

    /// Grows the box to include `p`.
    pub fn extend(&mut self, p: DVec3) {
        self.min = self.min.min(p);
        self.max = self.max.max(p);
    }

    /// The box with all sides moved outward by `margin`.
    #[must_use]
    pub fn grown(self, margin: f64) -> Self {
        Self { min: self.min - margin, max: self.max + margin }
    }

    /// The smallest box that contains both boxes.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Whether the box contains no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.min.x > self.max.x
    }

    /// Whether `other` lies in this box; touching the border counts.
    #[must_use]
    pub fn contains(&self, other: &Self) -> bool {
        self.min.cmple(other.min).all() && self.max.cmpge(other.max).all()
    }

    /// Whether a point lies in this box; the border counts.
    #[must_use]
    pub fn holds(&self, p: DVec3) -> bool {
        self.min.cmple(p).all() && self.max.cmpge(p).all()
    }

    /// Whether the boxes have a point in common; the border counts.
    #[must_use]
    pub fn meets(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && self.max.cmpge(other.min).all()
    }

    /// The centre, or the origin for the empty box. Halving each corner before adding avoids overflow.
    #[must_use]
    pub fn centre(&self) -> DVec3 {
        if self.is_empty() { DVec3::ZERO } else { self.min * 0.5 + self.max * 0.5 }
    }

    /// Length of the diagonal; 0 for the empty box. Scaling by the longest side avoids overflow and underflow of
    /// squares.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        if self.is_empty() {
            return 0.0;
        }
        let half = self.max * 0.5 - self.min * 0.5;
        let largest = half.max_element();
        if largest > 0.0 { (half / largest).length() * largest * 2.0 } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_empty_box_has_no_diagonal_and_a_finite_centre() {
        assert!(Box3::EMPTY.is_empty());
        assert_eq!(Box3::EMPTY.diagonal(), 0.0);
        assert_eq!(Box3::EMPTY.centre(), DVec3::ZERO);
    }

    #[test]
    fn the_diagonal_of_a_tiny_box_does_not_underflow() {
        let bounds = Box3::of([DVec3::ZERO, DVec3::splat(1e-200)]);
        assert!((bounds.diagonal() / 1e-200 - 3f64.sqrt()).abs() < 1e-12);
    }
}
