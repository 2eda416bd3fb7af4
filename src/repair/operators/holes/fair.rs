//! A patch that goes on smoothly from the surface around it.

use glam::DVec3;

use super::refine::Patch;

/// Sweeps for the membrane and the thin plate, and moves that all sweeps of one patch may make.
const MEMBRANE: usize = 40;
const PLATE: usize = 400;
const MOVES: usize = 4_000_000;
/// The sweeps end when no point moves by more than this share of the patch's size.
const STILL: f64 = 1e-7;

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
        let size = crate::math::Box3::of(self.points.iter().copied()).diagonal();
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
