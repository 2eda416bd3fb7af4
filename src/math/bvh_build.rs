//! Builds the hierarchy of a [`Tree`](super::Tree): of few triangles on the calling thread, of many in parallel.
//!
//! Many triangles are divided into chunks of neighbours: consecutive cells of a grid along a Morton curve. Each chunk
//! gets its own hierarchy, and one more hierarchy joins the chunks. Chunks depend on the triangles only, so the result
//! is the same for any number of threads.

use std::ops::Range;

use glam::DVec3;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::leaf_collapser::collapse;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

use super::threads;

/// Triangles of a chunk, at least, and the most that are asked for: larger chunks make better hierarchies, and several make use of
/// several threads.
const CHUNK: [usize; 2] = [1 << 14, 1 << 16];
/// Chunks into which triangles are divided where the chunks may be of any size.
const CHUNKS: usize = 16;
/// Triangles below which the hierarchy is built in one piece.
const MANY: usize = 2 * CHUNK[0];
/// Triangles of a leaf, at most, in a hierarchy of chunks: this halves its memory, and takes no more time.
const LEAF: u32 = 2;
/// The traversal cost from which leaves always become one, up to [`LEAF`] triangles.
const LEAF_COST: f32 = LEAF as f32;
/// Bits per axis of a cell's number.
const CELL_BITS: u32 = 5;

/// A hierarchy of boxes.
pub(super) struct Built {
    /// The hierarchy. Children come after their parents. Each leaf has one triangle, or up to [`LEAF`] if there are chunks.
    pub bvh: Bvh2,
    /// For each chunk, the nodes below its root. They follow the nodes that join the chunks. None if the hierarchy was
    /// built in one piece.
    pub chunks: Vec<Range<usize>>,
}

/// Builds the hierarchy of at least one triangle. `centre_of` returns a triangle's centre and `box_of` its box, both
/// between -2 and 2 along each axis.
pub(super) fn build(
    triangles: usize,
    centre_of: impl Fn(usize) -> DVec3 + Sync,
    box_of: impl Fn(usize) -> Aabb + Sync,
) -> Built {
    if triangles < MANY {
        let boxes: Vec<Aabb> = (0..triangles).map(box_of).collect();
        return Built { bvh: in_one_piece(&boxes), chunks: Vec::new() };
    }
    let (order, ends) = chunks_of_neighbours(triangles, centre_of);
    let begin_of = |chunk: usize| if chunk == 0 { 0 } else { ends[chunk - 1] };
    let chunk_of = |chunk: usize| &order[begin_of(chunk)..ends[chunk]];
    let built = threads::map(ends.len(), 1, |chunk| {
        let boxes: Vec<Aabb> = chunk_of(chunk).iter().map(|&triangle| box_of(triangle as usize)).collect();
        let mut bvh = in_one_piece(&boxes);
        collapse(&mut bvh, LEAF, LEAF_COST);
        bvh
    });
    let roots: Vec<Aabb> = built.iter().map(|bvh| *bvh.nodes[0].aabb()).collect();
    let mut joined = in_one_piece(&roots);
    // Each chunk's root replaces its leaf among the joining nodes, and the other nodes of the chunk follow.
    let mut root_at = vec![0; ends.len()];
    for (at, node) in joined.nodes.iter().enumerate().filter(|(_, node)| node.is_leaf()) {
        root_at[joined.primitive_indices[node.first_index as usize] as usize] = at;
    }
    let joining = joined.nodes.len();
    let below_roots: usize = built.iter().map(|bvh| bvh.nodes.len() - 1).sum();
    joined.nodes.resize(joining + below_roots, Bvh2Node::default());
    let (above, mut rest) = joined.nodes.split_at_mut(joining);
    let (mut chunks, mut parts) = (Vec::with_capacity(ends.len()), Vec::with_capacity(ends.len()));
    for (chunk, bvh) in built.into_iter().enumerate() {
        let begin = chunks.last().map_or(joining, |chunk: &Range<usize>| chunk.end);
        let (part, after) = rest.split_at_mut(bvh.nodes.len() - 1);
        chunks.push(begin..begin + part.len());
        rest = after;
        let moved = Moved { bvh, begin, first_triangle: begin_of(chunk) };
        above[root_at[chunk]] = moved.node(0);
        parts.push((part, moved));
    }
    joined.primitive_indices = parts
        .iter()
        .zip(0..)
        .flat_map(|((_, moved), chunk)| moved.bvh.primitive_indices.iter().map(move |&at| (chunk, at)))
        .map(|(chunk, at)| chunk_of(chunk)[at as usize])
        .collect();
    threads::for_each(parts, |(part, moved)| {
        part.iter_mut().zip(1..).for_each(|(node, at)| *node = moved.node(at));
    });
    Built { bvh: joined, chunks }
}

/// The hierarchy of a chunk on the way to its place in the whole.
struct Moved {
    bvh: Bvh2,
    /// The place of the first node below the root.
    begin: usize,
    /// The place of the chunk's first triangle.
    first_triangle: usize,
}

impl Moved {
    /// A node as it is in the whole.
    fn node(&self, at: usize) -> Bvh2Node {
        let node = &self.bvh.nodes[at];
        #[expect(clippy::cast_possible_truncation, reason = "nodes are counted in u32")]
        let first_index = if node.is_leaf() {
            node.first_index + self.first_triangle as u32
        } else {
            node.first_index - 1 + self.begin as u32
        };
        Bvh2Node { first_index, ..*node }
    }
}

