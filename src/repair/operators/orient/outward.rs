//! Decides which patches are flipped to face outward: by rays from their faces and by their depth in other parts.
//!
//! Two corrections follow: patches inside a solid with holes keep their winding, and so do patches whose non-manifold edges
//! were balanced.

use glam::DVec3;

use crate::inspect::{Analysis, Solid};
use crate::math::{Box3, ray_direction};
use crate::mesh::{Edges, Parts, Surface, UnionFind};
use crate::repair::operators::ray_caster::RayCaster;
use crate::repair::options::Nested;
use crate::repair::{Cancelled, Context};

/// The number of faces that vote for a patch.
const VOTERS: usize = 16;
/// The most rounds of voting, each in another direction, until the voters of a patch agree well enough.
const ROUNDS: u32 = 4;
/// The share of the voters' area by which one side must lead to end the voting early.
const CLEAR_LEAD: f64 = 0.25;
/// The weight of a vote where rays hit surface on both sides, so that only the parity of the hits tells the sides apart.
const PARITY_VOTE: f64 = 0.25;
/// The most faces that all rays together may test: a constant plus a number for each face. It suffices for a soup of single
/// triangles. A fan of thousands of sheets around one axis exceeds it, since each ray hits them all.
const BUDGET: u64 = 5_000_000;
const BUDGET_PER_FACE: u64 = 8;

/// The rays from each patch that test whether other patches surround it.
const SURROUND_RAYS: u32 = 32;
/// The most of these rays that may escape: a wall with a hole over up to a quarter of the view still surrounds. From a piece
/// of a wall itself every second ray escapes, whatever the wall's form.
const MAX_MISSES: u32 = SURROUND_RAYS / 4;

/// The direction in which a patch's front faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Facing {
    /// The outside is in front.
    Outward,
    /// The outside is behind.
    Inward,
    /// Both sides are equal, as for a single sheet, or the budget is spent.
    Undecided,
}

/// The patches of a surface, with what is needed to decide which of them face outward.
pub(super) struct PatchFacing<'a> {
    /// The surface.
    pub surface: &'a Surface,
    /// The patches of the surface.
    pub patches: &'a Parts,
    /// For each patch whether its facing is wanted.
    pub selected: &'a [bool],
    /// For each patch whether it is closed.
    pub closed: &'a [bool],
    /// Twice the area of each face.
    pub areas: &'a [f64],
    /// A mesh that may have the same triangles.
    pub known: Option<&'a Analysis<'a>>,
}

/// The hits of the two rays from one face.
struct RayHits {
    /// Whether the face lies in an odd number of closed patches.
    is_inside: bool,
    /// The number of hits on surface that is not around the face, in front and behind.
    hits: [usize; 2],
}

