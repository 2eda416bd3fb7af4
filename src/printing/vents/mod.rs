//! Vents: bores that join sealed voids with the outside, so that powder or resin can leave them.
//!
//! A bore is a prism of 24 sides around a cylinder of the given diameter. It is subtracted exactly, and the result is
//! verified: a void that can't be joined without side effects is left alone, with the reason.

mod bore;
mod options;
mod place;
mod verify;

use glam::DVec3;

use super::voids::{OUTSIDE, Regions, RegionsError, SealedVoid, voids_of};
use crate::context::{Cancelled, Context};
use crate::mesh::{ClosedSurface, Edges, Surface};
use bore::Bore;
pub use options::VentOptions;
use place::{Placement, Site, Task};
pub use verify::Mistake;
use verify::verify;

/// The most voids that get bores, largest first: each takes some ten milliseconds.
const MAX_VOIDS: usize = 500;
/// Places that are tried for one bore if the first fails the verification.
const MAX_TRIED: usize = 4;

/// A bore that was drilled. Lengths are in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vent {
    /// The centre of its mouth on the outer surface.
    pub at: DVec3,
    /// The unit direction from the void to the mouth.
    pub direction: DVec3,
    /// Diameter of the cylinder that passes through it.
    pub diameter: f64,
    /// Length of its axis in the wall.
    pub length: f64,
    /// Index of the void among [`Vented::voids`].
    pub void: usize,
}

/// Why a void has fewer bores than requested.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum VentFailure {
    /// No straight way of the bore's width leads from the void through one wall to the outside.
    #[error("no straight bore of this diameter leads through one wall to the outside")]
    NoWay,
    /// Bores exist, but fewer than requested have a place.
    #[error("only {drilled} of the bores {} a place", if *drilled == 1 { "has" } else { "have" })]
    TooFew {
        /// Number of bores drilled.
        drilled: u32,
    },
    /// The solid that holds the void lies in another void, which stayed sealed.
    #[error("the void around its solid stayed sealed")]
    ContainerSealed,
    /// The model has more voids than are drilled.
    #[error("only the {MAX_VOIDS} largest voids get bores")]
    TooMany,
    /// The bore could not be subtracted.
    #[error("the bore could not be subtracted: {0}")]
    NotSubtracted(String),
    /// The result did not pass the verification.
    #[error("the drilled model failed the verification: {0}")]
    NotVerified(Mistake),
}

/// Why no void could be treated.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum VentError {
    /// The diameter is not a positive number.
    #[error("the diameter of vents must be above 0")]
    Diameter,
    /// The regions of the surface could not be found.
    #[error(transparent)]
    Regions(#[from] RegionsError),
    /// The work was cancelled, or its deadline passed.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A model with its vents.
#[derive(Debug, Clone, PartialEq)]
pub struct Vented {
    /// The surface.
    pub surface: Surface,
    /// The sealed voids of the input, largest first.
    pub voids: Vec<SealedVoid>,
    /// The bores.
    pub vents: Vec<Vent>,
    /// Voids with fewer bores than requested, by index, and why.
    pub failed: Vec<(usize, VentFailure)>,
}

/// Why a union failed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum UnionError {
    /// The union could not be computed.
    #[error("{0}")]
    Failed(String),
    /// The work was cancelled, or its deadline passed.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Computes the boundary of the space that a closed surface winds around at least once, with faces that do not intersect
/// and positions of the output's precision. Faces that meet no other face must keep their positions.
pub type Union<'a> = dyn Fn(Surface, &Context<'_>) -> Result<Surface, UnionError> + 'a;

/// Drills vents into all sealed voids of a surface without intersections.
///
/// Result: each bore joins its void with the outside, or, for a void in a solid in another void, with that void. No other
/// face changes. Faces of bores have [`NO_SOURCE`](crate::mesh::NO_SOURCE). Leaves: voids in [`Vented::failed`] that
/// have no bore.
///
/// # Errors
/// [`VentError`] if the diameter is invalid, if the voids are undecided, and on cancellation.
pub fn vent_voids(
    surface: ClosedSurface<'_>,
    options: &VentOptions,
    union: &Union<'_>,
    context: &Context<'_>,
) -> Result<Vented, VentError> {
    if !(options.diameter > 0.0 && options.diameter.is_finite()) {
        return Err(VentError::Diameter);
    }
    let regions = Regions::new(surface, &Edges::new(&surface.faces), context)?;
    let surface = surface.get();
    let voids = voids_of(surface, &regions, context)?;
    let mut drilling = Drilling { options, union, surface: surface.clone(), vents: Vec::new(), failed: Vec::new() };
    let sites = drilling.choose(&regions, &voids, context)?;
    let first: Vec<Site> = sites.iter().filter_map(|of_bore| of_bore.first().copied()).collect();
    let is_done = first.is_empty() || drilling.drill(surface, &first, context)?.is_ok();
    if !is_done {
        drilling.drill_one_by_one(&sites, &voids, context)?;
    }
    drilling.failed.sort_by_key(|(void, _)| *void);
    let Drilling { surface, vents, failed, .. } = drilling;
    Ok(Vented { surface, voids, vents, failed })
}

