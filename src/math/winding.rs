use std::f64::consts::PI;

use glam::DVec3;

use super::tree::{DEPTH, Tree, box_distance_squared, spend, triangles_of};

/// How many radii of a cluster a point must be away for the cluster to count as one dipole. At 2 the sum over a closed
/// surface errs by about 0.02, far from the 0.5 that tells inside from outside, for half the time that 3 takes.
const BETA: f64 = 2.0;
/// Half-sides of the model from which on it winds around nothing.
const FAR: f64 = 1e18;

/// How many times farther than two points are from the one between them a triangle must be to be seen from that one for both:
/// its angle errs by about a thousandth.
const SAME: f64 = 1e3;

/// The area of the triangles under each node of a [`Tree`], as one dipole each, in the tree's own frame.
pub struct Dipoles {
    nodes: Vec<Dipole>,
}

/// Triangles seen from afar.
#[derive(Clone, Copy, Default)]
struct Dipole {
    /// Their centroid, by area.
    centre: DVec3,
    /// The sum of their normals, each as long as its area.
    area: DVec3,
    /// The sum of their areas.
    weight: f64,
    /// Distance from the centre within which they all are.
    radius: f64,
}

impl Tree {
    /// Sums the triangles for [`Tree::winding`]. `triangle` gives the corners that the tree was built with.
    pub fn dipoles(&self, triangle: impl Fn(u32) -> [DVec3; 3]) -> Dipoles {
        let Some(bvh) = &self.bvh else { return Dipoles { nodes: Vec::new() } };
        let mut nodes = vec![Dipole::default(); bvh.nodes.len()];
        for at in self.children_first() {
            let node = &bvh.nodes[at as usize];
            let (mut moment, mut sum) = (DVec3::ZERO, Dipole::default());
            let mut add = |area: DVec3, weight: f64, centre: DVec3| {
                sum.area += area;
                sum.weight += weight;
                moment += centre * weight;
            };
            let aabb = node.aabb();
            let (min, max) = (aabb.min.as_dvec3(), aabb.max.as_dvec3());
            let within_box = |centre: DVec3| (centre - min).max(max - centre).length();
            if node.is_leaf() {
                for &face in triangles_of(bvh, node) {
                    let [a, b, c] = self.framed(triangle(face));
                    let area = (b - a).cross(c - a) * 0.5;
                    add(area, area.length(), (a + b + c) / 3.0);
                }
            } else {
                for child in [node.first_index, node.first_index + 1] {
                    let Dipole { centre, area, weight, .. } = nodes[child as usize];
                    add(area, weight, centre);
                }
            }
            sum.centre = if sum.weight > 0.0 { moment / sum.weight } else { (min + max) * 0.5 };
            sum.radius = within_box(sum.centre);
            if !node.is_leaf() {
                // Where the triangles fill the box badly, the spheres of the children reach less far than its corners.
                let reach = [node.first_index, node.first_index + 1].map(|child| {
                    let child = &nodes[child as usize];
                    child.radius + child.centre.distance(sum.centre)
                });
                sum.radius = sum.radius.min(reach[0].max(reach[1]));
            }
            nodes[at as usize] = sum;
        }
        Dipoles { nodes }
    }

    /// The generalized winding number of the triangles around a point: 1 inside a closed outward surface, 0 outside, and
    /// in between near a hole (Jacobson et al. 2013). Near triangles count exactly, far ones as dipoles (Barill et al.
    /// 2018, order 1), so it errs by about 0.02.
    ///
    /// `dipoles` and `triangle` are of the triangles that the tree was built with. `steps` is how many nodes and triangles
    /// may be looked at and is counted down; where it reaches 0 the rest is left out.
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

