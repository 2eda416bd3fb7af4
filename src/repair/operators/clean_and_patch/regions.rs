//! Finds the defects of a surface that is being patched, and the regions to remove.

use crate::inspect::{Analysis, doubled_areas, intersections};
use crate::mesh::{Edges, Parts, Surface, UnionFind};
use crate::repair::{Cancelled, Context};

/// The origin of a face that belongs to a patch.
pub(super) const NEW: u32 = u32::MAX;
/// The value that stands for no region.
pub(super) const NONE: u32 = u32::MAX;

/// A partly patched surface, with the origin of its faces in the input.
#[derive(Clone)]
pub(super) struct PatchedSurface {
    /// The surface with the patches so far.
    pub surface: Surface,
    /// For each face its index in the input, or [`NEW`].
    pub origin: Vec<u32>,
    /// The part of each face of the input, and the number of faces of each part.
    input_parts: Parts,
    input_sizes: Vec<u64>,
}

impl PatchedSurface {
    /// Starts with the input surface.
    pub fn new(input: &Surface) -> Self {
        let input_parts = Parts::new(input, &Edges::new(&input.faces));
        let mut input_sizes = vec![0; input_parts.count];
        for &part in input_parts.of_face.iter().filter(|&&p| p != Parts::NONE) {
            input_sizes[part as usize] += 1;
        }
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        let origin = (0..input.faces.len() as u32).collect();
        Self { surface: input.clone(), origin, input_parts, input_sizes }
    }

    /// The part of a face of the input.
    pub fn input_part(&self, face: u32) -> u32 {
        self.input_parts.of_face[face as usize]
    }

    /// The number of faces of a part of the input.
    pub fn input_faces(&self, part: usize) -> u64 {
        self.input_sizes[part]
    }

    /// For each part of the input the number of its faces that were removed.
    pub fn lost(&self) -> Vec<u64> {
        let mut lost = self.input_sizes.clone();
        for &origin in self.origin.iter().filter(|&&o| o != NEW) {
            let part = self.input_part(origin);
            if part != Parts::NONE {
                lost[part as usize] -= 1;
            }
        }
        lost
    }
}

/// The defects of a surface: boundary and non-manifold edges by index, and pairs of faces that intersect.
pub(super) struct Defects {
    /// The edges of the surface.
    pub edges: Edges,
    /// The parts of the surface.
    pub parts: Parts,
    /// The pairs of intersecting faces, smaller index first.
    pub pairs: Vec<[u32; 2]>,
    /// Whether all pairs are listed.
    pub complete: bool,
    /// For each face whether its corners are collinear.
    pub degenerate: Vec<bool>,
}

impl Defects {
    /// Finds the defects of a surface.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn of(surface: &Surface, context: &Context<'_>) -> Result<Self, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let parts = Parts::new(surface, &edges);
        let soup = surface.to_soup();
        let analysis = Analysis::new((&soup).into(), context)?;
        let intersections = intersections(&analysis, context)?;
        let listed = intersections.pairs.len() as u64;
        let mut degenerate = vec![false; surface.faces.len()];
        for (&source, &is_degenerate) in analysis.surface.source.iter().zip(analysis.flat()) {
            degenerate[source as usize] = is_degenerate;
        }
        Ok(Self {
            edges,
            parts,
            pairs: intersections.pairs.into_iter().map(|pair| pair.faces).collect(),
            complete: intersections.counts.complete && intersections.counts.pairs == Some(listed),
            degenerate,
        })
    }

    /// The number of defects.
    pub fn total(&self) -> u64 {
        self.pairs.len() as u64 + self.edges.iter().filter(|h| h.len() != 2).count() as u64
    }

    /// The pairs within one part; overlapping parts are not defective themselves.
    pub fn pairs_within_parts(&self) -> impl Iterator<Item = [u32; 2]> {
        let part = |f: u32| self.parts.of_face[f as usize];
        self.pairs.iter().copied().filter(move |&[f, g]| part(f) == part(g))
    }

    /// For each face whether it is defective.
    pub fn faces(&self, surface: &Surface) -> Vec<bool> {
        let mut at = vec![false; surface.positions.len()];
        for (e, _) in self.edges.iter().enumerate().filter(|(_, h)| h.len() != 2) {
            for v in self.edges.vertices(e) {
                at[v as usize] = true;
            }
        }
        let mut defects: Vec<bool> = surface.faces.iter().map(|face| face.iter().any(|&v| at[v as usize])).collect();
        for f in self.pairs_within_parts().flatten() {
            defects[f as usize] = true;
        }
        defects
    }
}