impl<'a> PatchFacing<'a> {
    /// Prepares ray queries against the faces of all patches.
    pub fn rays(&self) -> RayCaster<'a> {
        let budget = BUDGET + BUDGET_PER_FACE * self.surface.faces.len() as u64;
        RayCaster::of_whole(self.surface, self.known, budget)
    }

    /// The facing of each selected patch, by vote.
    ///
    /// From the centroid of each of a patch's largest faces one ray goes to the front and one to the back. Closed patches
    /// around the face do not count. The side without hits is outside; if both sides have hits, the side with an even number
    /// is outside. Votes are weighted by area. A face inside a solid has no vote, unless layers alternate; then its vote is
    /// inverted.
    pub fn facings(
        &self,
        nested: Nested,
        rays: &mut RayCaster<'_>,
        context: &Context<'_>,
    ) -> Result<Vec<Facing>, Cancelled> {
        let mut voters = self.voters(self.selected);
        let mut votes = vec![0.0; self.patches.count];
        for round in 0..ROUNDS {
            for (patch, faces) in voters.iter_mut().enumerate().filter(|(_, faces)| !faces.is_empty()) {
                if patch % 256 == 0 {
                    context.check()?;
                }
                let (mut all, mut covered) = (0.0, false);
                for &f in &*faces {
                    all += self.areas[f as usize];
                    let Some(RayHits { is_inside, hits }) = self.cast_rays(rays, f, round) else {
                        covered = true;
                        continue;
                    };
                    covered |= hits != [0, 0];
                    let outward = match hits {
                        [0, 0] => 0.0,
                        [0, _] => 1.0,
                        [_, 0] => -1.0,
                        [front, back] if front % 2 == back % 2 => 0.0,
                        [front, _] => PARITY_VOTE * if front % 2 == 0 { 1.0 } else { -1.0 },
                    };
                    let sign = match (is_inside, nested) {
                        (false, _) => 1.0,
                        (true, Nested::Keep) => 0.0,
                        (true, Nested::Alternate) => -1.0,
                    };
                    votes[patch] += outward * sign * self.areas[f as usize];
                }
                // Oblique rays hit even low hills, so faces with a free view on both sides do not vote again.
                if !covered || f64::abs(votes[patch]) >= CLEAR_LEAD * all {
                    faces.clear();
                }
            }
            if rays.is_spent() {
                break;
            }
        }
        let facing = |vote: f64| match vote {
            vote if vote > 0.0 => Facing::Outward,
            vote if vote < 0.0 => Facing::Inward,
            _ => Facing::Undecided,
        };
        Ok(votes.into_iter().map(facing).collect())
    }

    /// The largest faces of each selected patch; faces of equal area are taken from all over the patch.
    pub fn voters(&self, selected: &[bool]) -> Vec<Vec<u32>> {
        let scattered = |f: u32| f.wrapping_mul(0x9e37_79b9).reverse_bits();
        let by_area = |x: &u32, y: &u32| {
            let size = |f: &u32| self.areas[*f as usize];
            size(y).total_cmp(&size(x)).then(scattered(*x).cmp(&scattered(*y)))
        };
        let mut lists = self.patches.faces();
        for (faces, selected) in lists.iter_mut().zip(selected) {
            if !selected {
                faces.clear();
            } else if faces.len() > VOTERS {
                faces.select_nth_unstable_by(VOTERS, by_area);
                faces.truncate(VOTERS);
            }
            faces.sort_unstable_by(by_area);
        }
        lists
    }

    /// The ray hits of a face, in the first round along its normal; `None` where a ray gives no answer.
    fn cast_rays(&self, rays: &mut RayCaster<'_>, f: u32, round: u32) -> Option<RayHits> {
        let [a, b, c] = self.surface.faces[f as usize].map(|v| rays.unit[v as usize]);
        // The smallest cross product of numbers around 1 may underflow; such a face has no vote.
        let normal = (b - a).cross(c - a).try_normalize()?;
        let from = (a + b + c) / 3.0;
        let tilt = if round == 0 { DVec3::ZERO } else { ray_direction(round) * 0.9 };
        let direction = (normal + tilt).normalize();
        let of_face = &self.patches.of_face;
        let own = of_face[f as usize];
        let mut cast = |direction: DVec3| {
            let mut hits = Vec::new();
            let clear = rays.each_crossing(from, from + direction * 8.0, Some(f), |g| hits.push(of_face[g as usize]));
            hits.sort_unstable();
            clear.then_some(hits)
        };
        let [front, back] = [cast(direction)?, cast(-direction)?];
        // A face is inside a closed patch where each ray crosses the patch an odd number of times; either ray would do.
        let around = |part: &u32| *part != own && *part != Parts::NONE && self.closed[*part as usize];
        let containers: Vec<u32> =
            front.chunk_by(|x, y| x == y).filter(|c| c.len() % 2 == 1 && around(&c[0])).map(|c| c[0]).collect();
        let hits = [front, back].map(|hits| {
            let mut beyond = hits.len();
            for of_part in hits.chunk_by(|x, y| x == y).filter(|c| containers.binary_search(&c[0]).is_ok()) {
                beyond -= of_part.len();
            }
            beyond
        });
        Some(RayHits { is_inside: containers.len() % 2 == 1, hits })
    }
}

/// Parts with the closed parts that contain each; `None` where containment is undecided.
#[derive(Clone, Copy)]
pub(super) struct Nesting<'a> {
    /// The parts.
    pub solids: &'a [Solid],
    /// For each part the closed parts that contain it.
    pub containers: &'a [Option<Vec<u32>>],
}

/// Which parts to flip, decided by their depth in closed parts.
#[derive(Debug, Default)]
pub(super) struct Layers {
    /// For each part whether to flip it.
    pub flip: Vec<bool>,
    /// The number of parts at odd depth that face inward and stay.
    pub cavities_kept: u64,
    /// The number of parts at odd depth that face outward: solids that overlap the solid around them.
    pub solids_inside_solids: u64,
}

impl Layers {
    /// Decides by the sign of each part's volume and by the parts that contain it.
    ///
    /// At even depth a part is flipped to positive volume. At odd depth an inward part is a cavity. An outward part
    /// inside a part that was flipped was the cavity of an inverted solid, so it is flipped too.
    pub fn new(nesting: Nesting<'_>, nested: Nested) -> Self {
        let Nesting { solids, containers } = nesting;
        let mut layers = Self { flip: vec![false; solids.len()], ..Self::default() };
        let depth = |part: usize| containers[part].as_ref().map(Vec::len);
        let mut order: Vec<(usize, usize)> = (0..solids.len()).filter_map(|p| Some((depth(p)?, p))).collect();
        order.sort_unstable();
        for (level, part) in order {
            let inward = solids[part].volume < 0.0;
            if level % 2 == 0 {
                layers.flip[part] = inward;
                continue;
            }
            let around = containers[part].iter().flatten().find(|&&c| depth(c as usize) == Some(level - 1));
            let was_cavity = around.is_some_and(|&c| layers.flip[c as usize]);
            layers.flip[part] = !inward && (was_cavity || nested == Nested::Alternate);
            if !layers.flip[part] {
                *(if inward { &mut layers.cavities_kept } else { &mut layers.solids_inside_solids }) += 1;
            }
        }
        layers
    }

