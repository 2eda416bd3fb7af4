//! Triangulations of a hole: by least weight, and by growth from the sharpest corners.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::DVec3;

/// Dihedral angles are compared in steps of this many degrees; triangulations in the same step are compared by area.
const ANGLE_STEP_DEG: f64 = 5.0;
/// The step of a triangle without area: worse than any dihedral angle.
const NO_AREA_STEP: u16 = 60;

/// The weight of a triangulation: its largest dihedral angle in steps, then its area (Liepa 2003, section 3).
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
struct Weight(u16, f64);

/// The weight of a polygon that cannot be triangulated.
const IMPOSSIBLE: Weight = Weight(u16::MAX, f64::INFINITY);

/// The criterion that a triangulation minimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Criterion {
    /// The largest dihedral angle, then the area.
    Fold,
    /// The area.
    Area,
}

/// The triangulation of a closed polygon in space with the least weight by `criterion`.
///
/// `normals[i]` is the unit normal of the face across the side from corner `i` to corner `i + 1`, or zero without a face.
/// `forbidden(i, j)` reports which diagonals may not be used. Triangles have the polygon's direction. `None` where every
/// triangulation needs a forbidden diagonal, or where `should_continue` returns `false`. O(n^3) time, O(n^2) memory.
///
/// Liepa 2003, "Filling Holes in Meshes"; the recurrence is that of Barequet and Sharir 1995.
pub(super) fn least_weight(
    points: &[DVec3],
    normals: &[DVec3],
    criterion: Criterion,
    forbidden: impl Fn(usize, usize) -> bool,
    mut should_continue: impl FnMut() -> bool,
) -> Option<Vec<[usize; 3]>> {
    let n = points.len();
    let at = |i: usize, j: usize| i * n + j;
    let mut weight = vec![Weight(0, 0.0); n * n];
    let mut apex = vec![0usize; n * n];
    let mut normal = vec![DVec3::ZERO; n * n];
    for i in 0..n {
        normal[at(i, (i + 1) % n)] = normals[i];
    }
    for span in 2..n {
        if !should_continue() {
            return None;
        }
        for i in 0..n - span {
            let j = i + span;
            let mut best = IMPOSSIBLE;
            if !(forbidden(i, j) && span < n - 1) {
                for k in i + 1..j {
                    let (left, right) = (weight[at(i, k)], weight[at(k, j)]);
                    if left == IMPOSSIBLE || right == IMPOSSIBLE || left.0.max(right.0) > best.0 {
                        continue;
                    }
                    let cross = (points[k] - points[i]).cross(points[j] - points[i]);
                    let length = cross.length();
                    let unit_normal = if length > 0.0 { cross / length } else { DVec3::ZERO };
                    let mut fold = if length > 0.0 { 0 } else { NO_AREA_STEP };
                    if criterion == Criterion::Fold {
                        let folds = [at(i, k), at(k, j)].map(|side| angle_step(unit_normal, normal[side]));
                        fold = fold.max(folds[0]).max(folds[1]);
                    }
                    if criterion == Criterion::Fold && span == n - 1 {
                        fold = fold.max(angle_step(unit_normal, normal[at(n - 1, 0)]));
                    }
                    let candidate = Weight(fold.max(left.0).max(right.0), left.1 + right.1 + length);
                    if candidate < best {
                        best = candidate;
                        apex[at(i, j)] = k;
                        if span < n - 1 {
                            normal[at(i, j)] = unit_normal;
                        }
                    }
                }
            }
            weight[at(i, j)] = best;
        }
    }
    if weight[at(0, n - 1)] == IMPOSSIBLE {
        return None;
    }
    let mut triangles = Vec::with_capacity(n - 2);
    let mut stack = vec![(0, n - 1)];
    while let Some((i, j)) = stack.pop() {
        if j - i < 2 {
            continue;
        }
        let k = apex[at(i, j)];
        triangles.push([i, k, j]);
        stack.push((k, j));
        stack.push((i, k));
    }
    Some(triangles)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an angle of at most 180 degrees")]
fn angle_step(a: DVec3, b: DVec3) -> u16 {
    if a == DVec3::ZERO || b == DVec3::ZERO {
        return 0;
    }
    (a.dot(b).clamp(-1.0, 1.0).acos().to_degrees() / ANGLE_STEP_DEG) as u16
}

/// A short diagonal that splits a long polygon into two with at least a quarter of its corners each. Up to about a thousand
/// corners are tried.
pub(super) fn shortest_cut(points: &[DVec3], forbidden: impl Fn(usize, usize) -> bool) -> Option<(usize, usize)> {
    let n = points.len();
    let stride = n.div_ceil(1000);
    let mut best: Option<(f64, usize, usize)> = None;
    for i in (0..n).step_by(stride) {
        let last = (i + n - n / 4).min(n - 1);
        for j in (i + (n / 4).max(2)..=last).step_by(stride) {
            let length = points[i].distance_squared(points[j]);
            if best.is_none_or(|b| length < b.0) && !forbidden(i, j) {
                best = Some((length, i, j));
            }
        }
    }
    best.map(|(_, i, j)| (i, j))
}

/// The triangles that grew over a loop, and the number of corners that stay open.
pub(super) struct Growth {
    /// The triangles by corner index.
    pub triangles: Vec<[usize; 3]>,
    /// The number of corners that stay open.
    pub open: usize,
}

/// Covers two adjacent sides of a polygon by a triangle, sharpest corner first, until no side is left or no triangle is allowed.
///
/// `is_allowed(triangle, is_last)` reports whether a triangle may be added; the last triangle adds no new side. Corners that
/// are reflex seen against `normal` count as the bluntest. A rejected corner is tried again when one of its neighbours is
/// gone. After *fill holes (sharp)* of Mesh Heal. O(n log n) time, plus at most three calls of `is_allowed` for each corner.
pub(super) fn grow_from_sharp_corners(
    points: &[DVec3],
    normal: DVec3,
    mut is_allowed: impl FnMut([usize; 3], bool) -> bool,
) -> Growth {
    let n = points.len();
    let mut around: Vec<[usize; 2]> = (0..n).map(|i| [(i + n - 1) % n, (i + 1) % n]).collect();
    let mut version = vec![0u32; n];
    let key = |i: usize, [before, after]: [usize; 2]| {
        let (u, v) = (points[after] - points[i], points[before] - points[i]);
        let cross = u.cross(v);
        let angle = cross.length().atan2(u.dot(v));
        // Positive floats have the order of their bit patterns.
        (if cross.dot(normal) < 0.0 { std::f64::consts::TAU - angle } else { angle }).to_bits()
    };
    let mut heap: BinaryHeap<_> = (0..n).map(|i| Reverse((key(i, around[i]), i, 0u32))).collect();
    let mut growth = Growth { triangles: Vec::with_capacity(n.saturating_sub(2)), open: n };
    while let Some(Reverse((_, i, of_version))) = heap.pop() {
        if version[i] != of_version {
            continue;
        }
        let [before, after] = around[i];
        let triangle = [before, i, after];
        if !is_allowed(triangle, growth.open == 3) {
            continue;
        }
        growth.triangles.push(triangle);
        if growth.open == 3 {
            growth.open = 0;
            break;
        }
        growth.open -= 1;
        version[i] = u32::MAX;
        around[before][1] = after;
        around[after][0] = before;
        for j in [before, after] {
            version[j] += 1;
            heap.push(Reverse((key(j, around[j]), j, version[j])));
        }
    }
    growth
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(n: u32, radius: f64, z: impl Fn(f64) -> f64) -> Vec<DVec3> {
        let at = |i: u32| f64::from(i) / f64::from(n) * std::f64::consts::TAU;
        (0..n).map(|i| DVec3::new(radius * at(i).cos(), radius * at(i).sin(), z(at(i)))).collect()
    }

    #[test]
    fn a_bent_quad_is_split_along_the_diagonal_with_the_smaller_fold() {
        let points = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.9), DVec3::Y];
        // The faces around lie flat except at the raised corner.
        let normals = [DVec3::Z, DVec3::ZERO, DVec3::ZERO, DVec3::Z];
        let cut = least_weight(&points, &normals, Criterion::Fold, |_, _| false, || true).unwrap();
        assert!(cut.contains(&[0, 1, 3]), "{cut:?}");
        let other = least_weight(&points, &normals, Criterion::Fold, |i, j| (i, j) == (1, 3), || true).unwrap();
        assert!(other.contains(&[0, 1, 2]), "{other:?}");
        assert_eq!(least_weight(&points, &normals, Criterion::Fold, |_, _| true, || true), None);
    }

    #[test]
    fn the_triangulation_of_least_area_has_no_more_area_than_any_other() {
        // A long roof, whose ridge is the longer diagonal.
        let points = [DVec3::ZERO, DVec3::new(1.0, 0.0, 1.0), DVec3::new(4.0, 0.0, 0.0), DVec3::new(1.0, 0.5, 1.0)];
        let area = |t: &[[usize; 3]]| -> f64 {
            t.iter().map(|t| (points[t[1]] - points[t[0]]).cross(points[t[2]] - points[t[0]]).length()).sum()
        };
        let least = least_weight(&points, &[DVec3::ZERO; 4], Criterion::Area, |_, _| false, || true).unwrap();
        for other in [[[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]] {
            assert!(area(&least) <= area(&other));
        }
    }

    #[test]
    fn a_flat_polygon_is_covered_once() {
        let points = circle(40, 1.0, |_| 0.0);
        let area = |t: &[[usize; 3]]| -> f64 {
            t.iter().map(|t| (points[t[1]] - points[t[0]]).cross(points[t[2]] - points[t[0]]).z / 2.0).sum()
        };
        let whole = 20.0 * (std::f64::consts::TAU / 40.0).sin();
        let t = least_weight(&points, &[DVec3::ZERO; 40], Criterion::Fold, |_, _| false, || true).unwrap();
        assert_eq!(t.len(), 38);
        assert!((area(&t) - whole).abs() < 1e-9);
    }

    #[test]
    fn a_long_polygon_is_split_where_it_is_narrow_and_not_at_its_end() {
        let mut points = circle(400, 1.0, |u| u.sin());
        points.iter_mut().for_each(|p| p.y *= 0.1);
        let (i, j) = shortest_cut(&points, |_, _| false).unwrap();
        assert!(j - i >= 100 && j - i <= 300);
        assert!(points[i].distance(points[j]) < 2.1);
    }

    #[test]
    fn the_sharpest_corner_goes_first_and_a_reflex_one_last() {
        // A spearhead: its tip is the sharpest corner, and the notch is reflex.
        let spear = [DVec3::new(10.0, 0.0, 0.0), DVec3::Y, DVec3::new(2.0, 0.0, 0.0), -DVec3::Y];
        let growth = grow_from_sharp_corners(&spear, DVec3::Z, |_, _| true);
        assert_eq!((growth.triangles[0], growth.open), ([3, 0, 1], 0));
        let kept = grow_from_sharp_corners(&spear, DVec3::Z, |t, _| t != [3, 0, 1]);
        assert_eq!((kept.open, kept.triangles.len()), (0, 2));
        assert_eq!(grow_from_sharp_corners(&spear, DVec3::Z, |_, _| false).open, 4);
    }
}
