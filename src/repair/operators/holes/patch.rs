//! A patch with faces as large as those around it, that goes on smoothly from the surface; and whether it intersects the surface,
//! other patches or itself, exactly.

use std::collections::HashMap;
use std::f64::consts::{PI, SQRT_2};

use glam::DVec3;

use crate::math::{Box3, Frame, Tree, collinear, contact, to_unit_range, unit_scale};

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

/// Steps that all questions together may take: pairs of triangles looked at, and what slow signs count.
const STEPS: u64 = 60_000_000;
const STEPS_A_SLOW_SIGN: u64 = 8;
/// Patch faces that are looked through one by one before they get a tree.
const BLOCK: usize = 64;

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

/// What is wrong with a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Faults {
    /// Pairs of faces that intersect, of which at least one is the patch's.
    pub crossings: u64,
    /// Faces whose corners lie on a line.
    pub flat: u64,
}

impl Faults {
    pub fn none(self) -> bool {
        self == Self::default()
    }
}

/// The surface around the holes and the patches so far, in trees, for the exact predicates.
///
/// The surface gets its tree once. Patches come one after another: a tree holds a block of them, and of blocks of one size
/// two are joined (Bentley and Saxe 1980), so that a question looks at logarithmically many trees.
pub(super) struct Clearance<'a> {
    unit: Vec<DVec3>,
    scale: f64,
    faces: &'a [[u32; 3]],
    frame: Frame,
    tree: Tree,
    patches: Vec<[u32; 3]>,
    blocks: Vec<(usize, Tree)>,
    steps: u64,
}

impl<'a> Clearance<'a> {
    pub fn new(positions: &[DVec3], faces: &'a [[u32; 3]]) -> Self {
        let unit = to_unit_range(positions);
        let frame = Frame::around(&unit, faces);
        let tree = Tree::in_frame(frame, &unit, faces);
        let scale = unit_scale(positions);
        Self { unit, scale, faces, frame, tree, patches: Vec::new(), blocks: Vec::new(), steps: STEPS }
    }

    /// Positions in the range of the exact predicates.
    pub fn unit(&self) -> &[DVec3] {
        &self.unit
    }

    /// Steps that questions may still take.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Adds vertices after those that are there.
    pub fn add_vertices(&mut self, positions: &[DVec3]) {
        self.unit.extend(positions.iter().map(|&p| p * self.scale));
    }

    /// Drops all vertices from a number on; no patch must use them.
    pub fn drop_vertices(&mut self, from: usize) {
        self.unit.truncate(from);
    }

    /// The patches that were put in.
    pub fn patches(&self) -> &[[u32; 3]] {
        &self.patches
    }

    /// Puts in a patch.
    pub fn put(&mut self, patch: &[[u32; 3]]) {
        self.patches.extend_from_slice(patch);
        let covered = self.covered();
        if self.patches.len() - covered < BLOCK {
            return;
        }
        let mut start = covered;
        while let Some(&(end, _)) = self.blocks.last() {
            let begin = self.blocks.len().checked_sub(2).map_or(0, |i| self.blocks[i].0);
            if end - begin > self.patches.len() - start {
                break;
            }
            start = begin;
            self.blocks.pop();
        }
        let tree = Tree::in_frame(self.frame, &self.unit, &self.patches[start..]);
        self.blocks.push((self.patches.len(), tree));
    }

    /// Takes out all patch faces from a number on.
    pub fn take_out(&mut self, from: usize) {
        self.patches.truncate(from);
        while self.covered() > from {
            self.blocks.pop();
        }
    }

    /// How many patch faces are in blocks.
    fn covered(&self) -> usize {
        self.blocks.last().map_or(0, |b| b.0)
    }

    /// What is wrong with a patch, counted until it is more than `most` pairs; `flat_picture` where it is known not to
    /// intersect itself. None where the steps were spent.
    pub fn faults(&mut self, patch: &[[u32; 3]], flat_picture: bool, most: u64) -> Option<Faults> {
        let mut faults = Faults::default();
        let own = (!flat_picture && patch.len() > BLOCK).then(|| Tree::in_frame(self.frame, &self.unit, patch));
        for (i, &face) in patch.iter().enumerate() {
            let corners = face.map(|v| self.unit[v as usize]);
            if collinear(corners[0], corners[1], corners[2]) {
                faults.flat += 1;
                continue;
            }
            let mut looked = 0;
            let bounds = Box3::of(corners);
            let mut see = |other: [u32; 3]| {
                looked += 1;
                faults.crossings += u64::from(self.meet(&corners, &bounds, other, &mut looked));
                faults.crossings <= most && looked < self.steps
            };
            self.tree.overlapping(&bounds, |f| see(self.faces[f as usize]));
            let mut start = 0;
            for (end, tree) in &self.blocks {
                tree.overlapping(&bounds, |f| see(self.patches[start + f as usize]));
                start = *end;
            }
            for &other in &self.patches[start..] {
                see(other);
            }
            match &own {
                // Each pair is seen from its second face.
                Some(tree) => tree.overlapping(&bounds, |f| (f as usize) >= i || see(patch[f as usize])),
                None if flat_picture => {}
                None => patch[..i].iter().for_each(|&other| {
                    see(other);
                }),
            }
            self.steps = self.steps.saturating_sub(looked);
            if self.steps == 0 {
                return None;
            }
            if faults.crossings > most {
                break;
            }
        }
        Some(faults)
    }

    /// Whether a triangle has more in common with a face than a vertex or an edge of both. Vertices at one position
    /// are one here, as they will be in a file.
    fn meet(&self, corners: &[DVec3; 3], bounds: &Box3, face: [u32; 3], steps: &mut u64) -> bool {
        let other = face.map(|v| self.unit[v as usize]);
        let about = Box3::of(other);
        if about.min.cmpgt(bounds.max).any() || about.max.cmplt(bounds.min).any() {
            return false;
        }
        let [a, b, c] = *corners;
        let [d, e, f] = other;
        // A face without area, as cracks are closed with, and of which nothing can be asked.
        if d == e || e == f || f == d {
            return false;
        }
        let number = |q: DVec3, own: u32| (0u32..).zip(corners).find(|(_, p)| **p == q).map_or(own, |(i, _)| i);
        let numbers = [number(d, 3), number(e, 4), number(f, 5)];
        let mut slow = 0;
        let found = contact(&[a, b, c, d, e, f], [0, 1, 2], numbers, &mut slow);
        *steps += slow * STEPS_A_SLOW_SIGN;
        // Of a face on a line the answer means nothing; to ask that first would take longer than all else.
        !found.is_apart() && !collinear(d, e, f)
    }
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
