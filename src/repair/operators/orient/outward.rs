//! Which patches are turned to look outward: by rays from their faces, by how deep they lie in others, and by what walls with holes
//! and edges of several faces correct of it.

use glam::DVec3;

use crate::inspect::Solid;
use crate::math::{Box3, ray_direction};
use crate::mesh::{Edges, Parts, Surface, UnionFind};
use crate::repair::operators::names::Nested;
use crate::repair::operators::ray_caster::RayCaster;
use crate::repair::{Cancelled, Context};

/// Faces that vote for a patch.
const VOTERS: usize = 16;
/// Times that the voters of a patch are asked, each time in another direction, until they agree well enough.
const ROUNDS: u32 = 4;
/// The share of the voters' area by which one side must lead before the last round.
const CLEAR: f64 = 0.25;
/// What a vote counts where both sides meet surface, so that only whether they meet an even number tells them apart.
const COVERED: f64 = 0.25;
/// Faces that all rays together may look at: this many, and as many again for each face. Enough for a soup of single
/// triangles; a fan of thousands of sheets around one axis, where each ray meets them all, runs out of it.
const BUDGET: u64 = 5_000_000;
const BUDGET_A_FACE: u64 = 8;

/// Rays that ask for each patch whether others are around it.
const AROUND_RAYS: u32 = 32;
/// Of those, so many may miss: a hole that takes up to a quarter of the view leaves a wall one. A piece of a wall sees the
/// rest of the wall in every second direction, whatever its form, since behind it is what it bounds and before it is not.
const MISSES: u32 = AROUND_RAYS / 4;

/// How a patch faces the outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Looks {
    Outward,
    Inward,
    /// As much the one as the other, as a sheet alone does, or the budget is spent.
    Untold,
}

/// The patches of a surface, to tell which of them show their back to the outside.
pub(super) struct Outside<'a> {
    pub surface: &'a Surface,
    pub patches: &'a Parts,
    /// The patches that are asked about.
    pub asked: &'a [bool],
    /// The patches that are closed.
    pub closed: &'a [bool],
    /// Twice the area of each face.
    pub areas: &'a [f64],
}

/// What the rays from one face meet.
struct Sight {
    /// Whether the face lies in an odd number of closed patches.
    within: bool,
    /// Surface that is not around it, before and behind.
    met: [usize; 2],
}

