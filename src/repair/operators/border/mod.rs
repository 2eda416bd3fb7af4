//! The boundary of a surface while its cracks are closed by merging vertices and splitting edges.
//!
//! A half-edge mesh allows one fan at each vertex, but a crack closed vertex by vertex has two fans where it is half closed. So
//! this structure lists the faces at each boundary vertex and identifies boundary edges by half-edge. The rest of the surface
//! may be non-manifold. Both edits change indices of existing faces: they remove no face, and they create or change no
//! position, except where vertices meet at their midpoint.

mod edits;

use std::sync::Arc;

use glam::DVec3;

use crate::math::{Tree, nearest_on_segment, unit_scale};
use crate::mesh::{Edges, HalfEdge, Parts, Surface};

/// The index that stands for no edge and no boundary vertex.
const NONE: u32 = u32::MAX;

/// The least cosine of the angle between boundary edges that count as parallel.
const MIN_COSINE: f64 = 0.5;

/// The boundary edges, with a search tree and the adjacency that merging and splitting need.
pub(super) struct Border<'a> {
    /// The surface under edit.
    pub surface: &'a mut Arc<Surface>,
    /// The original boundary vertices, ascending.
    pub vertices: Vec<u32>,
    /// For each vertex its index in `vertices`, or [`NONE`].
    boundary_index: Vec<u32>,
    /// The faces at each of `vertices`.
    faces_at: Vec<Vec<u32>>,
    /// The ends of the original boundary edges.
    edges: Vec<[u32; 2]>,
    /// For each of `edges` the boundary half-edges into which it was split. Some of them may be closed by now.
    pieces: Vec<Vec<HalfEdge>>,
    /// For each boundary half-edge the index in `edges` of the edge that it belongs to, otherwise [`NONE`].
    edge_of: Vec<u32>,
    /// For each of `vertices` the vertex that it was merged into, or itself.
    merged_into: Vec<u32>,
    /// For each of `vertices` the largest displacement of the vertices merged into it.
    displacement: Vec<f64>,
    /// The largest of these displacements.
    max_displacement: f64,
    tree: Tree,
    /// The power of two that brings coordinates into the range of exact predicates.
    to_unit: f64,
    /// Where merged vertices are placed.
    pub merge_position: MergePosition,
    /// The number of faces and edges that may still be visited; the limit guards against crafted input.
    pub budget: u64,
}

/// Where two merged boundary vertices are placed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum MergePosition {
    /// At the position of the vertex that stays.
    #[default]
    Kept,
    /// At the midpoint.
    Midpoint,
    /// At the midpoint, rounded to f32.
    MidpointF32,
}

/// A half-edge at a vertex.
#[derive(Debug, Clone, Copy)]
struct Spoke {
    half_edge: HalfEdge,
    /// The vertex at the half-edge's other end.
    other: u32,
    /// Whether the half-edge starts at the vertex.
    leaves: bool,
}

/// A direction in which the boundary leaves a point, and whether the half-edge there has the same direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct BoundaryDirection {
    direction: DVec3,
    leaves: bool,
}

/// A boundary edge near a vertex.
#[derive(Debug, Clone, Copy)]
pub(super) struct NearbyEdge {
    /// The index of the original edge that contains this edge.
    pub edge: u32,
    /// The boundary half-edge.
    pub half_edge: HalfEdge,
    /// The half-edge's start and end vertex.
    pub ends: [u32; 2],
    /// The position of the closest point between the ends, from 0 to 1.
    pub ratio: f64,
    /// The distance to the closest point, in the model's unit.
    pub distance: f64,
}

