//! Bad places removed and closed again.

mod regions;

use glam::DVec3;

use crate::math::{Box3, Tree};
use crate::mesh::{Edges, Parts, Surface, UnionFind};
use crate::repair::operators::holes::FillHoles;
use crate::repair::operators::operator::{Applied, Counter, Counts, Operation, Scope};
use crate::repair::{Cancelled, Change, ChangeKind, Context};
use regions::{Bad, Limits, NEW, NONE, Patching, Regions};

/// Rings of faces around what is bad that go with it, round by round.
const RINGS: std::ops::RangeInclusive<u32> = 0..=3;
/// Rounds with the same number of rings while they make it better: what a first patch hits goes in the second.
const ROUNDS_A_RING: u32 = 2;

/// The farthest that a patch may be from what it replaces, as a share of the part's diagonal.
const MOST_DEVIATION: f64 = 0.05;
/// How often patches are looked at again after some were put back, which may hit others.
const MOST_LOOKS: usize = 4;

/// Boxes and triangles that one search for a nearest point may look at.
const STEPS: u64 = 100_000;

/// How bad places are removed and closed again.
#[derive(Debug, Clone, Copy)]
pub struct CleanAndPatch {
    /// Most edges around a hole that is closed.
    pub max_hole_edges: u32,
    /// Largest extent of a hole that is closed, as a share of the bounding box's diagonal.
    pub max_hole_size: f64,
    /// Most of a part's faces that may go in all, in percent.
    pub max_face_loss_pct: f64,
    /// Most of a part's faces, and of its area, that may go at one place, in percent; 20 by default.
    pub max_region_pct: f64,
    /// The farthest that a patch may be from the surface that it replaces, in the model's unit. A twentieth of the part's
    /// diagonal is the most in any case.
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

/// What all rounds did.
#[derive(Debug, Default)]
struct Tally {
    regions: u64,
    removed: u64,
    moved: f64,
}

impl CleanAndPatch {
    /// Removes what is bad with growing rings around it and closes the holes, while that makes it better.
    ///
    /// Bad are faces at open or non-manifold edges, and faces that intersect others of their part. What belongs together,
    /// by a vertex or by an intersection, is one region. Its patch stays where the region has fewer open and
    /// non-manifold edges and intersecting pairs than before, counted exactly, no edge is open that was not, and the
    /// patch is near what it replaces; otherwise the region is put back as it was and tried again with one more ring.
    ///
    /// ```text
    ///    _____________        _____________        _____________
    ///   |   _/\/X_    |      |   ______    |      |   __ ___    |
    ///   |  |_X\/\_|   |  ->  |  |      |   |  ->  |  |  /   |   |
    ///   |_____________|      |__|______|___|      |__|_/____|___|
    /// ```
    ///
    /// Precondition: consistent winding, and sheets cut apart by index. Result: faces outside of the regions are as they
    /// were, no vertex moves, no part goes or falls in two. Leaves: places that a patch makes no better, that are
    /// larger than the limits, that hold a part together, and intersections between parts. It does nothing where the
    /// intersections are too many to be counted.
    ///
    /// After *Clean and Patch* of Mesh Heal.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let mut bad = Bad::of(surface, context)?;
        let first = bad.total();
        if first == 0 {
            return Ok(Applied::default());
        }
        if !bad.complete {
            let why = "so many faces intersect that they were not all counted; nothing was removed";
            return Ok(Applied { left: Some(why.to_owned()), ..Applied::default() });
        }
        let mut patching = Patching::new(surface);
        let mut tally = Tally::default();
        let (mut too_large, mut put_back) = (0, 0);
        'rings: for rings in RINGS {
            for _ in 0..ROUNDS_A_RING {
                context.check()?;
                let limits = Limits { in_all_pct: self.max_face_loss_pct, at_one_place_pct: self.max_region_pct };
                let regions = Regions::new(&patching, &bad, rings, limits);
                (too_large, put_back) = (regions.too_large, 0);
                if regions.count == 0 {
                    break;
                }
                let reach = (self.max_deviation - tally.moved).max(0.0);
                let limits = PatchLimits { max_edges: self.max_hole_edges, max_size: self.max_hole_size, reach };
                let round = patching.round(&bad, &regions, &limits, context)?;
                put_back = round.put_back;
                let Some(made) = round.made else { break };
                if Counts::of(&made.patching.surface).has_increase_over(&Counts::of(&patching.surface)) {
                    break;
                }
                tally.regions += made.regions;
                tally.removed += made.removed;
                tally.moved += made.deviation;
                (patching, bad) = (made.patching, made.bad);
                if bad.total() == 0 {
                    break 'rings;
                }
            }
        }
        let left = match (too_large, put_back) {
            (0, 0) => None,
            (large, 0) => Some(format!("{large} bad places are too large to be removed")),
            (0, back) => Some(format!("{back} bad places were put back, since a patch made them no better")),
            (large, back) => Some(format!(
                "{large} bad places are too large to be removed; {back} were put back, since a patch made them no better"
            )),
        };
        if tally.regions == 0 {
            return Ok(Applied { left, ..Applied::default() });
        }
        let added = patching.origin.iter().filter(|&&o| o == NEW).count() as u64;
        let changes = Change::list([
            (ChangeKind::PlacesPatched, tally.regions),
            (ChangeKind::FacesRemoved, tally.removed),
            (ChangeKind::FacesAdded, added),
            (ChangeKind::DefectsRemoved, first - bad.total()),
        ]);
        *surface = patching.surface;
        surface.drop_unreferenced();
        Ok(Applied { changes, moved: tally.moved, left, ..Applied::default() })
    }
}

