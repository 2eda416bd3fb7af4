//! Removes defective regions and fills the holes they leave.
//!
//! This file runs the rounds and judges the patches; `regions.rs` finds the defects and the regions to remove.

mod regions;

use glam::DVec3;

use crate::math::{Box3, Tree};
use crate::mesh::{Edges, Parts, Surface, UnionFind};
use crate::repair::operators::holes::FillHoles;
use crate::repair::operators::operator::{Applied, Counter, Counts, Operation, Scope};
use crate::repair::{Cancelled, Change, ChangeKind, Context};
use regions::{Defects, NEW, NONE, PatchedSurface, Regions, RemovalLimits};

/// The rings of faces around a defect that are removed with it: none at first, then one more after each pair of rounds.
const RINGS: std::ops::RangeInclusive<u32> = 0..=3;
/// The most rounds with the same number of rings, while they improve the surface.
const ROUNDS_PER_RING: u32 = 2;

/// The largest distance between a patch and the surface that it replaces, as a share of the part's diagonal.
const MAX_DEVIATION_SHARE: f64 = 0.05;
/// How often the patches of a round are evaluated again after some regions were restored, which may intersect others.
const MAX_EVALUATIONS: usize = 4;

/// The most boxes and triangles that one search for a nearest point may visit.
const SEARCH_BUDGET: u64 = 100_000;

/// Removes defective regions and fills the holes they leave.
#[derive(Debug, Clone, Copy)]
pub struct CleanAndPatch {
    /// The most edges around a hole that is filled.
    pub max_hole_edges: u32,
    /// The largest extent of a hole that is filled, as a share of the bounding box's diagonal.
    pub max_hole_size: f64,
    /// The largest share of a part's faces that may be removed in all, in percent.
    pub max_face_loss_pct: f64,
    /// The largest share of a part's faces and area that one region may have, in percent; 20 by default.
    pub max_region_pct: f64,
    /// The largest distance between a patch and the surface that it replaces, in the model's unit. A twentieth of the part's
    /// diagonal is the limit in any case.
    pub max_deviation: f64,
}

impl Default for CleanAndPatch {
    fn default() -> Self {
        Self {
            max_hole_edges: 1_000_000,
            max_hole_size: 1.0,
            max_face_loss_pct: 40.0,
            max_region_pct: 20.0,
            max_deviation: f64::INFINITY,
        }
    }
}

/// The sums over all rounds.
#[derive(Debug, Default)]
struct Totals {
    regions: u64,
    removed: u64,
    moved: f64,
}

impl CleanAndPatch {
    /// Removes defects with growing rings of faces around them and fills the holes, while the surface improves.
    ///
    /// Defects are faces at boundary or non-manifold edges, and faces that intersect others of their part. Defects that share a
    /// vertex or intersect form one region. A patch is kept under three conditions. The region then has fewer boundary and
    /// non-manifold edges and intersecting pairs, counted exactly; no new boundary edge appears; and the patch is close to the
    /// surface that it replaces. Otherwise the region is restored and tried again with one more ring.
    ///
    /// ```text
    ///    _____________        _____________        _____________
    ///   |   _/\/X_    |      |   ______    |      |   __ ___    |
    ///   |  |_X\/\_|   |  ->  |  |      |   |  ->  |  |  /   |   |
    ///   |_____________|      |__|______|___|      |__|_/____|___|
    /// ```
    ///
    /// Precondition: consistent winding, and sheets split by index. Result: faces outside the regions are unchanged; no
    /// vertex moves; no part disappears or falls apart. Leaves: regions that no patch improves, that exceed the limits, or
    /// that hold a part together; intersections between parts; every defect where the intersections are too many to count.
    ///
    /// After *Clean and Patch* of Mesh Heal.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let mut defects = Defects::of(surface, context)?;
        let first = defects.total();
        if first == 0 {
            return Ok(Applied::default());
        }
        if !defects.complete {
            let reason = "too many faces intersect to count them; nothing was removed";
            return Ok(Applied { left: Some(reason.to_owned()), ..Applied::default() });
        }
        let mut patched = PatchedSurface::new(surface);
        let mut totals = Totals::default();
        let (mut too_large, mut restored) = (0, 0);
        'rings: for rings in RINGS {
            for _ in 0..ROUNDS_PER_RING {
                context.check()?;
                let limits = RemovalLimits { total_pct: self.max_face_loss_pct, per_region_pct: self.max_region_pct };
                let regions = Regions::new(&patched, &defects, rings, limits);
                (too_large, restored) = (regions.too_large, 0);
                if regions.count == 0 {
                    break;
                }
                let reach = (self.max_deviation - totals.moved).max(0.0);
                let limits = PatchLimits { max_edges: self.max_hole_edges, max_size: self.max_hole_size, reach };
                let round = patched.round(&defects, &regions, &limits, context)?;
                restored = round.restored;
                let Some(improvement) = round.improvement else { break };
                if Counts::of(&improvement.patched.surface).has_increase_over(&Counts::of(&patched.surface)) {
                    break;
                }
                totals.regions += improvement.regions;
                totals.removed += improvement.removed;
                totals.moved += improvement.deviation;
                (patched, defects) = (improvement.patched, improvement.defects);
                if defects.total() == 0 {
                    break 'rings;
                }
            }
        }
        let left = match (too_large, restored) {
            (0, 0) => None,
            (large, 0) => Some(format!("{large} defective regions are too large to be removed")),
            (0, restored) => Some(format!("{restored} defective regions were restored, since no patch improved them")),
            (large, restored) => Some(format!(
                "{large} defective regions are too large to be removed; {restored} were restored, since no patch improved them"
            )),
        };
        if totals.regions == 0 {
            return Ok(Applied { left, ..Applied::default() });
        }
        let added = patched.origin.iter().filter(|&&o| o == NEW).count() as u64;
        let changes = Change::list([
            (ChangeKind::RegionsPatched, totals.regions),
            (ChangeKind::FacesRemoved, totals.removed),
            (ChangeKind::FacesAdded, added),
            (ChangeKind::DefectsRemoved, first - defects.total()),
        ]);
        *surface = patched.surface;
        surface.drop_unreferenced();
        Ok(Applied { changes, moved: totals.moved, left, ..Applied::default() })
    }
}