impl Outside<'_> {
    /// The faces of all patches, for the rays of all that is asked.
    pub fn rays(&self) -> RayCaster {
        let faces = &self.surface.faces;
        RayCaster::new(self.surface, faces.clone(), BUDGET + BUDGET_A_FACE * faces.len() as u64)
    }

    /// How each patch that is asked about looks.
    ///
    /// From the middle of each of its largest faces a ray goes out to the front and another to the back. Closed patches
    /// around the face count as its surroundings. Of what else is met, the side that meets nothing is outside, and where both
    /// meet something the one that meets an even number; the faces' areas are the votes. What lies in a solid has no vote
    /// unless layers are to alternate, and then the opposite one.
    pub fn looks(&self, nested: Nested, rays: &mut RayCaster, context: &Context<'_>) -> Result<Vec<Looks>, Cancelled> {
        let mut voters = self.voters(self.asked);
        let mut votes = vec![0.0; self.patches.count];
        for round in 0..ROUNDS {
            for (patch, faces) in voters.iter_mut().enumerate().filter(|(_, faces)| !faces.is_empty()) {
                if patch % 256 == 0 {
                    context.check()?;
                }
                let (mut all, mut covered) = (0.0, false);
                for &f in &*faces {
                    all += self.areas[f as usize];
                    let Some(Sight { within, met }) = self.sight(rays, f, round) else {
                        covered = true;
                        continue;
                    };
                    covered |= met != [0, 0];
                    let outward = match met {
                        [0, 0] => 0.0,
                        [0, _] => 1.0,
                        [_, 0] => -1.0,
                        [front, back] if front % 2 == back % 2 => 0.0,
                        [front, _] => COVERED * if front % 2 == 0 { 1.0 } else { -1.0 },
                    };
                    let sign = match (within, nested) {
                        (false, _) => 1.0,
                        (true, Nested::Keep) => 0.0,
                        (true, Nested::Alternate) => -1.0,
                    };
                    votes[patch] += outward * sign * self.areas[f as usize];
                }
                // Askance even hills see one another; so what sees the open on both sides is not asked again.
                if !covered || f64::abs(votes[patch]) >= CLEAR * all {
                    faces.clear();
                }
            }
            if rays.is_spent() {
                break;
            }
        }
        let looks = |vote: f64| match vote {
            vote if vote > 0.0 => Looks::Outward,
            vote if vote < 0.0 => Looks::Inward,
            _ => Looks::Untold,
        };
        Ok(votes.into_iter().map(looks).collect())
    }

    /// The largest faces of each patch that is asked about; of equal ones some from all over it.
    pub fn voters(&self, asked: &[bool]) -> Vec<Vec<u32>> {
        let scattered = |f: u32| f.wrapping_mul(0x9e37_79b9).reverse_bits();
        let by_area = |x: &u32, y: &u32| {
            let size = |f: &u32| self.areas[*f as usize];
            size(y).total_cmp(&size(x)).then(scattered(*x).cmp(&scattered(*y)))
        };
        let mut lists = self.patches.faces();
        for (faces, asked) in lists.iter_mut().zip(asked) {
            if !asked {
                faces.clear();
            } else if faces.len() > VOTERS {
                faces.select_nth_unstable_by(VOTERS, by_area);
                faces.truncate(VOTERS);
            }
            faces.sort_unstable_by(by_area);
        }
        lists
    }

    /// What a face sees, in the first round along its normal; none where that can't be told.
    fn sight(&self, rays: &mut RayCaster, f: u32, round: u32) -> Option<Sight> {
        let [a, b, c] = self.surface.faces[f as usize].map(|v| rays.unit[v as usize]);
        // The smallest cross product of numbers around 1 may underflow; such a face has no say.
        let normal = (b - a).cross(c - a).try_normalize()?;
        let from = (a + b + c) / 3.0;
        let aside = if round == 0 { DVec3::ZERO } else { ray_direction(round) * 0.9 };
        let direction = (normal + aside).normalize();
        let of_face = &self.patches.of_face;
        let own = of_face[f as usize];
        let mut look = |direction: DVec3| {
            let mut met = Vec::new();
            let clear = rays.each_crossing(from, from + direction * 8.0, Some(f), |g| met.push(of_face[g as usize]));
            met.sort_unstable();
            clear.then_some(met)
        };
        let [front, back] = [look(direction)?, look(-direction)?];
        // A face is in a closed patch where a ray to either side meets that an odd number of times; so both tell it.
        let around = |part: &u32| *part != own && *part != Parts::NONE && self.closed[*part as usize];
        let containers: Vec<u32> =
            front.chunk_by(|x, y| x == y).filter(|c| c.len() % 2 == 1 && around(&c[0])).map(|c| c[0]).collect();
        let met = [front, back].map(|met| {
            let mut beyond = met.len();
            for of_part in met.chunk_by(|x, y| x == y).filter(|c| containers.binary_search(&c[0]).is_ok()) {
                beyond -= of_part.len();
            }
            beyond
        });
        Some(Sight { within: containers.len() % 2 == 1, met })
    }
}

/// The parts of a surface, and for each the closed ones that it lies in, where that can be told.
#[derive(Clone, Copy)]
pub(super) struct Nest<'a> {
    pub solids: &'a [Solid],
    pub containers: &'a [Option<Vec<u32>>],
}

/// What is made of closed parts, by how deep they lie in others.
#[derive(Debug, Default)]
pub(super) struct Layers {
    /// Whether to turn each part.
    pub turn: Vec<bool>,
    /// Parts at odd depth that look inward, and did.
    pub cavities_kept: u64,
    /// Parts at odd depth that look outward: solids that overlap the one around them.
    pub solids_inside_solids: u64,
}

impl Layers {
    /// Decides by the sign of each part's volume and by the parts that it lies in.
    ///
    /// At even depth a part is turned to positive volume. At odd depth it is a cavity where it looks inward. Where the part
    /// around it was turned and it looked the other way than that one, it was a cavity of a solid that was inside out as a
    /// whole, so it is turned too.
    pub fn new(nest: Nest<'_>, nested: Nested) -> Self {
        let Nest { solids, containers } = nest;
        let mut layers = Self { turn: vec![false; solids.len()], ..Self::default() };
        let depth = |part: usize| containers[part].as_ref().map(Vec::len);
        let mut order: Vec<(usize, usize)> = (0..solids.len()).filter_map(|p| Some((depth(p)?, p))).collect();
        order.sort_unstable();
        for (level, part) in order {
            let inward = solids[part].volume < 0.0;
            if level % 2 == 0 {
                layers.turn[part] = inward;
                continue;
            }
            let around = containers[part].iter().flatten().find(|&&c| depth(c as usize) == Some(level - 1));
            let was_cavity = around.is_some_and(|&c| layers.turn[c as usize]);
            layers.turn[part] = !inward && (was_cavity || nested == Nested::Alternate);
            if !layers.turn[part] {
                *(if inward { &mut layers.cavities_kept } else { &mut layers.solids_inside_solids }) += 1;
            }
        }
        layers
    }

