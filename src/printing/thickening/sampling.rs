//! The samples of faces: where they are, and a limit for the triangles that faces are split into.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::context::Context;
use crate::math::{Box3, Tree, centre_and_radius};
use crate::mesh::Surface;
use crate::printing::thickness::OpposedPair;
use glam::DVec3;

use super::results::Thin;

/// Triangles between two checks for cancellation.
const TRIANGLES_PER_CHECK: u64 = 1 << 10;

/// The number of triangles that faces were split into, and the most.
pub struct TriangleBudget<'a> {
    count: AtomicU64,
    most: u64,
    context: &'a Context<'a>,
}

impl<'a> TriangleBudget<'a> {
    /// No triangle yet, of at most so many.
    pub fn new(most: u64, context: &'a Context<'a>) -> Self {
        Self { count: AtomicU64::new(0), most, context }
    }

    /// Counts a triangle. Whether there are too many, or the work should stop.
    pub fn should_stop(&self) -> bool {
        let count = self.count.fetch_add(1, Ordering::Relaxed);
        if count >= self.most {
            return true;
        }
        let should_stop = count.is_multiple_of(TRIANGLES_PER_CHECK) && self.context.check().is_err();
        if should_stop {
            self.count.store(self.most, Ordering::Relaxed);
        }
        should_stop
    }

    /// Whether there were too many triangles, so that some were left out.
    pub fn is_exceeded(&self) -> bool {
        self.count.load(Ordering::Relaxed) > self.most
    }
}

/// The points near the thinnest places of a surface.
pub struct NearThin {
    places: Tree,
    reach: f64,
}

impl NearThin {
    /// The points within `reach` of the thinnest place of each face.
    pub fn new(thin: &Thin, reach: f64) -> Self {
        let place = |pair: &OpposedPair| Box3::of([pair.points[0]]);
        let places: Vec<Box3> = thin.walls().iter().chain(thin.tips()).map(place).collect();
        Self { places: Tree::of_boxes(&places), reach }
    }

    /// The faces of a surface that may be near a thin place.
    pub fn faces(&self, surface: &Surface) -> Vec<u32> {
        let is_near = |&face: &u32| {
            let (centre, size) = centre_and_radius(surface.corners(face as usize));
            self.reaches(centre, size)
        };
        (0u32..).take(surface.faces.len()).filter(is_near).collect()
    }

    /// Whether points within `size` of a point may be near a thin place.
    pub fn reaches(&self, point: DVec3, size: f64) -> bool {
        self.places.any_overlapping(&Box3::of([point]).grown(self.reach + size), |_| true)
    }
}

/// Where faces are sampled, and how many triangles.
#[derive(Clone, Copy)]
pub struct Scope<'a> {
    /// The limit for the triangles of all faces.
    pub budget: &'a TriangleBudget<'a>,
    /// None for everywhere.
    pub near: Option<&'a NearThin>,
    /// How much thicker than the least wall a wall may be, as a share of it, to count as thin.
    pub tolerance: f64,
}
