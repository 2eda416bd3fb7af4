//! Polygons that are not flat: how much, and triangles with the least fold for them.

use glam::DVec3;

/// Folds are compared in steps of this many degrees; what is equal then goes by area.
const STEP_DEGREES: f64 = 1.0;
/// The step of a triangle without area: worse than any fold.
const NO_AREA: f64 = 1000.0;
/// A fold must be less by this many degrees for a quad to be cut another way than a flat one.
const ROUNDING_DEGREES: f64 = 1e-6;

/// The square of the sine of the twist: of the largest angle between the plane across `normal` through the corners' middle
/// and the way from that middle to a corner.
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

/// The corner from which a quad is cut with the lesser fold; `flat` is the one that a flat quad would be cut from.
pub(super) fn quad(corners: [DVec3; 4], flat: usize) -> usize {
    let fold = |from: usize| {
        let at = |k: usize| corners[(from + k) % 4];
        between(normal([at(0), at(1), at(2)]), normal([at(0), at(2), at(3)]))
    };
    let other = (flat + 1) % 4;
    if fold(other) < fold(flat) - ROUNDING_DEGREES { other } else { flat }
}

/// The triangulation with the least worst fold, then the least area, as places of corners. O(n^3). The recurrence keeps the best
/// triangulation of each stretch whatever it is joined to, so that the whole is a very good one and not always the best.
///
/// Liepa 2003, "Filling Holes in Meshes", section 3; the recurrence is that of Barequet and Sharir 1995.
pub(super) fn least_fold(points: &[DVec3], triangles: &mut Vec<u32>) {
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
                let folds = beyond.into_iter().flatten().map(|beside| (between(own, beside) / STEP_DEGREES).floor());
                let alone = if own.is_some() { 0.0 } else { NO_AREA };
                let worst = folds.fold(alone, f64::max).max(left.0).max(right.0);
                let area = (points[k] - points[i]).cross(points[j] - points[i]).length();
                let it = (worst, left.1 + right.1 + area);
                if k == i + 1 || it < best {
                    best = it;
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

fn normal([a, b, c]: [DVec3; 3]) -> Option<DVec3> {
    (b - a).cross(c - a).try_normalize()
}

/// The angle in degrees by which two triangles fold.
fn between(a: Option<DVec3>, b: Option<DVec3>) -> f64 {
    match (a, b) {
        (Some(a), Some(b)) => a.cross(b).length().atan2(a.dot(b)).to_degrees(),
        _ => NO_AREA,
    }
}