impl<'a> Border<'a> {
    /// Collects the boundary of a surface with the edges `all`; `None` where it has none. O(n) time, and O(n log n) for the tree over
    /// boundary edges. The surface is copied before the first change, if others share it.
    pub fn new(surface: &'a mut Arc<Surface>, all: &Edges) -> Option<Self> {
        let open: Vec<(usize, u32)> =
            all.iter().enumerate().filter(|(_, h)| h.len() == 1).map(|(e, h)| (e, h[0])).collect();
        if open.is_empty() {
            return None;
        }
        let mut boundary_index = vec![NONE; surface.positions.len()];
        let edges: Vec<[u32; 2]> = open.iter().map(|&(e, _)| all.vertices(e)).collect();
        for &v in edges.iter().flatten() {
            boundary_index[v as usize] = 0;
        }
        let vertices: Vec<u32> = (0u32..).zip(&boundary_index).filter(|&(_, &p)| p == 0).map(|(v, _)| v).collect();
        for (at, &v) in (0u32..).zip(&vertices) {
            boundary_index[v as usize] = at;
        }
        let mut faces_at = vec![Vec::new(); vertices.len()];
        for (f, &[a, b, c]) in (0u32..).zip(&surface.faces).filter(|&(_, &[a, b, c])| a != b && b != c && c != a) {
            for v in [a, b, c].into_iter().filter(|&v| boundary_index[v as usize] != NONE) {
                faces_at[boundary_index[v as usize] as usize].push(f);
            }
        }
        let mut edge_of = vec![NONE; 3 * surface.faces.len()];
        for (e, &(_, h)) in (0u32..).zip(&open) {
            edge_of[h as usize] = e;
        }
        let segments: Vec<[u32; 3]> = edges.iter().map(|&[a, b]| [a, b, b]).collect();
        let tree = Tree::new(&surface.positions, &segments);
        Some(Self {
            boundary_index,
            faces_at,
            pieces: open.iter().map(|&(_, h)| vec![HalfEdge(h)]).collect(),
            edge_of,
            merged_into: vertices.clone(),
            displacement: vec![0.0; vertices.len()],
            max_displacement: 0.0,
            tree,
            to_unit: unit_scale(&surface.positions),
            merge_position: MergePosition::Kept,
            budget: 1_000_000 + 400 * edges.len() as u64,
            vertices,
            edges,
            surface,
        })
    }

    /// The position of a vertex.
    pub fn position(&self, v: u32) -> DVec3 {
        self.surface.positions[v as usize]
    }

    /// The vertex into which a boundary vertex was merged, or the vertex itself.
    pub fn current_vertex(&mut self, mut v: u32) -> u32 {
        loop {
            let at = self.boundary_index(v);
            let next = self.merged_into[at];
            if next == v {
                return v;
            }
            self.merged_into[at] = self.merged_into[self.boundary_index(next)];
            v = next;
        }
    }

    /// The index in `vertices` of an original boundary vertex.
    pub fn boundary_index(&self, v: u32) -> usize {
        self.boundary_index[v as usize] as usize
    }

    /// The largest displacement of a vertex so far, in the model's unit.
    pub fn max_displacement(&self) -> f64 {
        self.max_displacement
    }

    /// The number of original boundary edges.
    pub fn edges_before(&self) -> usize {
        self.edges.len()
    }

