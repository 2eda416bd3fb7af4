//! Segment queries on a [`Tree`]: candidates along a segment, and the first hit.

use glam::{DVec3, Vec3A};
use obvhs::aabb::Aabb;
use smallvec::SmallVec;

use super::tree::{DEPTH, FAR, Tree, spend, triangles_of, vec3a};
use super::triangle::hit;

/// Relative bound of the slab test's f32 rounding: a subtraction, a reciprocal and a product, each with half of 2^-23.
const ROUNDING: f32 = 1.0 / (1 << 20) as f32;

impl Tree {
    /// Calls `visit` with every triangle whose box meets the segment from `from` to `to`, until `visit` returns
    /// `false`.
    pub fn along(&self, from: DVec3, to: DVec3, visit: impl FnMut(u32) -> bool) {
        let segment = self.segment(from, to);
        self.walk(|aabb| segment.enters(aabb).is_some(), visit);
    }

    /// The first triangle besides `own` that the segment from `from` to `from + step` meets, with its parameter along the
    /// segment. `triangle` and `steps` as in [`Tree::nearest`].
    pub fn first_hit(
        &self,
        [from, step]: [DVec3; 2],
        own: Option<u32>,
        steps: &mut u64,
        triangle: impl Fn(u32) -> [DVec3; 3],
    ) -> Option<(f64, u32)> {
        let meets = |face: u32| if Some(face) == own { None } else { hit(from, step, triangle(face)) };
        self.first_along([from, from + step], None, steps, meets)
    }

    /// The first triangle that the segment meets, with its parameter along the segment. Ties go to the smallest index.
    /// With `after`, the first triangle behind that pair in this order.
    ///
    /// `hit` returns the parameter, from 0 to 1, at which the segment meets a triangle. `steps` as in
    /// [`Tree::nearest`]; when it reaches 0, a nearer triangle may have been missed.
    pub fn first_along(
        &self,
        [from, to]: [DVec3; 2],
        after: Option<(f64, u32)>,
        steps: &mut u64,
        hit: impl Fn(u32) -> Option<f64>,
    ) -> Option<(f64, u32)> {
        let bvh = self.bvh.as_ref()?;
        let segment = self.segment(from, to);
        // The parameter at which the segment enters a node's box; infinity for a box it misses.
        let entry = |node: u32| segment.enters(bvh.nodes[node as usize].aabb()).unwrap_or(f32::INFINITY);
        let mut first: Option<(f64, u32)> = None;
        // Boxes that start beyond this parameter are skipped.
        let mut limit = f64::MAX;
        let mut stack: SmallVec<[(f32, u32); DEPTH]> = SmallVec::new();
        stack.push((entry(0), 0));
        while let Some((parameter, mut at)) = stack.pop() {
            if f64::from(parameter) > limit {
                continue;
            }
            // Descends to a leaf, always into the nearer child, and keeps the other child for later.
            loop {
                let node = &bvh.nodes[at as usize];
                if !spend(steps, node) {
                    return first;
                }
                if node.is_leaf() {
                    for &face in triangles_of(bvh, node) {
                        let Some(found) = hit(face).map(|parameter| (parameter, face)) else { continue };
                        if after.is_none_or(|after| after < found) && first.is_none_or(|first| found < first) {
                            first = Some(found);
                            limit = found.0;
                        }
                    }
                    break;
                }
                let (mut near, mut far) = (node.first_index, node.first_index + 1);
                let (mut near_parameter, mut far_parameter) = (entry(near), entry(far));
                if far_parameter < near_parameter {
                    (near, far, near_parameter, far_parameter) = (far, near, far_parameter, near_parameter);
                }
                if f64::from(far_parameter) <= limit {
                    stack.push((far_parameter, far));
                }
                if f64::from(near_parameter) > limit {
                    break;
                }
                at = near;
            }
        }
        first
    }

    /// The segment in the tree's frame, prepared for slab tests.
    pub(super) fn segment(&self, from: DVec3, to: DVec3) -> Segment {
        let origin = self.frame.to_tree(from);
        let step = self.frame.to_tree(to) - origin;
        if !origin.abs().max(step.abs()).cmplt(DVec3::splat(FAR)).all() {
            // The segment is too far away or too long for f32, so it is treated as meeting every box.
            return Segment { low: Vec3A::ZERO, high: Vec3A::ZERO, reciprocal: Vec3A::ZERO };
        }
        // Clamped to finite values, so that a product with zero is zero; any other product lies outside the segment.
        let reciprocal = vec3a(step.recip()).clamp(Vec3A::splat(f32::MIN), Vec3A::splat(f32::MAX));
        let origin = vec3a(origin);
        let rounding = origin.abs() * f32::EPSILON;
        Segment { low: origin + rounding, high: origin - rounding, reciprocal }
    }
}

/// A segment in the tree's frame, prepared for slab tests.
pub(super) struct Segment {
    /// The start, rounded up for the low sides of boxes and down for the high sides: this enlarges boxes by the f32
    /// rounding of the start.
    low: Vec3A,
    high: Vec3A,
    /// The reciprocal of the step along each axis.
    reciprocal: Vec3A,
}

impl Segment {
    /// The segment for boxes that are larger by `half` on each side: it meets a box if a box of that half size, moved along
    /// the segment with its centre, does.
    pub(super) fn widened(self, half: Vec3A) -> Self {
        Self { low: self.low + half, high: self.high - half, ..self }
    }

