//! Removes or attaches small separate solids, as the option `islands` asks.

use super::operator::{Applied, Counter, Operation, Scope};
use super::struts::attach;
use crate::inspect::{nesting, solids};
use crate::math::Precision;
use crate::mesh::{Edges, Parts, Surface};
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

impl Operation<'_> for TreatIslands {
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
        let (dropped, faces) = drop_small(surface, self.min_volume, context)?;
        let struts = match self.strut {
            Some(diameter) => attach(surface, diameter, self.precision, context)?,
            None => 0,
        };
        let solids_left = if self.strut.is_some() { count_solids(surface) } else { 1 };
        let left = (solids_left > 1).then(|| format!("{solids_left} separate solids remain, because a strut failed"));
        let changes = Change::list([
            (ChangeKind::IslandsDropped, dropped),
            (ChangeKind::FacesRemoved, faces),
            (ChangeKind::IslandsAttached, struts),
        ]);
        Ok(Applied { changes, left, ..Applied::default() })
    }
}

/// Removes separate solids below a volume, with the cavities inside them, but never the largest solid. Returns the numbers
/// of solids and of faces removed.
fn drop_small(surface: &mut Surface, min_volume: f64, context: &Context<'_>) -> Result<(u64, u64), Cancelled> {
    let edges = Edges::new(&surface.faces);
    let parts = Parts::new(surface, &edges);
    let solids = solids(surface, &edges, &parts);
    let largest = solids.iter().map(|solid| solid.volume).fold(0.0, f64::max);
    let is_small = |part: usize| {
        let solid = &solids[part];
        solid.closed && solid.volume > 0.0 && solid.volume < min_volume.min(largest)
    };
    let mut is_removed: Vec<bool> = (0..parts.count).map(is_small).collect();
    let count = is_removed.iter().filter(|&&removed| removed).count() as u64;
    if count == 0 {
        return Ok((0, 0));
    }
    let is_cavity: Vec<bool> = solids.iter().map(|solid| solid.volume < 0.0).collect();
    let containers = nesting(surface, &parts, &solids, &is_cavity, context)?;
    for cavity in (0..parts.count).filter(|&part| is_cavity[part]) {
        is_removed[cavity] = containers[cavity].iter().flatten().any(|&around| is_removed[around as usize]);
    }
    let faces = parts.remove(&is_removed, surface);
    surface.drop_unreferenced();
    Ok((count, faces))
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
