//! Positions near others that no vertex has yet, as f32 tells them apart.

use std::collections::HashSet;

use glam::DVec3;

use super::rounding::TOLD_APART;
use crate::math::Precision;
use crate::mesh::Surface;

/// Lengths that are tried, each twice the one before, beginning with the distance between neighbouring f32 numbers.
const STEPS: i32 = 12;

/// The positions that are taken, as f32.
pub(super) struct Places {
    taken: HashSet<[u32; 3]>,
    /// Whether positions are rounded to f32.
    precision: Precision,
    /// The least length that is tried.
    least: f64,
    /// The farthest that was gone so far.
    pub moved: f64,
}

impl Places {
    /// Those of a surface's vertices.
    pub fn new(surface: &Surface, precision: Precision) -> Self {
        let largest = surface.positions.iter().fold(DVec3::ZERO, |most, p| most.max(p.abs()));
        // In a direction between the axes it is still above 1e-8 along one of them.
        let least = (2.0 * TOLD_APART).min(spacing(largest));
        Self { taken: surface.positions.iter().map(|&p| key(p)).collect(), precision, least, moved: 0.0 }
    }

    /// The nearest free position from `p` in a direction, no farther than `most`, for which `fits` holds; then it is taken.
    pub fn find(
        &mut self,
        p: DVec3,
        direction: DVec3,
        most: f64,
        mut fits: impl FnMut(DVec3) -> bool,
    ) -> Option<DVec3> {
        let least = spacing(p).max(self.least);
        for k in 0..STEPS {
            let q = self.precision.round(p + direction * (least * 2f64.powi(k)));
            let free = q.is_finite() && p.distance(q) <= most && !self.taken.contains(&key(q));
            if free && fits(q) {
                self.taken.insert(key(q));
                self.moved = self.moved.max(p.distance(q));
                return Some(q);
            }
        }
        None
    }
}

/// A position as an STL file would hold it, to be compared.
#[expect(clippy::cast_possible_truncation, reason = "compared as an STL file would hold them")]
pub(super) fn key(p: DVec3) -> [u32; 3] {
    p.to_array().map(|x| (x as f32 + 0.0).to_bits())
}

/// The distance between f32 numbers as large as the largest coordinate, and where that is too large for one, as the largest number.
#[expect(clippy::cast_possible_truncation, reason = "asked about f32")]
pub(super) fn spacing(p: DVec3) -> f64 {
    let largest = (p.abs().max_element() as f32).clamp(f32::MIN_POSITIVE, f32::MAX.next_down());
    f64::from(largest.next_up() - largest)
}
