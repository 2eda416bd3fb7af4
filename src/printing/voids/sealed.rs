//! The sealed voids among the regions of a surface.

use glam::DVec3;

use super::regions::{OUTSIDE, Regions, RegionsError, bounds_of};
use super::widest::RegionFaces;
use crate::context::{Cancelled, Context};
use crate::math::{Box3, to_unit_range, unit_scale};
use crate::mesh::{ClosedSurface, Edges, Surface};

/// Budget of the searches for widest balls, in cubes: for one void, and for all voids together.
const CUBES_PER_VOID: usize = 2_000;
const CUBES: usize = 60_000;

/// A space of air that no way connects with the outside.
#[derive(Debug, Clone, PartialEq)]
pub struct SealedVoid {
    /// A place inside: the centre of the widest ball.
    pub at: DVec3,
    /// The volume, without the solids inside it. Exact up to the rounding of f64.
    pub volume: f64,
    /// The faces around it, of the surface: those of its wall and of the solids inside it. Ascending.
    pub faces: Vec<u32>,
    /// The bounding box.
    pub bounds: Box3,
    /// The diameter of a ball that fits, within 1 % of the widest one; 0 if none was found.
    pub widest: f64,
    /// No ball of a larger diameter fits.
    pub widest_at_most: f64,
    /// The void in which the solid with this void lies, if the solid is not itself seen from outside.
    pub container: Option<usize>,
    /// Number of solids that lie in this void.
    pub solids: usize,
    /// The number of its region in [`Regions`].
    pub region: u32,
}

/// Finds all sealed voids, largest volume first. The faces of the surface must not intersect.
///
/// # Errors
/// [`RegionsError`] as for [`Regions::new`].
pub fn sealed_voids(surface: ClosedSurface<'_>, context: &Context<'_>) -> Result<Vec<SealedVoid>, RegionsError> {
    let regions = Regions::new(surface, &Edges::new(&surface.faces), context)?;
    Ok(voids_of(&surface, &regions, context)?)
}

/// The sealed voids of a surface that is closed for certain.
#[cfg(test)]
pub fn voids_in(surface: &Surface, context: &Context<'_>) -> Vec<SealedVoid> {
    sealed_voids(ClosedSurface::try_from(surface).unwrap(), context).unwrap()
}

/// The sealed voids among the regions of a surface, largest volume first.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn voids_of(surface: &Surface, regions: &Regions, context: &Context<'_>) -> Result<Vec<SealedVoid>, Cancelled> {
    let is_void = |region: u32| region != OUTSIDE && !regions.is_material[region as usize];
    let mut solids = vec![0; regions.count()];
    for (region, &around) in regions.towards_outside.iter().enumerate() {
        solids[around as usize] += usize::from(regions.is_material[region]);
    }
    let mut voids: Vec<SealedVoid> = (0u32..)
        .zip(regions.faces())
        .filter(|(region, _)| is_void(*region))
        .map(|(region, faces)| {
            let volume = regions.volume(surface, region, &faces);
            let bounds = bounds_of(surface, &faces);
            let solids = solids[region as usize];
            let at = faces.first().map_or(DVec3::ZERO, |&f| surface.corners(f as usize).iter().sum::<DVec3>() / 3.0);
            let (widest, widest_at_most) = (0.0, f64::INFINITY);
            SealedVoid { at, volume, faces, bounds, widest, widest_at_most, container: None, solids, region }
        })
        .collect();
    voids.sort_by(|a, b| b.volume.total_cmp(&a.volume).then(a.region.cmp(&b.region)));
    let mut of_region = vec![None; regions.count()];
    voids.iter().enumerate().for_each(|(at, void)| of_region[void.region as usize] = Some(at));
    let container = |region: u32| {
        let wall = regions.towards_outside[region as usize];
        of_region[regions.towards_outside[wall as usize] as usize]
    };
    let (unit, scale) = (to_unit_range(&surface.positions), unit_scale(&surface.positions));
    let cubes = CUBES_PER_VOID.min(CUBES / voids.len().max(1));
    for void in &mut voids {
        context.check()?;
        void.container = container(void.region);
        let faces = RegionFaces::new(surface, &unit, regions, void.region, &void.faces);
        if let Some(ball) = faces.widest_ball(scale, cubes, context)? {
            (void.at, void.widest, void.widest_at_most) = (ball.centre, 2.0 * ball.radius, 2.0 * ball.radius_at_most);
        }
    }
    Ok(voids)
}
