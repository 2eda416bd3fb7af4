//! A constrained triangulation in a plane, built by inserting points and lines with exact predicates.

mod constraints;

use smallvec::SmallVec;

use super::points::Points;
use crate::math::Sign;

/// Marks an absent triangle or line set.
const NONE: u32 = u32::MAX;

#[derive(Debug, Clone, Copy)]
struct Triangle {
    /// Corners in counter-clockwise order.
    corners: [u32; 3],
    /// The neighbour across the edge from corner `i` to the next.
    across: [u32; 3],
    /// The set of lines on that edge.
    lines: [u32; 3],
}

/// The exact carrier of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Support {
    /// The plane of another face.
    Plane(u32),
    /// The edge between two vertices of a coplanar face.
    Edge([u32; 2]),
}

/// A constraint: a line that must consist of triangle edges.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line {
    /// The end points.
    pub ends: [u32; 2],
    /// The carrier of the line.
    pub support: Support,
    /// The face that the line bounds, in the caller's numbering, if any.
    pub bounds: Option<u32>,
}

/// The location of a point in the triangulation.
enum Location {
    /// In the interior of this triangle.
    Inside(u32),
    /// On this edge of this triangle.
    On(u32, usize),
    /// At this corner.
    Corner(u32),
}

/// A triangulation in a plane that contains given points and lines, built by inserting them one after another with
/// exact signs. A new point is created where two lines cross.
///
/// Points are inserted by splitting and Lawson's flips. Lines are inserted by flipping the edges that they cross (Sloan
/// 1993, "A fast algorithm for generating constrained Delaunay triangulations"). Floating point decides how close the
/// result is to Delaunay, which affects only triangle shape; the validity of the triangulation is exact.
pub(super) struct Triangulation<'a> {
    points: &'a mut Points,
    /// The projection axis, and whether the plane's normal points against it. If so, points that are counter-clockwise
    /// seen against the normal are clockwise seen against the axis.
    axis: usize,
    turned: bool,
    /// The plane of the triangulation.
    plane: u32,
    triangles: Vec<Triangle>,
    /// The points in order of insertion; the position in this list is the local number.
    ids: Vec<u32>,
    local: rustc_hash::FxHashMap<u32, u32>,
    /// For each point, a triangle with that corner.
    at: Vec<u32>,
    lines: Vec<Line>,
    /// Sets of lines that run along the same edge.
    sets: Vec<SmallVec<[u32; 2]>>,
    last: u32,
}

impl<'a> Triangulation<'a> {
    /// Starts with one triangle, counter-clockwise seen against the normal of `plane`.
    pub fn new(points: &'a mut Points, plane: u32, corners: [u32; 3]) -> Self {
        let axis = points.planes[plane as usize].axis();
        let turned = points.planes[plane as usize].normal[axis] < 0;
        let local = corners.into_iter().zip(0..).collect();
        Self {
            points,
            axis,
            turned,
            plane,
            triangles: vec![Triangle { corners: [0, 1, 2], across: [NONE; 3], lines: [NONE; 3] }],
            ids: corners.to_vec(),
            local,
            at: vec![0; 3],
            lines: Vec::new(),
            sets: Vec::new(),
            last: 0,
        }
    }

    /// Number of points of the whole arrangement.
    pub fn count(&self) -> usize {
        self.points.len()
    }

    /// The triangles, as points of the arrangement.
    pub fn triangles(&self) -> impl Iterator<Item = [u32; 3]> {
        self.triangles.iter().map(|t| t.corners.map(|c| self.ids[c as usize]))
    }

    /// Inserts a point unless it is present. Returns its local number.
    pub fn insert(&mut self, id: u32) -> u32 {
        if let Some(&known) = self.local.get(&id) {
            return known;
        }
        let p = self.name(id);
        match self.locate(p) {
            Location::Inside(t) => self.split_inside(t, p),
            Location::On(t, i) => self.split_edge(t, i, p),
            // Points are pairwise different, so this case does not occur; handling it is harmless.
            Location::Corner(c) => {
                self.local.insert(id, c);
                return c;
            }
        }
        self.legalise_around(p);
        p
    }

