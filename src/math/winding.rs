//! Generalized winding numbers of triangles around points: exact sums, and fast sums over a [`Tree`] of dipoles.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use obvhs::aabb::Aabb;
use obvhs::bvh2::node::Bvh2Node;
use smallvec::{SmallVec, smallvec};

use super::tree::{DEPTH, Tree, box_distance_squared, spend, triangles_of};

/// Distance of a point from a cluster, in radii of the cluster, beyond which the cluster counts as one dipole. At 2 the
/// sum over a closed surface errs by about 0.02, far from the 0.5 that separates inside from outside. A value of 3
/// takes twice the time.
const DIPOLE_DISTANCE: f64 = 2.0;
/// Distance from the model, in half-sides of the model, beyond which its winding number is 0.
const FAR: f64 = 1e18;

/// Ratio of a triangle's distance to the offset of two query points beyond which the triangle is evaluated once for
/// both, at their midpoint. Its solid angle then errs by about a thousandth.
const SHARED_DISTANCE: f64 = 1e3;

/// The rule that decides by its winding number `w` whether a cell or a point is inside. Around open surface, `w` is not an integer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum WindingRule {
    /// `w >= 1`, or `w > 1/2` around open surface: space that the surface winds around outward. An inverted part adds no material.
    #[default]
    Positive,
    /// `w != 0`, or `|w| > 1/2` around open surface: inverted parts are solid as well.
    Nonzero,
    /// `w` is odd, or `|w|` nearer to an odd number than to an even one: space that is enclosed twice is outside, whatever the orientation
    /// of its facets.
    Odd,
}

/// A dipole for the triangles under each node of a [`Tree`], in the tree's frame.
pub struct Dipoles {
    nodes: Vec<Dipole>,
}

/// A cluster of triangles, approximated by a dipole. f32 suffices: the approximation itself errs far more.
#[derive(Clone, Copy, Default)]
struct Dipole {
    /// Area-weighted centroid.
    centre: Vec3,
    /// Sum of the area vectors: normals with the length of the area.
    area: Vec3,
    /// Sum of the areas.
    weight: f32,
    /// Radius of a sphere around the centre that contains all triangles.
    radius: f32,
}

impl Dipole {
    /// The sum of dipoles, in a sphere around the box that contains their triangles.
    fn around(dipoles: impl Iterator<Item = Self>, aabb: &Aabb) -> Self {
        let (mut moment, mut sum) = (Vec3::ZERO, Self::default());
        for Self { centre, area, weight, .. } in dipoles {
            sum.area += area;
            sum.weight += weight;
            moment += centre * weight;
        }
        let (min, max) = (Vec3::from(aabb.min), Vec3::from(aabb.max));
        sum.centre = if sum.weight > 0.0 { moment / sum.weight } else { (min + max) * 0.5 };
        sum.radius = (sum.centre - min).max(max - sum.centre).length();
        sum
    }
}

impl Tree {
    /// Computes the dipoles for [`Tree::winding`]. `triangle` returns the corners that the tree was built with.
    pub fn dipoles(&self, triangle: impl Fn(u32) -> [DVec3; 3] + Sync) -> Dipoles {
        let of_leaf = |node: &Bvh2Node, faces: &[u32]| {
            let faces = faces.iter().map(|&face| {
                let [a, b, c] = self.framed(triangle(face));
                let area = ((b - a).cross(c - a) * 0.5).as_vec3();
                Dipole { centre: ((a + b + c) / 3.0).as_vec3(), area, weight: area.length(), radius: 0.0 }
            });
            Dipole::around(faces, node.aabb())
        };
        let of_children = |node: &Bvh2Node, children: [Dipole; 2]| {
            let mut sum = Dipole::around(children.into_iter(), node.aabb());
            // If the triangles fill the box badly, the children's spheres give a smaller radius than the box's corners.
            let [left, right] = children.map(|child| child.radius + child.centre.distance(sum.centre));
            sum.radius = sum.radius.min(left.max(right));
            sum
        };
        Dipoles { nodes: self.summaries(Dipole::default(), of_leaf, of_children) }
    }

