//! Boundary loops and chains of an open surface.

use super::adjacency::Edges;
use super::connectivity::{Fans, UnionFind, fans_at};
use super::surface::Surface;

/// The holes of a surface, as closed walks along its boundary.
///
/// ```text
///      face            a loop runs against the faces' half-edges,
///   u -----> v         so that a patch whose edges run along the loop
///   u <----- v         fits the faces around it
///      loop
/// ```
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct BoundaryLoops {
    /// Simple loops (no vertex occurs twice) of at least three vertices, in the order of their smallest half-edge.
    pub simple: Vec<Vec<u32>>,
    /// For each simple loop, a face at its border.
    pub face: Vec<u32>,
    /// Number of boundary edges in no simple loop: edges of open walks, which need inconsistent winding or non-manifold
    /// edges, and of two-edge loops.
    pub left: u64,
}

/// Finds the boundary loops: walks along the boundary from fan to fan, and splits each walk where it visits a vertex
/// again.
///
/// The surface should be consistently wound; otherwise walks may not close, and their edges count in
/// [`BoundaryLoops::left`].
#[must_use]
pub fn boundary_loops(surface: &Surface, edges: &Edges) -> BoundaryLoops {
    let faces = &surface.faces;
    let mut boundary: Vec<u32> = edges.iter().filter(|h| h.len() == 1).map(|h| h[0]).collect();
    boundary.sort_unstable();
    let mut is_at_boundary = vec![false; surface.positions.len()];
    boundary.iter().flat_map(|&h| Edges::ends(faces, h)).for_each(|v| is_at_boundary[v as usize] = true);
    let of_corner = fans_at(surface, edges, |v| is_at_boundary[v as usize]);
    // A boundary half-edge u -> v of a face is walked as v -> u. The walk continues in u's fan with the half-edge that
    // ends in u, found by the fan of the corner at its end.
    let mut by_end: Vec<(u32, u32)> = boundary.iter().map(|&h| (of_corner[Edges::next(h) as usize], h)).collect();
    by_end.sort_unstable();
    let mut used = vec![false; by_end.len()];
    let position_of = |h: u32| by_end.binary_search(&(of_corner[Edges::next(h) as usize], h)).ok();
    let mut loops = BoundaryLoops::default();
    for &start in &boundary {
        let Some(at) = position_of(start) else { continue };
        if used[at] {
            continue;
        }
        let mut walk = vec![start];
        used[at] = true;
        let mut h = start;
        let closed = loop {
            let fan = of_corner[h as usize];
            let from = by_end.partition_point(|&(f, _)| f < fan);
            let Some(found) = (from..by_end.len())
                .take_while(|&i| by_end[i].0 == fan)
                .take(64)
                .find(|&i| !used[i] || by_end[i].1 == start)
            else {
                break false;
            };
            h = by_end[found].1;
            if h == start {
                break true;
            }
            used[found] = true;
            walk.push(h);
        };
        if closed {
            split_into_simple_loops(faces, &walk, &mut loops);
        } else {
            loops.left += walk.len() as u64;
        }
    }
    loops
}

/// Splits a closed walk at each vertex that it visits more than once.
fn split_into_simple_loops(faces: &[[u32; 3]], walk: &[u32], loops: &mut BoundaryLoops) {
    // Maps each vertex on the stack to its index there.
    let mut at: std::collections::HashMap<u32, usize> = std::collections::HashMap::with_capacity(walk.len());
    let mut stack: Vec<(u32, u32)> = Vec::with_capacity(walk.len());
    for &h in walk {
        let [_, v] = Edges::ends(faces, h);
        if let Some(&from) = at.get(&v) {
            pop_loop(&mut stack, from, &mut at, loops);
        }
        at.insert(v, stack.len());
        stack.push((v, h / 3));
    }
    pop_loop(&mut stack, 0, &mut at, loops);
}

fn pop_loop(
    stack: &mut Vec<(u32, u32)>,
    from: usize,
    at: &mut std::collections::HashMap<u32, usize>,
    loops: &mut BoundaryLoops,
) {
    let piece = stack.split_off(from);
    for (v, _) in &piece {
        at.remove(v);
    }
    if piece.len() < 3 {
        loops.left += piece.len() as u64;
    } else {
        loops.face.push(piece[0].1);
        loops.simple.push(piece.iter().map(|&(v, _)| v).collect());
    }
}

/// One half-edge of each chain of boundary edges, whatever the winding. Boundary edges that bound the same fan are in
/// one chain.
#[must_use]
pub fn boundary_chains(faces: &[[u32; 3]], edges: &Edges, fans: &Fans) -> Vec<u32> {
    let boundary: Vec<u32> = edges.iter().filter(|h| h.len() == 1).map(|h| h[0]).collect();
    let mut ends: Vec<(Option<u32>, u32)> = boundary
        .iter()
        .zip(0u32..)
        .flat_map(|(&h, i)| [h, Edges::next(h)].map(|corner| (fans.of_corner(faces, corner), i)))
        .collect();
    ends.sort_unstable();
    let mut sets = UnionFind::new(boundary.len());
    for pair in ends.windows(2).filter(|p| p[0].0 == p[1].0) {
        sets.unite(pair[0].1, pair[1].1);
    }
    (0u32..).zip(&boundary).filter(|&(i, _)| sets.root(i) == i).map(|(_, &h)| h).collect()
}

/// The number of chains of boundary edges.
#[must_use]
pub fn count_boundary_chains(faces: &[[u32; 3]], edges: &Edges, fans: &Fans) -> u64 {
    boundary_chains(faces, edges, fans).len() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn surface(faces: Vec<[u32; 3]>) -> Surface {
        let n = faces.iter().flatten().max().map_or(0, |m| m + 1);
        let source = vec![0; faces.len()];
        Surface { positions: (0..n).map(|i| DVec3::splat(f64::from(i))).collect(), faces, source }
    }

    fn loops(faces: Vec<[u32; 3]>) -> (BoundaryLoops, u64) {
        let surface = surface(faces);
        let edges = Edges::new(&surface.faces);
        let fans = Fans::new(&surface, &edges);
        (boundary_loops(&surface, &edges), count_boundary_chains(&surface.faces, &edges, &fans))
    }

    #[test]
    fn a_loop_runs_against_the_half_edges_of_the_faces() {
        let (found, chains) = loops(vec![[0, 1, 2], [0, 2, 3]]);
        assert_eq!(found.simple, [[1, 0, 3, 2]]);
        assert_eq!((found.left, chains), (0, 1));
    }

    #[test]
    fn two_loops_that_touch_in_a_vertex_are_two_simple_loops() {
        // The two triangles share only vertex 0.
        let (found, _) = loops(vec![[0, 1, 2], [0, 3, 4]]);
        assert_eq!(found.simple.len(), 2);
        assert!(found.simple.iter().all(|l| l.len() == 3));
    }

    #[test]
    fn the_edges_of_a_walk_that_does_not_close_are_left() {
        // The second face is flipped.
        let (found, chains) = loops(vec![[0, 1, 2], [0, 3, 2]].into_iter().map(|f: [u32; 3]| f).collect());
        let (turned, _) = loops(vec![[0, 1, 2], [2, 3, 0]]);
        assert_eq!(turned.left, 0);
        assert_eq!(found.simple.len() as u64 + found.left.min(1), 1);
        assert_eq!(chains, 1);
    }
}