/// All triangles in an order in which neighbours follow each other, and the ends of the chunks in this order.
fn chunks_of_neighbours(triangles: usize, centre_of: impl Fn(usize) -> DVec3 + Sync) -> (Vec<u32>, Vec<usize>) {
    let least = (triangles / CHUNKS).clamp(CHUNK[0], CHUNK[1]);
    let cells = threads::map_cheap(triangles, |triangle| cell(centre_of(triangle)));
    let mut begin = vec![0usize; 1 << (3 * CELL_BITS)];
    cells.iter().for_each(|&cell| begin[cell as usize] += 1);
    let (mut total, mut ends) = (0, Vec::new());
    for count in &mut begin {
        if total >= ends.last().unwrap_or(&0) + least {
            ends.push(total);
        }
        total += std::mem::replace(count, total);
    }
    if ends.last() != Some(&total) {
        ends.push(total);
    }
    let mut order = vec![0u32; triangles];
    for (&cell, triangle) in cells.iter().zip(0u32..) {
        let next = &mut begin[cell as usize];
        order[*next] = triangle;
        *next += 1;
    }
    (order, ends)
}

fn in_one_piece(boxes: &[Aabb]) -> Bvh2 {
    #[expect(clippy::cast_possible_truncation, reason = "triangles are counted in u32")]
    let indices = (0..boxes.len() as u32).collect();
    PlocBuilder::new().build(PlocSearchDistance::Minimum, boxes, indices, SortPrecision::U64, 0)
}

/// The cell of a point, numbered along a Morton curve: the bits of its coordinates in turn.
fn cell(point: DVec3) -> u16 {
    let side = f64::from(1u32 << CELL_BITS);
    // Most coordinates are between -1 and 1.
    let at = ((point * 0.5 + 0.5) * side).clamp(DVec3::ZERO, DVec3::splat(side - 1.0));
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the cells")]
    let axes = at.to_array().map(|x| x as u16);
    let bit_of = |axis: usize, bit: u32| (axes[axis] >> bit & 1) << (3 * bit + axis as u32);
    (0..CELL_BITS).flat_map(|bit| (0..3).map(move |axis| (axis, bit))).map(|(axis, bit)| bit_of(axis, bit)).sum()
}

#[cfg(test)]
mod tests {
    use glam::Vec3A;

    use super::*;
    use crate::math::r3;

    fn small_box(triangle: usize) -> Aabb {
        #[expect(clippy::cast_precision_loss, reason = "a small number")]
        let low = DVec3::from(r3(triangle as f64)).as_vec3a();
        Aabb::new(low, low + Vec3A::splat(0.01))
    }

    fn build_small(triangles: usize) -> Built {
        build(triangles, |triangle| small_box(triangle).min.as_dvec3(), small_box)
    }

    #[test]
    fn a_hierarchy_of_chunks_has_each_triangle_once_within_all_its_ancestors() {
        let triangles = MANY + CHUNK[0] / 2;
        let built = build_small(triangles);
        let nodes = &built.bvh.nodes;
        assert_eq!(built.chunks.len(), 3);
        assert!(nodes.len() < 3 * triangles / 2, "most leaves have two triangles");
        assert!(built.chunks.iter().cloned().flatten().eq(5..nodes.len()));
        let (mut is_found, mut stack) = (vec![false; triangles], vec![0u32]);
        while let Some(at) = stack.pop() {
            let node = &nodes[at as usize];
            if node.is_leaf() {
                assert!(node.prim_count <= LEAF);
                let first = node.first_index as usize;
                let of_leaf = &built.bvh.primitive_indices[first..first + node.prim_count as usize];
                let mut bounds = Aabb::empty();
                for &triangle in of_leaf {
                    assert!(!std::mem::replace(&mut is_found[triangle as usize], true), "{triangle} twice");
                    bounds = bounds.union(&small_box(triangle as usize));
                }
                assert_eq!((node.aabb().min, node.aabb().max), (bounds.min, bounds.max));
                continue;
            }
            for child in [node.first_index, node.first_index + 1] {
                let (outer, inner) = (node.aabb(), nodes[child as usize].aabb());
                assert!(child > at && outer.min.cmple(inner.min).all() && outer.max.cmpge(inner.max).all());
                stack.push(child);
            }
        }
        assert!(is_found.into_iter().all(|found| found));
    }

    #[test]
    fn any_number_of_threads_builds_the_same_hierarchy() {
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
            let built = pool.install(|| build_small(MANY));
            built.bvh.nodes.iter().map(|node| (node.prim_count, node.first_index)).collect::<Vec<_>>()
        };
        assert!(on(1) == on(3));
    }

    #[test]
    fn bits_of_three_coordinates_alternate() {
        assert_eq!([-1.0, 1.0].map(|x| cell(DVec3::splat(x))), [0, (1 << 15) - 1]);
        assert_eq!(cell(DVec3::new(0.0, -1.0, -1.0)), 1 << 12);
        assert_eq!(cell(DVec3::new(-1.0, -1.0, -0.9)), 4);
    }

    #[test]
    fn triangles_at_one_point_are_one_chunk() {
        let built = build(MANY, |_| DVec3::ZERO, small_box);
        assert_eq!(built.chunks.len(), 1);
        assert_eq!(built.chunks[0], 1..built.bvh.nodes.len());
    }
}
