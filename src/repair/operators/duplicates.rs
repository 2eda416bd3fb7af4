//! Faces with the same three vertices, and walls of no thickness.

use std::collections::HashSet;

use super::walls::Walls;
use crate::inspect::group_faces;
use crate::math::ray_direction;
use crate::mesh::{Edges, Surface, UnionFind};
use crate::repair::Change;

/// Walls over this share of the whole area stay as one sheet where they can be seen.
const LARGE: f64 = 5e-3;
/// Faces of walls that are asked, rays tried from each, and faces that all rays together may look at.
const ASKED: usize = 256;
const RAYS: u32 = 24;
const BUDGET: u64 = 5_000_000;

/// Leaves one face of each group of faces with the same three vertices, or none where they cancel.
///
/// In the arithmetic of chains two faces on the same vertices add up to nothing: they may be a wall of no thickness,
/// a flap, or a piece of surface that was written twice. Such pairs are taken together with the pairs next to them;
/// all of them go where that leaves fewer open or non-manifold edges than one sheet of them would, and one sheet
/// stays otherwise, so that a two-sided sheet standing alone is not lost. Nor does a wall go that can be seen and is large.
///
/// ```text
///    ____________                    ____________
///   |      |wall |          ->      |            |
///   |______|_____|  (two faces)     |____________|
/// ```
///
/// Precondition: none. Result: no two faces have the same three vertices; of faces that wind the same way the first
/// one stays. Leaves: faces that lie on one another with different vertices.
pub fn remove_duplicates(surface: &mut Surface) -> Vec<Change> {
    let groups = group_faces(&surface.faces);
    if groups.len() == surface.faces.len() {
        return Vec::new();
    }
    let mut keep = vec![true; surface.faces.len()];
    let mut cancelling = Vec::new();
    for group in groups.iter().filter(|g| g.len() > 1) {
        let even = group.iter().filter(|&&f| is_even(surface.faces[f as usize])).count();
        let majority = 2 * even >= group.len();
        let first = group.iter().find(|&&f| is_even(surface.faces[f as usize]) == majority);
        for &f in group {
            keep[f as usize] = Some(&f) == first;
        }
        // By number and not by winding, which says little before faces are turned.
        if group.len() % 2 == 0 {
            cancelling.extend(first.copied());
        }
    }
    let walls = drop_walls(surface, &mut keep, &cancelling);
    let gone = surface.retain_faces(&keep);
    Change::list([("duplicate_faces_removed", gone - walls), ("cancelling_faces_removed", walls)])
}

/// Takes back the sheets of those walls that are better gone. `cancelling` are the kept faces of groups of even
/// number. Answers how many faces that is.
fn drop_walls(surface: &Surface, keep: &mut [bool], cancelling: &[u32]) -> u64 {
    if cancelling.is_empty() {
        return 0;
    }
    let mut wall_of = vec![u32::MAX; surface.faces.len()];
    for (&f, i) in cancelling.iter().zip(0u32..) {
        wall_of[f as usize] = i;
    }
    let edges = Edges::new(&surface.faces);
    let mut sets = UnionFind::new(cancelling.len());
    for half_edges in edges.iter() {
        let mut walls = half_edges.iter().map(|h| wall_of[*h as usize / 3]).filter(|&w| w != u32::MAX);
        if let Some(first) = walls.next() {
            for other in walls {
                sets.unite(first, other);
            }
        }
    }
    // For each wall: the edges that are bad when it is gone, and those that are bad when one sheet stays.
    let mut bad = vec![(0u64, 0u64, false); cancelling.len()];
    for half_edges in edges.iter() {
        let kept = half_edges.iter().filter(|h| keep[**h as usize / 3]);
        let (walls, others): (Vec<u32>, Vec<u32>) =
            kept.map(|h| wall_of[*h as usize / 3]).partition(|&w| w != u32::MAX);
        if let Some(&wall) = walls.first() {
            let it = &mut bad[sets.root(wall) as usize];
            it.0 += u64::from(!matches!(others.len(), 0 | 2));
            it.1 += u64::from(walls.len() + others.len() != 2);
            it.2 |= !others.is_empty();
        }
    }
    let goes = |(without, with, attached): (u64, u64, bool)| attached && without < with;
    let mut area = vec![0.0; cancelling.len()];
    for (&f, i) in cancelling.iter().zip(0u32..) {
        area[sets.root(i) as usize] += surface.area_vector(f as usize).length();
    }
    let total: f64 = (0..surface.faces.len()).map(|f| surface.area_vector(f).length()).sum();
    let large: Vec<bool> = bad.iter().zip(&area).map(|(&bad, &area)| goes(bad) && area > LARGE * total).collect();
    let seen = seen_from_outside(surface, cancelling, |i| large[sets.root(i) as usize]);
    let mut sees = vec![[0u32; 2]; cancelling.len()];
    for (i, seen) in seen {
        sees[sets.root(i) as usize][usize::from(seen)] += 1;
    }
    let mut gone = 0;
    for (&f, i) in cancelling.iter().zip(0u32..) {
        let root = sets.root(i) as usize;
        // What is large and can be seen is a board that was drawn without thickness, and part of the model.
        if goes(bad[root]) && sees[root][1] <= sees[root][0] {
            keep[f as usize] = false;
            gone += 2;
        }
    }
    gone
}

/// Of some of the faces that `asked` says, by number, whether a ray from their middle leaves the surface unhindered.
fn seen_from_outside(surface: &Surface, faces: &[u32], mut asked: impl FnMut(u32) -> bool) -> Vec<(u32, bool)> {
    let asked: Vec<u32> = (0u32..).take(faces.len()).filter(|&i| asked(i)).collect();
    if asked.is_empty() {
        return Vec::new();
    }
    // The faces themselves, and their doubles, are no hindrance: rays begin within them.
    let own: HashSet<[u32; 3]> = asked.iter().map(|&i| sorted(surface.faces[faces[i as usize] as usize])).collect();
    let others = surface.faces.iter().copied().filter(|&face| !own.contains(&sorted(face))).collect();
    let mut walls = Walls::new(surface, others, BUDGET);
    let stride = asked.len().div_ceil(ASKED);
    let see = |&i: &u32| {
        let [a, b, c] = surface.faces[faces[i as usize] as usize].map(|v| walls.unit[v as usize]);
        let from = (a + b + c) / 3.0;
        let free = (0..RAYS).any(|ray| walls.crossings(from, from + ray_direction(ray) * 8.0, None) == Some(0));
        (i, free)
    };
    asked.iter().step_by(stride).map(see).collect()
}

fn sorted(mut face: [u32; 3]) -> [u32; 3] {
    face.sort_unstable();
    face
}

/// Whether the face's vertices are an even permutation of their sorted order.
fn is_even([a, b, c]: [u32; 3]) -> bool {
    (a < b) == ((b < c) == (a < c))
}
