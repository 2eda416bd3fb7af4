//! The two edits of a border: merging two vertices, and splitting an edge at a vertex.

use std::sync::Arc;

use glam::DVec3;

use super::{Border, MergePosition, NONE, Spoke};
use crate::math::collinear;
use crate::mesh::HalfEdge;

impl Border<'_> {
    /// Merges a boundary vertex into another that shares no edge with it (vertex-pair contraction). Boundary edges that
    /// then connect the same two vertices close.
    ///
    /// ```text
    ///      x               x
    ///     / \              |
    ///   from to    ->      to
    ///     \ /              |
    ///      y               y
    /// ```
    ///
    /// Returns `false` and changes nothing where the merge would violate a condition: the vertices share an edge; an edge
    /// would get more than two faces, or two in the same direction; two faces would coincide; a face would lose its area
    /// or flip; or a vertex would be displaced by more than `max_displacement`.
    pub fn merge(&mut self, from: u32, to: u32, max_displacement: f64) -> bool {
        let displacement = self.displacement_by_merging(from, to);
        if displacement > max_displacement || !self.can_merge(from, to) {
            return false;
        }
        let target = self.target(from, to);
        for (one, other) in self.closed_by_merging(from, to) {
            self.edge_of[one.index()] = NONE;
            self.edge_of[other.index()] = NONE;
        }
        let [from_index, to_index] = [self.boundary_index(from), self.boundary_index(to)];
        let faces = std::mem::take(&mut self.faces_at[from_index]);
        let surface = Arc::make_mut(self.surface);
        for &f in &faces {
            for v in surface.faces[f as usize].iter_mut().filter(|v| **v == from) {
                *v = to;
            }
        }
        surface.positions[to as usize] = target;
        self.faces_at[to_index].extend(faces);
        self.merged_into[from_index] = to;
        self.displacement[to_index] = self.displacement[to_index].max(displacement);
        self.max_displacement = self.max_displacement.max(displacement);
        true
    }

    /// The largest total displacement among the vertices merged into either vertex, if one were merged into the other.
    fn displacement_by_merging(&self, from: u32, to: u32) -> f64 {
        let target = self.target(from, to);
        let total = |v: u32| self.displacement[self.boundary_index(v)] + self.position(v).distance(target);
        if self.merge_position == MergePosition::Kept { total(from) } else { total(from).max(total(to)) }
    }

    /// The position of the merged vertex.
    fn target(&self, from: u32, to: u32) -> DVec3 {
        let midpoint = || self.position(from).midpoint(self.position(to));
        match self.merge_position {
            MergePosition::Kept => self.position(to),
            MergePosition::Midpoint => midpoint(),
            MergePosition::MidpointF32 => midpoint().as_vec3().as_dvec3(),
        }
    }

    /// Whether merging displaces no vertex by more than `max_displacement`.
    pub fn is_within_displacement(&self, from: u32, to: u32, max_displacement: f64) -> bool {
        self.displacement_by_merging(from, to) <= max_displacement
    }

    /// The pairs of half-edges, one at each vertex, whose other ends coincide.
    fn closed_by_merging(&self, from: u32, to: u32) -> Vec<(HalfEdge, HalfEdge)> {
        let mut of_from: Vec<(u32, HalfEdge)> = self.spokes(from).map(|s| (s.other, s.half_edge)).collect();
        of_from.sort_unstable();
        let pair = |s: Spoke| {
            let at = of_from.binary_search_by_key(&s.other, |&(other, _)| other).ok()?;
            Some((of_from[at].1, s.half_edge))
        };
        self.spokes(to).filter_map(pair).collect()
    }

    /// Whether the conditions of [`Border::merge`] hold, except for the displacement.
    pub fn can_merge(&mut self, from: u32, to: u32) -> bool {
        let [x, y] = [from, to].map(|v| self.faces_at[self.boundary_index(v)].len() as u64);
        self.budget = self.budget.saturating_sub(x + y);
        if from == to || x == 0 || y == 0 || self.spokes(to).any(|s| s.other == from) {
            return false;
        }
        let mut of_from: Vec<Spoke> = self.spokes(from).collect();
        of_from.sort_unstable_by_key(|s| s.other);
        let fits = |s: Spoke| {
            let begin = of_from.partition_point(|t| t.other < s.other);
            match of_from[begin..].iter().take_while(|t| t.other == s.other).count() {
                0 => true,
                1 => {
                    let t = of_from[begin];
                    self.is_open(s.half_edge)
                        && self.is_open(t.half_edge)
                        && s.leaves != t.leaves
                        && self.opposite(s.half_edge) != self.opposite(t.half_edge)
                }
                _ => false,
            }
        };
        let target = self.target(from, to);
        let keeps_face = |&f: &u32| {
            let face = self.surface.faces[f as usize];
            let corners = face.map(|v| self.position(v));
            let moved = face.map(|v| if v == from || v == to { target } else { self.position(v) });
            self.keeps_orientation(corners, moved)
        };
        let keeps_faces = |v: u32| self.faces_at[self.boundary_index(v)].iter().all(keeps_face);
        self.spokes(to).all(fits)
            && keeps_faces(from)
            && (self.merge_position == MergePosition::Kept || keeps_faces(to))
    }

    /// Splits a boundary edge and its face at another boundary vertex that lies on or near the edge.
    ///
    /// ```text
    ///       o               o
    ///     /   \           / | \
    ///    a-----b   ->    a--c--b    the edge bends to the vertex, which keeps its position
    ///       c
    /// ```
    ///
    /// Returns the half-edge from the vertex onward; the split half-edge then ends at the vertex. Returns `None` and changes
    /// nothing where [`Border::merge`] with a new vertex on the edge would be refused.
    pub fn split_edge(&mut self, half_edge: HalfEdge, vertex: u32) -> Option<HalfEdge> {
        if !self.can_split_edge(half_edge, vertex) {
            return None;
        }
        let (f, corner) = (half_edge.0 / 3, half_edge.0 % 3);
        let [a, b] = half_edge.ends(&self.surface.faces);
        let o = self.opposite(half_edge);
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        let new = self.surface.faces.len() as u32;
        let mut face = [o; 3];
        face[corner as usize] = vertex;
        face[(corner as usize + 1) % 3] = b;
        let surface = Arc::make_mut(self.surface);
        surface.faces.push(face);
        surface.source.push(surface.source[f as usize]);
        surface.faces[f as usize][(corner as usize + 1) % 3] = vertex;
        self.edge_of.extend([NONE; 3]);
        // The half-edge from b to o now belongs to the new face.
        let beyond = HalfEdge(3 * new + corner);
        for (old, moved, keeps_edge) in [(half_edge, beyond, true), (half_edge.next(), beyond.next(), false)] {
            let edge = self.edge_of[old.index()];
            self.edge_of[moved.index()] = edge;
            if edge != NONE {
                self.pieces[edge as usize].push(moved);
            }
            if !keeps_edge {
                self.edge_of[old.index()] = NONE;
            }
        }
        let of_b = self.boundary_index(b);
        for at in self.faces_at[of_b].iter_mut().filter(|at| **at == f) {
            *at = new;
        }
        if self.boundary_index[o as usize] != NONE {
            let of_o = self.boundary_index(o);
            self.faces_at[of_o].push(new);
        }
        let spokes: Vec<Spoke> = self.spokes(vertex).collect();
        for spoke in spokes {
            let closed = if spoke.other == a { half_edge } else { beyond };
            if spoke.other == a || spoke.other == b {
                self.edge_of[spoke.half_edge.index()] = NONE;
                self.edge_of[closed.index()] = NONE;
            }
        }
        let of_vertex = self.boundary_index(vertex);
        self.faces_at[of_vertex].extend([f, new]);
        Some(beyond)
    }

    /// Whether [`Border::split_edge`] would succeed.
    pub fn can_split_edge(&mut self, half_edge: HalfEdge, vertex: u32) -> bool {
        let degree = self.faces_at[self.boundary_index(vertex)].len() as u64;
        self.budget = self.budget.saturating_sub(degree);
        let [a, b] = half_edge.ends(&self.surface.faces);
        let o = self.opposite(half_edge);
        if degree == 0 || !self.is_open(half_edge) || [a, b, o].contains(&vertex) {
            return false;
        }
        let mut shared = [0, 0];
        for spoke in self.spokes(vertex) {
            if spoke.other == o {
                return false;
            }
            for (side, count) in shared.iter_mut().enumerate().filter(|(side, _)| spoke.other == [a, b][*side]) {
                *count += 1;
                // The new half-edges run from a to the vertex and on to b.
                if *count > 1 || !self.is_open(spoke.half_edge) || spoke.leaves == (side == 1) {
                    return false;
                }
            }
        }
        let [pa, pb, po, p] = [a, b, o, vertex].map(|v| self.position(v));
        [[pa, p, po], [p, pb, po]].into_iter().all(|piece| self.keeps_orientation([pa, pb, po], piece))
    }

    /// Whether a face keeps its orientation and has an area.
    fn keeps_orientation(&self, before: [DVec3; 3], after: [DVec3; 3]) -> bool {
        let [before, after @ [a, b, c]] = [before, after].map(|corners| corners.map(|p| p * self.to_unit));
        let area = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
        area(before).dot(area(after)) > 0.0 && !collinear(a, b, c)
    }
}