impl Operation for CleanAndPatch {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges, Counter::NonManifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[];

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

/// How large a hole may be that is closed, and how far its patch may be from what it replaces.
struct PatchLimits {
    max_edges: u32,
    max_size: f64,
    /// In the model's unit.
    reach: f64,
}

/// What a round came to.
struct Round {
    /// Regions that no patch made better.
    put_back: u64,
    made: Option<Made>,
}

/// A better surface.
struct Made {
    patching: Patching,
    bad: Bad,
    regions: u64,
    removed: u64,
    deviation: f64,
}

/// The patches of a round, by region.
struct Patches {
    /// Faces beside a region that got other vertices at the same positions.
    kept: Vec<(u32, [u32; 3])>,
    faces: Vec<([u32; 3], u32)>,
    positions: Vec<DVec3>,
    /// The region of each vertex of a region or its patch.
    of_vertex: Vec<u32>,
}

/// How bad a region is.
#[derive(Clone, Copy, Default)]
struct Score {
    edges: u64,
    pairs: u64,
    newly_open: u64,
}

impl Score {
    fn beats(self, before: Self) -> bool {
        self.newly_open == 0 && self.edges <= before.edges && self.edges + self.pairs < before.edges + before.pairs
    }
}

impl Patching {
    /// Removes regions, closes the holes, and puts back those regions that are no better for it.
    fn round(
        &self,
        bad: &Bad,
        regions: &Regions,
        limits: &PatchLimits,
        context: &Context<'_>,
    ) -> Result<Round, Cancelled> {
        let Some(patches) = self.fill(regions, limits, context)? else {
            return Ok(Round { put_back: regions.count as u64, made: None });
        };
        let deviations = self.deviations(bad, regions, &patches, context)?;
        let mut active: Vec<bool> =
            deviations.iter().map(|&(far, diagonal)| far <= limits.reach.min(MOST_DEVIATION * diagonal)).collect();
        let before = self.scores(bad, &patches.of_vertex, &regions.of_face, None);
        for _ in 0..MOST_LOOKS {
            if !active.contains(&true) {
                break;
            }
            let (patching, region_of) = self.with(&patches, regions, &active);
            let now = Bad::of(&patching.surface, context)?;
            if !now.complete {
                break;
            }
            let after = patching.scores(&now, &patches.of_vertex, &region_of, Some(&bad.edges));
            let worse: Vec<usize> = (0..active.len()).filter(|&r| active[r] && !after[r].beats(before[r])).collect();
            if worse.is_empty() {
                let put_back = active.iter().filter(|&&a| !a).count() as u64;
                let goes = |r: &&u32| **r != NONE && active[**r as usize];
                let made = Made {
                    regions: regions.count as u64 - put_back,
                    removed: regions.of_face.iter().filter(goes).count() as u64,
                    deviation: (0..active.len()).filter(|&r| active[r]).map(|r| deviations[r].0).fold(0.0, f64::max),
                    patching,
                    bad: now,
                };
                let better = made.bad.total() < bad.total();
                return Ok(Round { put_back, made: better.then_some(made) });
            }
            for region in worse {
                active[region] = false;
            }
        }
        Ok(Round { put_back: regions.count as u64, made: None })
    }

    /// Closes the holes that the regions leave. None where that changed more than it should.
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
        // A patch that hangs together belongs to one region; if it bridged two, both would be judged by the first.
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

