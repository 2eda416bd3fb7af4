//! Mesh simplification by edge collapse, cheapest edge first. A collapse is made only if it preserves every property
//! listed at [`Simplify::apply`].
//!
//! ```text
//!      x---x            x---x
//!     / \ / \          / \ / \
//!    x---a---b    ->  x---p   x      removes the two faces at edge a-b
//!     \ / \ /          \ / \ /
//!      x---x            x---x
//! ```
//!
//! [`queue`] chooses the new vertex position and the cost of a collapse; [`collapse`] decides whether the collapse is
//! allowed, by [`deviation`] and [`validity`]; [`max_distance`] tests the distance at every point.

mod collapse;
mod decimate;
mod deviation;
mod dynamic_mesh;
mod max_distance;
mod queue;
mod slabs;
mod validity;

use std::cell::OnceCell;

use rustc_hash::FxHashSet;

use crate::context::{Cancelled, Context};
use crate::math::Tree;
use crate::mesh::{Surface, position_key};
use collapse::MAX_BOUND_RATIO;
use decimate::Constraints;
use max_distance::Target;

pub use decimate::{Simplified, Simplify};

/// Share of the maximum error that is the limit at measured points, if the maximum error should hold everywhere.
const ERROR_SHARE: f64 = 0.95;
/// Maximum number of attempts with this share. The last attempt divides the maximum error by [`MAX_BOUND_RATIO`], so that
/// even the sum of all displacements is within it.
const MAX_ATTEMPTS: u32 = 4;

impl Simplify {
    /// Collapses edges, cheapest first by area-weighted quadrics (Garland and Heckbert 1997), until `max_faces` is
    /// reached or no edge may collapse.
    ///
    /// An edge collapses only if
    /// - the topology stays the same: closed, manifold, with as many handles and parts (link condition of Dey,
    ///   Edelsbrunner, Guha and Nekhayev 1999);
    /// - boundary and sharp edges keep their line;
    /// - no closed part shrinks to less than half of its volume or grows to more than twice its volume;
    /// - no face turns by more than 78 degrees in one collapse, loses its area or becomes a needle;
    /// - the error stays within its bound: see [`Simplify::max_error`];
    /// - the changed faces meet no other face. This test is exact on the output positions, rounded to f32 if requested.
    ///   Like a reader of STL, the test treats vertices at one position as one.
    ///
    /// There is no precondition. Vertices whose faces do not form one fan, or are inconsistently oriented, keep their
    /// position and all their edges. Where faces intersect, a collapse that would leave one of its faces intersecting
    /// is refused, so the number of intersecting pairs only decreases. Each face keeps its source, and the order of
    /// faces stays the same. If no edge collapses, the surface is unchanged. The result is deterministic.
    ///
    /// # Errors
    /// [`Cancelled`] if the work is cancelled, or the deadline passes before the first collapse; the surface is then
    /// unchanged. A later deadline ends the work with the collapses made so far. All guarantees above hold, except that
    /// `max_error` holds only at measured points if the deadline passes while both surfaces are tested.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Simplified, Cancelled> {
        if !self.everywhere {
            return self.apply_once(surface, &Constraints::default(), context);
        }
        let mut fixed = FxHashSet::default();
        let original = OnceCell::new();
        let mut result = Surface::default();
        let mut done = Simplified::default();
        for attempt in 0..=MAX_ATTEMPTS {
            let share = if attempt < MAX_ATTEMPTS { ERROR_SHARE } else { 1.0 / MAX_BOUND_RATIO };
            result.clone_from(surface);
            let constraints = Constraints { fixed_positions: Some(&fixed), ..Constraints::default() };
            done =
                Self { max_error: self.max_error * share, ..*self }.apply_once(&mut result, &constraints, context)?;
            if done.bound <= self.max_error {
                break;
            }
            let tree = original.get_or_init(|| Tree::new(&surface.positions, &surface.faces));
            match context.unless_late(self.faces_beyond((surface, tree), &result, context))? {
                Some(faces) if faces.is_empty() => done.bound = self.max_error,
                Some(faces) => {
                    let vertices = faces.iter().flat_map(|&f| surface.faces[f as usize]);
                    fixed.extend(vertices.map(|v| position_key(surface.positions[v as usize])));
                    continue;
                }
                None => done.is_late = true,
            }
            break;
        }
        *surface = result;
        Ok(done)
    }

    /// Collapses edges with the error limited at the measured points.
    fn apply_once(
        &self,
        surface: &mut Surface,
        constraints: &Constraints<'_>,
        context: &Context<'_>,
    ) -> Result<Simplified, Cancelled> {
        if self.max_faces.is_none() && self.max_error.is_finite() && slabs::is_large(surface) {
            return slabs::simplify_in_slabs(self, surface, constraints, context);
        }
        self.apply_constrained(surface, constraints, context)
    }

    /// The faces of the original surface, given with its tree, where the distance between both surfaces exceeds `max_error`.
    fn faces_beyond(
        &self,
        (before, tree): (&Surface, &Tree),
        after: &Surface,
        context: &Context<'_>,
    ) -> Result<Vec<u32>, Cancelled> {
        let beyond = |from: &Surface, to: &Surface, tree: &Tree| {
            let target = Target { tree, positions: &to.positions, faces: &to.faces };
            target.faces_beyond(from, self.max_error, context)
        };
        let lost = beyond(before, after, &Tree::new(&after.positions, &after.faces))?;
        let added = beyond(after, before, tree)?;
        Ok(lost.iter().map(|pair| pair[0]).chain(added.iter().map(|pair| pair[1])).collect())
    }
}
