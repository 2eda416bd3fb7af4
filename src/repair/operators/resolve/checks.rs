//! What is asked of a surface between the rounds.

use rustc_hash::FxHashSet;

use super::super::quantise::quantise;
use super::super::{Counter, Counts};
use crate::inspect::{Analysis, Intersections, intersections};
use crate::mesh::{Edges, Surface, position_key, weld_exactly};
use crate::repair::{Cancelled, Context};

/// Whether a reader of STL would find every edge between two faces that agree, and one fan at every vertex.
pub(super) fn is_manifold_by_position(surface: &Surface) -> bool {
    let mut welded = surface.clone();
    quantise(&mut welded);
    weld_exactly(&mut welded);
    let counts = Counts::of(&welded);
    use Counter::{BoundaryEdges, MisorientedEdges, NonmanifoldEdges, PinchedVertices};
    [BoundaryEdges, MisorientedEdges, NonmanifoldEdges, PinchedVertices].iter().all(|&c| counts.get(c) == 0)
}

/// Marks faces where sheets could not be kept apart by position: those at edges that more than two faces share. Answers how many
/// such edges there are.
pub(super) fn mark_pinched(apart: &Surface, work: &Surface, takes_part: &mut [bool]) -> u64 {
    let mut welded = apart.clone();
    weld_exactly(&mut welded);
    let edges = Edges::new(&welded.faces);
    let mut at: FxHashSet<[u64; 3]> = FxHashSet::default();
    let mut count = 0;
    for half_edges in edges.iter().filter(|half_edges| half_edges.len() > 2) {
        at.extend(
            Edges::ends(&welded.faces, half_edges[0]).iter().map(|&v| position_key(welded.positions[v as usize])),
        );
        count += 1;
    }
    if count > 0 {
        for (face, takes) in work.faces.iter().zip(takes_part) {
            *takes |= face.iter().any(|&v| at.contains(&position_key(work.positions[v as usize])));
        }
    }
    count
}

/// The faces that intersect.
pub(super) fn crossings(surface: &Surface, context: &Context<'_>) -> Result<Intersections, Cancelled> {
    let soup = surface.to_soup();
    intersections(&Analysis::new((&soup).into(), context)?, context)
}

/// How many pairs of faces intersect.
pub(super) fn count(found: &Intersections) -> u64 {
    found.counts.pairs.unwrap_or(0)
}