impl Operation<'_> for CleanAndPatch {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges, Counter::NonManifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[];
    const IS_HEAVY: bool = true;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let options = scope.options;
        Self {
            max_hole_edges: options.max_hole_edges,
            max_hole_size: options.max_hole_size,
            max_face_loss_pct: options.max_face_loss_pct,
            max_deviation: scope.max_deviation,
            ..Self::default()
        }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}

/// The limits on holes that are filled and on the distance of their patches.
struct PatchLimits {
    /// The most edges around a hole.
    max_edges: u32,
    /// The largest extent of a hole, as a share of the diagonal.
    max_size: f64,
    /// The largest distance between patch and replaced surface, in the model's unit.
    reach: f64,
}

/// The outcome of a round.
struct RoundResult {
    /// The number of regions that no patch improved.
    restored: u64,
    /// The improved surface, if any region was improved.
    improvement: Option<Improvement>,
}

/// An improved surface.
struct Improvement {
    patched: PatchedSurface,
    defects: Defects,
    regions: u64,
    removed: u64,
    deviation: f64,
}

/// The patches of a round, with their regions.
struct Patches {
    /// Faces next to a region that got other vertices at the same positions.
    kept: Vec<(u32, [u32; 3])>,
    /// The patches' faces, each with its region.
    faces: Vec<([u32; 3], u32)>,
    /// The positions of the surface with the patches.
    positions: Vec<DVec3>,
    /// For each vertex of a region or its patch the region, otherwise [`NONE`].
    of_vertex: Vec<u32>,
}

/// The number of defects in a region.
#[derive(Clone, Copy, Default)]
struct Score {
    edges: u64,
    pairs: u64,
    newly_open: u64,
}

impl Score {
    /// Whether the region has fewer defects than before and no new boundary edge.
    fn improves_on(self, before: Self) -> bool {
        self.newly_open == 0 && self.edges <= before.edges && self.edges + self.pairs < before.edges + before.pairs
    }
}