/// The limits on removed faces, in percent of the part.
#[derive(Debug, Clone, Copy)]
pub(super) struct RemovalLimits {
    /// The share of a part's faces that may be removed in all.
    pub total_pct: f64,
    /// The share of a part's faces and of its area that one region may have.
    pub per_region_pct: f64,
}

/// The regions to remove: faces connected by vertices or by intersections. No two regions share a vertex.
pub(super) struct Regions {
    /// The region of each face, or [`NONE`].
    pub of_face: Vec<u32>,
    /// The number of regions.
    pub count: usize,
    /// The number of regions that were rejected: they exceed the limits, or their part would fall apart without them.
    pub too_large: u64,
}

impl Regions {
    /// Collects the regions around defects, extended by `rings` rings of faces.
    pub fn new(patched: &PatchedSurface, defects: &Defects, rings: u32, limits: RemovalLimits) -> Self {
        let surface = &patched.surface;
        let mut removed = defects.faces(surface);
        for _ in 0..rings {
            grow_by_one_ring(surface, &mut removed);
        }
        let cut_off = absorb_islands(surface, defects, &mut removed, limits);
        let mut regions = connected(surface, defects, &removed);
        regions.reject_too_large(patched, defects, &cut_off, limits);
        regions
    }

    /// Rejects the regions that exceed the limits or touch a larger island, and renumbers the others.
    fn reject_too_large(
        &mut self,
        patched: &PatchedSurface,
        defects: &Defects,
        cut_off: &[bool],
        limits: RemovalLimits,
    ) {
        let mut faces: Vec<RegionFace> = Vec::new();
        let mut rejected = vec![false; self.count];
        for (f, (&part, &region)) in (0u32..).zip(defects.parts.of_face.iter().zip(&self.of_face)) {
            if region != NONE {
                faces.push(RegionFace { region, part, face: f });
                rejected[region as usize] |= patched.surface.faces[f as usize].iter().any(|&v| cut_off[v as usize]);
            }
        }
        faces.sort_unstable();
        reject_large_shares(&patched.surface, defects, &faces, limits, &mut rejected);
        reject_past_total(patched, &faces, limits, &mut rejected);
        self.too_large = rejected.iter().filter(|&&g| g).count() as u64;
        let mut next = 0;
        let number: Vec<u32> = rejected
            .iter()
            .map(|&removed| {
                next += u32::from(!removed);
                if removed { NONE } else { next - 1 }
            })
            .collect();
        self.count = next as usize;
        for region in self.of_face.iter_mut().filter(|r| **r != NONE) {
            *region = number[*region as usize];
        }
    }
}

/// A face of a region, with the face's part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct RegionFace {
    region: u32,
    part: u32,
    face: u32,
}

/// Rejects the regions that have too large a share of their part's faces or area.
fn reject_large_shares(
    surface: &Surface,
    defects: &Defects,
    faces: &[RegionFace],
    limits: RemovalLimits,
    rejected: &mut [bool],
) {
    let areas = doubled_areas(surface);
    let mut totals = vec![(0u64, 0.0f64); defects.parts.count];
    for (&part, area) in defects.parts.of_face.iter().zip(&areas).filter(|(part, _)| **part != Parts::NONE) {
        let (count, sum) = &mut totals[part as usize];
        (*count, *sum) = (*count + 1, *sum + area);
    }
    for same in faces.chunk_by(|a, b| (a.region, a.part) == (b.region, b.part)) {
        let RegionFace { region, part, .. } = same[0];
        if part == Parts::NONE {
            continue;
        }
        let (count, area) = totals[part as usize];
        let own: f64 = same.iter().map(|face| areas[face.face as usize]).sum();
        let share = limits.per_region_pct / 100.0;
        rejected[region as usize] |= same.len() as f64 > share * count as f64 || own > share * area;
    }
}

