//! A patch with faces as large as those around it, that goes on smoothly from the surface.

use std::collections::HashMap;
use std::f64::consts::{PI, SQRT_2};

use glam::DVec3;

use crate::math::Box3;

/// Rounds of splitting, and of relaxing within each: both end by themselves long before on what is no crafted input.
const ROUNDS: usize = 24;
const RELAXATIONS: usize = 12;
/// Vertices that one patch may get.
const MOST_VERTICES: usize = 100_000;
/// Two angles across an edge must exceed a half turn by this to be worth a flip.
const MARGIN: f64 = 1e-9;

/// Sweeps for the membrane and the thin plate, and moves that all sweeps of one patch may make.
const MEMBRANE: usize = 40;
const PLATE: usize = 400;
const MOVES: usize = 4_000_000;
/// The sweeps end when no point moves by more than this share of the patch's size.
const STILL: f64 = 1e-7;

/// A patch over points, of which the first `fixed` are on its border.
#[derive(Debug, Clone)]
pub(super) struct Patch {
    pub points: Vec<DVec3>,
    pub fixed: usize,
    pub triangles: Vec<[usize; 3]>,
}

impl Patch {
    /// Splits triangles at their middle while they are large against the edges around, and flips edges so that the angles
    /// across each are small: Liepa 2003, section 4.
    ///
    /// `scale` is the mean length of the edges at each border point; `taken` says which edges between border points are
    /// there already; `rounded` gives a new point as it can be held.
    pub fn refine(&mut self, scale: &[f64], taken: impl Fn(usize, usize) -> bool, rounded: impl Fn(DVec3) -> DVec3) {
        let mut scale = scale.to_vec();
        for _ in 0..ROUNDS {
            let before = self.triangles.len();
            for t in 0..before {
                let corners = self.triangles[t];
                let [a, b, c] = corners;
                let middle = rounded(corners.iter().map(|&v| self.points[v]).sum::<DVec3>() / 3.0);
                let size = corners.iter().map(|&v| scale[v]).sum::<f64>() / 3.0;
                let is_far = |&v: &usize| SQRT_2 * middle.distance(self.points[v]) > size.max(scale[v]);
                if self.points.len() - self.fixed < MOST_VERTICES && corners.iter().all(is_far) {
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
            self.relax(&taken);
        }
    }

    /// Flips inner edges until the two angles across each are no more than half a turn together.
    fn relax(&mut self, taken: impl Fn(usize, usize) -> bool) {
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
                    let there = of_edge.contains_key(&(c, d)) || of_edge.contains_key(&(d, c));
                    let there = there || (c < self.fixed && d < self.fixed && taken(c, d));
                    if there || !self.is_better_flipped([a, b, c, d]) {
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

    /// Whether the edge from `a` to `b` should rather run from `c` to `d`, and no triangle turns over by it.
    fn is_better_flipped(&self, corners: [usize; 4]) -> bool {
        let [a, b, c, d] = corners.map(|v| self.points[v]);
        if (a - c).angle_between(b - c) + (a - d).angle_between(b - d) <= PI + MARGIN {
            return false;
        }
        let normal = |p: DVec3, q: DVec3, r: DVec3| (q - p).cross(r - p);
        let about = normal(a, b, c) + normal(b, a, d);
        normal(a, d, c).dot(about) > 0.0 && normal(d, b, c).dot(about) > 0.0
    }
}

impl Patch {
    /// Moves the inner points to where the patch bends least: sweeps of the umbrella operator, first once for a membrane
    /// as a start, then twice for a thin plate (Kobbelt et al. 1998). The border stays where it is.
    ///
    /// `beyond` gives for each border point its neighbours on the surface outside the patch, by which the plate goes on in
    /// the surface's direction.
    pub fn fair(&mut self, beyond: &[Vec<DVec3>]) {
        let inner = self.points.len() - self.fixed;
        if inner == 0 {
            return;
        }
        let around = self.neighbours();
        let size = Box3::of(self.points.iter().copied()).diagonal();
        let sweeps = (MOVES / inner).max(1);
        self.sweep(MEMBRANE.min(sweeps), size, |points, v| umbrella(points, &around[v], &[], v));
        let none = Vec::new();
        let outside = |v: usize| beyond.get(v).unwrap_or(&none).as_slice();
        self.sweep(PLATE.min(sweeps / 8 + 1), size, |points, v| {
            let own = umbrella(points, &around[v], &[], v);
            let (mut sum, mut share) = (DVec3::ZERO, 0.0);
            for &w in &around[v] {
                sum += umbrella(points, &around[w], outside(w), w);
                share += 1.0 / count(around[w].len() + outside(w).len());
            }
            let n = count(around[v].len());
            // The second umbrella, over what it changes when the point moves by one.
            (own - sum / n) / (1.0 + share / n)
        });
    }

    /// Moves every inner point by what `step` says, until they are still or so many times.
    fn sweep(&mut self, sweeps: usize, size: f64, step: impl Fn(&[DVec3], usize) -> DVec3) {
        for _ in 0..sweeps {
            let mut farthest = 0.0f64;
            for v in self.fixed..self.points.len() {
                let by = step(&self.points, v);
                self.points[v] += by;
                farthest = farthest.max(by.length());
            }
            if farthest <= STILL * size {
                break;
            }
        }
    }

    fn neighbours(&self) -> Vec<Vec<usize>> {
        let mut around = vec![Vec::new(); self.points.len()];
        for &[a, b, c] in &self.triangles {
            for [v, w] in [[a, b], [b, c], [c, a]] {
                around[v].push(w);
                around[w].push(v);
            }
        }
        for list in &mut around {
            list.sort_unstable();
            list.dedup();
        }
        around
    }
}

/// From a point to the middle of its neighbours.
fn umbrella(points: &[DVec3], around: &[usize], outside: &[DVec3], v: usize) -> DVec3 {
    let sum = around.iter().map(|&w| points[w]).sum::<DVec3>() + outside.iter().sum::<DVec3>();
    sum / count(around.len() + outside.len()) - points[v]
}

fn count(n: usize) -> f64 {
    f64::from(u32::try_from(n.max(1)).unwrap_or(u32::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_gets_triangles_as_small_as_its_border() {
        let side = |from: DVec3, to: DVec3| (0..8).map(move |i| from.lerp(to, f64::from(i) / 8.0));
        let [a, b, c, d] = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::Y];
        let points: Vec<DVec3> = side(a, b).chain(side(b, c)).chain(side(c, d)).chain(side(d, a)).collect();
        let triangles = super::super::triangulate::planar(&points, &[32], DVec3::Z).unwrap_or_default();
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
