//! Twisted polygons: measuring the twist, and triangulating with the least fold.

use glam::DVec3;

/// Folds are compared in steps of this many degrees; equal folds are then compared by area.
const STEP_DEGREES: f64 = 1.0;
/// The fold of a triangle without area, larger than any real fold.
const NO_AREA: f64 = 1000.0;
/// How much smaller a fold must be, in degrees, for a quad_start to be split along the other diagonal.
const ROUNDING_DEGREES: f64 = 1e-6;

/// The squared sine of a polygon's twist. The twist is the largest angle between the plane across `normal` through the corners' centroid
/// and the line from the centroid to a corner. `scale` keeps the products in range.
pub(super) fn squared_sine(positions: &[DVec3], corners: &[u32], normal: DVec3, scale: f64) -> f64 {
    let origin = positions[corners[0] as usize];
    let at = |v: u32| (positions[v as usize] - origin) * scale;
    #[expect(clippy::cast_precision_loss, reason = "a count of corners")]
    let middle = corners.iter().map(|&v| at(v)).sum::<DVec3>() / corners.len() as f64;
    let square = normal.length_squared();
    corners.iter().fold(0.0, |most: f64, &v| {
        let to = at(v) - middle;
        let (rise, length) = (to.dot(normal), to.length_squared());
        if length > 0.0 { most.max(rise * rise / (length * square)) } else { most }
    })
}

/// The corner from which to split a quad_start with the smaller fold. `flat` is the corner for a flat quad_start.
pub(super) fn quad_start(corners: [DVec3; 4], flat: usize) -> usize {
    let fold = |from: usize| {
        let at = |k: usize| corners[(from + k) % 4];
        fold_deg(normal([at(0), at(1), at(2)]), normal([at(0), at(2), at(3)]))
    };
    let other = (flat + 1) % 4;
    if fold(other) < fold(flat) - ROUNDING_DEGREES { other } else { flat }
}

/// Triangulates a polygon with the smallest maximum fold, then the smallest area. The result is corner indices in `triangles`; time O(n³).
///
/// The recurrence keeps one best triangulation of each range of corners, independent of its neighbours. The result is therefore very good,
/// but not always optimal.
///
/// Liepa, "Filling Holes in Meshes" (2003), section 3, with the recurrence of Barequet and Sharir (1995).
pub(super) fn triangulate_with_least_fold(points: &[DVec3], triangles: &mut Vec<u32>) {
    let n = points.len();
    let at = |i: usize, j: usize| i * n + j;
    let mut weight = vec![(0.0f64, 0.0f64); n * n];
    let mut apex = vec![0usize; n * n];
    let mut normals: Vec<Option<DVec3>> = vec![None; n * n];
    for span in 2..n {
        for i in 0..n - span {
            let j = i + span;
            let mut best = (f64::INFINITY, f64::INFINITY);
            for k in i + 1..j {
                let (left, right) = (weight[at(i, k)], weight[at(k, j)]);
                let own = normal([points[i], points[k], points[j]]);
                let beyond = [(k > i + 1).then(|| normals[at(i, k)]), (j > k + 1).then(|| normals[at(k, j)])];
                let folds = beyond.into_iter().flatten().map(|beside| (fold_deg(own, beside) / STEP_DEGREES).floor());
                let alone = if own.is_some() { 0.0 } else { NO_AREA };
                let worst = folds.fold(alone, f64::max).max(left.0).max(right.0);
                let area = (points[k] - points[i]).cross(points[j] - points[i]).length();
                let candidate = (worst, left.1 + right.1 + area);
                if k == i + 1 || candidate < best {
                    best = candidate;
                    apex[at(i, j)] = k;
                    normals[at(i, j)] = own;
                }
            }
            weight[at(i, j)] = best;
        }
    }
    triangles.clear();
    let mut stack = vec![(0, n - 1)];
    while let Some((i, j)) = stack.pop() {
        if j - i < 2 {
            continue;
        }
        let k = apex[at(i, j)];
        #[expect(clippy::cast_possible_truncation, reason = "few corners")]
        triangles.extend([i as u32, k as u32, j as u32]);
        stack.push((k, j));
        stack.push((i, k));
    }
}

/// The unit normal of a triangle; `None` if the triangle has no area.
fn normal([a, b, c]: [DVec3; 3]) -> Option<DVec3> {
    (b - a).cross(c - a).try_normalize()
}

/// The angle in degrees between two triangles with these unit normals.
fn fold_deg(a: Option<DVec3>, b: Option<DVec3>) -> f64 {
    match (a, b) {
        (Some(a), Some(b)) => a.cross(b).length().atan2(a.dot(b)).to_degrees(),
        _ => NO_AREA,
    }
}
