//! Triangulation of polygons.
//!
//! The polygon is projected along the axis nearest to its Newell normal (Sutherland, Sproull and Schumacker 1974). Dropping a coordinate
//! needs no rounding. Collinear corners therefore stay collinear, and a flat simple polygon stays simple. Ear cutting then runs in that
//! plane.
//!
//! Every polygon of n corners, whatever its shape, gives exactly n - 2 triangles. They have the polygon's orientation, and each edge of the
//! polygon is a side of exactly one of them.

mod twist;

use earcut::{Earcut, Refiner};
use glam::DVec3;
use robust::{Coord, orient2d};

use super::content::Polygons;

/// Triangulates polygons, and reuses its buffers from one polygon to the next.
pub(super) struct Triangulator {
    earcut: Earcut<f64>,
    refiner: Refiner,
    flat: Vec<[f64; 2]>,
    triangles: Vec<u32>,
    edges: Vec<(u32, u32)>,
    order: Vec<u32>,
    work: u64,
    degenerate_count: u64,
    fan_count: u64,
    points: Vec<DVec3>,
    fold_work: u64,
    /// Squared sine of the twist angle above which a polygon counts as twisted.
    twist: f64,
    counted: u64,
    twisted: u64,
    /// Largest squared sine of a twist so far.
    max_squared_sine: f64,
}

/// Polygons with more corners are split as fans, which is right only for is_convex polygons. Ear cutting takes quadratic time on
/// adversarial polygons.
const MAX_CORNERS: usize = 8192;

/// Self-intersecting polygons with more corners are split as fans. Ear cutting can take cubic time on them, and its result is no better.
const MAX_CROSSING_CORNERS: usize = 64;

/// Total work, in squared corner counts, after which all polygons are split as fans. Only adversarial models need that much.
const MAX_WORK: u64 = 100_000_000;

/// Corners with a smaller doubled triangle area count as straight, in a polygon scaled to a size near one.
const STRAIGHT_AREA: f64 = 1e-9;

/// Twisted polygons with more corners are triangulated as flat ones, because finding the least fold takes cubic time.
const MAX_TWISTED_CORNERS: usize = 64;

/// Total work, in cubed corner counts, after which all twisted polygons are triangulated as flat ones.
const MAX_FOLD_WORK: u64 = 500_000_000;

