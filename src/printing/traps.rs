//! Powder traps: hollows whose openings are all narrower than an escape hole.

use glam::DVec3;

use super::reach::{Reach, ReachOptions, Reached};
use super::voids::{OUTSIDE, RegionRays, Regions};
use crate::context::{Cancelled, Context};
use crate::math::Tree;
use crate::mesh::Surface;

/// Octree cells per diameter of the ball. A hollow is found for certain if it is wider than the ball by three cells.
const CELLS_PER_DIAMETER: u32 = 4;
/// How often cells at an opening of undecided width are halved.
const REFINEMENTS: u32 = 4;
/// How many times as many nodes an octree with cells of half the size needs at most, as a rule.
const NODES_OF_HALVED_CELLS: usize = 5;
/// How often the smaller ball that measures a trap's opening is halved, until it can leave.
const MAX_HALVINGS: u32 = 2;
/// The ratio of the upper and the lower bound of an opening's width at which the measurement ends.
const CLOSE: f64 = 1.05;
/// Most octree nodes of all smaller balls together.
const MAX_NODES_OF_SMALLER: usize = 4_000_000;

/// A hollow in which a ball of the escape hole's diameter fits, but which it can't leave. Lengths are in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PowderTrap {
    /// A place inside where the ball fits.
    pub at: DVec3,
    /// Lower bound of the volume of all positions that the ball's centre can have. The hollow is larger.
    pub centres_volume: f64,
    /// Width of the widest opening: the diameter of the largest ball that can leave, within 5 % as a rule. 0 if the opening is far
    /// narrower than the escape hole.
    pub opening: f64,
}

/// The powder traps of a model.
#[derive(Debug, Clone, PartialEq)]
pub struct PowderTraps {
    /// The traps, largest first. Sealed voids are not among them.
    pub traps: Vec<PowderTrap>,
    /// Volume of the positions of the ball's centre behind openings whose width equals the ball's, within the resolution. If above
    /// 0, the hollows there are neither traps nor shown to be open.
    pub undecided_volume: f64,
}

/// Finds the hollows that a ball of the given diameter can't leave. `None` if the octree would need more than `max_nodes` nodes.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn powder_traps(
    surface: &Surface,
    regions: &Regions,
    diameter: f64,
    max_nodes: usize,
    context: &Context<'_>,
) -> Result<Option<PowderTraps>, Cancelled> {
    let tree = Tree::new(&surface.positions, &surface.faces);
    let reach_of = |diameter: f64, halved: u32, max_nodes: usize| {
        let (cells_per_diameter, refinements) = (CELLS_PER_DIAMETER << halved, REFINEMENTS - halved);
        let options = ReachOptions { diameter, cells_per_diameter, refinements, max_nodes };
        Reach::new(&surface.positions, &surface.faces, &tree, options, context)
    };
    let Some(coarse) = reach_of(diameter, 0, max_nodes)? else { return Ok(None) };
    let affordable = NODES_OF_HALVED_CELLS * coarse.node_count() <= max_nodes;
    let fine = if affordable { reach_of(diameter, 1, max_nodes)? } else { None };
    let reach = fine.unwrap_or(coarse);
    let rays = RegionRays::new(surface, regions);
    let is_outside = |at: DVec3| rays.region_at(at * rays.scale) == Some(OUTSIDE);
    let mut traps: Vec<PowderTrap> = reach
        .hidden_regions()
        .iter()
        .filter(|region| is_outside(region.at))
        .map(|region| PowderTrap { at: region.at, centres_volume: region.volume, opening: 0.0 })
        .collect();
    let mut openings = vec![Opening { bounds: [0.0, diameter], equal: None }; traps.len()];
    let (mut left, least) = (max_nodes.min(MAX_NODES_OF_SMALLER), diameter / f64::from(1u32 << MAX_HALVINGS));
    while let Some(next) = openings.iter().filter_map(|opening| opening.next(least)).max_by(f64::total_cmp) {
        let Some(smaller) = reach_of(next, 0, left)? else { break };
        left -= smaller.node_count().min(left);
        for (opening, trap) in openings.iter_mut().zip(&traps) {
            opening.add(next, smaller.at(trap.at));
        }
    }
    traps.iter_mut().zip(openings).for_each(|(trap, opening)| trap.opening = opening.width());
    traps.sort_by(|a, b| b.centres_volume.total_cmp(&a.centres_volume));
    Ok(Some(PowderTraps { traps, undecided_volume: reach.doubtful_volume() }))
}