    /// Flips edges until the triangulation is as close to Delaunay as floating point can decide.
    pub fn improve(&mut self) {
        let mut stack: Vec<(u32, usize)> = Vec::new();
        for t in 0..self.triangles.len() {
            #[expect(clippy::cast_possible_truncation, reason = "triangles are counted in u32")]
            stack.extend((0..3).map(|i| (t as u32, i)));
        }
        let mut left = 20 * self.triangles.len();
        while let Some((t, i)) = stack.pop() {
            if left == 0 {
                break;
            }
            if self.wants_flip(t, i) && self.can_flip(t, i) {
                left -= 1;
                let (s, _) = self.twin(t, i);
                self.flip(t, i);
                for k in 0..3 {
                    stack.extend([(t, k), (s, k)]);
                }
            }
        }
    }

    /// Gives a point the next local number.
    fn name(&mut self, id: u32) -> u32 {
        #[expect(clippy::cast_possible_truncation, reason = "points are counted in u32")]
        let p = self.ids.len() as u32;
        self.ids.push(id);
        self.local.insert(id, p);
        self.at.push(NONE);
        p
    }

    /// The orientation of three corners: positive for counter-clockwise.
    fn turn(&self, a: u32, b: u32, c: u32) -> Sign {
        let ids = [a, b, c].map(|x| self.ids[x as usize]);
        let sign = self.points.turn(self.plane, self.axis, ids);
        if self.turned { -sign } else { sign }
    }

    /// The rounded projection of a point.
    fn xy(&self, a: u32) -> [f64; 2] {
        let p = self.points.place(self.ids[a as usize]);
        let (i, j) = ((self.axis + 1) % 3, (self.axis + 2) % 3);
        if self.turned { [p[j], p[i]] } else { [p[i], p[j]] }
    }

    /// Restores the Delaunay property around a new point by Lawson's flips.
    fn legalise_around(&mut self, p: u32) {
        let mut stack: Vec<u32> = self.triangles_at(p).collect();
        while let Some(t) = stack.pop() {
            let Some(k) = self.triangles[t as usize].corners.iter().position(|&c| c == p) else { continue };
            let i = (k + 1) % 3;
            if self.wants_flip(t, i) && self.can_flip(t, i) {
                let (s, _) = self.twin(t, i);
                self.flip(t, i);
                stack.extend([t, s]);
            }
        }
    }

    /// Locates a point by walking towards it.
    fn locate(&self, p: u32) -> Location {
        let mut t = self.last;
        let mut from = NONE;
        for step in 0..4 * self.triangles.len() + 8 {
            let triangle = &self.triangles[t as usize];
            let mut next = None;
            let mut zero: SmallVec<[usize; 3]> = SmallVec::new();
            for k in 0..3 {
                // The first edge tested varies, so that the walk cannot cycle forever.
                let i = (k + step) % 3;
                if triangle.across[i] == from && from != NONE {
                    continue;
                }
                match self.turn(triangle.corners[i], triangle.corners[(i + 1) % 3], p) {
                    Sign::Negative if triangle.across[i] != NONE => {
                        next = Some(triangle.across[i]);
                        break;
                    }
                    Sign::Zero => zero.push(i),
                    _ => {}
                }
            }
            if let Some(next) = next {
                (from, t) = (t, next);
                continue;
            }
            return match zero.as_slice() {
                [] => Location::Inside(t),
                [i] => Location::On(t, *i),
                [i, j, ..] => {
                    let (i, j) = (*i.min(j), *i.max(j));
                    Location::Corner(triangle.corners[if (i, j) == (0, 2) { 0 } else { j }])
                }
            };
        }
        self.search(p)
    }

