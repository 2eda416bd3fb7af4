//! Constraint segments of a triangulation, and the faces whose boundary they form.

use std::cmp::Ordering;
use std::collections::VecDeque;

use smallvec::SmallVec;

use super::{Line, NONE, Support, Triangle, Triangulation};
use crate::arrange::points::Points;
use crate::math::Sign;

impl Triangulation<'_> {
    /// For each triangle, the sorted faces that contain the triangle; all bounding segments must have been inserted.
    /// Crossing a bounding segment enters or leaves the segment's face, and no face contains the outermost triangles.
    /// None if the lists would have more than `most` entries in total.
    pub fn covers(&self, most: usize) -> Option<Vec<SmallVec<[u32; 2]>>> {
        let mut covers: Vec<Option<SmallVec<[u32; 2]>>> = vec![None; self.triangles.len()];
        let mut queue = VecDeque::new();
        let mut total = 0;
        for (t, triangle) in (0u32..).zip(&self.triangles) {
            if triangle.across.contains(&NONE) {
                covers[t as usize] = Some(SmallVec::new());
                queue.push_back(t);
            }
        }
        while let Some(t) = queue.pop_front() {
            let cover = covers[t as usize].clone().unwrap_or_default();
            let Triangle { across, lines, .. } = self.triangles[t as usize];
            for (next, set) in across.into_iter().zip(lines) {
                if next == NONE || covers[next as usize].is_some() {
                    continue;
                }
                let mut beyond = cover.clone();
                let bounds = self.set(set).iter().filter_map(|&line| self.lines[line as usize].bounds);
                for face in bounds {
                    match beyond.binary_search(&face) {
                        Ok(at) => drop(beyond.remove(at)),
                        Err(at) => beyond.insert(at, face),
                    }
                }
                total += beyond.len();
                if total > most {
                    return None;
                }
                covers[next as usize] = Some(beyond);
                queue.push_back(next);
            }
        }
        Some(covers.into_iter().map(Option::unwrap_or_default).collect())
    }

    /// Inserts a line and its end points.
    pub fn insert_line(&mut self, line: Line) {
        let [a, b] = line.ends.map(|end| self.insert(end));
        #[expect(clippy::cast_possible_truncation, reason = "fewer than there are pairs of faces")]
        let index = self.lines.len() as u32;
        self.lines.push(line);
        let mut from = a;
        while from != b {
            from = self.advance(from, b, index);
        }
    }

    /// Inserts segments with the same carrier, which may overlap: each stretch that they cover together is one line.
    pub fn insert_overlapping(&mut self, segments: &[[u32; 2]], support: Support) {
        let [first, ..] = segments else { return };
        let axes = [(self.axis + 1) % 3, (self.axis + 2) % 3];
        let axis = axes.into_iter().find(|&k| self.points.compare(k, first[0], first[1]) != Ordering::Equal);
        let axis = axis.unwrap_or(axes[0]);
        let order = |points: &Points, a: u32, b: u32| points.compare(axis, a, b);
        let mut ascending: Vec<[u32; 2]> =
            segments.iter().map(|&[a, b]| if order(self.points, a, b).is_gt() { [b, a] } else { [a, b] }).collect();
        ascending.sort_by(|[a, _], [b, _]| order(self.points, *a, *b).then(a.cmp(b)));
        let mut stretches: Vec<[u32; 2]> = Vec::new();
        for segment in ascending {
            match stretches.last_mut() {
                Some([_, end]) if order(self.points, segment[0], *end).is_le() => {
                    if order(self.points, segment[1], *end).is_gt() {
                        *end = segment[1];
                    }
                }
                _ => stretches.push(segment),
            }
        }
        for &end in segments.iter().flatten() {
            self.insert(end);
        }
        for ends in stretches {
            self.insert_line(Line { ends, support, bounds: None });
        }
    }

    /// The lines along an edge. A triangle stores for each edge the number of such a set, or `NONE`.
    fn set(&self, set: u32) -> &[u32] {
        self.sets.get(set as usize).map_or(&[], SmallVec::as_slice)
    }

    /// Whether `b` and `c`, on a line through `a`, lie on the same side of `a`.
    fn is_ahead(&self, a: u32, b: u32, c: u32) -> bool {
        let [a, b, c] = [a, b, c].map(|x| self.ids[x as usize]);
        for k in [(self.axis + 1) % 3, (self.axis + 2) % 3] {
            let order = self.points.compare(k, a, c);
            if order != Ordering::Equal {
                return order == self.points.compare(k, a, b);
            }
        }
        false
    }

    /// Inserts the next piece of a line from `a` towards `b`. Returns the point where the piece ends.
    fn advance(&mut self, a: u32, b: u32, line: u32) -> u32 {
        let (mut t, mut i) = match self.direction(a, b) {
            Direction::Along(x) => {
                self.mark(a, x, line);
                return x;
            }
            Direction::Across(t, i) => (t, i),
        };
        // The edges that cross the line, up to the next corner on it or the next constraint.
        let mut across: VecDeque<[u32; 2]> = VecDeque::new();
        let end = loop {
            let corners = self.triangles[t as usize].corners;
            let [x, y] = [corners[i], corners[(i + 1) % 3]];
            let set = self.triangles[t as usize].lines[i];
            if set != NONE {
                let id = self.crossing(line, self.set(set)[0]);
                if let Some(&known) = self.local.get(&id) {
                    // Can happen only where edges share an end point, and a line never crosses such edges strictly.
                    debug_assert!(false, "two lines cross in a corner");
                    break known;
                }
                let p = self.name(id);
                self.split_edge(t, i, p);
                break p;
            }
            across.push_back([x, y]);
            let (s, j) = self.twin(t, i);
            let far = self.triangles[s as usize].corners[(j + 2) % 3];
            match self.turn(a, b, far) {
                Sign::Zero => break far,
                // The line leaves between `far` and the corner on its other side. Edge `j` runs from `y` to `x`, and
                // `x` is right of the line.
                Sign::Positive => (t, i) = (s, (j + 1) % 3),
                Sign::Negative => (t, i) = (s, (j + 2) % 3),
            }
        };
        self.flip_into_edge(a, end, across);
        self.mark(a, end, line);
        end
    }

    /// The edge along which, or across which, the line from `a` to `b` leaves the triangles around `a`.
    fn direction(&self, a: u32, b: u32) -> Direction {
        for t in self.triangles_at(a) {
            let corners = self.triangles[t as usize].corners;
            let Some(k) = corners.iter().position(|&c| c == a) else { continue };
            let [x, y] = [corners[(k + 1) % 3], corners[(k + 2) % 3]];
            if x == b || y == b {
                return Direction::Along(b);
            }
            let [right, left] = [self.turn(a, x, b), self.turn(a, y, b)];
            if right == Sign::Zero && self.is_ahead(a, b, x) {
                return Direction::Along(x);
            }
            if left == Sign::Zero && self.is_ahead(a, b, y) {
                return Direction::Along(y);
            }
            if right == Sign::Positive && left == Sign::Negative {
                return Direction::Across(t, (k + 1) % 3);
            }
        }
        unreachable!("a line within the triangulation leaves its end point")
    }

    /// Flips the edges that cross the segment from `a` to `b` until the segment is an edge.
    fn flip_into_edge(&mut self, a: u32, b: u32, mut across: VecDeque<[u32; 2]>) {
        while let Some([x, y]) = across.pop_front() {
            let Some((t, i)) = self.edge(x, y) else { continue };
            if !self.can_flip(t, i) {
                across.push_back([x, y]);
                continue;
            }
            self.flip(t, i);
            let corners = self.triangles[t as usize].corners;
            let [c, d] = [corners[0], corners[1]];
            if c != a && c != b && d != a && d != b && self.turn(a, b, c) != self.turn(a, b, d) {
                across.push_back([c, d]);
            }
        }
    }

    /// Marks the edge between two corners as part of a line.
    fn mark(&mut self, a: u32, b: u32, line: u32) {
        let Some((t, i)) = self.edge(a, b).or_else(|| self.edge(b, a)) else {
            debug_assert!(false, "no edge along an inserted line");
            return;
        };
        let mut set: SmallVec<[u32; 2]> = self.set(self.triangles[t as usize].lines[i]).into();
        if set.contains(&line) {
            return;
        }
        set.push(line);
        #[expect(clippy::cast_possible_truncation, reason = "fewer than there are edges and lines")]
        let new = self.sets.len() as u32;
        self.sets.push(set);
        self.triangles[t as usize].lines[i] = new;
        let (s, j) = self.twin(t, i);
        if s != NONE {
            self.triangles[s as usize].lines[j] = new;
        }
    }

    /// The intersection point of two lines.
    fn crossing(&mut self, line: u32, other: u32) -> u32 {
        let [one, two] = [line, other].map(|l| self.lines[l as usize].support);
        match (one, two) {
            (Support::Plane(p), Support::Plane(q)) => self.points.of_planes([self.plane, p, q]),
            (Support::Plane(p), Support::Edge(e)) | (Support::Edge(e), Support::Plane(p)) => self.points.on_edge(e, p),
            (Support::Edge(e), Support::Edge(f)) => {
                let upright = self.points.upright(f, self.axis);
                self.points.on_edge(e, upright)
            }
        }
    }
}

/// How a line leaves a corner.
enum Direction {
    /// Along the edge to this corner.
    Along(u32),
    /// Across this edge of this triangle.
    Across(u32, usize),
}