    /// Of each region how far its patch and the surface that it replaces are apart, and its part's diagonal.
    fn deviations(
        &self,
        bad: &Bad,
        regions: &Regions,
        patches: &Patches,
        context: &Context<'_>,
    ) -> Result<Vec<(f64, f64)>, Cancelled> {
        let surface = &self.surface;
        let mut boxes = vec![Box3::of([]); bad.parts.count];
        for (face, &part) in surface.faces.iter().zip(&bad.parts.of_face).filter(|(_, p)| **p != Parts::NONE) {
            face.iter().for_each(|&v| boxes[part as usize].extend(surface.positions[v as usize]));
        }
        let mut open = vec![false; regions.count];
        for half_edges in bad.edges.iter().filter(|h| h.len() == 1) {
            let region = regions.of_face[half_edges[0] as usize / 3];
            if region != NONE {
                open[region as usize] = true;
            }
        }
        let (mut old, mut new) = (vec![Vec::new(); regions.count], vec![Vec::new(); regions.count]);
        let mut diagonals = vec![0.0; regions.count];
        for (f, &region) in regions.of_face.iter().enumerate().filter(|(_, r)| **r != NONE) {
            old[region as usize].push(surface.faces[f]);
            let part = bad.parts.of_face[f];
            if part != Parts::NONE {
                diagonals[region as usize] = boxes[part as usize].diagonal();
            }
        }
        for &(face, region) in &patches.faces {
            new[region as usize].push(face);
        }
        let at = |v: u32| patches.positions[v as usize];
        let mut found = Vec::with_capacity(regions.count);
        for ((old, new), (&diagonal, &open)) in old.iter().zip(&new).zip(diagonals.iter().zip(&open)) {
            context.check()?;
            let mut far = farthest(old.iter().flatten().map(|&v| at(v)), &patches.positions, new);
            if !open && !new.is_empty() {
                // A patch over a hole has nothing that it replaces.
                let middles = new.iter().flat_map(|&[a, b, c]| {
                    let [a, b, c] = [at(a), at(b), at(c)];
                    [(a + b + c) / 3.0, (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0]
                });
                far = far.max(farthest(middles, &patches.positions, old));
            }
            found.push((far, diagonal));
        }
        Ok(found)
    }

    /// The surface with the patches of the regions that are active, and the others as they were; and of each face of a
    /// patch its region.
    fn with(&self, patches: &Patches, regions: &Regions, active: &[bool]) -> (Self, Vec<u32>) {
        let mut made = self.clone();
        made.surface.positions.clone_from(&patches.positions);
        for &(f, face) in &patches.kept {
            made.surface.faces[f as usize] = face;
        }
        let goes = |r: u32| r != NONE && active[r as usize];
        let keep: Vec<bool> = regions.of_face.iter().map(|&r| !goes(r)).collect();
        made.surface.retain_faces(&keep);
        let mut flags = keep.iter();
        made.origin.retain(|_| flags.next().is_some_and(|&k| k));
        let mut region_of = vec![NONE; made.origin.len()];
        for &(face, region) in patches.faces.iter().filter(|p| goes(p.1)) {
            made.surface.push_patch(face);
            made.origin.push(NEW);
            region_of.push(region);
        }
        (made, region_of)
    }

    /// How bad each region is, its faces being those of `region_of`; edges are those between its vertices.
    fn scores(&self, bad: &Bad, of_vertex: &[u32], region_of: &[u32], before: Option<&Edges>) -> Vec<Score> {
        let count = of_vertex.iter().filter(|&&r| r != NONE).max().map_or(0, |&r| r as usize + 1);
        let mut scores = vec![Score::default(); count];
        for (e, half_edges) in bad.edges.iter().enumerate().filter(|(_, h)| h.len() != 2) {
            let [a, b] = bad.edges.vertices(e);
            let region = of_vertex[a as usize];
            if region == NONE || of_vertex[b as usize] != region {
                continue;
            }
            let score = &mut scores[region as usize];
            score.edges += 1;
            let was_open = |edges: &Edges| edges.find(a, b).is_some_and(|e| edges.half_edges(e).len() == 1);
            score.newly_open += u64::from(half_edges.len() == 1 && before.is_some_and(|edges| !was_open(edges)));
        }
        for &[f, g] in &bad.pairs {
            let [f, g] = [region_of[f as usize], region_of[g as usize]];
            if f != NONE {
                scores[f as usize].pairs += 1;
            }
            if g != NONE && g != f {
                scores[g as usize].pairs += 1;
            }
        }
        for (&region, _) in region_of.iter().zip(&bad.flat).filter(|&(&r, &flat)| r != NONE && flat) {
            scores[region as usize].pairs += 1;
        }
        scores
    }
}

/// How far the farthest of some points is from triangles; infinity where there are no triangles or a search was given up.
fn farthest(points: impl Iterator<Item = DVec3>, positions: &[DVec3], faces: &[[u32; 3]]) -> f64 {
    let tree = Tree::new(positions, faces);
    let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
    let distance = |point| {
        let mut steps = STEPS;
        let nearest = tree.nearest(point, f64::INFINITY, &mut steps, corners);
        nearest.filter(|_| steps > 0).map_or(f64::INFINITY, |nearest| nearest.distance)
    };
    points.map(distance).fold(0.0, f64::max)
}