    /// The parameter at which the segment enters a box, if it meets the box: the slab test (Kay and Kajiya 1986). The
    /// tolerance makes the entry never too late and misses no box through rounding (Ize 2013, "Robust BVH Ray
    /// Traversal").
    #[inline]
    pub(super) fn enters(&self, aabb: &Aabb) -> Option<f32> {
        let (a, b) = ((aabb.min - self.low) * self.reciprocal, (aabb.max - self.high) * self.reciprocal);
        let (enter, leave) = (a.min(b).max_element().max(0.0), a.max(b).min_element().min(1.0));
        let enter = enter * (1.0 - ROUNDING);
        (enter <= leave * (1.0 + ROUNDING)).then_some(enter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{hit, r3, ray_direction};

    fn triangles(n: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let corner = |i: u32| DVec3::from(r3(f64::from(i / 3))) + DVec3::from(r3(f64::from(i + 7000))) * 0.8;
        ((0..3 * n).map(corner).collect(), (0..n).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
    }

    fn segments() -> impl Iterator<Item = [DVec3; 2]> {
        let end = |i: u32| DVec3::from(r3(f64::from(i))) * 2.0 - 0.5;
        // Every third segment is parallel to an axis, so two of its reciprocals are infinite.
        (0..300).map(move |i| {
            let (from, to) = (end(i), end(i + 900));
            [from, if i % 3 == 0 { DVec3::new(to.x, from.y, from.z) } else { to }]
        })
    }

    #[test]
    fn exactly_the_triangles_that_a_segment_meets_come_in_order() {
        let (positions, mut faces) = triangles(300);
        // Every triangle twice, so that two are always hit at the same parameter.
        faces.extend_from_within(..);
        let tree = Tree::new(&positions, &faces);
        let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
        let mut met = 0;
        for [from, to] in segments() {
            let mut expected: Vec<(f64, u32)> =
                (0..600).filter_map(|f| hit(from, to - from, corners(f)).map(|parameter| (parameter, f))).collect();
            expected.sort_by(|a, b| a.partial_cmp(b).unwrap());
            let (mut found, mut steps) = (Vec::new(), u64::MAX);
            let mut next =
                |after| tree.first_along([from, to], after, &mut steps, |f| hit(from, to - from, corners(f)));
            while let Some(first) = next(found.last().copied()) {
                found.push(first);
            }
            assert_eq!(found, expected);
            let mut candidates = Vec::new();
            tree.along(from, to, |f| {
                candidates.push(f);
                true
            });
            assert!(found.iter().all(|(_, f)| candidates.contains(f)));
            met += found.len();
        }
        assert!(met > 500, "{met}");
    }

    #[test]
    fn a_segment_visits_the_boxes_it_crosses_and_few_others() {
        let positions: Vec<DVec3> =
            (0..3000).map(|i| DVec3::new(f64::from(i / 3) + f64::from(i % 3 % 2), f64::from(i % 3 / 2), 0.0)).collect();
        let faces: Vec<[u32; 3]> = (0..1000).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let mut found = Vec::new();
        Tree::new(&positions, &faces).along(DVec3::new(500.2, 0.1, -1.0), DVec3::new(500.2, 0.1, 1.0), |f| {
            found.push(f);
            true
        });
        assert!(found.contains(&500), "{found:?}");
        assert!(found.len() < 4, "{found:?}");
    }

    #[test]
    fn a_segment_that_starts_far_away_misses_no_triangle() {
        let (positions, faces) = triangles(300);
        let tree = Tree::new(&positions, &faces);
        for (f, far) in (0..300).zip([1e3, 1e5, 1e7].into_iter().cycle()) {
            let corners = faces[f as usize].map(|v| positions[v as usize]);
            let centre = corners.iter().sum::<DVec3>() / 3.0;
            let from = centre + DVec3::new(far, -0.7 * far, 0.3 * far);
            let mut candidates = Vec::new();
            tree.along(from, centre - (from - centre), |face| {
                candidates.push(face);
                true
            });
            assert!(candidates.contains(&f), "{f} from {far}");
        }
    }

    #[test]
    fn a_segment_meets_a_triangle_too_small_for_f32_seen_from_afar() {
        for exponent in 10..300 {
            let size = 10f64.powi(-exponent);
            let tree = Tree::new(&[DVec3::ZERO, DVec3::X, DVec3::Y].map(|p| p * size), &[[0, 1, 2]]);
            let aside = DVec3::new(0.2, 0.3, 0.0) * size;
            let ways =
                (0..20).map(ray_direction).chain([DVec3::Z, DVec3::new(1.0, -1.0, 1.0), DVec3::new(1.0, 1e-3, -1e-6)]);
            for way in ways {
                let mut candidates = 0;
                tree.along(aside + way, aside - way, |_| {
                    candidates += 1;
                    true
                });
                assert_eq!(candidates, 1, "{size} {way}");
            }
        }
    }

    #[test]
    fn the_search_ends_when_the_steps_run_out() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let tree = Tree::new(&positions, &vec![[0, 1, 2]; 5000]);
        let mut steps = 3000;
        let segment = [DVec3::new(0.2, 0.2, -1.0), DVec3::new(0.2, 0.2, 1.0)];
        let found = tree.first_along(segment, None, &mut steps, |_| Some(0.5));
        assert!(found.is_some() && steps == 0);
        assert_eq!(Tree::new(&[], &[]).first_along(segment, None, &mut steps, |_| Some(0.5)), None);
    }
}
