use super::bad::Bad;
use super::patch::{NEW, Patching};
use crate::inspect::doubled_areas;
use crate::mesh::{Parts, Surface, UnionFind};

/// No region.
pub(super) const NONE: u32 = u32::MAX;

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
        let surface = &on.surface;
        let areas = doubled_areas(surface);
        let mut whole = vec![(0u64, 0.0f64); bad.parts.count];
        let mut keys: Vec<(u32, u32, u32)> = Vec::new();
        let mut given_up = vec![false; self.count];
        for (f, (&part, &region)) in (0u32..).zip(bad.parts.of_face.iter().zip(&self.of_face)) {
            if part != Parts::NONE {
                let (count, area) = &mut whole[part as usize];
                (*count, *area) = (*count + 1, *area + areas[f as usize]);
            }
            if region != NONE {
                keys.push((region, part, f));
                given_up[region as usize] |= surface.faces[f as usize].iter().any(|&v| cut_off[v as usize]);
            }
        }
        keys.sort_unstable();
        for same in keys.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let (region, part, _) = same[0];
            if part == Parts::NONE {
                continue;
            }
            let (faces, area) = whole[part as usize];
            let own: f64 = same.iter().map(|&(_, _, f)| areas[f as usize]).sum();
            let share = limits.at_one_place_pct / 100.0;
            given_up[region as usize] |= same.len() as f64 > share * faces as f64 || own > share * area;
        }
        // What has gone of each part of the input, with the regions before this one.
        let mut lost = on.lost();
        for of_region in keys.chunk_by(|a, b| a.0 == b.0) {
            let region = of_region[0].0 as usize;
            if given_up[region] {
                continue;
            }
            let origins = of_region.iter().map(|&(_, _, f)| on.origin[f as usize]);
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