/// The state of drilling.
struct Drilling<'a> {
    options: &'a VentOptions,
    union: &'a Union<'a>,
    surface: Surface,
    vents: Vec<Vent>,
    failed: Vec<(usize, VentFailure)>,
}

impl Drilling<'_> {
    /// Chooses the sites of all bores, voids within voids after those around them: for each bore the best, followed by
    /// others.
    fn choose(
        &mut self,
        regions: &Regions,
        voids: &[SealedVoid],
        context: &Context<'_>,
    ) -> Result<Vec<Vec<Site>>, Cancelled> {
        let placement = Placement::new(&self.surface, regions, voids, self.options);
        let mut order: Vec<usize> = (0..voids.len()).collect();
        order.sort_by_key(|&void| (regions.depth[voids[void].region as usize], void));
        let mut is_open = vec![false; regions.count()];
        if let Some(outside) = is_open.get_mut(OUTSIDE as usize) {
            *outside = true;
        }
        let (mut all, mut chosen) = (Vec::new(), Vec::new());
        for void in order {
            context.check()?;
            if void >= MAX_VOIDS {
                self.failed.push((void, VentFailure::TooMany));
                continue;
            }
            if voids[void].container.is_some_and(|around| !is_open[voids[around].region as usize]) {
                self.failed.push((void, VentFailure::ContainerSealed));
                continue;
            }
            let sites = placement.sites(&Task { void, is_open: &is_open, others: &chosen }, context)?;
            match u32::try_from(sites.len()).unwrap_or(u32::MAX) {
                0 => self.failed.push((void, VentFailure::NoWay)),
                drilled if drilled < self.options.per_void => {
                    self.failed.push((void, VentFailure::TooFew { drilled }));
                }
                _ => {}
            }
            is_open[voids[void].region as usize] = !sites.is_empty();
            chosen.extend(sites.iter().filter_map(|of_bore| of_bore.first().copied()));
            all.extend(sites);
        }
        Ok(all)
    }

    /// Drills bores into a surface and takes the result if it passes the verification.
    fn drill(
        &mut self,
        surface: &Surface,
        sites: &[Site],
        context: &Context<'_>,
    ) -> Result<Result<(), VentFailure>, VentError> {
        let drilled = self.drilled(surface, sites, context)?;
        Ok(drilled.map(|drilled| {
            self.surface = drilled;
            self.vents.extend(sites.iter().map(|site| Vent {
                at: site.mouth,
                direction: site.direction,
                diameter: self.options.diameter,
                length: site.length,
                void: site.void,
            }));
        }))
    }

    fn drilled(
        &self,
        surface: &Surface,
        sites: &[Site],
        context: &Context<'_>,
    ) -> Result<Result<Surface, VentFailure>, VentError> {
        let bores: Vec<Bore> = sites.iter().map(|site| Bore::new(site.axis, site.direction, self.options)).collect();
        let mut cut = surface.clone();
        bores.iter().for_each(|bore| bore.append_to(&mut cut));
        let result = match (self.union)(cut, context) {
            Ok(result) => result,
            Err(UnionError::Cancelled(stop)) => return Err(stop.into()),
            Err(UnionError::Failed(why)) => return Ok(Err(VentFailure::NotSubtracted(why))),
        };
        let opened = {
            let mut opened: Vec<usize> = sites.iter().map(|site| site.void).collect();
            opened.sort_unstable();
            opened.dedup();
            opened.len()
        };
        let mistake = verify([surface, &result], &bores, opened, context)?;
        Ok(mistake.map_or(Ok(result), |mistake| Err(VentFailure::NotVerified(mistake))))
    }

    /// Drills one bore after the other, since all together failed, each at the first of its sites that passes.
    fn drill_one_by_one(
        &mut self,
        sites: &[Vec<Site>],
        voids: &[SealedVoid],
        context: &Context<'_>,
    ) -> Result<(), VentError> {
        for of_bore in sites {
            let Some(void) = of_bore.first().map(|site| site.void) else { continue };
            let is_open = |void: usize| self.vents.iter().any(|vent| vent.void == void);
            if voids[void].container.is_some_and(|around| !is_open(around)) {
                self.failed.retain(|(failed, _)| *failed != void);
                self.failed.push((void, VentFailure::ContainerSealed));
                continue;
            }
            let before = self.surface.clone();
            let mut failure = None;
            for site in of_bore.iter().take(MAX_TRIED) {
                context.check()?;
                match self.drill(&before, std::slice::from_ref(site), context)? {
                    Ok(()) => {
                        failure = None;
                        break;
                    }
                    Err(why) => failure = failure.or(Some(why)),
                }
            }
            self.failed.extend(failure.map(|why| (void, why)));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
