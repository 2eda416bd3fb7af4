//! Patches of least weight.

use glam::DVec3;

/// Dihedral angles are compared in steps of this many degrees; what is equal then goes by area.
const STEP_DEGREES: f64 = 5.0;
/// The step of a triangle without area: worse than any fold.
const NO_AREA: u16 = 60;

/// The weight of a triangulation: its worst dihedral angle in steps, then its area (Liepa 2003, section 3).
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
struct Weight(u16, f64);

const NEVER: Weight = Weight(u16::MAX, f64::INFINITY);

/// What a triangulation is weighed by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Weigh {
    /// By its worst fold, then by its area.
    Fold,
    /// By its area alone.
    Area,
}

/// The triangulation of a closed polygon in space with the least worst fold and the least area, or the least area alone.
///
/// `normals[i]` is the unit normal of the face across the side from corner `i` to corner `i + 1`, or zero where there
/// is none; `forbidden(i, j)` says which diagonals may not be used. Triangles run the way the polygon runs.
/// None where every triangulation needs a forbidden diagonal. O(n^3) time, O(n^2) memory.
///
/// Liepa 2003, "Filling Holes in Meshes"; the recurrence is that of Barequet and Sharir 1995.
pub(super) fn least_weight(
    points: &[DVec3],
    normals: &[DVec3],
    weigh: Weigh,
    forbidden: impl Fn(usize, usize) -> bool,
    mut go_on: impl FnMut() -> bool,
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
        if !go_on() {
            return None;
        }
        for i in 0..n - span {
            let j = i + span;
            let mut best = NEVER;
            if !(forbidden(i, j) && span < n - 1) {
                for k in i + 1..j {
                    let (left, right) = (weight[at(i, k)], weight[at(k, j)]);
                    if left == NEVER || right == NEVER || left.0.max(right.0) > best.0 {
                        continue;
                    }
                    let cross = (points[k] - points[i]).cross(points[j] - points[i]);
                    let length = cross.length();
                    let own = if length > 0.0 { cross / length } else { DVec3::ZERO };
                    let mut fold = if length > 0.0 { 0 } else { NO_AREA };
                    if weigh == Weigh::Fold {
                        fold = fold.max(step(own, normal[at(i, k)])).max(step(own, normal[at(k, j)]));
                    }
                    if weigh == Weigh::Fold && span == n - 1 {
                        fold = fold.max(step(own, normal[at(n - 1, 0)]));
                    }
                    let it = Weight(fold.max(left.0).max(right.0), left.1 + right.1 + length);
                    if it < best {
                        best = it;
                        apex[at(i, j)] = k;
                        if span < n - 1 {
                            normal[at(i, j)] = own;
                        }
                    }
                }
            }
            weight[at(i, j)] = best;
        }
    }
    if weight[at(0, n - 1)] == NEVER {
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
fn step(a: DVec3, b: DVec3) -> u16 {
    if a == DVec3::ZERO || b == DVec3::ZERO {
        return 0;
    }
    (a.dot(b).clamp(-1.0, 1.0).acos().to_degrees() / STEP_DEGREES) as u16
}

/// A diagonal that cuts a long polygon into two of at least a quarter of its corners each, as short as can be found
/// among about a thousand corners.
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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;

    fn circle(n: u32, z: impl Fn(f64) -> f64) -> Vec<DVec3> {
        (0..n)
            .map(|i| {
                let u = f64::from(i) / f64::from(n) * std::f64::consts::TAU;
                DVec3::new(u.cos(), u.sin(), z(u))
            })
            .collect()
    }

    #[test]
    fn a_bent_quad_is_cut_along_the_diagonal_that_folds_less() {
        let points = [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 1.0, 0.9), DVec3::Y];
        // The faces around lie flat except at the raised corner.
        let normals = [DVec3::Z, DVec3::ZERO, DVec3::ZERO, DVec3::Z];
        let cut = least_weight(&points, &normals, Weigh::Fold, |_, _| false, || true).unwrap();
        assert!(cut.contains(&[0, 1, 3]), "{cut:?}");
        let other = least_weight(&points, &normals, Weigh::Fold, |i, j| (i, j) == (1, 3), || true).unwrap();
        assert!(other.contains(&[0, 1, 2]), "{other:?}");
        assert_eq!(least_weight(&points, &normals, Weigh::Fold, |_, _| true, || true), None);
    }

    #[test]
    fn the_least_area_may_fold_more() {
        // A long roof: the ridge is the longer diagonal.
        let points = [DVec3::ZERO, DVec3::new(1.0, 0.0, 1.0), DVec3::new(4.0, 0.0, 0.0), DVec3::new(1.0, 0.5, 1.0)];
        let area = |t: &[[usize; 3]]| -> f64 {
            t.iter().map(|t| (points[t[1]] - points[t[0]]).cross(points[t[2]] - points[t[0]]).length()).sum()
        };
        let least = least_weight(&points, &[DVec3::ZERO; 4], Weigh::Area, |_, _| false, || true).unwrap();
        for other in [[[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]] {
            assert!(area(&least) <= area(&other));
        }
    }

    #[test]
    fn a_flat_polygon_is_covered_once() {
        let points = circle(40, |_| 0.0);
        let area = |t: &[[usize; 3]]| -> f64 {
            t.iter().map(|t| (points[t[1]] - points[t[0]]).cross(points[t[2]] - points[t[0]]).z / 2.0).sum()
        };
        let whole = 20.0 * (std::f64::consts::TAU / 40.0).sin();
        let t = least_weight(&points, &[DVec3::ZERO; 40], Weigh::Fold, |_, _| false, || true).unwrap();
        assert_eq!(t.len(), 38);
        assert!((area(&t) - whole).abs() < 1e-9);
    }

    #[test]
    fn a_long_polygon_is_cut_where_it_is_narrow_and_not_at_its_end() {
        let mut points = circle(400, |u| u.sin());
        points.iter_mut().for_each(|p| p.y *= 0.1);
        let (i, j) = shortest_cut(&points, |_, _| false).unwrap();
        assert!(j - i >= 100 && j - i <= 300);
        assert!(points[i].distance(points[j]) < 2.1);
    }
}