/// Rejects a region where, together with the regions before it, too many faces of an input part would be removed.
fn reject_past_total(patched: &PatchedSurface, faces: &[RegionFace], limits: RemovalLimits, rejected: &mut [bool]) {
    let mut lost = patched.lost();
    for of_region in faces.chunk_by(|a, b| a.region == b.region) {
        let region = of_region[0].region as usize;
        if rejected[region] {
            continue;
        }
        let origins = of_region.iter().map(|face| patched.origin[face.face as usize]);
        let mut parts: Vec<u32> = origins.filter(|&o| o != NEW).map(|o| patched.input_part(o)).collect();
        parts.retain(|&part| part != Parts::NONE);
        parts.sort_unstable();
        let over = |same: &[u32]| {
            let part = same[0] as usize;
            (lost[part] + same.len() as u64) as f64 > limits.total_pct / 100.0 * patched.input_faces(part) as f64
        };
        if parts.chunk_by(|a, b| a == b).any(over) {
            rejected[region] = true;
        } else {
            for part in parts {
                lost[part as usize] += 1;
            }
        }
    }
}

/// Adds all faces that share a vertex with a marked face.
fn grow_by_one_ring(surface: &Surface, removed: &mut [bool]) {
    let mut at = vec![false; surface.positions.len()];
    for (face, _) in surface.faces.iter().zip(&*removed).filter(|(_, removed)| **removed) {
        for &v in face {
            at[v as usize] = true;
        }
    }
    for (face, removed) in surface.faces.iter().zip(removed) {
        *removed |= face.iter().any(|&v| at[v as usize]);
    }
}

/// Marks the small islands that would remain of a part besides its largest piece. Returns, for each vertex, whether it lies
/// on a larger island: a region with such a vertex would divide its part.
fn absorb_islands(surface: &Surface, defects: &Defects, removed: &mut [bool], limits: RemovalLimits) -> Vec<bool> {
    let faces = surface.faces.len();
    let mut sets = UnionFind::new(faces);
    for half_edges in defects.edges.iter() {
        let mut stay = half_edges.iter().map(|&h| h / 3).filter(|&f| !removed[f as usize]);
        if let Some(first) = stay.next() {
            stay.for_each(|f| sets.unite(first, f));
        }
    }
    let roots = sets.into_roots();
    let mut size = vec![0u64; faces];
    let (mut of_part, mut largest) = (vec![0u64; defects.parts.count], vec![NONE; defects.parts.count]);
    for (f, &part) in defects.parts.of_face.iter().enumerate().filter(|(_, p)| **p != Parts::NONE) {
        of_part[part as usize] += 1;
        size[roots[f] as usize] += u64::from(!removed[f]);
    }
    for (f, &part) in (0u32..).zip(&defects.parts.of_face).filter(|(_, p)| **p != Parts::NONE) {
        let best = &mut largest[part as usize];
        if roots[f as usize] == f && (*best == NONE || size[f as usize] > size[*best as usize]) {
            *best = f;
        }
    }
    let mut cut_off = vec![false; surface.positions.len()];
    for f in 0..faces {
        let part = defects.parts.of_face[f];
        if removed[f] || part == Parts::NONE || largest[part as usize] == roots[f] {
            continue;
        }
        let small = size[roots[f] as usize] as f64 <= limits.per_region_pct / 100.0 * of_part[part as usize] as f64;
        if small {
            removed[f] = true;
        } else {
            for &v in &surface.faces[f] {
                cut_off[v as usize] = true;
            }
        }
    }
    cut_off
}

/// Groups the removed faces into connected regions.
fn connected(surface: &Surface, defects: &Defects, removed: &[bool]) -> Regions {
    let mut sets = UnionFind::new(removed.len());
    let mut first = vec![NONE; surface.positions.len()];
    for (f, face) in (0u32..).zip(&surface.faces).filter(|&(f, _)| removed[f as usize]) {
        for &v in face {
            let first = &mut first[v as usize];
            if *first == NONE {
                *first = f;
            }
            sets.unite(*first, f);
        }
    }
    for [f, g] in defects.pairs_within_parts() {
        sets.unite(f, g);
    }
    let (of_face, count) = sets.into_numbers(|f| removed[f]);
    Regions { of_face, count, too_large: 0 }
}
