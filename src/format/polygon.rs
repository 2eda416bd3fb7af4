//! Cutting polygons into triangles.
//!
//! A polygon is seen along the axis that its Newell normal (Sutherland, Sproull, Schumacker 1974) is nearest to: leaving out
//! a coordinate is free of rounding, so that corners on a line stay on that line and a flat polygon that doesn't cross
//! itself still doesn't. Ears are then cut in that plane. Every polygon of n corners gives exactly n - 2 triangles that turn
//! as it does and have each of its edges once, whatever its shape.

use earcut::Earcut;
use glam::DVec3;
use robust::{Coord, orient2d};

/// Cuts polygons, keeping its buffers from one to the next.
pub(super) struct Cutter {
    earcut: Earcut<f64>,
    flat: Vec<[f64; 2]>,
    triangles: Vec<u32>,
    edges: Vec<(u32, u32)>,
    work: u64,
    fanned: u64,
}

/// Corners above which a polygon that is not convex is cut as a fan: ear cutting takes cubic time on polygons that are
/// made to defeat it.
const MOST_CORNERS: usize = 4096;

/// Sum of squared corner counts above which polygons that are not convex are cut as fans, for the same reason.
const MOST_WORK: u64 = 400_000_000;

impl Cutter {
    pub fn new() -> Self {
        Self { earcut: Earcut::new(), flat: Vec::new(), triangles: Vec::new(), edges: Vec::new(), work: 0, fanned: 0 }
    }

    /// Polygons that had to be cut as fans although they are not convex: without a plane, crossing themselves, or with
    /// too many corners.
    pub fn fanned(&self) -> u64 {
        self.fanned
    }

    /// Cuts one polygon. `corners` are indices into `positions`, all in range; the n - 2 triangles go to `push`, as corners.
    pub fn cut(&mut self, positions: &[DVec3], corners: &[u32], mut push: impl FnMut([u32; 3])) {
        let count = corners.len();
        if count < 3 {
            return;
        }
        if count == 3 {
            push([corners[0], corners[1], corners[2]]);
            return;
        }
        let first = self.shape(positions, corners);
        match first {
            Shape::FanFrom(start) => {
                for k in 1..count - 1 {
                    push([corners[start], corners[(start + k) % count], corners[(start + k + 1) % count]]);
                }
            }
            Shape::Ears => {
                for triangle in self.triangles.chunks_exact(3) {
                    push([triangle[0], triangle[1], triangle[2]].map(|k| corners[k as usize]));
                }
            }
        }
    }

    fn shape(&mut self, positions: &[DVec3], corners: &[u32]) -> Shape {
        if !self.flatten(positions, corners) {
            self.fanned += 1;
            return Shape::FanFrom(0);
        }
        if corners.len() == 4 {
            // A fan from a straight or reflex corner is the only one whose triangles have area and don't fold.
            return Shape::FanFrom((0..4).find(|&k| self.turn(k) <= 0.0).unwrap_or(0));
        }
        if self.convex() {
            return Shape::FanFrom(0);
        }
        let work = (corners.len() as u64).saturating_pow(2);
        if corners.len() <= MOST_CORNERS && self.work.saturating_add(work) <= MOST_WORK {
            self.work += work;
            if self.cut_ears() {
                return Shape::Ears;
            }
        }
        self.fanned += 1;
        Shape::FanFrom(0)
    }

    /// Fills `flat` with the polygon in a coordinate plane in which it runs counter-clockwise; false if it has no normal.
    fn flatten(&mut self, positions: &[DVec3], corners: &[u32]) -> bool {
        let at = |k: usize| positions[corners[k] as usize];
        let origin = at(0);
        let size = (1..corners.len()).map(|k| (at(k) - origin).abs().max_element()).fold(0.0, f64::max);
        if !size.is_finite() || size == 0.0 || !(0..corners.len()).all(|k| at(k).is_finite()) {
            return false;
        }
        // Scaled, so that the products of very large or small models stay in range.
        let mut normal = DVec3::ZERO;
        for k in 1..corners.len() - 1 {
            normal += ((at(k) - origin) / size).cross((at(k + 1) - origin) / size);
        }
        let strength = normal.abs().max_element();
        if !strength.is_finite() || strength <= f64::EPSILON * 16.0 {
            return false;
        }
        let axis = (0..3).find(|&k| normal[k].abs() == strength).unwrap_or(2);
        let (mut u, mut v) = ((axis + 1) % 3, (axis + 2) % 3);
        if normal[axis] < 0.0 {
            std::mem::swap(&mut u, &mut v);
        }
        self.flat.clear();
        self.flat.extend((0..corners.len()).map(|k| {
            let p = at(k);
            [p[u], p[v]]
        }));
        true
    }