    /// The same on both sides of a point, `aside` from it and against `aside`, in one walk. What is far from a point, seen by
    /// how far aside the two are, looks the same from both.
    pub fn windings(
        &self,
        dipoles: &Dipoles,
        [point, aside]: [DVec3; 2],
        steps: &mut u64,
        triangle: impl Fn(u32) -> [DVec3; 3],
    ) -> [f64; 2] {
        let Some(bvh) = &self.bvh else { return [0.0; 2] };
        let place = self.frame.to_tree(point);
        if !place.abs().cmplt(DVec3::splat(FAR)).all() {
            return [0.0; 2];
        }
        let aside = aside * self.frame.scale();
        let apart = (aside.length() * SAME).powi(2);
        let mut sides = [HalfAngles::NONE; 2];
        let (mut angle, mut both) = (0.0, HalfAngles::NONE);
        let mut stack = Vec::with_capacity(DEPTH);
        stack.push(0u32);
        while let Some(at) = stack.pop() {
            let (node, dipole) = (&bvh.nodes[at as usize], &dipoles.nodes[at as usize]);
            if !spend(steps, node) {
                break;
            }
            let towards = dipole.centre - place;
            let square = towards.length_squared();
            if square > (BETA * dipole.radius).powi(2) {
                angle += dipole.area.dot(towards) / (square * square.sqrt());
            } else if node.is_leaf() {
                let near = apart > 0.0 && box_distance_squared(node.aabb(), place) < apart;
                for &face in triangles_of(bvh, node) {
                    let corners = self.framed(triangle(face)).map(|p| p - place);
                    if near {
                        sides[0].add(corners.map(|p| p - aside));
                        sides[1].add(corners.map(|p| p + aside));
                    } else {
                        both.add(corners);
                    }
                }
            } else {
                stack.push(node.first_index + 1);
                stack.push(node.first_index);
            }
        }
        let both = angle + both.sum();
        sides.map(|side| (both + side.sum()) / (4.0 * PI))
    }

    fn framed(&self, triangle: [DVec3; 3]) -> [DVec3; 3] {
        triangle.map(|p| self.frame.to_tree(p))
    }
}

/// The generalized winding number of triangles around a point, summed one by one.
pub fn winding_exact(point: DVec3, triangles: impl IntoIterator<Item = [DVec3; 3]>) -> f64 {
    let mut angles = HalfAngles::NONE;
    triangles.into_iter().for_each(|t| angles.add(t.map(|p| p - point)));
    angles.sum() / (4.0 * PI)
}

/// A sum of angles under which triangles are seen from the origin. Half of each is the argument of a complex number (van
/// Oosterom and Strackee 1983), so their sum is that of the product, and whole turns are counted beside it: one arc tangent
/// for all of them.
#[derive(Clone, Copy)]
struct HalfAngles {
    /// The product's real and imaginary part, of about length 1.
    product: [f64; 2],
    turns: i64,
}

impl HalfAngles {
    const NONE: Self = Self { product: [1.0, 0.0], turns: 0 };

    /// Adds a triangle's angle, positive from behind.
    fn add(&mut self, [a, b, c]: [DVec3; 3]) {
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        let above = a.dot(b.cross(c));
        if above == 0.0 {
            return;
        }
        let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
        let size = below.abs().max(above.abs());
        let ([x, y], below, above) = (self.product, below / size, above / size);
        // The last sum makes -0 a 0, which is on the upper side of the axis.
        let next = [x * below - y * above, x * above + y * below + 0.0];
        // Both in the upper half, or both in the lower: only their sum may pass the negative axis.
        if (y >= 0.0) == (above > 0.0) && (next[1] >= 0.0) != (y >= 0.0) {
            self.turns += if above > 0.0 { 1 } else { -1 };
        }
        let size = next[0].abs().max(next[1].abs());
        self.product = next.map(|part| part / size);
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

    /// A ball of `n` by `n` quads, open at the poles by one ring where asked for.
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
    fn the_fast_sum_is_the_exact_sum_but_for_a_few_hundredths() {
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
    fn a_point_far_away_takes_few_steps_and_nothing_winds_around_it() {
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
