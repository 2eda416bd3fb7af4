//! The union of a solid with the layer that thickens its walls, by the rounds of the self-union.

use super::self_union::{SelfUnionRounds, is_manifold_by_position};
use crate::arrange::{Exact, WindingRule};
use crate::context::{Cancelled, Context};
use crate::mesh::Surface;
use crate::printing::thickening::SelfUnion;

/// Unites overlapping volumes exactly and rounds new vertices to f32.
#[derive(Debug, Clone, Copy, Default)]
pub struct LayerUnion;

impl SelfUnion for LayerUnion {
    fn unite(
        &self,
        surface: &Surface,
        max_deviation: f64,
        context: &Context<'_>,
    ) -> Result<Option<Surface>, Cancelled> {
        let union = SelfUnionRounds { winding_rule: WindingRule::Positive, max_deviation, sheets: None, always: true };
        Ok(union.boundary(surface, &Exact, context)?.filter(is_manifold_by_position))
    }
}

#[cfg(test)]
mod tests;
