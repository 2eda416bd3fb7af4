use glam::DVec3;

use super::{Border, Meeting, NONE, Spoke};
use crate::math::collinear;
use crate::mesh::Edges;

impl Border<'_> {
    /// Moves one vertex of the boundary into another that shares no edge with it: the general collapse of a vertex into a
    /// vertex. Boundary edges that then join the same vertices close.
    ///
    /// ```text
    ///      x               x
    ///     / \              |
    ///   from to    ->      to
    ///     \ /              |
    ///      y               y
    /// ```
    ///
    /// Refused, with nothing changed, where the vertices share an edge, where an edge would have more than two faces or
    /// two in the same direction, where two faces would lie on one another, where a face would lose its area or turn over,
    /// and where a vertex would have come farther than `most`.
    pub fn merge(&mut self, from: u32, to: u32, most: f64) -> bool {
        let come = self.come(from, to);
        if come > most || !self.may_merge(from, to) {
            return false;
        }
        let target = self.target(from, to);
        for (one, other) in self.closed_by_merging(from, to) {
            self.edge_of[one as usize] = NONE;
            self.edge_of[other as usize] = NONE;
        }
        let [gone, kept] = [self.place(from), self.place(to)];
        let faces = std::mem::take(&mut self.faces_at[gone]);
        for &f in &faces {
            for v in self.surface.faces[f as usize].iter_mut().filter(|v| **v == from) {
                *v = to;
            }
        }
        self.faces_at[kept].extend(faces);
        self.surface.positions[to as usize] = target;
        self.into[gone] = to;
        self.strayed[kept] = self.strayed[kept].max(come);
        self.farthest = self.farthest.max(come);
        true
    }

    /// How far the vertices that make up either would have come in all, were one merged into the other.
    fn come(&self, from: u32, to: u32) -> f64 {
        let target = self.target(from, to);
        let come = |v: u32| self.strayed[self.place(v)] + self.position(v).distance(target);
        if self.meeting == Meeting::AtOne { come(from) } else { come(from).max(come(to)) }
    }

    /// Where the vertex will be that two become.
    fn target(&self, from: u32, to: u32) -> DVec3 {
        let halfway = || self.position(from).midpoint(self.position(to));
        match self.meeting {
            Meeting::AtOne => self.position(to),
            Meeting::Halfway => halfway(),
            Meeting::HalfwayInF32 => halfway().as_vec3().as_dvec3(),
        }
    }

    /// Whether no vertex would have come farther than `most`.
    pub fn may_stray(&self, from: u32, to: u32, most: f64) -> bool {
        self.come(from, to) <= most
    }

    /// The pairs of half-edges that lead to the same vertex.
    fn closed_by_merging(&self, from: u32, to: u32) -> Vec<(u32, u32)> {
        let mut of_from: Vec<(u32, u32)> = self.spokes(from).map(|s| (s.other, s.half_edge)).collect();
        of_from.sort_unstable();
        let pair = |s: Spoke| {
            let at = of_from.binary_search_by_key(&s.other, |&(other, _)| other).ok()?;
            Some((of_from[at].1, s.half_edge))
        };
        self.spokes(to).filter_map(pair).collect()
    }

    /// Whether the conditions of [`Border::merge`] hold but for the distance.
    pub fn may_merge(&mut self, from: u32, to: u32) -> bool {
        let [x, y] = [from, to].map(|v| self.faces_at[self.place(v)].len() as u64);
        self.steps = self.steps.saturating_sub(x + y);
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
        let stays = |&f: &u32| {
            let face = self.surface.faces[f as usize];
            let corners = face.map(|v| self.position(v));
            let moved = face.map(|v| if v == from || v == to { target } else { self.position(v) });
            self.keeps_facing(corners, moved)
        };
        let stay = |v: u32| self.faces_at[self.place(v)].iter().all(stays);
        self.spokes(to).all(fits) && stay(from) && (self.meeting == Meeting::AtOne || stay(to))
    }

    /// Cuts a boundary edge, and its face, at a vertex of the boundary that lies on it or near.
    ///
    /// ```text
    ///       o               o
    ///     /   \           / | \
    ///    a-----b   ->    a--c--b    the edge bends to the vertex, which stays where it is
    ///       c
    /// ```
    ///
    /// Refused, with nothing changed, where [`Border::merge`] with a new vertex on the edge would be.
    /// Answers the half-edge from the vertex on; the one that was cut then ends in it.
    pub fn cut(&mut self, half_edge: u32, vertex: u32) -> Option<u32> {
        if !self.may_cut(half_edge, vertex) {
            return None;
        }
        let (f, corner) = (half_edge / 3, half_edge % 3);
        let [a, b] = Edges::ends(&self.surface.faces, half_edge);
        let o = self.opposite(half_edge);
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        let new = self.surface.faces.len() as u32;
        let mut face = [o; 3];
        face[corner as usize] = vertex;
        face[(corner as usize + 1) % 3] = b;
        self.surface.faces.push(face);
        self.surface.source.push(self.surface.source[f as usize]);
        self.surface.faces[f as usize][(corner as usize + 1) % 3] = vertex;
        self.edge_of.extend([NONE; 3]);
        // The half-edge from b to o is the new face's now.
        let beyond = 3 * new + corner;
        for (old, moved, stays) in [(half_edge, beyond, true), (Edges::next(half_edge), Edges::next(beyond), false)] {
            let edge = self.edge_of[old as usize];
            self.edge_of[moved as usize] = edge;
            if edge != NONE {
                self.pieces[edge as usize].push(moved);
            }
            if !stays {
                self.edge_of[old as usize] = NONE;
            }
        }
        let of_b = self.place(b);
        for at in self.faces_at[of_b].iter_mut().filter(|at| **at == f) {
            *at = new;
        }
        if self.place[o as usize] != NONE {
            let of_o = self.place(o);
            self.faces_at[of_o].push(new);
        }
        let met: Vec<Spoke> = self.spokes(vertex).collect();
        for spoke in met {
            let closed = if spoke.other == a { half_edge } else { beyond };
            if spoke.other == a || spoke.other == b {
                self.edge_of[spoke.half_edge as usize] = NONE;
                self.edge_of[closed as usize] = NONE;
            }
        }
        let of_vertex = self.place(vertex);
        self.faces_at[of_vertex].extend([f, new]);
        Some(beyond)
    }

    /// Whether [`Border::cut`] would be made.
    pub fn may_cut(&mut self, half_edge: u32, vertex: u32) -> bool {
        let degree = self.faces_at[self.place(vertex)].len() as u64;
        self.steps = self.steps.saturating_sub(degree);
        let [a, b] = Edges::ends(&self.surface.faces, half_edge);
        let o = self.opposite(half_edge);
        if degree == 0 || !self.is_open(half_edge) || [a, b, o].contains(&vertex) {
            return false;
        }
        let mut met = [0, 0];
        for spoke in self.spokes(vertex) {
            if spoke.other == o {
                return false;
            }
            for (side, count) in met.iter_mut().enumerate().filter(|(side, _)| spoke.other == [a, b][*side]) {
                *count += 1;
                // The new half-edges run from a to the vertex and on to b.
                if *count > 1 || !self.is_open(spoke.half_edge) || spoke.leaves == (side == 1) {
                    return false;
                }
            }
        }
        let [pa, pb, po, p] = [a, b, o, vertex].map(|v| self.position(v));
        [[pa, p, po], [p, pb, po]].into_iter().all(|piece| self.keeps_facing([pa, pb, po], piece))
    }

    /// Whether a face keeps facing where it did, with some area.
    fn keeps_facing(&self, before: [DVec3; 3], after: [DVec3; 3]) -> bool {
        let [before, after @ [a, b, c]] = [before, after].map(|corners| corners.map(|p| p * self.to_unit));
        let area = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
        area(before).dot(area(after)) > 0.0 && !collinear(a, b, c)
    }
}
