//! Closed parts that are smaller than the options keep.

use super::{Applied, Counter, Operation, Scope};
use crate::inspect::{nesting, solids};
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Drops small parts.
#[derive(Debug, Clone, Copy)]
pub struct DropSmallParts {
    /// A part with a smaller share of the volume of all parts goes, in percent.
    pub min_volume_pct: f64,
}

impl DropSmallParts {
    /// Drops the closed parts with less than a share of the volume of all parts, and what lies in them. The cavities of a part that
    /// stays are no parts of their own and stay with it.
    ///
    /// Precondition: consistent and outward winding; what overlaps is united. Result: what is left is as it was. Leaves: open parts of
    /// any size, and the largest part.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let parts = Parts::new(surface, &edges);
        let solids = solids(surface, &edges, &parts);
        let is_solid = |part: usize| solids[part].closed && solids[part].volume > 0.0;
        let total: f64 = solids.iter().filter(|it| it.closed).map(|it| it.volume).sum();
        let largest = solids.iter().map(|it| it.volume).fold(0.0, f64::max);
        let least = (self.min_volume_pct / 100.0 * total).min(largest);
        let mut goes: Vec<bool> = (0..parts.count).map(|part| is_solid(part) && solids[part].volume < least).collect();
        if !goes.contains(&true) {
            return Ok(Applied::default());
        }
        let wanted: Vec<bool> = solids.iter().map(|it| it.volume < 0.0).collect();
        let containers = nesting(surface, &parts, &solids, &wanted, context)?;
        let within = |part: usize| containers[part].iter().flatten().any(|&around| goes[around as usize]);
        let cavities: Vec<usize> = (0..parts.count).filter(|&part| wanted[part] && within(part)).collect();
        for part in cavities {
            goes[part] = true;
        }
        let count = (0..parts.count).filter(|&part| goes[part] && is_solid(part)).count() as u64;
        let faces = parts.remove(&goes, surface);
        surface.drop_unreferenced();
        Ok(Change::list([(ChangeKind::SmallPartsDropped, count), (ChangeKind::SmallPartFacesDropped, faces)]).into())
    }
}

impl Operation for DropSmallParts {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { min_volume_pct: scope.options.min_part_volume_pct }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