    /// Decides again on parts inside closed parts that are `surrounded` by walls with holes. Such parts lie one layer
    /// deeper than closed parts alone suggest.
    fn correct_nested(&mut self, surrounded: &[bool], nesting: Nesting<'_>) {
        let Nesting { solids, containers } = nesting;
        let depth = |part: usize| containers[part].as_ref().map_or(0, Vec::len);
        let deeper = |part: usize| containers[part].iter().flatten().any(|&c| surrounded[c as usize]);
        let mut order: Vec<(usize, usize)> = (0..solids.len()).filter(|&p| deeper(p)).map(|p| (depth(p), p)).collect();
        order.sort_unstable();
        for (depth_here, part) in order {
            let inward = solids[part].volume < 0.0;
            let around = containers[part].iter().flatten().find(|&&c| depth(c as usize) + 1 == depth_here);
            let was_cavity = around.is_some_and(|&c| self.flip[c as usize]);
            self.flip[part] = if depth_here % 2 == 1 { inward } else { !inward && was_cavity };
        }
    }
}

/// A patch with the patches that surround it.
struct Surrounding {
    patch: usize,
    /// The surrounding patches, once for each ray that crossed one.
    hits: Vec<u32>,
}

/// Corrects the flips of patches that are surrounded by walls, even if the walls are not closed. So a hole in the wall of a
/// solid does not turn its cavity into a solid.
///
/// A patch is surrounded where nearly all rays from it cross an odd number of faces of other patches. A surrounded patch keeps its
/// winding. Exception: if most rays hit outer patches that are flipped, the patch was a cavity of an inverted solid and flips too.
pub(super) fn keep_surrounded_patches(
    facing: &PatchFacing<'_>,
    rays: &mut RayCaster<'_>,
    nesting: Nesting<'_>,
    layers: &mut Layers,
    context: &Context<'_>,
) -> Result<(), Cancelled> {
    let Nesting { solids, containers } = nesting;
    let voters = facing.voters(&vec![true; solids.len()]);
    let mut surrounded = vec![false; solids.len()];
    let mut surroundings = Vec::new();
    // The first pass tests patches that would be flipped, the second those that may have to flip with the walls around them.
    for pass in [true, false] {
        let mut bounds = BoundsExceptOne::default();
        for (patch, solid) in solids.iter().enumerate().filter(|(patch, _)| pass || layers.flip[*patch]) {
            bounds.add(patch, &solid.bounds);
        }
        for patch in 0..solids.len() {
            let selected = if pass { layers.flip[patch] } else { !layers.flip[patch] && solids[patch].volume > 0.0 };
            // A part inside closed patches follows the outermost of them.
            let inner = containers[patch].as_ref().is_some_and(|c| !c.is_empty());
            if !selected || inner || surrounded[patch] || !bounds.contains(patch, &solids[patch].bounds) {
                continue;
            }
            if patch % 256 == 0 {
                context.check()?;
            }
            if let Some(hits) = surrounding_patches(facing, rays, &voters[patch]) {
                surrounded[patch] = true;
                surroundings.push(Surrounding { patch, hits });
            }
        }
        if pass {
            for surrounding in &surroundings {
                layers.flip[surrounding.patch] = false;
            }
        }
    }
    let hits_flipped = |hits: &[u32]| {
        let patches = hits.iter().filter(|&&p| p != Parts::NONE);
        let outer: Vec<usize> = patches.map(|&p| p as usize).filter(|&p| !surrounded[p]).collect();
        2 * outer.iter().filter(|&&p| layers.flip[p]).count() > outer.len()
    };
    let with_walls: Vec<usize> = surroundings
        .iter()
        .filter(|s| solids[s.patch].volume > 0.0 && hits_flipped(&s.hits))
        .map(|s| s.patch)
        .collect();
    for patch in with_walls {
        layers.flip[patch] = true;
    }
    layers.correct_nested(&surrounded, nesting);
    Ok(())
}

