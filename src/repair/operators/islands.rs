//! Removes small separate solids, as the option `islands` asks.

use super::operator::{Applied, Counter, Operation, Scope};
use crate::inspect::{nesting, solids};
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Removes separate solids below a volume, with the cavities inside them. The largest solid stays.
///
/// Precondition: a closed surface without intersections, oriented outward. Result: all other solids are unchanged.
#[derive(Debug, Clone, Copy)]
pub struct TreatIslands {
    /// The least volume of a solid, in cubic units.
    pub min_volume: f64,
}

impl Operation for TreatIslands {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &[];
    const CHANGES_SOUND_MODEL: bool = true;

    fn with_scope(scope: &Scope<'_>, surface: &Surface) -> Self {
        Self { min_volume: scope.options.print.min_island_volume(scope.millimetres, || enclosed_volume(surface)) }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let parts = Parts::new(surface, &edges);
        let solids = solids(surface, &edges, &parts);
        let largest = solids.iter().map(|solid| solid.volume).fold(0.0, f64::max);
        let is_small = |part: usize| {
            let solid = &solids[part];
            solid.closed && solid.volume > 0.0 && solid.volume < self.min_volume.min(largest)
        };
        let mut is_removed: Vec<bool> = (0..parts.count).map(is_small).collect();
        let count = is_removed.iter().filter(|&&removed| removed).count() as u64;
        if count == 0 {
            return Ok(Applied::default());
        }
        let is_cavity: Vec<bool> = solids.iter().map(|solid| solid.volume < 0.0).collect();
        let containers = nesting(surface, &parts, &solids, &is_cavity, context)?;
        for cavity in (0..parts.count).filter(|&part| is_cavity[part]) {
            is_removed[cavity] = containers[cavity].iter().flatten().any(|&around| is_removed[around as usize]);
        }
        let faces = parts.remove(&is_removed, surface);
        surface.drop_unreferenced();
        Ok(Change::list([(ChangeKind::IslandsDropped, count), (ChangeKind::FacesRemoved, faces)]).into())
    }
}

/// The sum of the volumes of all closed parts; cavities count as negative.
fn enclosed_volume(surface: &Surface) -> f64 {
    let edges = Edges::new(&surface.faces);
    let solids = solids(surface, &edges, &Parts::new(surface, &edges));
    solids.iter().filter(|solid| solid.closed).map(|solid| solid.volume).sum()
}