impl PatchedSurface {
    /// Removes regions, fills the holes, and restores the regions that did not improve.
    fn round(
        &self,
        defects: &Defects,
        regions: &Regions,
        limits: &PatchLimits,
        context: &Context<'_>,
    ) -> Result<RoundResult, Cancelled> {
        let Some(patches) = self.fill(regions, limits, context)? else {
            return Ok(RoundResult { restored: regions.count as u64, improvement: None });
        };
        let deviations = self.deviations(defects, regions, &patches, context)?;
        let mut active: Vec<bool> =
            deviations.iter().map(|&(far, diagonal)| far <= limits.reach.min(MAX_DEVIATION_SHARE * diagonal)).collect();
        let before = self.scores(defects, &patches.of_vertex, &regions.of_face, None);
        for _ in 0..MAX_EVALUATIONS {
            if !active.contains(&true) {
                break;
            }
            let (patched, region_of) = self.apply_patches(&patches, regions, &active);
            let now = Defects::of(&patched.surface, context)?;
            if !now.complete {
                break;
            }
            let after = patched.scores(&now, &patches.of_vertex, &region_of, Some(&defects.edges));
            let worse: Vec<usize> =
                (0..active.len()).filter(|&r| active[r] && !after[r].improves_on(before[r])).collect();
            if worse.is_empty() {
                let restored = active.iter().filter(|&&a| !a).count() as u64;
                let is_active = |r: &&u32| **r != NONE && active[**r as usize];
                let improvement = Improvement {
                    regions: regions.count as u64 - restored,
                    removed: regions.of_face.iter().filter(is_active).count() as u64,
                    deviation: (0..active.len()).filter(|&r| active[r]).map(|r| deviations[r].0).fold(0.0, f64::max),
                    patched,
                    defects: now,
                };
                let better = improvement.defects.total() < defects.total();
                return Ok(RoundResult { restored, improvement: better.then_some(improvement) });
            }
            for region in worse {
                active[region] = false;
            }
        }
        Ok(RoundResult { restored: regions.count as u64, improvement: None })
    }

    /// Fills the holes that the regions leave. `None` where the filling changed other faces or positions.
    fn fill(
        &self,
        regions: &Regions,
        limits: &PatchLimits,
        context: &Context<'_>,
    ) -> Result<Option<Patches>, Cancelled> {
        let surface = &self.surface;
        let keep: Vec<bool> = regions.of_face.iter().map(|&r| r == NONE).collect();
        let mut filled = surface.clone();
        filled.retain_faces(&keep);
        let count = filled.faces.len();
        let &PatchLimits { max_edges, max_size, .. } = limits;
        FillHoles { max_edges, max_size, ..FillHoles::default() }.apply(&mut filled, context)?;
        if filled.faces.len() < count || !filled.positions.starts_with(&surface.positions) {
            return Ok(None);
        }
        let mut of_vertex = vec![NONE; filled.positions.len()];
        for (face, &region) in surface.faces.iter().zip(&regions.of_face).filter(|(_, r)| **r != NONE) {
            for &v in face {
                of_vertex[v as usize] = region;
            }
        }
        let mut kept = Vec::new();
        let stays = (0u32..).zip(&keep).filter(|(_, keep)| **keep);
        for ((f, _), &face) in stays.zip(&filled.faces) {
            if face != surface.faces[f as usize] {
                kept.push((f, face));
            }
        }
        // A connected patch belongs to one region; a patch between two regions is judged with the first.
        let patches = &filled.faces[count..];
        let mut sets = UnionFind::new(filled.positions.len());
        for &[a, b, c] in patches {
            sets.unite(a, b);
            sets.unite(b, c);
        }
        let mut region_of_set = vec![NONE; filled.positions.len()];
        for (v, &region) in (0u32..).zip(&of_vertex).filter(|(_, r)| **r != NONE) {
            let slot = &mut region_of_set[sets.root(v) as usize];
            *slot = region.min(*slot);
        }
        let mut faces = Vec::new();
        for &face in patches {
            let region = region_of_set[sets.root(face[0]) as usize];
            if region != NONE {
                faces.push((face, region));
                for v in face {
                    let of_vertex = &mut of_vertex[v as usize];
                    *of_vertex = if *of_vertex == NONE { region } else { *of_vertex };
                }
            }
        }
        Ok(Some(Patches { kept, faces, positions: filled.positions, of_vertex }))
    }

