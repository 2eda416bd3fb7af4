use glam::DVec3;

use super::super::holes::FillHoles;
use super::bad::Bad;
use super::deviation::farthest;
use super::regions::{NONE, Regions};
use crate::math::Box3;
use crate::mesh::{Edges, Parts, Surface, UnionFind};
use crate::repair::{Cancelled, Context};

/// The origin of a face of a patch.
pub(super) const NEW: u32 = u32::MAX;
/// The farthest that a patch may be from what it replaces, as a share of the part's diagonal.
const MOST_DEVIATION: f64 = 0.05;
/// How often patches are looked at again after some were put back, which may hit others.
const MOST_LOOKS: usize = 4;

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

/// What a round came to.
pub(super) struct Round {
    /// Regions that no patch made better.
    pub put_back: u64,
    pub made: Option<Made>,
}

/// A better surface.
pub(super) struct Made {
    pub patching: Patching,
    pub bad: Bad,
    pub regions: u64,
    pub removed: u64,
    pub deviation: f64,
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

    /// Removes regions, closes the holes, and puts back those regions that are no better for it.
    pub fn round(
        &self,
        bad: &Bad,
        regions: &Regions,
        reach: f64,
        hole_limits: (u32, f64),
        context: &Context<'_>,
    ) -> Result<Round, Cancelled> {
        let Some(patches) = self.fill(regions, hole_limits, context)? else {
            return Ok(Round { put_back: regions.count as u64, made: None });
        };
        let deviations = self.deviations(bad, regions, &patches, context)?;
        let mut active: Vec<bool> =
            deviations.iter().map(|&(far, diagonal)| far <= reach.min(MOST_DEVIATION * diagonal)).collect();
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
        (max_edges, max_size): (u32, f64),
        context: &Context<'_>,
    ) -> Result<Option<Patches>, Cancelled> {
        let surface = &self.surface;
        let keep: Vec<bool> = regions.of_face.iter().map(|&r| r == NONE).collect();
        let mut filled = surface.clone();
        filled.retain_faces(&keep);
        let count = filled.faces.len();
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
