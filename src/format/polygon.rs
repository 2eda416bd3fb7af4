//! Cutting polygons into triangles.
//!
//! A polygon is seen along the axis that its Newell normal (Sutherland, Sproull, Schumacker 1974) is nearest to: leaving out
//! a coordinate is free of rounding, so that corners on a line stay on that line and a flat polygon that doesn't cross
//! itself still doesn't. Ears are then cut in that plane. Every polygon of n corners gives exactly n - 2 triangles that turn
//! as it does and have each of its edges once, whatever its shape.

mod twist;

use earcut::{Earcut, Refiner};
use glam::DVec3;
use robust::{Coord, orient2d};

use super::content::Polygons;

/// Cuts polygons, keeping its buffers from one to the next.
pub(super) struct Cutter {
    earcut: Earcut<f64>,
    refiner: Refiner,
    flat: Vec<[f64; 2]>,
    triangles: Vec<u32>,
    edges: Vec<(u32, u32)>,
    order: Vec<u32>,
    work: u64,
    without_normal: u64,
    fanned: u64,
    points: Vec<DVec3>,
    fold_work: u64,
    /// The square of the sine of the angle above which polygons are twisted.
    twist: f64,
    counted: u64,
    twisted: u64,
    /// The largest square of a sine so far.
    most_twist: f64,
}

/// Corners above which polygons are cut as fans, right for convex ones only: ear cutting takes quadratic time on polygons
/// that are made to defeat it.
const MOST_CORNERS: usize = 8192;

/// Corners above which a polygon that crosses itself is cut as a fan: on these ear cutting can take cubic time, and what it
/// gives is no better.
const MOST_CROSSING_CORNERS: usize = 64;

/// Work after which all polygons are cut as fans, in squared corner counts; far more than a model needs that is not made to
/// be slow.
const MOST_WORK: u64 = 100_000_000;

/// Twice the area of the triangle at a corner, in a polygon of a size near one, below which the corner counts as straight.
const STRAIGHT: f64 = 1e-9;

/// Corners up to which twisted polygons are cut with the least fold, which takes cubic time, ...
const MOST_TWISTED_CORNERS: usize = 64;

/// ... and work in cubed corner counts after which they are cut as flat ones.
const MOST_FOLD_WORK: u64 = 500_000_000;

impl Cutter {
    /// Polygons twisted by more than `twist_angle_deg` are cut with the least fold.
    pub fn new(twist_angle_deg: f64) -> Self {
        let sine = twist_angle_deg.max(0.0).to_radians().sin();
        Self {
            earcut: Earcut::new(),
            refiner: Refiner::new(),
            flat: Vec::new(),
            triangles: Vec::new(),
            edges: Vec::new(),
            order: Vec::new(),
            work: 0,
            without_normal: 0,
            fanned: 0,
            points: Vec::new(),
            fold_work: 0,
            twist: if twist_angle_deg < 90.0 { sine * sine } else { f64::INFINITY },
            counted: 0,
            twisted: 0,
            most_twist: 0.0,
        }
    }

    /// Polygons without a normal: with all corners on a line, or some that are not finite. They are cut as fans.
    pub fn without_normal(&self) -> u64 {
        self.without_normal
    }

    /// Polygons that had to be cut as fans although they are not convex: crossing themselves, or with too many corners.
    pub fn fanned(&self) -> u64 {
        self.fanned
    }

    /// What there was to cut.
    pub fn polygons(&self) -> Polygons {
        let largest_twist_deg = self.most_twist.sqrt().min(1.0).asin().to_degrees();
        Polygons { count: self.counted, twisted: self.twisted, largest_twist_deg }
    }