    /// Decides anew on parts in closed ones that are themselves `surrounded` by walls with holes, so that all that is in
    /// them lies one layer deeper than closed parts alone tell.
    fn correct_within(&mut self, surrounded: &[bool], nest: Nest<'_>) {
        let Nest { solids, containers } = nest;
        let depth = |part: usize| containers[part].as_ref().map_or(0, Vec::len);
        let deeper = |part: usize| containers[part].iter().flatten().any(|&c| surrounded[c as usize]);
        let mut order: Vec<(usize, usize)> = (0..solids.len()).filter(|&p| deeper(p)).map(|p| (depth(p), p)).collect();
        order.sort_unstable();
        for (depth_here, part) in order {
            let inward = solids[part].volume < 0.0;
            let around = containers[part].iter().flatten().find(|&&c| depth(c as usize) + 1 == depth_here);
            let was_cavity = around.is_some_and(|&c| self.turn[c as usize]);
            self.turn[part] = if depth_here % 2 == 1 { inward } else { !inward && was_cavity };
        }
    }
}

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
    rays: &mut RayCaster,
    nest: Nest<'_>,
    layers: &mut Layers,
    context: &Context<'_>,
) -> Result<(), Cancelled> {
    let Nest { solids, containers } = nest;
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
            if let Some(met) = around(outside, rays, &voters[patch]) {
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
    layers.correct_within(&surrounded, nest);
    Ok(())
}

/// The other patches that rays from `voters`, all of one patch, show to be around it, if nearly all do.
fn around(outside: &Outside<'_>, rays: &mut RayCaster, voters: &[u32]) -> Option<Vec<u32>> {
    let of_face = &outside.patches.of_face;
    let (mut met, mut missed) = (Vec::new(), 0);
    for (ray, &f) in (0..AROUND_RAYS).zip(voters.iter().cycle()) {
        let from = rays.centroid(outside.surface.faces[f as usize]);
        let mut odd = false;
        let mut here = Vec::new();
        let clear = rays.each_crossing(from, from + ray_direction(ray) * 8.0, Some(f), |g| {
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

/// Keeps the winding of open patches that meet in edges of several faces, where those were crossed as often one way as the
/// other and the patches together look outward. Solids that touch or overlap in common edges fall into patches there, of which
/// each may lie within another solid and so seem to look inward; but as they were they wound around their solids. Where
/// the edges were not all crossed so, what leaves more of them uneven is taken back.
pub(super) fn keep_what_was_balanced(
    surface: &Surface,
    edges: &Edges,
    patches: &Parts,
    solids: &[Solid],
    layers: &mut Layers,
) {
    let of_half_edge = |h: u32| patches.of_face[h as usize / 3];
    let several = || edges.iter().filter(|half_edges| half_edges.len() > 2);
    let mut groups = UnionFind::new(patches.count);
    for half_edges in several() {
        let mut at = half_edges.iter().map(|&h| of_half_edge(h)).filter(|&p| p != Parts::NONE);
        if let Some(first) = at.next() {
            at.for_each(|patch| groups.unite(first, patch));
        }
    }
    let group = groups.into_roots();
    // Of each group, how many edges are uneven as they were and after turning, ...
    let mut uneven = vec![[0u64; 2]; patches.count];
    for half_edges in several() {
        let Some(patch) = half_edges.iter().map(|&h| of_half_edge(h)).find(|&p| p != Parts::NONE) else { continue };
        for (turning, uneven) in uneven[group[patch as usize] as usize].iter_mut().enumerate() {
            let turned =
                |h: u32| turning == 1 && of_half_edge(h) != Parts::NONE && layers.turn[of_half_edge(h) as usize];
            let forward = half_edges.iter().filter(|&&h| Edges::is_forward(&surface.faces, h) != turned(h)).count();
            *uneven += u64::from(2 * forward != half_edges.len());
        }
    }
    // ... and what it encloses as it was.
    let mut volume = vec![0.0; patches.count];
    let about = surface.bounds().centre();
    for (f, &patch) in patches.of_face.iter().enumerate().filter(|&(_, &patch)| patch != Parts::NONE) {
        let [a, b, c] = surface.corners(f).map(|p| p - about);
        volume[group[patch as usize] as usize] += a.dot(b.cross(c)) / 6.0;
    }
    let mut shared = vec![0u32; patches.count];
    group.iter().for_each(|&g| shared[g as usize] += 1);
    for patch in (0..patches.count).filter(|&patch| !solids[patch].closed) {
        let group = group[patch] as usize;
        let [before, after] = uneven[group];
        let solid = shared[group] > 1 && before == 0 && volume[group] > 0.0;
        layers.turn[patch] &= !solid && after <= before;
    }
}
