use super::Layers;
use super::outside::Outside;
use crate::inspect::Solid;
use crate::math::{Box3, ray_direction};
use crate::mesh::Parts;
use crate::repair::operators::walls::Walls;
use crate::repair::{Cancelled, Context};

/// Rays that ask for each patch whether others are around it.
const RAYS: u32 = 32;
/// Of those, so many may miss: a hole that takes up to a quarter of the view leaves a wall one. A piece of a wall sees the
/// rest of the wall in every second direction, whatever its form, since behind it is what it bounds and before it is not.
const MISSES: u32 = RAYS / 4;

/// The surface around a patch, where there is any.
struct Around {
    patch: usize,
    /// The patches around it, as often as a ray went through one.
    met: Vec<u32>,
}

/// Corrects which patches are turned by the walls that lie around them and need not be closed, so that a hole in the wall of
/// a solid makes no solid of its cavity.
///
/// A patch is surrounded where nearly all rays from it go through an odd number of other faces, whatever patches these are of.
/// What is surrounded keeps its winding, unless the faces around it, in so far as they are not surrounded themselves, were
/// turned by most rays: then it was a cavity of what was inside out as a whole, and is turned with it.
pub(super) fn keep_what_is_surrounded(
    outside: &Outside<'_>,
    walls: &mut Walls,
    solids: &[Solid],
    containers: &[Option<Vec<u32>>],
    layers: &mut Layers,
    context: &Context<'_>,
) -> Result<(), Cancelled> {
    let voters = outside.voters(&vec![true; solids.len()]);
    let mut surrounded = vec![false; solids.len()];
    let mut found = Vec::new();
    // Only what would be turned wrongly is asked for, and what should have been turned with the walls around it.
    for pass in [true, false] {
        let mut bounds = Bounds::default();
        for (patch, solid) in solids.iter().enumerate().filter(|(patch, _)| pass || layers.turn[*patch]) {
            bounds.add(patch, &solid.bounds);
        }
        for patch in 0..solids.len() {
            let asked = if pass { layers.turn[patch] } else { !layers.turn[patch] && solids[patch].volume > 0.0 };
            // What lies in closed patches goes with the outermost of them.
            let inner = containers[patch].as_ref().is_some_and(|c| !c.is_empty());
            if !asked || inner || surrounded[patch] || !bounds.hold(patch, &solids[patch].bounds) {
                continue;
            }
            if patch % 256 == 0 {
                context.check()?;
            }
            if let Some(met) = around(outside, walls, &voters[patch]) {
                surrounded[patch] = true;
                found.push(Around { patch, met });
            }
        }
        if pass {
            for it in &found {
                layers.turn[it.patch] = false;
            }
        }
    }
    let met_turned = |met: &[u32]| {
        let patches = met.iter().filter(|&&p| p != Parts::NONE);
        let outer: Vec<usize> = patches.map(|&p| p as usize).filter(|&p| !surrounded[p]).collect();
        2 * outer.iter().filter(|&&p| layers.turn[p]).count() > outer.len()
    };
    let with_walls: Vec<usize> =
        found.iter().filter(|it| solids[it.patch].volume > 0.0 && met_turned(&it.met)).map(|it| it.patch).collect();
    for patch in with_walls {
        layers.turn[patch] = true;
    }
    layers.correct_within(&surrounded, solids, containers);
    Ok(())
}

/// The other patches that rays from `voters`, all of one patch, show to be around it, if nearly all do.
fn around(outside: &Outside<'_>, walls: &mut Walls, voters: &[u32]) -> Option<Vec<u32>> {
    let of_face = &outside.patches.of_face;
    let (mut met, mut missed) = (Vec::new(), 0);
    for (ray, &f) in (0..RAYS).zip(voters.iter().cycle()) {
        let from = walls.middle(outside.surface.faces[f as usize]);
        let mut odd = false;
        let mut here = Vec::new();
        let clear = walls.each_crossing(from, from + ray_direction(ray) * 8.0, Some(f), |g| {
            if of_face[g as usize] != of_face[f as usize] {
                odd = !odd;
                here.push(of_face[g as usize]);
            }
        });
        if !clear || !odd {
            missed += 1;
            if missed > MISSES {
                return None;
            }
            continue;
        }
        // What a ray goes in and out of is beside the patch and not around it.
        here.sort_unstable();
        met.extend(here.chunk_by(|x, y| x == y).filter(|c| c.len() % 2 == 1).map(|c| c[0]));
    }
    (!met.is_empty()).then_some(met)
}

/// The box around some patches, but for any one of them.
struct Bounds {
    /// For each of the six sides the patch that reaches farthest, how far, and how far the others do.
    sides: [(usize, f64, f64); 6],
}

impl Default for Bounds {
    fn default() -> Self {
        Self { sides: [(usize::MAX, f64::NEG_INFINITY, f64::NEG_INFINITY); 6] }
    }
}

impl Bounds {
    fn reach(of: &Box3) -> [f64; 6] {
        let (low, high) = (-of.min, of.max);
        [low.x, low.y, low.z, high.x, high.y, high.z]
    }

    fn add(&mut self, patch: usize, bounds: &Box3) {
        for (side, far) in self.sides.iter_mut().zip(Self::reach(bounds)) {
            if far > side.1 {
                *side = (patch, far, side.1);
            } else if far > side.2 {
                side.2 = far;
            }
        }
    }

    /// Whether the box around all others holds that of a patch.
    fn hold(&self, patch: usize, bounds: &Box3) -> bool {
        self.sides
            .iter()
            .zip(Self::reach(bounds))
            .all(|(&(farthest, far, next), reach)| reach <= if farthest == patch { next } else { far })
    }
}