/// The other patches that surround a patch, by rays from its `voters`; `None` unless nearly all rays cross some.
fn surrounding_patches(facing: &PatchFacing<'_>, rays: &mut RayCaster<'_>, voters: &[u32]) -> Option<Vec<u32>> {
    let of_face = &facing.patches.of_face;
    let (mut hits, mut missed) = (Vec::new(), 0);
    for (ray, &f) in (0..SURROUND_RAYS).zip(voters.iter().cycle()) {
        let from = rays.centroid(facing.surface.faces[f as usize]);
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
            if missed > MAX_MISSES {
                return None;
            }
            continue;
        }
        // A patch that the ray enters and leaves is beside the voter's patch and not around it.
        here.sort_unstable();
        hits.extend(here.chunk_by(|x, y| x == y).filter(|c| c.len() % 2 == 1).map(|c| c[0]));
    }
    (!hits.is_empty()).then_some(hits)
}

/// The bounding box of some patches, with the box without any one of them.
struct BoundsExceptOne {
    /// For each of the six sides the patch that extends farthest, its extent, and the largest extent of the others.
    sides: [(usize, f64, f64); 6],
}

impl Default for BoundsExceptOne {
    fn default() -> Self {
        Self { sides: [(usize::MAX, f64::NEG_INFINITY, f64::NEG_INFINITY); 6] }
    }
}

impl BoundsExceptOne {
    /// The extent of a box on each of the six sides.
    fn reach(of: &Box3) -> [f64; 6] {
        let (low, high) = (-of.min, of.max);
        [low.x, low.y, low.z, high.x, high.y, high.z]
    }

    /// Adds the box of a patch.
    fn add(&mut self, patch: usize, bounds: &Box3) {
        for (side, far) in self.sides.iter_mut().zip(Self::reach(bounds)) {
            if far > side.1 {
                *side = (patch, far, side.1);
            } else if far > side.2 {
                side.2 = far;
            }
        }
    }

    /// Whether the box of all other patches contains the box of `patch`.
    fn contains(&self, patch: usize, bounds: &Box3) -> bool {
        self.sides
            .iter()
            .zip(Self::reach(bounds))
            .all(|(&(farthest, far, next), reach)| reach <= if farthest == patch { next } else { far })
    }
}

/// Keeps the winding of open patches that meet in balanced non-manifold edges and together face outward. An edge is balanced
/// where its faces traverse it equally often in both directions.
///
/// Solids that touch or overlap in common edges fall into patches there. Each patch may lie inside another solid and then
/// seems to face inward, although it is wound correctly around its own solid. In groups with unbalanced edges, flips that
/// unbalance more edges are undone.
pub(super) fn keep_balanced_patches(
    surface: &Surface,
    edges: &Edges,
    patches: &Parts,
    solids: &[Solid],
    layers: &mut Layers,
) {
    let of_half_edge = |h: u32| patches.of_face[h as usize / 3];
    let non_manifold_edges = || edges.iter().filter(|half_edges| half_edges.len() > 2);
    let mut groups = UnionFind::new(patches.count);
    for half_edges in non_manifold_edges() {
        let mut at = half_edges.iter().map(|&h| of_half_edge(h)).filter(|&p| p != Parts::NONE);
        if let Some(first) = at.next() {
            at.for_each(|patch| groups.unite(first, patch));
        }
    }
    let group = groups.into_roots();
    // For each group the number of unbalanced edges before and after the flips.
    let mut unbalanced = vec![[0u64; 2]; patches.count];
    for half_edges in non_manifold_edges() {
        let Some(patch) = half_edges.iter().map(|&h| of_half_edge(h)).find(|&p| p != Parts::NONE) else { continue };
        for (after_flip, unbalanced) in unbalanced[group[patch as usize] as usize].iter_mut().enumerate() {
            let flipped =
                |h: u32| after_flip == 1 && of_half_edge(h) != Parts::NONE && layers.flip[of_half_edge(h) as usize];
            let forward = half_edges.iter().filter(|&&h| Edges::is_forward(&surface.faces, h) != flipped(h)).count();
            *unbalanced += u64::from(2 * forward != half_edges.len());
        }
    }
    // The volume that each group encloses before the flips.
    let mut volume = vec![0.0; patches.count];
    let centre = surface.bounds().centre();
    for (f, &patch) in patches.of_face.iter().enumerate().filter(|&(_, &patch)| patch != Parts::NONE) {
        let [a, b, c] = surface.corners(f).map(|p| p - centre);
        volume[group[patch as usize] as usize] += a.dot(b.cross(c)) / 6.0;
    }
    let mut shared = vec![0u32; patches.count];
    group.iter().for_each(|&g| shared[g as usize] += 1);
    for patch in (0..patches.count).filter(|&patch| !solids[patch].closed) {
        let group = group[patch] as usize;
        let [before, after] = unbalanced[group];
        let is_solid = shared[group] > 1 && before == 0 && volume[group] > 0.0;
        layers.flip[patch] &= !is_solid && after <= before;
    }
}