    /// The generalized winding number of the triangles around a point: 1 inside a closed, outward-oriented surface, 0
    /// outside, and between them near a hole (Jacobson, Kavan and Sorkine-Hornung 2013). Near triangles count exactly,
    /// far clusters as dipoles (Barill et al. 2018, order 1). The error is about 0.02.
    ///
    /// `dipoles` and `triangle` belong to the triangles that the tree was built with. `steps` is the number of nodes
    /// and triangles that may still be visited, and counts down. When it reaches 0, the remaining triangles are
    /// omitted.
    pub fn winding(
        &self,
        dipoles: &Dipoles,
        point: DVec3,
        steps: &mut u64,
        triangle: impl Fn(u32) -> [DVec3; 3],
    ) -> f64 {
        let [number, _] = self.windings(dipoles, [point, DVec3::ZERO], steps, triangle);
        number
    }

    /// The winding numbers at `point + aside` and `point - aside`, in one traversal. Triangles that are far away
    /// relative to the offset are evaluated once for both.
    pub fn windings(
        &self,
        dipoles: &Dipoles,
        [point, aside]: [DVec3; 2],
        steps: &mut u64,
        triangle: impl Fn(u32) -> [DVec3; 3],
    ) -> [f64; 2] {
        let Some(bvh) = &self.bvh else { return [0.0; 2] };
        let query = self.frame.to_tree(point);
        if !query.abs().cmplt(DVec3::splat(FAR)).all() {
            return [0.0; 2];
        }
        let aside = aside * self.frame.scale();
        let shared_from = (aside.length() * SHARED_DISTANCE).powi(2);
        let mut sides = [HalfAngles::NONE; 2];
        let (mut angle, mut shared) = (0.0, HalfAngles::NONE);
        let mut stack: SmallVec<[u32; DEPTH]> = smallvec![0];
        while let Some(at) = stack.pop() {
            let (node, dipole) = (&bvh.nodes[at as usize], &dipoles.nodes[at as usize]);
            if !spend(steps, node) {
                break;
            }
            let towards = dipole.centre.as_dvec3() - query;
            let square = towards.length_squared();
            if square > (DIPOLE_DISTANCE * f64::from(dipole.radius)).powi(2) {
                angle += dipole.area.as_dvec3().dot(towards) / (square * square.sqrt());
            } else if node.is_leaf() {
                let is_near = shared_from > 0.0 && box_distance_squared(node.aabb(), query) < shared_from;
                for &face in triangles_of(bvh, node) {
                    let [a, b, c] = self.framed(triangle(face));
                    let corners = [a - query, b - query, c - query];
                    if is_near {
                        sides[0].add(corners.map(|p| p - aside));
                        sides[1].add(corners.map(|p| p + aside));
                    } else {
                        shared.add(corners);
                    }
                }
            } else {
                stack.push(node.first_index + 1);
                stack.push(node.first_index);
            }
        }
        let shared = angle + shared.sum();
        sides.map(|side| (shared + side.sum()) / (4.0 * PI))
    }

    /// Transforms a triangle into the tree's frame.
    #[inline]
    fn framed(&self, triangle: [DVec3; 3]) -> [DVec3; 3] {
        let [a, b, c] = triangle;
        [self.frame.to_tree(a), self.frame.to_tree(b), self.frame.to_tree(c)]
    }
}

/// The generalized winding number of triangles around a point, summed exactly over all triangles.
pub fn winding_exact(point: DVec3, triangles: impl IntoIterator<Item = [DVec3; 3]>) -> f64 {
    let mut angles = HalfAngles::NONE;
    triangles.into_iter().for_each(|[a, b, c]| angles.add([a - point, b - point, c - point]));
    angles.sum() / (4.0 * PI)
}

