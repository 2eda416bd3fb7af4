//! Refines and smooths patches.

use std::collections::HashMap;
use std::f64::consts::{PI, SQRT_2};

use glam::DVec3;

use crate::math::Box3;

/// The most rounds of splitting, and of flipping within each round. Only crafted input reaches these limits.
const ROUNDS: usize = 24;
const RELAXATIONS: usize = 12;
/// The most vertices added to one patch.
const MAX_VERTICES: usize = 100_000;
/// Two opposite angles must exceed a half turn by this, in radians, for an edge to be flipped.
const ANGLE_MARGIN: f64 = 1e-9;

/// The sweeps for the membrane and the thin plate, and the most moves in all sweeps of one patch.
const MEMBRANE_SWEEPS: usize = 40;
const PLATE_SWEEPS: usize = 400;
const MAX_MOVES: usize = 4_000_000;
/// The sweeps end when no point moves by more than this share of the patch's size.
const STILL_SHARE: f64 = 1e-7;

/// A patch over points, of which the first `fixed` are on its border.
#[derive(Debug, Clone)]
pub(super) struct Patch {
    /// The points, those on the border first.
    pub points: Vec<DVec3>,
    /// The number of points on the border.
    pub fixed: usize,
    /// The triangles by point index.
    pub triangles: Vec<[usize; 3]>,
}

impl Patch {
    /// Splits triangles at their centroid while they are large relative to the edges around them, and flips edges with large
    /// opposite angles: Liepa 2003, section 4.
    ///
    /// `scale` is the mean edge length at each border point. `edge_exists` reports whether two border points are connected
    /// outside the patch. `rounded` rounds a new point to the precision of the result.
    pub fn refine(
        &mut self,
        scale: &[f64],
        edge_exists: impl Fn(usize, usize) -> bool,
        rounded: impl Fn(DVec3) -> DVec3,
    ) {
        let mut scale = scale.to_vec();
        for _ in 0..ROUNDS {
            let before = self.triangles.len();
            for t in 0..before {
                let corners = self.triangles[t];
                let [a, b, c] = corners;
                let middle = rounded(corners.iter().map(|&v| self.points[v]).sum::<DVec3>() / 3.0);
                let size = corners.iter().map(|&v| scale[v]).sum::<f64>() / 3.0;
                let is_far = |&v: &usize| SQRT_2 * middle.distance(self.points[v]) > size.max(scale[v]);
                if self.points.len() - self.fixed < MAX_VERTICES && corners.iter().all(is_far) {
                    let m = self.points.len();
                    self.points.push(middle);
                    scale.push(size);
                    self.triangles[t] = [a, b, m];
                    self.triangles.extend([[b, c, m], [c, a, m]]);
                }
            }
            if self.triangles.len() == before {
                break;
            }
            self.relax(&edge_exists);
        }
    }

    /// Flips inner edges until the two opposite angles of each sum to at most half a turn.
    fn relax(&mut self, edge_exists: impl Fn(usize, usize) -> bool) {
        let mut of_edge: HashMap<(usize, usize), usize> = HashMap::with_capacity(3 * self.triangles.len());
        for (t, &[a, b, c]) in self.triangles.iter().enumerate() {
            of_edge.extend([((a, b), t), ((b, c), t), ((c, a), t)]);
        }
        for _ in 0..RELAXATIONS {
            let mut flipped = false;
            for t in 0..self.triangles.len() {
                for k in 0..3 {
                    let [a, b, c] = [0, 1, 2].map(|i| self.triangles[t][(k + i) % 3]);
                    let Some(&u) = of_edge.get(&(b, a)) else { continue };
                    let Some(&d) = self.triangles[u].iter().find(|&&v| v != a && v != b) else { continue };
                    let exists = of_edge.contains_key(&(c, d)) || of_edge.contains_key(&(d, c));
                    let exists = exists || (c < self.fixed && d < self.fixed && edge_exists(c, d));
                    if exists || !self.is_better_flipped([a, b, c, d]) {
                        continue;
                    }
                    self.triangles[t] = [a, d, c];
                    self.triangles[u] = [d, b, c];
                    of_edge.remove(&(a, b));
                    of_edge.remove(&(b, a));
                    of_edge.extend([((a, d), t), ((d, c), t), ((c, a), t), ((d, b), u), ((b, c), u), ((c, d), u)]);
                    flipped = true;
                    break;
                }
            }
            if !flipped {
                break;
            }
        }
    }

    /// Whether flipping the edge from `a` to `b` to run from `c` to `d` improves the angles without flipping a triangle over.
    fn is_better_flipped(&self, corners: [usize; 4]) -> bool {
        let [a, b, c, d] = corners.map(|v| self.points[v]);
        if (a - c).angle_between(b - c) + (a - d).angle_between(b - d) <= PI + ANGLE_MARGIN {
            return false;
        }
        let normal = |p: DVec3, q: DVec3, r: DVec3| (q - p).cross(r - p);
        let mean_normal = normal(a, b, c) + normal(b, a, d);
        normal(a, d, c).dot(mean_normal) > 0.0 && normal(d, b, c).dot(mean_normal) > 0.0
    }
}

