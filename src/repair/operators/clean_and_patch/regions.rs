//! What is bad about a surface that is being patched, and the regions of it that are to be removed.

use crate::inspect::{Analysis, doubled_areas, intersections};
use crate::mesh::{Edges, Parts, Surface, UnionFind};
use crate::repair::{Cancelled, Context};

/// The origin of a face of a patch.
pub(super) const NEW: u32 = u32::MAX;
/// No region.
pub(super) const NONE: u32 = u32::MAX;

/// A surface on its way, with what it was.
#[derive(Clone)]
pub(super) struct Patching {
    pub surface: Surface,
    /// For each face the face of the input that it is, or [`NEW`].
    pub origin: Vec<u32>,
    /// Of the input: the part of each face, and the faces of each part.
    input_parts: Parts,
    input_sizes: Vec<u64>,
}

impl Patching {
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

    pub fn input_part(&self, face: u32) -> u32 {
        self.input_parts.of_face[face as usize]
    }

    pub fn input_faces(&self, part: usize) -> u64 {
        self.input_sizes[part]
    }

    /// Faces of each part of the input that are gone.
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

/// What is bad about a surface: open and non-manifold edges by index, and pairs of faces that intersect.
pub(super) struct Bad {
    pub edges: Edges,
    pub parts: Parts,
    /// By face of the surface, the smaller first.
    pub pairs: Vec<[u32; 2]>,
    /// Whether all pairs are listed.
    pub complete: bool,
    /// Of each face whether its corners are on a line.
    pub flat: Vec<bool>,
}

impl Bad {
    pub fn of(surface: &Surface, context: &Context<'_>) -> Result<Self, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let parts = Parts::new(surface, &edges);
        let soup = surface.to_soup();
        let analysis = Analysis::new((&soup).into(), context)?;
        let found = intersections(&analysis, context)?;
        let listed = found.pairs.len() as u64;
        let mut flat = vec![false; surface.faces.len()];
        for (&source, &is_flat) in analysis.surface.source.iter().zip(analysis.flat()) {
            flat[source as usize] = is_flat;
        }
        Ok(Self {
            edges,
            parts,
            pairs: found.pairs.into_iter().map(|pair| pair.faces).collect(),
            complete: found.counts.complete && found.counts.pairs == Some(listed),
            flat,
        })
    }

    /// How much is bad.
    pub fn total(&self) -> u64 {
        self.pairs.len() as u64 + self.edges.iter().filter(|h| h.len() != 2).count() as u64
    }

    /// The pairs within one part; where parts overlap nothing is bad about either.
    pub fn pairs_within_parts(&self) -> impl Iterator<Item = [u32; 2]> {
        let part = |f: u32| self.parts.of_face[f as usize];
        self.pairs.iter().copied().filter(move |&[f, g]| part(f) == part(g))
    }

    /// Of each face whether it is bad.
    pub fn faces(&self, surface: &Surface) -> Vec<bool> {
        let mut at = vec![false; surface.positions.len()];
        for (e, _) in self.edges.iter().enumerate().filter(|(_, h)| h.len() != 2) {
            for v in self.edges.vertices(e) {
                at[v as usize] = true;
            }
        }
        let mut bad: Vec<bool> = surface.faces.iter().map(|face| face.iter().any(|&v| at[v as usize])).collect();
        for f in self.pairs_within_parts().flatten() {
            bad[f as usize] = true;
        }
        bad
    }
}

/// How much may go, in percent of the part.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Of its faces, in all.
    pub in_all_pct: f64,
    /// Of its faces and of its area, at one place.
    pub at_one_place_pct: f64,
}

/// The places to be removed: faces that hang together by vertices or by intersections. No two regions share a vertex.
pub(super) struct Regions {
    /// The region of each face, or [`NONE`].
    pub of_face: Vec<u32>,
    pub count: usize,
    /// Regions that were given up because of the limits, or since without them a part would fall in two.
    pub too_large: u64,
}

impl Regions {
    pub fn new(on: &Patching, bad: &Bad, rings: u32, limits: Limits) -> Self {
        let surface = &on.surface;
        let mut gone = bad.faces(surface);
        for _ in 0..rings {
            grow(surface, &mut gone);
        }
        let cut_off = take_islands(surface, bad, &mut gone, limits);
        let mut regions = connected(surface, bad, &gone);
        regions.give_up_too_large(on, bad, &cut_off, limits);
        regions
    }

    /// Gives up the regions over the limits or at what would be cut off, and numbers the others anew.
    fn give_up_too_large(&mut self, on: &Patching, bad: &Bad, cut_off: &[bool], limits: Limits) {
        let mut faces: Vec<RegionFace> = Vec::new();
        let mut given_up = vec![false; self.count];
        for (f, (&part, &region)) in (0u32..).zip(bad.parts.of_face.iter().zip(&self.of_face)) {
            if region != NONE {
                faces.push(RegionFace { region, part, face: f });
                given_up[region as usize] |= on.surface.faces[f as usize].iter().any(|&v| cut_off[v as usize]);
            }
        }
        faces.sort_unstable();
        give_up_large_shares(&on.surface, bad, &faces, limits, &mut given_up);
        give_up_past_total(on, &faces, limits, &mut given_up);
        self.too_large = given_up.iter().filter(|&&g| g).count() as u64;
        let mut next = 0;
        let number: Vec<u32> = given_up
            .iter()
            .map(|&gone| {
                next += u32::from(!gone);
                if gone { NONE } else { next - 1 }
            })
            .collect();
        self.count = next as usize;
        for region in self.of_face.iter_mut().filter(|r| **r != NONE) {
            *region = number[*region as usize];
        }
    }
}