    /// Locates a point by testing every triangle.
    fn search(&self, p: u32) -> Location {
        for (t, triangle) in (0u32..).zip(&self.triangles) {
            let [a, b, c] = triangle.corners;
            let turns = [self.turn(a, b, p), self.turn(b, c, p), self.turn(c, a, p)];
            if turns.contains(&Sign::Negative) {
                continue;
            }
            return match turns.iter().position(|&s| s == Sign::Zero) {
                Some(i) => Location::On(t, i),
                None => Location::Inside(t),
            };
        }
        Location::Inside(self.last)
    }

    /// The same edge in the neighbouring triangle; `NONE` if there is no neighbour.
    fn twin(&self, t: u32, i: usize) -> (u32, usize) {
        let s = self.triangles[t as usize].across[i];
        if s == NONE {
            return (NONE, 0);
        }
        let start = self.triangles[t as usize].corners[(i + 1) % 3];
        let j = self.triangles[s as usize].corners.iter().position(|&c| c == start).unwrap_or(0);
        (s, j)
    }

    fn push(&mut self, triangle: Triangle) -> u32 {
        #[expect(clippy::cast_possible_truncation, reason = "triangles are counted in u32")]
        let t = self.triangles.len() as u32;
        self.triangles.push(triangle);
        t
    }

    /// Updates the neighbours and corners of a triangle to refer to `t`.
    fn connect(&mut self, t: u32) {
        let Triangle { corners, across, .. } = self.triangles[t as usize];
        for i in 0..3 {
            self.at[corners[i] as usize] = t;
            if across[i] != NONE {
                let end = corners[(i + 1) % 3];
                let other = &mut self.triangles[across[i] as usize];
                if let Some(j) = other.corners.iter().position(|&c| c == end) {
                    other.across[j] = t;
                }
            }
        }
    }

    /// Splits a triangle at a point in its interior.
    fn split_inside(&mut self, t: u32, p: u32) {
        let Triangle { corners: [a, b, c], across, lines } = self.triangles[t as usize];
        let (u, v) = (t, self.triangles.len() as u32);
        let w = v + 1;
        let no = NONE;
        self.triangles[t as usize] =
            Triangle { corners: [a, b, p], across: [across[0], v, w], lines: [lines[0], no, no] };
        self.push(Triangle { corners: [b, c, p], across: [across[1], w, u], lines: [lines[1], no, no] });
        self.push(Triangle { corners: [c, a, p], across: [across[2], u, v], lines: [lines[2], no, no] });
        for t in [u, v, w] {
            self.connect(t);
        }
        self.last = t;
    }

    /// Splits edge `i` of `t` at a point on it; both halves keep its lines.
    fn split_edge(&mut self, t: u32, i: usize, p: u32) {
        let (s, j) = self.twin(t, i);
        let one = self.triangles[t as usize];
        let [a, b, c] = [0, 1, 2].map(|k| one.corners[(i + k) % 3]);
        let [_, bc, ca] = [0, 1, 2].map(|k| (one.across[(i + k) % 3], one.lines[(i + k) % 3]));
        let set = one.lines[i];
        let t2 = self.push(one);
        self.triangles[t as usize] =
            Triangle { corners: [a, p, c], across: [NONE, t2, ca.0], lines: [set, NONE, ca.1] };
        self.triangles[t2 as usize] =
            Triangle { corners: [p, b, c], across: [NONE, bc.0, t], lines: [set, bc.1, NONE] };
        if s != NONE {
            let two = self.triangles[s as usize];
            let d = two.corners[(j + 2) % 3];
            let [_, ad, db] = [0, 1, 2].map(|k| (two.across[(j + k) % 3], two.lines[(j + k) % 3]));
            let s2 = self.push(two);
            self.triangles[s as usize] =
                Triangle { corners: [b, p, d], across: [t2, s2, db.0], lines: [set, NONE, db.1] };
            self.triangles[s2 as usize] =
                Triangle { corners: [p, a, d], across: [t, ad.0, s], lines: [set, ad.1, NONE] };
            self.triangles[t as usize].across[0] = s2;
            self.triangles[t2 as usize].across[0] = s;
            self.connect(s);
            self.connect(s2);
        }
        self.connect(t);
        self.connect(t2);
        self.last = t;
    }