    /// Cuts one polygon. `corners` are indices into `positions`, all in range; the n - 2 triangles go to `push`, as places
    /// in `corners`.
    pub fn cut(&mut self, positions: &[DVec3], corners: &[u32], mut push: impl FnMut([usize; 3])) {
        let count = corners.len();
        if count < 3 {
            return;
        }
        if count == 3 {
            push([0, 1, 2]);
            return;
        }
        self.counted += 1;
        match self.shape(positions, corners) {
            Shape::FanFrom(start) => {
                for k in 1..count - 1 {
                    push([start, (start + k) % count, (start + k + 1) % count]);
                }
            }
            Shape::Ears => {
                for triangle in self.triangles.chunks_exact(3) {
                    push([triangle[0], triangle[1], triangle[2]].map(|k| k as usize));
                }
            }
        }
    }

    fn shape(&mut self, positions: &[DVec3], corners: &[u32]) -> Shape {
        let count = corners.len();
        let Some((normal, scale)) = newell(positions, corners) else {
            self.without_normal += 1;
            return Shape::FanFrom(0);
        };
        let twist = twist::squared_sine(positions, corners, normal, scale);
        self.most_twist = self.most_twist.max(twist);
        let twisted = twist > self.twist;
        self.twisted += u64::from(twisted);
        self.look_along_axis(positions, corners, normal, scale);
        if count == 4 {
            // A fan from a straight or reflex corner is the only one whose triangles have area and don't fold.
            let flat = (0..4).find(|&k| self.turn(k) <= STRAIGHT).unwrap_or(0);
            let at = |k: usize| (positions[corners[k] as usize] - positions[corners[0] as usize]) * scale;
            return Shape::FanFrom(if twisted { twist::quad([0, 1, 2, 3].map(at), flat) } else { flat });
        }
        if twisted && self.fold_least(positions, corners, scale) {
            return Shape::Ears;
        }
        let convex = self.convex();
        if count > MOST_CORNERS || self.work > MOST_WORK {
            self.fanned += u64::from(!convex);
            return Shape::FanFrom(0);
        }
        if convex {
            self.triangles.clear();
            #[expect(clippy::cast_possible_truncation, reason = "a polygon here has at most MOST_CORNERS corners")]
            self.triangles.extend((1..count as u32 - 1).flat_map(|k| [0, k, k + 1]));
            self.refiner.refine(&mut self.triangles, &self.flat);
            return Shape::Ears;
        }
        if self.cut_ears() {
            return Shape::Ears;
        }
        // A narrow polygon that is not quite flat can cross itself when seen askew.
        self.look_along_normal(positions, corners, normal, scale);
        if self.cut_ears() {
            return Shape::Ears;
        }
        self.fanned += 1;
        Shape::FanFrom(0)
    }

    /// Cuts a twisted polygon; false if that would take too long.
    fn fold_least(&mut self, positions: &[DVec3], corners: &[u32], scale: f64) -> bool {
        let cubed = (corners.len() as u64).saturating_pow(3);
        if corners.len() > MOST_TWISTED_CORNERS || self.fold_work + cubed > MOST_FOLD_WORK {
            return false;
        }
        self.fold_work += cubed;
        let origin = positions[corners[0] as usize];
        self.points.clear();
        self.points.extend(corners.iter().map(|&v| (positions[v as usize] - origin) * scale));
        twist::least_fold(&self.points, &mut self.triangles);
        true
    }

    /// Fills `flat` with the polygon in the coordinate plane in which it is largest; there it runs counter-clockwise.
    fn look_along_axis(&mut self, positions: &[DVec3], corners: &[u32], normal: DVec3, scale: f64) {
        let axis = normal.abs().max_position();
        let (mut u, mut v) = ((axis + 1) % 3, (axis + 2) % 3);
        if normal[axis] < 0.0 {
            std::mem::swap(&mut u, &mut v);
        }
        self.flat.clear();
        self.flat.extend(corners.iter().map(|&corner| {
            let p = positions[corner as usize] * scale;
            [p[u], p[v]]
        }));
    }

