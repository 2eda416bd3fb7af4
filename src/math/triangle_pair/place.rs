use glam::DVec3;

/// Heights below this are those of points that lie in a plane, rounded. It moves a place, and decides nothing else.
const ROUNDED: f64 = 1e-13;

/// A point that two triangles have in common, rounded: the middle of what they have in common. They should meet.
///
/// Positions should be in the range of [`crate::math::to_unit_range`].
#[must_use]
pub fn common_point(p: &[DVec3; 3], q: &[DVec3; 3], coplanar: bool) -> DVec3 {
    let normal = (q[1] - q[0]).cross(q[2] - q[0]).normalize_or_zero();
    let mut common = if coplanar { p.to_vec() } else { section(p, |x| normal.dot(x - q[0])) };
    for k in 0..3 {
        let inward = normal.cross(q[(k + 1) % 3] - q[k]).normalize_or_zero();
        let part = inside(&common, |x| inward.dot(x - q[k]));
        // What rounding leaves of a single point may lie outside; the point itself is near enough.
        if !part.is_empty() {
            common = part;
        }
    }
    common.iter().sum::<DVec3>() / common.len() as f64
}

fn clean(height: f64) -> f64 {
    if height.abs() < ROUNDED { 0.0 } else { height }
}

/// The ends of what a triangle has in a plane that `height` is measured from; its corner nearest to it where it has
/// nothing.
fn section(p: &[DVec3; 3], height: impl Fn(DVec3) -> f64) -> Vec<DVec3> {
    let heights = p.map(|x| clean(height(x)));
    let mut ends: Vec<DVec3> = Vec::with_capacity(3);
    for k in 0..3 {
        let (a, b) = (k, (k + 1) % 3);
        if heights[a] == 0.0 {
            ends.push(p[a]);
        } else if heights[a] * heights[b] < 0.0 {
            ends.push(p[a].lerp(p[b], heights[a] / (heights[a] - heights[b])));
        }
    }
    if ends.is_empty() {
        let nearest = (0..3).min_by(|&a, &b| heights[a].abs().total_cmp(&heights[b].abs())).unwrap_or(0);
        ends.push(p[nearest]);
    }
    ends
}

/// The part of a convex polygon, or of a segment, where `height` is not negative (Sutherland and Hodgman 1974).
fn inside(polygon: &[DVec3], height: impl Fn(DVec3) -> f64) -> Vec<DVec3> {
    let mut part = Vec::with_capacity(polygon.len() + 1);
    for (k, &a) in polygon.iter().enumerate() {
        let b = polygon[(k + 1) % polygon.len()];
        let (at_a, at_b) = (clean(height(a)), clean(height(b)));
        if at_a >= 0.0 {
            part.push(a);
        }
        if (at_a > 0.0 && at_b < 0.0) || (at_a < 0.0 && at_b > 0.0) {
            part.push(a.lerp(b, at_a / (at_a - at_b)));
        }
    }
    part
}
