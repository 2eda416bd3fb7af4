//! Faces with the same three vertices, and walls of no thickness.

use crate::inspect::group_faces;
use crate::mesh::{Edges, Surface, UnionFind};
use crate::repair::Change;

/// Leaves one face of each group of faces with the same three vertices, or none where they cancel.
///
/// In the arithmetic of chains two faces on the same vertices add up to nothing: they may be a wall of no thickness,
/// a flap, or a piece of surface that was written twice. Such pairs are taken together with the pairs next to them;
/// all of them go where that leaves fewer open or non-manifold edges than one sheet of them would, and one sheet
/// stays otherwise, so that a two-sided sheet standing alone is not lost.
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
    let mut gone = 0;
    for (&f, i) in cancelling.iter().zip(0u32..) {
        let (without, with, attached) = bad[sets.root(i) as usize];
        if attached && without < with {
            keep[f as usize] = false;
            gone += 2;
        }
    }
    gone
}

/// Whether the face's vertices are an even permutation of their sorted order.
fn is_even([a, b, c]: [u32; 3]) -> bool {
    (a < b) == ((b < c) == (a < c))
}