    /// Flips edge `i` of `t` within its quadrilateral. The new edge is edge 0 of `t`.
    fn flip(&mut self, t: u32, i: usize) {
        let (s, j) = self.twin(t, i);
        let (one, two) = (self.triangles[t as usize], self.triangles[s as usize]);
        let [a, b, c] = [0, 1, 2].map(|k| one.corners[(i + k) % 3]);
        let d = two.corners[(j + 2) % 3];
        let side = |of: &Triangle, k: usize| (of.across[k % 3], of.lines[k % 3]);
        let (bc, ca) = (side(&one, i + 1), side(&one, i + 2));
        let (ad, db) = (side(&two, j + 1), side(&two, j + 2));
        self.triangles[t as usize] =
            Triangle { corners: [c, d, b], across: [s, db.0, bc.0], lines: [NONE, db.1, bc.1] };
        self.triangles[s as usize] =
            Triangle { corners: [d, c, a], across: [t, ca.0, ad.0], lines: [NONE, ca.1, ad.1] };
        self.connect(t);
        self.connect(s);
    }

    /// Whether the edge is unconstrained and its quadrilateral strictly convex.
    fn can_flip(&self, t: u32, i: usize) -> bool {
        let (s, j) = self.twin(t, i);
        if s == NONE || self.triangles[t as usize].lines[i] != NONE {
            return false;
        }
        let [a, b, c] = [0, 1, 2].map(|k| self.triangles[t as usize].corners[(i + k) % 3]);
        let d = self.triangles[s as usize].corners[(j + 2) % 3];
        self.turn(c, a, d) == Sign::Positive && self.turn(d, b, c) == Sign::Positive
    }

    /// Whether the circumcircle of a triangle contains the opposite corner of its neighbour, as far as floating point
    /// can decide.
    fn wants_flip(&self, t: u32, i: usize) -> bool {
        let (s, j) = self.twin(t, i);
        if s == NONE || self.triangles[t as usize].lines[i] != NONE {
            return false;
        }
        let corners = self.triangles[t as usize].corners;
        let d = self.xy(self.triangles[s as usize].corners[(j + 2) % 3]);
        let [a, b, c] = corners.map(|x| {
            let p = self.xy(x);
            [p[0] - d[0], p[1] - d[1]]
        });
        let square = |p: [f64; 2]| p[0] * p[0] + p[1] * p[1];
        let minor = |p: [f64; 2], q: [f64; 2]| p[0] * q[1] - p[1] * q[0];
        let terms = [square(a) * minor(b, c), square(b) * minor(c, a), square(c) * minor(a, b)];
        terms.iter().sum::<f64>() > 1e-9 * terms.iter().map(|t| t.abs()).sum::<f64>()
    }

    /// The triangles around a point in counter-clockwise order, complete also for points on the border.
    fn triangles_at(&self, p: u32) -> impl Iterator<Item = u32> + use<'_, 'a> {
        // Walks clockwise to the first triangle, if the fan is open.
        let start = self.at[p as usize];
        let corner = move |t: u32| self.triangles[t as usize].corners.iter().position(|&c| c == p).unwrap_or(0);
        let mut first = start;
        loop {
            let back = self.triangles[first as usize].across[corner(first)];
            if back == NONE || back == start {
                first = if back == NONE { first } else { start };
                break;
            }
            first = back;
        }
        let mut next = Some(first);
        std::iter::from_fn(move || {
            let t = next?;
            let on = self.triangles[t as usize].across[(corner(t) + 2) % 3];
            next = (on != NONE && on != first).then_some(on);
            Some(t)
        })
    }

    /// The triangle and the edge index that run from `a` to `b`.
    fn edge(&self, a: u32, b: u32) -> Option<(u32, usize)> {
        self.triangles_at(a).find_map(|t| {
            let corners = self.triangles[t as usize].corners;
            (0..3).find(|&i| corners[i] == a && corners[(i + 1) % 3] == b).map(|i| (t, i))
        })
    }
}
