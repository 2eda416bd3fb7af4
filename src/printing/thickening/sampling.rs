//! A limit for the triangles that faces are split into.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::context::Context;

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