    /// For each region the distance between its patch and the surface that it replaces, and its part's diagonal.
    fn deviations(
        &self,
        defects: &Defects,
        regions: &Regions,
        patches: &Patches,
        context: &Context<'_>,
    ) -> Result<Vec<(f64, f64)>, Cancelled> {
        let surface = &self.surface;
        let mut boxes = vec![Box3::of([]); defects.parts.count];
        for (face, &part) in surface.faces.iter().zip(&defects.parts.of_face).filter(|(_, p)| **p != Parts::NONE) {
            face.iter().for_each(|&v| boxes[part as usize].extend(surface.positions[v as usize]));
        }
        let mut open = vec![false; regions.count];
        for half_edges in defects.edges.iter().filter(|h| h.len() == 1) {
            let region = regions.of_face[half_edges[0] as usize / 3];
            if region != NONE {
                open[region as usize] = true;
            }
        }
        let (mut old, mut new) = (vec![Vec::new(); regions.count], vec![Vec::new(); regions.count]);
        let mut diagonals = vec![0.0; regions.count];
        for (f, &region) in regions.of_face.iter().enumerate().filter(|(_, r)| **r != NONE) {
            old[region as usize].push(surface.faces[f]);
            let part = defects.parts.of_face[f];
            if part != Parts::NONE {
                diagonals[region as usize] = boxes[part as usize].diagonal();
            }
        }
        for &(face, region) in &patches.faces {
            new[region as usize].push(face);
        }
        let at = |v: u32| patches.positions[v as usize];
        let mut deviations = Vec::with_capacity(regions.count);
        for ((old, new), (&diagonal, &open)) in old.iter().zip(&new).zip(diagonals.iter().zip(&open)) {
            context.check()?;
            let mut deviation = max_distance(old.iter().flatten().map(|&v| at(v)), &patches.positions, new);
            if !open && !new.is_empty() {
                // A patch over a hole of the input replaces no surface, so it is not measured.
                let samples = new.iter().flat_map(|&[a, b, c]| {
                    let [a, b, c] = [at(a), at(b), at(c)];
                    [(a + b + c) / 3.0, (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0]
                });
                deviation = deviation.max(max_distance(samples, &patches.positions, old));
            }
            deviations.push((deviation, diagonal));
        }
        Ok(deviations)
    }

    /// The surface with the patches of the active regions and the other regions unchanged; and for each face its patch's
    /// region.
    fn apply_patches(&self, patches: &Patches, regions: &Regions, active: &[bool]) -> (Self, Vec<u32>) {
        let mut patched = self.clone();
        patched.surface.positions.clone_from(&patches.positions);
        for &(f, face) in &patches.kept {
            patched.surface.faces[f as usize] = face;
        }
        let is_active = |r: u32| r != NONE && active[r as usize];
        let keep: Vec<bool> = regions.of_face.iter().map(|&r| !is_active(r)).collect();
        patched.surface.retain_faces(&keep);
        let mut flags = keep.iter();
        patched.origin.retain(|_| flags.next().is_some_and(|&k| k));
        let mut region_of = vec![NONE; patched.origin.len()];
        for &(face, region) in patches.faces.iter().filter(|p| is_active(p.1)) {
            patched.surface.push_patch(face);
            patched.origin.push(NEW);
            region_of.push(region);
        }
        (patched, region_of)
    }

    /// The score of each region. Its faces are those of `region_of`, its edges those between its vertices.
    fn scores(&self, defects: &Defects, of_vertex: &[u32], region_of: &[u32], before: Option<&Edges>) -> Vec<Score> {
        let count = of_vertex.iter().filter(|&&r| r != NONE).max().map_or(0, |&r| r as usize + 1);
        let mut scores = vec![Score::default(); count];
        for (e, half_edges) in defects.edges.iter().enumerate().filter(|(_, h)| h.len() != 2) {
            let [a, b] = defects.edges.vertices(e);
            let region = of_vertex[a as usize];
            if region == NONE || of_vertex[b as usize] != region {
                continue;
            }
            let score = &mut scores[region as usize];
            score.edges += 1;
            let was_open = |edges: &Edges| edges.find(a, b).is_some_and(|e| edges.half_edges(e).len() == 1);
            score.newly_open += u64::from(half_edges.len() == 1 && before.is_some_and(|edges| !was_open(edges)));
        }
        for &[f, g] in &defects.pairs {
            let [f, g] = [region_of[f as usize], region_of[g as usize]];
            if f != NONE {
                scores[f as usize].pairs += 1;
            }
            if g != NONE && g != f {
                scores[g as usize].pairs += 1;
            }
        }
        for (&region, _) in
            region_of.iter().zip(&defects.degenerate).filter(|&(&r, &degenerate)| r != NONE && degenerate)
        {
            scores[region as usize].pairs += 1;
        }
        scores
    }
}

/// The largest distance of the points from the triangles; infinity without triangles or where a search exceeds its budget.
fn max_distance(points: impl Iterator<Item = DVec3>, positions: &[DVec3], faces: &[[u32; 3]]) -> f64 {
    let tree = Tree::new(positions, faces);
    let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
    let distance = |point| {
        let mut steps = SEARCH_BUDGET;
        let nearest = tree.nearest(point, f64::INFINITY, &mut steps, corners);
        nearest.filter(|_| steps > 0).map_or(f64::INFINITY, |nearest| nearest.distance)
    };
    points.map(distance).fold(0.0, f64::max)
}
