//! The hollows of a solid, as a report lists them: sealed cavities, powder traps, and resin cups.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::cups::resin_cups;
use super::traps::powder_traps;
use super::voids::{Regions, RegionsError, narrowest_neck, voids_of};
use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;
use crate::mesh::ClosedSurface;
use crate::scene::Up;

/// Most cavities that a report lists, and most cups.
const MAX_LISTED: usize = 20;
/// Grid cells for the narrowest passage of a cavity.
const NECK_CELLS: usize = 20_000;
/// Octree nodes for the search for powder traps.
const TRAP_NODES: usize = 4_000_000;
/// Diameter of the ball that must be able to leave, as a share of the escape hole's diameter. The search decides to within 3 %,
/// so a ball with the hole's exact diameter would stay undecided.
const ESCAPE_MARGIN: f64 = 0.95;
/// Least volume of a resin cup. Smaller hollows are texture of the surface.
const MIN_CUP_MM3: f64 = 10.0;

/// A sealed cavity: a space inside a solid without any opening to the outside.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Cavity {
    /// A point inside, in the file's unit.
    pub at: [f64; 3],
    /// Volume, without the solids inside.
    pub volume_mm3: f64,
    /// Lower bound of the diameter of the largest ball that fits; 0 if none was found.
    pub widest_mm: f64,
    /// Width of the narrowest passage between the cavity's chambers; absent for a cavity of one chamber.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub narrowest_mm: Option<f64>,
    /// Number of separate solids inside.
    pub solids: usize,
}

/// A resin cup: a hollow that is cut off from the outside while the layers below its brim are printed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ResinCup {
    /// The lowest point, where a drain would empty the cup, in the file's unit.
    pub at: [f64; 3],
    /// Volume below the brim.
    pub volume_mm3: f64,
    /// Area of the opening at the brim.
    pub opening_mm2: f64,
}

/// A hollow whose openings are narrower than an escape hole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Trap {
    pub at: [f64; 3],
    /// Diameter of the largest ball that can leave; 0 for a sealed cavity.
    pub opening_mm: f64,
}

/// The hollows of a solid.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Hollows {
    /// The largest sealed cavities, largest first.
    pub cavities: Vec<Cavity>,
    /// The largest resin cups, largest first; empty unless the caller asked for cups.
    pub cups: Vec<ResinCup>,
    /// All sealed cavities and powder traps.
    pub traps: Vec<Trap>,
    /// Whether the search for powder traps was finished. Without escape holes no search is needed.
    pub is_complete: bool,
}

/// Finds the hollows of a printable solid. `escape_mm` is the diameter of an escape hole, if the process needs any.
/// `None` if the nesting of the parts is undecided.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub(super) fn find_hollows(
    analysis: &Analysis<'_>,
    escape_mm: Option<f64>,
    wants_cups: bool,
    context: &Context<'_>,
) -> Result<Option<Hollows>, Cancelled> {
    let unit = analysis.facts.unit;
    let mm = unit.map_or(1.0, |unit| unit.used.millimetres());
    let surface = &analysis.surface;
    let Ok(closed) = ClosedSurface::new(surface, &analysis.edges) else { return Ok(None) };
    let regions = match Regions::new(closed, &analysis.edges, context) {
        Ok(regions) => regions,
        Err(RegionsError::Cancelled(stop)) => return Err(stop),
        Err(_) => return Ok(None),
    };
    let voids = voids_of(surface, &regions, context)?;
    let mut found = Hollows { is_complete: true, ..Hollows::default() };
    for void in voids.iter().take(MAX_LISTED) {
        let neck = narrowest_neck(surface, &regions, void, NECK_CELLS, context)?;
        found.cavities.push(Cavity {
            at: void.at.to_array(),
            volume_mm3: void.volume * mm * mm * mm,
            widest_mm: void.widest * mm,
            narrowest_mm: neck.map(|neck| neck.width * mm),
            solids: void.solids,
        });
    }
    if let Some(escape_mm) = escape_mm {
        found.traps.extend(voids.iter().map(|void| Trap { at: void.at.to_array(), opening_mm: 0.0 }));
        let open = powder_traps(surface, &regions, ESCAPE_MARGIN * escape_mm / mm, TRAP_NODES, context)?;
        found.is_complete = open.as_ref().is_some_and(|open| open.undecided_volume == 0.0);
        let open = open.into_iter().flat_map(|open| open.traps);
        found.traps.extend(open.map(|trap| Trap { at: trap.at.to_array(), opening_mm: trap.opening * mm }));
    }
    if wants_cups {
        let up = if unit.is_some_and(|unit| unit.up == Some(Up::Y)) { DVec3::Y } else { DVec3::Z };
        let cups = match resin_cups(surface, &regions, up, context) {
            Ok(cups) => cups,
            Err(RegionsError::Cancelled(stop)) => return Err(stop),
            Err(_) => Vec::new(),
        };
        let cups = cups.into_iter().map(|cup| ResinCup {
            at: cup.at.to_array(),
            volume_mm3: cup.volume * mm * mm * mm,
            opening_mm2: cup.opening_area * mm * mm,
        });
        found.cups = cups.filter(|cup| cup.volume_mm3 >= MIN_CUP_MM3).take(MAX_LISTED).collect();
    }
    Ok(Some(found))
}