/// A face of a region, with the part that it is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct RegionFace {
    region: u32,
    part: u32,
    face: u32,
}

/// Gives up the regions that have too large a share of their part's faces or area.
fn give_up_large_shares(surface: &Surface, bad: &Bad, faces: &[RegionFace], limits: Limits, given_up: &mut [bool]) {
    let areas = doubled_areas(surface);
    let mut whole = vec![(0u64, 0.0f64); bad.parts.count];
    for (&part, area) in bad.parts.of_face.iter().zip(&areas).filter(|(part, _)| **part != Parts::NONE) {
        let (count, sum) = &mut whole[part as usize];
        (*count, *sum) = (*count + 1, *sum + area);
    }
    for same in faces.chunk_by(|a, b| (a.region, a.part) == (b.region, b.part)) {
        let RegionFace { region, part, .. } = same[0];
        if part == Parts::NONE {
            continue;
        }
        let (count, area) = whole[part as usize];
        let own: f64 = same.iter().map(|it| areas[it.face as usize]).sum();
        let share = limits.at_one_place_pct / 100.0;
        given_up[region as usize] |= same.len() as f64 > share * count as f64 || own > share * area;
    }
}

/// Gives up the regions with which, and with the regions before them, too much of a part of the input would have gone.
fn give_up_past_total(on: &Patching, faces: &[RegionFace], limits: Limits, given_up: &mut [bool]) {
    let mut lost = on.lost();
    for of_region in faces.chunk_by(|a, b| a.region == b.region) {
        let region = of_region[0].region as usize;
        if given_up[region] {
            continue;
        }
        let origins = of_region.iter().map(|it| on.origin[it.face as usize]);
        let mut parts: Vec<u32> = origins.filter(|&o| o != NEW).map(|o| on.input_part(o)).collect();
        parts.retain(|&part| part != Parts::NONE);
        parts.sort_unstable();
        let over = |same: &[u32]| {
            let part = same[0] as usize;
            (lost[part] + same.len() as u64) as f64 > limits.in_all_pct / 100.0 * on.input_faces(part) as f64
        };
        if parts.chunk_by(|a, b| a == b).any(over) {
            given_up[region] = true;
        } else {
            for part in parts {
                lost[part as usize] += 1;
            }
        }
    }
}

/// Adds all faces with a vertex in common.
fn grow(surface: &Surface, gone: &mut [bool]) {
    let mut at = vec![false; surface.positions.len()];
    for (face, _) in surface.faces.iter().zip(&*gone).filter(|(_, gone)| **gone) {
        for &v in face {
            at[v as usize] = true;
        }
    }
    for (face, gone) in surface.faces.iter().zip(gone) {
        *gone |= face.iter().any(|&v| at[v as usize]);
    }
}

/// Adds the small islands that would be left of a part beside its largest piece. Answers the vertices of larger ones: a
/// region that has one of them would cut its part in two.
fn take_islands(surface: &Surface, bad: &Bad, gone: &mut [bool], limits: Limits) -> Vec<bool> {
    let faces = surface.faces.len();
    let mut sets = UnionFind::new(faces);
    for half_edges in bad.edges.iter() {
        let mut stay = half_edges.iter().map(|&h| h / 3).filter(|&f| !gone[f as usize]);
        if let Some(first) = stay.next() {
            stay.for_each(|f| sets.unite(first, f));
        }
    }
    let roots = sets.into_roots();
    let mut size = vec![0u64; faces];
    let (mut of_part, mut largest) = (vec![0u64; bad.parts.count], vec![NONE; bad.parts.count]);
    for (f, &part) in bad.parts.of_face.iter().enumerate().filter(|(_, p)| **p != Parts::NONE) {
        of_part[part as usize] += 1;
        size[roots[f] as usize] += u64::from(!gone[f]);
    }
    for (f, &part) in (0u32..).zip(&bad.parts.of_face).filter(|(_, p)| **p != Parts::NONE) {
        let best = &mut largest[part as usize];
        if roots[f as usize] == f && (*best == NONE || size[f as usize] > size[*best as usize]) {
            *best = f;
        }
    }
    let mut cut_off = vec![false; surface.positions.len()];
    for f in 0..faces {
        let part = bad.parts.of_face[f];
        if gone[f] || part == Parts::NONE || largest[part as usize] == roots[f] {
            continue;
        }
        let small = size[roots[f] as usize] as f64 <= limits.at_one_place_pct / 100.0 * of_part[part as usize] as f64;
        if small {
            gone[f] = true;
        } else {
            for &v in &surface.faces[f] {
                cut_off[v as usize] = true;
            }
        }
    }
    cut_off
}

/// The faces that go, by what hangs together.
fn connected(surface: &Surface, bad: &Bad, gone: &[bool]) -> Regions {
    let mut sets = UnionFind::new(gone.len());
    let mut first = vec![NONE; surface.positions.len()];
    for (f, face) in (0u32..).zip(&surface.faces).filter(|&(f, _)| gone[f as usize]) {
        for &v in face {
            let first = &mut first[v as usize];
            if *first == NONE {
                *first = f;
            }
            sets.unite(*first, f);
        }
    }
    for [f, g] in bad.pairs_within_parts() {
        sets.unite(f, g);
    }
    let mut of_face = sets.into_roots();
    let mut count = 0u32;
    for f in 0..of_face.len() {
        of_face[f] = if !gone[f] {
            NONE
        } else if of_face[f] as usize == f {
            count += 1;
            count - 1
        } else {
            // The root is smaller, so that it holds its number already.
            of_face[of_face[f] as usize]
        };
    }
    Regions { of_face, count: count as usize, too_large: 0 }
}