impl Patch {
    /// Moves the inner points to minimise the bending of the patch (Kobbelt et al. 1998). Sweeps of the umbrella operator
    /// first give a membrane as a start, then sweeps of its square a thin plate. The border stays in place.
    ///
    /// `beyond` gives for each border point its neighbours on the surface outside the patch, so that the plate continues
    /// the surface's direction.
    pub fn fair(&mut self, beyond: &[Vec<DVec3>]) {
        let inner = self.points.len() - self.fixed;
        if inner == 0 {
            return;
        }
        let neighbours = self.neighbours();
        let size = Box3::of(self.points.iter().copied()).diagonal();
        let sweeps = (MAX_MOVES / inner).max(1);
        self.sweep(MEMBRANE_SWEEPS.min(sweeps), size, |points, v| umbrella(points, &neighbours[v], &[], v));
        let no_neighbours = Vec::new();
        let outside = |v: usize| beyond.get(v).unwrap_or(&no_neighbours).as_slice();
        self.sweep(PLATE_SWEEPS.min(sweeps / 8 + 1), size, |points, v| {
            let own = umbrella(points, &neighbours[v], &[], v);
            let (mut sum, mut share) = (DVec3::ZERO, 0.0);
            for &w in &neighbours[v] {
                sum += umbrella(points, &neighbours[w], outside(w), w);
                share += 1.0 / count(neighbours[w].len() + outside(w).len());
            }
            let n = count(neighbours[v].len());
            // The second-order umbrella, divided by its derivative with respect to the point.
            (own - sum / n) / (1.0 + share / n)
        });
    }

    /// Moves every inner point by `step`, until all points are still or the sweeps are used up.
    fn sweep(&mut self, sweeps: usize, size: f64, step: impl Fn(&[DVec3], usize) -> DVec3) {
        for _ in 0..sweeps {
            let mut farthest = 0.0f64;
            for v in self.fixed..self.points.len() {
                let by = step(&self.points, v);
                self.points[v] += by;
                farthest = farthest.max(by.length());
            }
            if farthest <= STILL_SHARE * size {
                break;
            }
        }
    }

    /// The neighbours of each point.
    fn neighbours(&self) -> Vec<Vec<usize>> {
        let mut neighbours = vec![Vec::new(); self.points.len()];
        for &[a, b, c] in &self.triangles {
            for [v, w] in [[a, b], [b, c], [c, a]] {
                neighbours[v].push(w);
                neighbours[w].push(v);
            }
        }
        for list in &mut neighbours {
            list.sort_unstable();
            list.dedup();
        }
        neighbours
    }
}

/// The vector from a point to the mean of its neighbours.
fn umbrella(points: &[DVec3], neighbours: &[usize], outside: &[DVec3], v: usize) -> DVec3 {
    let sum = neighbours.iter().map(|&w| points[w]).sum::<DVec3>() + outside.iter().sum::<DVec3>();
    sum / count(neighbours.len() + outside.len()) - points[v]
}

/// The number as a float, at least 1.
fn count(n: usize) -> f64 {
    f64::from(u32::try_from(n.max(1)).unwrap_or(u32::MAX))
}

/// The faults of a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Faults {
    /// The number of intersecting pairs of faces with at least one face of the patch.
    pub crossings: u64,
    /// The number of faces with collinear corners.
    pub degenerate: u64,
}

impl Faults {
    /// Whether there are no faults.
    pub fn is_empty(self) -> bool {
        self == Self::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refined_square_gets_triangles_as_small_as_its_border_edges() {
        let side = |from: DVec3, to: DVec3| (0..8).map(move |i| from.lerp(to, f64::from(i) / 8.0));
        let [a, b, c, d] = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
        let points: Vec<DVec3> = side(a, b).chain(side(b, c)).chain(side(c, d)).chain(side(d, a)).collect();
        let triangles = crate::math::triangulated_area(&points, &[32], DVec3::Z).unwrap_or_default();
        let mut patch = Patch { fixed: 32, points, triangles };
        patch.refine(&[0.125; 32], |_, _| false, |p| p);
        let area = |t: &[usize; 3]| {
            let [a, b, c] = t.map(|v| patch.points[v]);
            (b - a).cross(c - a).z / 2.0
        };
        assert!(patch.triangles.iter().all(|t| area(t) > 0.0));
        assert!((patch.triangles.iter().map(area).sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(patch.points.len() > 60 && patch.points.len() < 200, "{}", patch.points.len());
        assert_eq!(patch.triangles.len(), 30 + 2 * (patch.points.len() - 32));
    }
}