/// What balls of several diameters show about the widest opening of a trap.
#[derive(Debug, Clone)]
struct Opening {
    /// The largest diameter that passes, and the smallest one that does not.
    bounds: [f64; 2],
    /// A diameter that equals the opening's width, within the resolution.
    equal: Option<f64>,
}

impl Opening {
    fn add(&mut self, diameter: f64, reached: Reached) {
        let [low, high] = &mut self.bounds;
        if diameter > *low && diameter < *high {
            match reached {
                Reached::Outside => *low = diameter,
                Reached::Hidden(_) => *high = diameter,
                Reached::Doubtful | Reached::Blocked => self.equal = self.equal.or(Some(diameter)),
            }
        }
    }

    /// The diameter to try next: half of the smallest one that does not pass, until one above `least` passes; then one in the middle
    /// of the bounds. `None` once the width is known.
    fn next(&self, least: f64) -> Option<f64> {
        let [low, high] = self.bounds;
        let halved = (high > least).then_some(high / 2.0);
        let middle = (high > CLOSE * low).then_some((low * high).sqrt());
        if low == 0.0 { halved } else { middle }.filter(|_| self.equal.is_none())
    }

    fn width(&self) -> f64 {
        let [low, high] = self.bounds;
        self.equal.unwrap_or((low * high).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::printing::shapes::*;

    /// A box with a hollow of side 6 and, below, a sealed cavity. A square opening of the given width leads into the hollow.
    fn jar(width: f64) -> Surface {
        let (a, h) = (3.0, width / 2.0);
        let square = |r: f64, z: f64| [[-r, -r], [r, -r], [r, r], [-r, r]].map(|[x, y]| DVec3::new(x, y, z));
        let positions =
            [square(5.0, -12.0), square(5.0, 5.0), square(h, 5.0), square(h, 3.0), square(a, 3.0), square(a, -3.0)];
        let mut faces = vec![[0, 2, 1], [0, 3, 2], [20, 21, 22], [20, 22, 23]];
        for ring in 0..5 {
            for i in 0..4 {
                let (p, q) = (4 * ring + i, 4 * ring + (i + 1) % 4);
                faces.extend([[p, q, q + 4], [p, q + 4, p + 4]]);
            }
        }
        let sealed = inverted(cuboid(DVec3::new(-3.0, -3.0, -10.0), DVec3::new(3.0, 3.0, -5.0)));
        joined(&[surface(positions.concat(), faces), sealed])
    }

    fn traps(surface: &Surface, diameter: f64) -> PowderTraps {
        let mut found = None;
        quietly(|context| {
            let regions = Regions::of_closed(surface, context);
            found = powder_traps(surface, &regions, diameter, 1 << 22, context).unwrap();
        });
        found.unwrap()
    }

    #[test]
    fn a_jar_is_a_trap_if_its_opening_is_narrower_than_the_escape_hole() {
        let model = jar(1.2);
        assert!(volume(&model) > 0.0);
        let found = traps(&model, 2.0);
        let [trap] = found.traps[..] else { panic!("{found:?}") };
        assert!(trap.at.abs().max_element() < 2.0 + 1e-9 && found.undecided_volume == 0.0, "{found:?}");
        assert!(trap.centres_volume <= 64.0 && trap.centres_volume > 10.0);
        for width in [1.2, 0.7] {
            let opening = traps(&jar(width), 2.0).traps[0].opening;
            assert!((0.95 * width..1.05 * width).contains(&opening), "{width}: {opening}");
        }
        assert_eq!(traps(&jar(0.2), 2.0).traps[0].opening, 0.0);
        assert!(traps(&model, 0.9).traps.is_empty());
        assert!(traps(&jar(3.0), 2.0).traps.is_empty());
    }

    #[test]
    fn a_hollow_that_is_half_as_wide_again_as_the_escape_hole_is_a_trap() {
        let found = traps(&jar(2.0), 4.0);
        assert!(found.traps.len() == 1 && found.undecided_volume == 0.0, "{found:?}");
    }

    #[test]
    fn solids_and_sealed_voids_are_no_traps() {
        let hollow = joined(&[cuboid(DVec3::ZERO, DVec3::splat(9.0)), inverted(cuboid(DVec3::ONE, DVec3::splat(6.0)))]);
        assert!(traps(&hollow, 1.5).traps.is_empty());
    }
}