    /// How the polygon turns at a corner: above zero for left, zero for straight on.
    fn turn(&self, k: usize) -> f64 {
        let count = self.flat.len();
        let at = |k: usize| Coord { x: self.flat[k % count][0], y: self.flat[k % count][1] };
        orient2d(at(k + count - 1), at(k), at(k + 1))
    }

    /// Every corner turns left and the turns add up to one round.
    fn convex(&self) -> bool {
        if (0..self.flat.len()).any(|k| self.turn(k) <= 0.0) {
            return false;
        }
        let count = self.flat.len();
        // A polygon that only turns left goes round once if its direction changes between left and right twice.
        let rightward = |k: usize| {
            let (a, b) = (self.flat[k % count], self.flat[(k + 1) % count]);
            (b[0], b[1]) > (a[0], a[1])
        };
        (0..count).filter(|&k| rightward(k) != rightward(k + 1)).count() == 2
    }

    /// Cuts ears; false if what comes out is not a disk over exactly the polygon's edges.
    fn cut_ears(&mut self) -> bool {
        let count = self.flat.len();
        self.earcut.earcut_slice(&self.flat, &[], &mut self.triangles);
        for triangle in self.triangles.chunks_exact_mut(3) {
            // Along the polygon, so that each turns as it does.
            triangle.sort_unstable();
        }
        if self.triangles.len() < 3 * (count - 2) {
            self.put_back_skipped_corners();
        }
        self.triangles.len() == 3 * (count - 2) && self.is_disk()
    }

    /// Ear cutting passes over corners on a straight line; each run of them is put back by splitting the triangle that has
    /// the line as its side.
    fn put_back_skipped_corners(&mut self) {
        let count = self.flat.len();
        let mut used = vec![false; count];
        for &k in &self.triangles {
            used[k as usize] = true;
        }
        let Some(first) = used.iter().position(|&u| u) else { return };
        #[expect(clippy::cast_possible_truncation, reason = "a polygon here has at most MOST_CORNERS corners")]
        let name = |k: usize| (k % count) as u32;
        let mut at = first;
        while at < first + count {
            let Some(next) = (at + 1..=first + count).find(|&k| used[k % count]) else { return };
            if next > at + 1 {
                let (a, b) = (name(at), name(next));
                let Some(found) = self.triangles.chunks_exact(3).position(|t| has_side(t, a, b)) else { return };
                let apex = self.triangles[3 * found..3 * found + 3].iter().copied().find(|&k| k != a && k != b);
                let Some(apex) = apex else { return };
                for (k, slot) in [a, name(at + 1), apex].into_iter().enumerate() {
                    self.triangles[3 * found + k] = slot;
                }
                for k in at + 1..next {
                    self.triangles.extend([name(k), name(k + 1), apex]);
                }
            }
            at = next;
        }
    }

    /// Every edge of the polygon is a side once, and every other side is there once in either direction.
    fn is_disk(&mut self) -> bool {
        self.edges.clear();
        for t in self.triangles.chunks_exact(3) {
            self.edges.extend([(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
        }
        let count = self.flat.len();
        // What closes the polygon's own edges, so that every side has a partner.
        #[expect(clippy::cast_possible_truncation, reason = "a polygon here has at most MOST_CORNERS corners")]
        self.edges.extend((0..count).map(|k| (((k + 1) % count) as u32, k as u32)));
        self.edges.sort_unstable();
        self.edges.windows(2).all(|w| w[0] != w[1])
            && self.edges.iter().all(|&(a, b)| a != b && self.edges.binary_search(&(b, a)).is_ok())
    }
}

fn has_side(triangle: &[u32], a: u32, b: u32) -> bool {
    (0..3).any(|k| triangle[k] == a && triangle[(k + 1) % 3] == b)
}

enum Shape {
    /// Triangles from one corner to all others.
    FanFrom(usize),
    /// The triangles are in `Cutter::triangles`, as places in the polygon.
    Ears,
}
