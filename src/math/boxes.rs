use glam::DVec3;

/// An axis-parallel box in f64. The empty box has its corners at infinity, the wrong way round.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Box3 {
    /// Smallest coordinates.
    pub min: DVec3,
    /// Largest coordinates.
    pub max: DVec3,
}

impl Box3 {
    /// The box of no points.
    pub const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// The smallest box around points.
    pub fn of(points: impl IntoIterator<Item = DVec3>) -> Self {
        let mut it = Self::EMPTY;
        for p in points {
            it.extend(p);
        }
        it
    }

    /// Grows the box so that it holds `p`.
    pub fn extend(&mut self, p: DVec3) {
        self.min = self.min.min(p);
        self.max = self.max.max(p);
    }

    /// Whether no point is in it.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.min.x > self.max.x
    }

    /// Whether `other` lies in this box, borders included.
    #[must_use]
    pub fn contains(&self, other: &Self) -> bool {
        self.min.cmple(other.min).all() && self.max.cmpge(other.max).all()
    }

    /// Whether a point lies in this box, borders included.
    #[must_use]
    pub fn holds(&self, p: DVec3) -> bool {
        self.min.cmple(p).all() && self.max.cmpge(p).all()
    }

    /// Whether the boxes have a point in common, borders included.
    #[must_use]
    pub fn meets(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && self.max.cmpge(other.min).all()
    }

    /// The middle. Halves are added so that huge coordinates do not overflow.
    #[must_use]
    pub fn centre(&self) -> DVec3 {
        if self.is_empty() { DVec3::ZERO } else { self.min * 0.5 + self.max * 0.5 }
    }

    /// Length of the diagonal; 0 for the empty box. Finite for every finite box but one of astronomic size.
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
        let it = Box3::of([DVec3::ZERO, DVec3::splat(1e-200)]);
        assert!((it.diagonal() / 1e-200 - 3f64.sqrt()).abs() < 1e-12);
    }
}