/// A sum of solid angles of triangles seen from the origin. Half of each angle is the argument of a complex number (van
/// Oosterom and Strackee 1983). The sum is the argument of the product, with whole turns counted separately: one arc
/// tangent suffices for all triangles.
#[derive(Clone, Copy)]
struct HalfAngles {
    /// Real and imaginary part of the product, of length about 1.
    product: [f64; 2],
    turns: i64,
}

impl HalfAngles {
    const NONE: Self = Self { product: [1.0, 0.0], turns: 0 };

    /// Adds a triangle's solid angle, positive seen from behind.
    fn add(&mut self, [a, b, c]: [DVec3; 3]) {
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        let above = a.dot(b.cross(c));
        if above == 0.0 {
            return;
        }
        let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        let size = below.abs().max(above.abs());
        let ([x, y], below, above) = (self.product, below / size, above / size);
        // Adding 0 turns -0 into 0, which lies on the upper side of the axis.
        let next = [x * below - y * above, x * above + y * below + 0.0];
        // If both factors lie in the upper half-plane, or both in the lower, only their sum can pass the negative axis.
        if (y >= 0.0) == (above > 0.0) && (next[1] >= 0.0) != (y >= 0.0) {
            self.turns += if above > 0.0 { 1 } else { -1 };
        }
        let size = next[0].abs().max(next[1].abs());
        self.product = [next[0] / size, next[1] / size];
    }

    fn sum(self) -> f64 {
        let [x, y] = self.product;
        2.0 * (y.atan2(x) + 2.0 * PI * self.turns as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::r3;

    /// A sphere of `n` by `n` quads; `open` omits one ring at a pole.
    fn ball(n: u32, open: bool, size: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let at = |i: u32, j: u32| {
            let (u, v) = (f64::from(i) / f64::from(n) * 2.0 * PI, f64::from(j) / f64::from(n) * PI);
            DVec3::new(v.sin() * u.cos(), v.sin() * u.sin(), -v.cos()) * size
        };
        let positions = (0..=n).flat_map(|j| (0..n).map(move |i| at(i, j))).collect();
        let mut faces = Vec::new();
        for j in u32::from(open)..n {
            for i in 0..n {
                let [a, b, c, d] = [j * n + i, j * n + (i + 1) % n, (j + 1) * n + (i + 1) % n, (j + 1) * n + i];
                faces.extend([[a, b, c], [a, c, d]]);
            }
        }
        (positions, faces)
    }

    #[test]
    fn the_fast_sum_errs_by_at_most_a_few_hundredths() {
        for (open, size) in [(false, 1.0), (true, 1.0), (false, 1e300), (true, 1e-300)] {
            let (positions, faces) = ball(24, open, size);
            let tree = Tree::new(&positions, &faces);
            let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
            let dipoles = tree.dipoles(corners);
            let count = u32::try_from(faces.len()).unwrap_or(0);
            for i in 0..300 {
                let point = DVec3::from(r3(f64::from(i))) * 3.0 - 1.5;
                let exact = winding_exact(point, (0..count).map(|f| corners(f).map(|p| p / size)));
                let fast = tree.winding(&dipoles, point * size, &mut u64::MAX.clone(), corners);
                assert!((fast - exact).abs() < 0.04, "{fast} {exact} at {point}, {size}");
                if !open && (point.length() - 1.0).abs() > 0.02 {
                    assert!((fast - f64::from(u8::from(point.length() < 1.0))).abs() < 0.04);
                }
            }
        }
    }

    #[test]
    fn a_point_far_away_takes_few_steps_and_has_winding_number_zero() {
        let (positions, faces) = ball(64, false, 1.0);
        let tree = Tree::new(&positions, &faces);
        let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
        let dipoles = tree.dipoles(corners);
        let mut steps = 50;
        assert!(tree.winding(&dipoles, DVec3::splat(40.0), &mut steps, corners).abs() < 1e-3);
        assert!(steps > 0);
        for far in [DVec3::splat(1e200), DVec3::NAN] {
            assert_eq!(tree.winding(&dipoles, far, &mut steps, corners), 0.0);
        }
    }
}