impl Triangulator {
    /// Polygons twisted by more than `twist_angle_deg` are triangulated with the least fold.
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
            degenerate_count: 0,
            fan_count: 0,
            points: Vec::new(),
            fold_work: 0,
            twist: if twist_angle_deg < 90.0 { sine * sine } else { f64::INFINITY },
            counted: 0,
            twisted: 0,
            max_squared_sine: 0.0,
        }
    }

    /// Number of polygons without a normal: all corners are collinear, or some are not finite. They are split as fans.
    pub fn degenerate_count(&self) -> u64 {
        self.degenerate_count
    }

    /// Number of non-is_convex polygons that were split as fans, because they cross themselves or have too many corners.
    pub fn fan_count(&self) -> u64 {
        self.fan_count
    }

    /// Counts of all polygons with more than three corners so far.
    pub fn polygons(&self) -> Polygons {
        let largest_twist_deg = self.max_squared_sine.sqrt().min(1.0).asin().to_degrees();
        Polygons { count: self.counted, twisted: self.twisted, largest_twist_deg }
    }

    /// Triangulates one polygon. `corners` are indices into `positions`, all in range. The n - 2 triangles go to `push` as indices into
    /// `corners`.
    pub fn triangulate(&mut self, positions: &[DVec3], corners: &[u32], mut push: impl FnMut([usize; 3])) {
        let count = corners.len();
        if count < 3 {
            return;
        }
        if count == 3 {
            push([0, 1, 2]);
            return;
        }
        self.counted += 1;
        match self.triangulation_of(positions, corners) {
            Triangulation::FanFrom(start) => {
                for k in 1..count - 1 {
                    push([start, (start + k) % count, (start + k + 1) % count]);
                }
            }
            Triangulation::Ears => {
                for triangle in self.triangles.chunks_exact(3) {
                    push([triangle[0], triangle[1], triangle[2]].map(|k| k as usize));
                }
            }
        }
    }

    /// Chooses the triangulation of a polygon with more than three corners.
    fn triangulation_of(&mut self, positions: &[DVec3], corners: &[u32]) -> Triangulation {
        let count = corners.len();
        let Some((normal, scale)) = newell(positions, corners) else {
            self.degenerate_count += 1;
            return Triangulation::FanFrom(0);
        };
        let twist = twist::squared_sine(positions, corners, normal, scale);
        self.max_squared_sine = self.max_squared_sine.max(twist);
        let twisted = twist > self.twist;
        self.twisted += u64::from(twisted);
        self.project_along_axis(positions, corners, normal, scale);
        if count == 4 {
            // Only a fan from a straight or reflex corner has triangles with area and without folds.
            let flat = (0..4).find(|&k| self.turn(k) <= STRAIGHT_AREA).unwrap_or(0);
            let at = |k: usize| (positions[corners[k] as usize] - positions[corners[0] as usize]) * scale;
            return Triangulation::FanFrom(if twisted { twist::quad_start([0, 1, 2, 3].map(at), flat) } else { flat });
        }
        if twisted && self.triangulate_twisted(positions, corners, scale) {
            return Triangulation::Ears;
        }
        let is_convex = self.is_convex();
        if count > MAX_CORNERS || self.work > MAX_WORK {
            self.fan_count += u64::from(!is_convex);
            return Triangulation::FanFrom(0);
        }
        if is_convex {
            self.triangles.clear();
            #[expect(clippy::cast_possible_truncation, reason = "a polygon here has at most MAX_CORNERS corners")]
            self.triangles.extend((1..count as u32 - 1).flat_map(|k| [0, k, k + 1]));
            self.refiner.refine(&mut self.triangles, &self.flat);
            return Triangulation::Ears;
        }
        if self.cut_ears() {
            return Triangulation::Ears;
        }
        // A narrow polygon that is slightly bent can cross itself in an axis-aligned projection.
        self.project_along_normal(positions, corners, normal, scale);
        if self.cut_ears() {
            return Triangulation::Ears;
        }
        self.fan_count += 1;
        Triangulation::FanFrom(0)
    }

    /// Triangulates a twisted polygon with the least fold; `false` if that would take too long.
    fn triangulate_twisted(&mut self, positions: &[DVec3], corners: &[u32], scale: f64) -> bool {
        let cubed = (corners.len() as u64).saturating_pow(3);
        if corners.len() > MAX_TWISTED_CORNERS || self.fold_work + cubed > MAX_FOLD_WORK {
            return false;
        }
        self.fold_work += cubed;
        let origin = positions[corners[0] as usize];
        self.points.clear();
        self.points.extend(corners.iter().map(|&v| (positions[v as usize] - origin) * scale));
        twist::triangulate_with_least_fold(&self.points, &mut self.triangles);
        true
    }

    /// Projects the polygon along the axis nearest to its normal into `flat`, counter-clockwise.
    fn project_along_axis(&mut self, positions: &[DVec3], corners: &[u32], normal: DVec3, scale: f64) {
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

    /// Projects the polygon along its normal into `flat`, counter-clockwise.
    fn project_along_normal(&mut self, positions: &[DVec3], corners: &[u32], normal: DVec3, scale: f64) {
        let (u, v) = normal.normalize_or_zero().any_orthonormal_pair();
        let origin = positions[corners[0] as usize] * scale;
        self.flat.clear();
        self.flat.extend(corners.iter().map(|&corner| {
            let p = positions[corner as usize] * scale - origin;
            [p.dot(u), p.dot(v)]
        }));
    }

    /// The orientation at a corner: positive for a left turn, zero for straight.
    fn turn(&self, k: usize) -> f64 {
        let count = self.flat.len();
        let at = |k: usize| Coord { x: self.flat[k % count][0], y: self.flat[k % count][1] };
        orient2d(at(k + count - 1), at(k), at(k + 1))
    }

    /// Whether the polygon is is_convex: every corner turns left, and the turns add up to one revolution.
    fn is_convex(&self) -> bool {
        if (0..self.flat.len()).any(|k| self.turn(k) <= 0.0) {
            return false;
        }
        let count = self.flat.len();
        // A polygon with only left turns makes one revolution if its direction changes between left and right twice.
        let rightward = |k: usize| {
            let (a, b) = (self.flat[k % count], self.flat[(k + 1) % count]);
            (b[0], b[1]) > (a[0], a[1])
        };
        (0..count).filter(|&k| rightward(k) != rightward(k + 1)).count() == 2
    }

    /// Cuts ears; `false` if the result is not a disk bounded by exactly the polygon's edges.
    fn cut_ears(&mut self) -> bool {
        let count = self.flat.len();
        let squared = (count as u64).saturating_pow(2);
        let crossing = self.crosses_itself();
        self.work += squared / 16;
        if crossing {
            if count > MAX_CROSSING_CORNERS {
                return false;
            }
            self.work += squared;
        }
        self.earcut.earcut_slice(&self.flat, &[], &mut self.triangles);
        for triangle in self.triangles.chunks_exact_mut(3) {
            // In the polygon's order, so each triangle has its orientation.
            triangle.sort_unstable();
        }
        if self.triangles.len() < 3 * (count - 2) {
            self.restore_skipped_corners();
        }
        if !crossing {
            // Rounding can produce ears without area; Delaunay flips remove them.
            self.refiner.refine(&mut self.triangles, &self.flat);
        }
        self.triangles.len() == 3 * (count - 2) && self.is_disk()
    }

    /// Whether two of the polygon's edges cross in their interiors. Touching edges are allowed: a polygon with a hole that a bridge edge
    /// joins to the outline runs along the bridge twice.
    fn crosses_itself(&mut self) -> bool {
        let count = self.flat.len();
        let flat = &self.flat;
        let ends = |k: u32| (flat[k as usize], flat[(k as usize + 1) % count]);
        self.order.clear();
        #[expect(clippy::cast_possible_truncation, reason = "a polygon here has at most MAX_CORNERS corners")]
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
                if r[1].max(s[1]) >= low && r[1].min(s[1]) <= high && segments_cross([p, q, r, s]) {
                    return true;
                }
            }
        }
        false
    }

    /// Restores the collinear corners that ear cutting skips. Each run of them splits the triangle that has the run as a side.
    fn restore_skipped_corners(&mut self) {
        let count = self.flat.len();
        let mut used = vec![false; count];
        for &k in &self.triangles {
            used[k as usize] = true;
        }
        let Some(first) = used.iter().position(|&u| u) else { return };
        #[expect(clippy::cast_possible_truncation, reason = "a polygon here has at most MAX_CORNERS corners")]
        let name = |k: usize| (k % count) as u32;
        let mut at = first;
        while at < first + count {
            let Some(next) = (at + 1..=first + count).find(|&k| used[k % count]) else { return };
            if next > at + 1 {
                let (a, b) = (name(at), name(next));
                let Some(index) = self.triangles.chunks_exact(3).position(|t| has_side(t, a, b)) else { return };
                let apex = self.triangles[3 * index..3 * index + 3].iter().copied().find(|&k| k != a && k != b);
                let Some(apex) = apex else { return };
                for (k, slot) in [a, name(at + 1), apex].into_iter().enumerate() {
                    self.triangles[3 * index + k] = slot;
                }
                for k in at + 1..next {
                    self.triangles.extend([name(k), name(k + 1), apex]);
                }
            }
            at = next;
        }
    }

    /// Whether every polygon edge is a side exactly once, and every other side occurs once in each direction.
    fn is_disk(&mut self) -> bool {
        self.edges.clear();
        for t in self.triangles.chunks_exact(3) {
            self.edges.extend([(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
        }
        let count = self.flat.len();
        // The polygon's own edges in reverse, so that every side has an opposite.
        #[expect(clippy::cast_possible_truncation, reason = "a polygon here has at most MAX_CORNERS corners")]
        self.edges.extend((0..count).map(|k| (((k + 1) % count) as u32, k as u32)));
        self.edges.sort_unstable();
        self.edges.windows(2).all(|w| w[0] != w[1])
            && self.edges.iter().all(|&(a, b)| a != b && self.edges.binary_search(&(b, a)).is_ok())
    }
}

/// The Newell normal, not normalised, of a polygon scaled to a size near one, and that scale, a power of two. `None` if the corners are
/// collinear or not finite.
fn newell(positions: &[DVec3], corners: &[u32]) -> Option<(DVec3, f64)> {
    let at = |k: usize| positions[corners[k] as usize];
    let origin = at(0);
    let size = corners.iter().map(|&v| (positions[v as usize] - origin).abs().max_element()).fold(0.0, f64::max);
    let finite = origin.is_finite() && corners.iter().all(|&v| (positions[v as usize] - origin).is_finite());
    if !finite || size == 0.0 {
        return None;
    }
    // Scaling keeps products of very large or small coordinates in range; a power of two scales without rounding.
    let scale = size.log2().floor().clamp(-1000.0, 1000.0).exp2().recip();
    let mut normal = DVec3::ZERO;
    for k in 1..corners.len() - 1 {
        normal += ((at(k) - origin) * scale).cross((at(k + 1) - origin) * scale);
    }
    // Smaller normals are rounding errors of collinear corners.
    (normal.abs().max_element() > 16.0 * f64::EPSILON).then_some((normal, scale))
}

/// Whether the segments pq and rs cross in their interiors.
fn segments_cross([p, q, r, s]: [[f64; 2]; 4]) -> bool {
    let side = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        orient2d(Coord { x: a[0], y: a[1] }, Coord { x: b[0], y: b[1] }, Coord { x: c[0], y: c[1] })
    };
    side(p, q, r) * side(p, q, s) < 0.0 && side(r, s, p) * side(r, s, q) < 0.0
}

fn has_side(triangle: &[u32], a: u32, b: u32) -> bool {
    (0..3).any(|k| triangle[k] == a && triangle[(k + 1) % 3] == b)
}

/// How a polygon is triangulated.
enum Triangulation {
    /// A fan of triangles from one corner.
    FanFrom(usize),
    /// The triangles are in `Triangulator::triangles`, as corner indices of the polygon.
    Ears,
}

#[cfg(test)]
mod tests;
