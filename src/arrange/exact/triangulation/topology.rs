//! Triangles and their neighbours: splitting and flipping.

use super::{NONE, Triangle, Triangulation};
use crate::math::Sign;

impl<'a> Triangulation<'a> {
    /// The same edge seen from the other side; `NONE` where there is none.
    pub(super) fn twin(&self, t: u32, i: usize) -> (u32, usize) {
        let s = self.triangles[t as usize].across[i];
        if s == NONE {
            return (NONE, 0);
        }
        let start = self.triangles[t as usize].corners[(i + 1) % 3];
        let j = self.triangles[s as usize].corners.iter().position(|&c| c == start).unwrap_or(0);
        (s, j)
    }

    pub(super) fn push(&mut self, triangle: Triangle) -> u32 {
        #[expect(clippy::cast_possible_truncation, reason = "triangles are counted in u32")]
        let t = self.triangles.len() as u32;
        self.triangles.push(triangle);
        t
    }

    /// Tells the neighbour across an edge, and the corners, that the triangle is now `t`.
    pub(super) fn connect(&mut self, t: u32) {
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

    pub(super) fn split_inside(&mut self, t: u32, p: u32) {
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
    pub(super) fn split_edge(&mut self, t: u32, i: usize, p: u32) {
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

    /// Turns the edge `i` of `t` within its quadrilateral. Edge 0 of `t` is then the new one.
    pub(super) fn flip(&mut self, t: u32, i: usize) {
        let (s, j) = self.twin(t, i);
        let (one, two) = (self.triangles[t as usize], self.triangles[s as usize]);
        let [a, b, c] = [0, 1, 2].map(|k| one.corners[(i + k) % 3]);
        let d = two.corners[(j + 2) % 3];
        let side = |it: &Triangle, k: usize| (it.across[k % 3], it.lines[k % 3]);
        let (bc, ca) = (side(&one, i + 1), side(&one, i + 2));
        let (ad, db) = (side(&two, j + 1), side(&two, j + 2));
        self.triangles[t as usize] =
            Triangle { corners: [c, d, b], across: [s, db.0, bc.0], lines: [NONE, db.1, bc.1] };
        self.triangles[s as usize] =
            Triangle { corners: [d, c, a], across: [t, ca.0, ad.0], lines: [NONE, ca.1, ad.1] };
        self.connect(t);
        self.connect(s);
    }

    /// Whether the edge is free and its quadrilateral strictly convex.
    pub(super) fn can_flip(&self, t: u32, i: usize) -> bool {
        let (s, j) = self.twin(t, i);
        if s == NONE || self.triangles[t as usize].lines[i] != NONE {
            return false;
        }
        let [a, b, c] = [0, 1, 2].map(|k| self.triangles[t as usize].corners[(i + k) % 3]);
        let d = self.triangles[s as usize].corners[(j + 2) % 3];
        self.turn(c, a, d) == Sign::Positive && self.turn(d, b, c) == Sign::Positive
    }

    /// Whether the circle of a triangle holds the far corner of its neighbour, as far as floating point can tell.
    pub(super) fn wants_flip(&self, t: u32, i: usize) -> bool {
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

    /// The triangles around a point, counter-clockwise, all of them also where it is on the rim.
    pub(super) fn triangles_at(&self, p: u32) -> impl Iterator<Item = u32> + use<'_, 'a> {
        // Back to the first, where there is one.
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

    /// The triangle and edge that run from `a` to `b`.
    pub(super) fn edge(&self, a: u32, b: u32) -> Option<(u32, usize)> {
        self.triangles_at(a).find_map(|t| {
            let corners = self.triangles[t as usize].corners;
            (0..3).find(|&i| corners[i] == a && corners[(i + 1) % 3] == b).map(|i| (t, i))
        })
    }
}