    /// The original boundary edges with their lengths.
    pub fn edge_lengths(&self) -> impl Iterator<Item = ([u32; 2], f64)> + '_ {
        self.edges.iter().map(|&[a, b]| ([a, b], self.position(a).distance(self.position(b))))
    }

    /// The half-edges at a boundary vertex: those that start and those that end there.
    fn spokes(&self, v: u32) -> impl Iterator<Item = Spoke> + '_ {
        let boundary_index = self.boundary_index[v as usize];
        let faces = self.faces_at.get(boundary_index as usize).map_or(&[][..], Vec::as_slice);
        faces.iter().flat_map(move |&f| {
            let face = self.surface.faces[f as usize];
            let corner = if face[0] == v { 0 } else { 1 + u32::from(face[1] != v) };
            let [next, last] = [(corner + 1) % 3, (corner + 2) % 3];
            [
                Spoke { half_edge: HalfEdge(3 * f + corner), other: face[next as usize], leaves: true },
                Spoke { half_edge: HalfEdge(3 * f + last), other: face[last as usize], leaves: false },
            ]
        })
    }

    /// Whether a half-edge is on the boundary.
    fn is_open(&self, half_edge: HalfEdge) -> bool {
        self.edge_of[half_edge.index()] != NONE
    }

    /// The corner of a half-edge's face that is not on the half-edge.
    fn opposite(&self, half_edge: HalfEdge) -> u32 {
        Edges::opposite(&self.surface.faces, half_edge.0)
    }

    /// The other ends of the boundary edges at a vertex.
    pub fn neighbours(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        self.spokes(v).filter(|s| self.is_open(s.half_edge)).map(|s| s.other)
    }

    /// Whether a vertex is on the boundary.
    pub fn is_on_boundary(&self, v: u32) -> bool {
        self.neighbours(v).next().is_some()
    }

    /// The directions in which the boundary leaves a vertex.
    pub fn boundary_directions(&self, v: u32) -> Vec<BoundaryDirection> {
        let at = self.position(v);
        let open = self.spokes(v).filter(|s| self.is_open(s.half_edge));
        open.map(|s| BoundaryDirection {
            direction: (self.position(s.other) - at).normalize_or_zero(),
            leaves: s.leaves,
        })
        .collect()
    }

    /// The directions in which the boundary leaves a point on a boundary edge from `a` to `b`.
    pub fn boundary_directions_on([a, b]: [DVec3; 2]) -> [BoundaryDirection; 2] {
        let direction = (b - a).normalize_or_zero();
        [BoundaryDirection { direction, leaves: true }, BoundaryDirection { direction: -direction, leaves: false }]
    }

    /// Whether two boundaries run side by side in opposite directions, as the two sides of a crack do.
    pub fn are_opposed(one: &[BoundaryDirection], other: &[BoundaryDirection]) -> bool {
        one.iter().any(|x| other.iter().any(|y| x.leaves != y.leaves && x.direction.dot(y.direction) > MIN_COSINE))
    }

    /// Appends to `result` the boundary edges closer to a vertex than `reach`, nearest first, without those at the vertex.
    pub fn edges_near(&mut self, v: u32, reach: f64, result: &mut Vec<NearbyEdge>) {
        let p = self.position(v);
        let mut budget = self.budget;
        // The tree holds the original edges; the reach covers the displacement of their ends since.
        self.tree.around(p, reach + self.max_displacement, |e| {
            for &half_edge in self.pieces[e as usize].iter().filter(|&&h| self.edge_of[h.index()] == e) {
                budget = budget.saturating_sub(1);
                let ends = half_edge.ends(&self.surface.faces);
                let [a, b] = ends.map(|v| self.position(v));
                let foot = nearest_on_segment(p, [a, b]);
                let distance = p.distance(foot);
                if distance < reach && !ends.contains(&v) {
                    result.push(NearbyEdge { edge: e, half_edge, ends, ratio: ratio(foot, [a, b]), distance });
                }
            }
            budget = budget.saturating_sub(1);
            budget > 0
        });
        self.budget = budget;
        // Sorted for a deterministic result, since the tree's order is arbitrary.
        result.sort_unstable_by(|x, y| x.distance.total_cmp(&y.distance).then(x.half_edge.cmp(&y.half_edge)));
    }

    /// The last piece of an edge after its splits, in half-edge direction; `None` where that piece is closed.
    pub fn last_piece(&self, edge: u32) -> Option<HalfEdge> {
        self.pieces[edge as usize].last().copied().filter(|&h| self.edge_of[h.index()] == edge)
    }

    /// A note for the report where the budget ended the search.
    pub fn exhausted_note(&self) -> Option<String> {
        (self.budget == 0).then(|| "some boundary edges were skipped: too many lie close together".to_owned())
    }

    /// The length of the original boundary edge that contains a half-edge, measured between the ends' current positions.
    pub fn length_before(&self, half_edge: HalfEdge) -> f64 {
        let [a, b] = self.edges[self.edge_of[half_edge.index()] as usize];
        self.position(a).distance(self.position(b))
    }
}

/// The position of `foot` on the segment from `a` to `b`, from 0 to 1.
fn ratio(foot: DVec3, [a, b]: [DVec3; 2]) -> f64 {
    let length = a.distance(b);
    if foot == b {
        1.0
    } else if length > 0.0 {
        (a.distance(foot) / length).min(1.0)
    } else {
        0.0
    }
}

/// The parts of a surface that have a boundary.
pub(crate) struct OpenParts {
    /// The number of open parts.
    pub count: u64,
    /// The faces of the open parts, ascending.
    pub faces: Vec<u32>,
    /// For each of `faces` its part, numbered among the open parts.
    pub part: Vec<u32>,
}

/// Finds the parts that have an edge with exactly one face.
pub(crate) fn open_parts(surface: &Surface) -> OpenParts {
    let edges = Edges::new(&surface.faces);
    let mut result = OpenParts { count: 0, faces: Vec::new(), part: Vec::new() };
    if edges.iter().all(|h| h.len() != 1) {
        return result;
    }
    let parts = Parts::new(surface, &edges);
    let open = parts.open(&edges);
    let mut number = vec![Parts::NONE; parts.count];
    for (number, count) in number.iter_mut().zip(&open).filter(|(_, open)| **open).map(|(n, _)| n).zip(0u32..) {
        *number = count;
        result.count += 1;
    }
    for (f, &part) in (0u32..).zip(&parts.of_face) {
        if part != Parts::NONE && open[part as usize] {
            result.faces.push(f);
            result.part.push(number[part as usize]);
        }
    }
    result
}
