//! Removes or attaches small separate solids, as the option `islands` asks.

use super::operator::{Applied, Counter, Operation, Scope};
use crate::inspect::solids;
use crate::math::Precision;
use crate::mesh::{Edges, Parts, Surface};
use crate::repair::solid_skin::{attach, drop_small};
use crate::repair::{Cancelled, Change, ChangeKind, Context, Islands};

/// Diameter of struts without a process, in millimetres.
const STRUT_MM: f64 = 2.0;

/// Removes separate solids below a volume, with the cavities inside them, and attaches the others to the largest solid with
/// struts if the options ask for that. The largest solid stays.
///
/// Precondition: a closed surface without intersections, oriented outward. Result: all other surface is unchanged.
#[derive(Debug, Clone, Copy)]
pub struct TreatIslands {
    /// The least volume of a solid, in cubic units.
    min_volume: f64,
    /// Diameter of the struts, in the model's unit; `None` to attach nothing.
    strut: Option<f64>,
    precision: Precision,
}

impl Operation for TreatIslands {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &[];
    const CHANGES_SOUND_MODEL: bool = true;

    fn with_scope(scope: &Scope<'_>, surface: &Surface) -> Self {
        let print = &scope.options.print;
        let strut_mm = || print.profile().map_or(STRUT_MM, |profile| profile.wire_mm.limit.max(profile.pin_mm.limit));
        Self {
            min_volume: print.min_island_volume(scope.millimetres, || enclosed_volume(surface)),
            strut: (print.islands == Islands::Attach).then(|| strut_mm() / scope.millimetres),
            precision: scope.format.precision(),
        }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let solids_before = count_solids(surface);
        let removed = drop_small(surface, self.min_volume, context)?;
        surface.drop_unreferenced();
        let dropped = if removed.is_empty() { 0 } else { solids_before - count_solids(surface) };
        let struts = match self.strut {
            Some(diameter) => attach(surface, diameter, self.precision, context)?.len(),
            None => 0,
        };
        let solids_left = if self.strut.is_some() { count_solids(surface) } else { 1 };
        let left = (solids_left > 1).then(|| format!("{solids_left} separate solids remain, because a strut failed"));
        let changes = Change::list([
            (ChangeKind::IslandsDropped, dropped),
            (ChangeKind::FacesRemoved, removed.len() as u64),
            (ChangeKind::IslandsAttached, struts as u64),
        ]);
        Ok(Applied { changes, left, ..Applied::default() })
    }
}

/// The number of closed parts, without the surfaces of cavities.
fn count_solids(surface: &Surface) -> u64 {
    let edges = Edges::new(&surface.faces);
    let solids = solids(surface, &edges, &Parts::new(surface, &edges));
    solids.iter().filter(|solid| solid.closed && solid.volume > 0.0).count() as u64
}

/// The sum of the volumes of all closed parts; cavities count as negative.
fn enclosed_volume(surface: &Surface) -> f64 {
    let edges = Edges::new(&surface.faces);
    let solids = solids(surface, &edges, &Parts::new(surface, &edges));
    solids.iter().filter(|solid| solid.closed).map(|solid| solid.volume).sum()
}