    /// Fills `flat` with the polygon in the plane across its normal, counter-clockwise.
    fn look_along_normal(&mut self, positions: &[DVec3], corners: &[u32], normal: DVec3, scale: f64) {
        let (u, v) = normal.normalize_or_zero().any_orthonormal_pair();
        let origin = positions[corners[0] as usize] * scale;
        self.flat.clear();
        self.flat.extend(corners.iter().map(|&corner| {
            let p = positions[corner as usize] * scale - origin;
            [p.dot(u), p.dot(v)]
        }));
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
        let squared = (count as u64).saturating_pow(2);
        let crossing = self.crosses_itself();
        self.work += squared / 16;
        if crossing {
            if count > MOST_CROSSING_CORNERS {
                return false;
            }
            self.work += squared;
        }
        self.earcut.earcut_slice(&self.flat, &[], &mut self.triangles);
        for triangle in self.triangles.chunks_exact_mut(3) {
            // Along the polygon, so that each turns as it does.
            triangle.sort_unstable();
        }
        if self.triangles.len() < 3 * (count - 2) {
            self.put_back_skipped_corners();
        }
        if !crossing {
            // Rounding lets ears without area pass for ears; Delaunay flips are rid of them.
            self.refiner.refine(&mut self.triangles, &self.flat);
        }
        self.triangles.len() == 3 * (count - 2) && self.is_disk()
    }

    /// Whether two of the polygon's edges cross. Touching is not crossing: a polygon with a hole that is joined to the
    /// outline by a cut runs along the cut twice.
    fn crosses_itself(&mut self) -> bool {
        let count = self.flat.len();
        let flat = &self.flat;
        let ends = |k: u32| (flat[k as usize], flat[(k as usize + 1) % count]);
        self.order.clear();
        #[expect(clippy::cast_possible_truncation, reason = "a polygon here has at most MOST_CORNERS corners")]
        self.order.extend(0..count as u32);
        let left = |k: u32| ends(k).0[0].min(ends(k).1[0]);
        self.order.sort_unstable_by(|&a, &b| left(a).total_cmp(&left(b)));
        for (i, &a) in self.order.iter().enumerate() {
            let (p, q) = ends(a);
            let (right, low, high) = (p[0].max(q[0]), p[1].min(q[1]), p[1].max(q[1]));
            for &b in &self.order[i + 1..] {
                let (r, s) = ends(b);
                if r[0].min(s[0]) > right {
                    break;
                }
                if r[1].max(s[1]) >= low && r[1].min(s[1]) <= high && cross([p, q, r, s]) {
                    return true;
                }
            }
        }
        false
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

/// The Newell normal, not normalised, of a polygon that was scaled to a size near one, and that scale, a power of two;
/// none if the corners lie on a line or are not finite.
fn newell(positions: &[DVec3], corners: &[u32]) -> Option<(DVec3, f64)> {
    let at = |k: usize| positions[corners[k] as usize];
    let origin = at(0);
    let size = corners.iter().map(|&v| (positions[v as usize] - origin).abs().max_element()).fold(0.0, f64::max);
    let finite = origin.is_finite() && corners.iter().all(|&v| (positions[v as usize] - origin).is_finite());
    if !finite || size == 0.0 {
        return None;
    }
    // So that products of very large or small coordinates stay in range; a power of two is free of rounding.
    let scale = size.log2().floor().clamp(-1000.0, 1000.0).exp2().recip();
    let mut normal = DVec3::ZERO;
    for k in 1..corners.len() - 1 {
        normal += ((at(k) - origin) * scale).cross((at(k + 1) - origin) * scale);
    }
    // Less is what rounding leaves of corners on a line.
    (normal.abs().max_element() > 16.0 * f64::EPSILON).then_some((normal, scale))
}

/// Whether the segments from p to q and from r to s cross in their insides.
fn cross([p, q, r, s]: [[f64; 2]; 4]) -> bool {
    let side = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        orient2d(Coord { x: a[0], y: a[1] }, Coord { x: b[0], y: b[1] }, Coord { x: c[0], y: c[1] })
    };
    side(p, q, r) * side(p, q, s) < 0.0 && side(r, s, p) * side(r, s, q) < 0.0
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

#[cfg(test)]
mod tests;
