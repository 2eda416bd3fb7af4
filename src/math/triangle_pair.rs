//! Exact intersection of two triangles, decided by the signs of determinants alone.
//!
//! Each triangle cuts the common line of the two planes in an interval, and two more signs decide whether the intervals
//! overlap: Guigue and Devillers 2003, "Fast and Robust Triangle-Triangle Overlap Test Using Orientation Predicates".
//! Shared vertices are identified by index, so their signs are known to be zero.

use glam::DVec3;

use super::polygon::clip;
use super::predicates::{Sign, orient2d, orient3d};

/// Bound of the rounding error of a 3 by 3 determinant of differences, relative to its permanent: `O3DERRBOUND_A` of
/// Shewchuk 1997. It holds for an expansion along any row or column.
const RELATIVE_ERROR: f64 = 7.771_561_172_376_103e-16;

/// Heights below this are rounded heights of points in the plane. The threshold affects only the position of a common
/// point.
const HEIGHT_TOLERANCE: f64 = 1e-13;

/// The sine of the least angle between an edge and the side of a triangle at which its rounded normal is trusted.
const LEAST_SINE: f64 = 1e-8;

/// The intersection of two closed triangles. Exactly one variant applies to each pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contact {
    /// No common point.
    Disjoint,
    /// Only the vertex or the edge that they share by index.
    Neighbours,
    /// All three vertices are the same by index.
    Same,
    /// Points besides the shared ones, but their interiors do not meet.
    Touching,
    /// They lie in two planes, and the interior of one passes through the interior of the other.
    Crossing,
    /// They lie in one plane, and their interiors overlap.
    Coplanar,
}

impl Contact {
    /// Whether the triangles have nothing in common except the vertex or edge that they share by index.
    #[must_use]
    pub fn is_apart(self) -> bool {
        matches!(self, Self::Disjoint | Self::Neighbours)
    }
}

/// The intersection of the triangles `a` and `b`, given as indices into `positions`, exactly.
///
/// Positions must be pairwise different and in the range of [`super::to_unit_range`], and the corners of each triangle
/// must not be collinear. `slow` grows by the number of determinants that floating point could not decide; each takes
/// about a hundred times as long as the others.
///
/// # Panics
/// If an index is out of range.
#[must_use]
pub fn contact(positions: &[DVec3], a: [u32; 3], b: [u32; 3], slow: &mut u64) -> Contact {
    let mut shared = [(0, 0); 3];
    let mut count = 0;
    for (i, v) in a.into_iter().enumerate() {
        for (j, w) in b.into_iter().enumerate() {
            if v == w && count < 3 {
                shared[count] = (i, j);
                count += 1;
            }
        }
    }
    let corners = |[a, b, c]: [u32; 3]| [positions[a as usize], positions[b as usize], positions[c as usize]];
    let (p, q) = (corners(a), corners(b));
    match count {
        0 if are_apart(&p, &q) => Contact::Disjoint,
        0 => with_at_most_one_common_vertex(&p, &q, None, slow),
        1 => with_at_most_one_common_vertex(&p, &q, Some(shared[0]), slow),
        2 => {
            let (i, j) = (3 - shared[0].0 - shared[1].0, 3 - shared[0].1 - shared[1].1);
            with_common_edge(&p, i, q[j], slow)
        }
        _ => Contact::Same,
    }
}

/// Whether the bounding boxes of two triangles have no common point. Faster than the signs of determinants where leaves of a tree
/// have several triangles.
fn are_apart(p: &[DVec3; 3], q: &[DVec3; 3]) -> bool {
    let low = |[a, b, c]: &[DVec3; 3]| a.min(*b).min(*c);
    let high = |[a, b, c]: &[DVec3; 3]| a.max(*b).max(*c);
    low(p).cmpgt(high(q)).any() || low(q).cmpgt(high(p)).any()
}

/// Two triangles with a common edge: `p` without its corner `i`, and the same edge with `apex`.
fn with_common_edge(p: &[DVec3; 3], i: usize, apex: DVec3, slow: &mut u64) -> Contact {
    let plane = Plane::through(p);
    let [u, v] = [p[(i + 1) % 3], p[(i + 2) % 3]];
    let side = plane.fast_side(apex);
    if side.is_none() && is_unfolded(u, v, p[i], apex) {
        return Contact::Neighbours;
    }
    if side.unwrap_or_else(|| plane.exact_side(apex, slow)) != Sign::Zero {
        return Contact::Neighbours;
    }
    let projection = Projection::of(&plane);
    if projection.turn(u, v, p[i]) == projection.turn(u, v, apex) { Contact::Coplanar } else { Contact::Neighbours }
}

/// Two triangles with at most one vertex in common: corner `i` of `p` is corner `j` of `q`.
fn with_at_most_one_common_vertex(
    p: &[DVec3; 3],
    q: &[DVec3; 3],
    shared: Option<(usize, usize)>,
    slow: &mut u64,
) -> Contact {
    let apart = if shared.is_some() { Contact::Neighbours } else { Contact::Disjoint };
    let plane_p = Plane::through(p);
    let fast_sides = plane_p.fast_sides(q, shared.map(|s| s.1));
    if let Some((i, j)) = shared
        && fast_sides.contains(&None)
        && are_separated_at_vertex(p, i, q, j)
    {
        return apart;
    }
    let sides_q = plane_p.decided_sides(fast_sides, q, slow);
    if on_one_side(sides_q, shared.is_some()) {
        return apart;
    }
    if sides_q == [Sign::Zero; 3] {
        return Projection::of(&plane_p).overlap(p, q, shared);
    }
    let plane_q = Plane::through(q);
    let sides_p = plane_q.sides(p, shared.map(|s| s.0), slow);
    if on_one_side(sides_p, shared.is_some()) {
        return apart;
    }
    // Rotates each triangle so that the corner alone on its side comes first, and flips it so that the other's lone
    // corner is above it.
    let ((i, i_above), (j, j_above)) = (lone(sides_p), lone(sides_q));
    let mut order_p = [i, (i + 1) % 3, (i + 2) % 3];
    let mut order_q = [j, (j + 1) % 3, (j + 2) % 3];
    if !i_above {
        order_q.swap(1, 2);
    }
    if !j_above {
        order_p.swap(1, 2);
    }
    // The intervals end where the edges from the lone corners pass through the other plane. For two edges with a common
    // vertex, both ends are the same point.
    let mut strictly = true;
    for k in [1, 2] {
        let side = match shared {
            Some((s, t)) if [order_p[0], order_p[k]].contains(&s) && [order_q[0], order_q[k]].contains(&t) => {
                Sign::Zero
            }
            _ => {
                let [p0, pk] = [p[order_p[0]], p[order_p[k]]];
                let [q0, qk] = [q[order_q[0]], q[order_q[k]]];
                let triangle = if k == 1 { [pk, q0, p0] } else { [p0, q0, pk] };
                Plane::through(&triangle).side(qk, slow)
            }
        };
        match side {
            Sign::Positive => return apart,
            Sign::Zero => strictly = false,
            Sign::Negative => {}
        }
    }
    let through = |sides: [Sign; 3]| sides.contains(&Sign::Positive) && sides.contains(&Sign::Negative);
    match (strictly, through(sides_p) && through(sides_q)) {
        (true, true) => Contact::Crossing,
        (false, _) if shared.is_some() => Contact::Neighbours,
        _ => Contact::Touching,
    }
}

/// Whether two triangles on the edge from `u` to `v` certainly have nothing else in common: the half-planes from that edge
/// to `apex` and to `other` form an angle of more than 60 degrees. Two half-planes with a common edge meet elsewhere only
/// where they coincide, so no exact sign is needed. This decides nearly all neighbours in flat surface.
fn is_unfolded(u: DVec3, v: DVec3, apex: DVec3, other: DVec3) -> bool {
    let (edge, a, b) = (v - u, apex - u, other - u);
    let (n, m) = (edge.cross(a), edge.cross(b));
    let (n2, m2, dot) = (n.length_squared(), m.length_squared(), n.dot(m));
    // Rounding turns a normal by less than 1e-6 where the corner is not that close to the edge's line.
    let is_certain =
        |normal2: f64, side: DVec3| normal2 > LEAST_SINE * LEAST_SINE * edge.length_squared() * side.length_squared();
    let is_wide = dot <= 0.0 || dot * dot < 0.25 * n2 * m2;
    is_wide && is_certain(n2, a) && is_certain(m2, b)
}

/// Whether a plane through the common vertex certainly separates two triangles: corner `i` of `p` is corner `j` of `q`.
fn are_separated_at_vertex(p: &[DVec3; 3], i: usize, q: &[DVec3; 3], j: usize) -> bool {
    let at = p[i];
    let directions = [p[(i + 1) % 3], p[(i + 2) % 3], q[(j + 1) % 3], q[(j + 2) % 3]]
        .map(|corner| (corner - at).normalize_or_zero());
    let [a, b, c, d] = directions;
    let normal = (a + b) - (c + d);
    // Far more than the rounding of the products of directions of length 1.
    let least = 1e-12;
    a.dot(normal) > least && b.dot(normal) > least && c.dot(normal) < -least && d.dot(normal) < -least
}

/// Whether a plane meets a triangle at most in a vertex that is known to lie in the plane.
fn on_one_side(sides: [Sign; 3], vertex_in_plane: bool) -> bool {
    let [a, b, c] = sides;
    let count = |sign| u8::from(a == sign) + u8::from(b == sign) + u8::from(c == sign);
    let all = if vertex_in_plane { 2 } else { 3 };
    count(Sign::Positive) == all || count(Sign::Negative) == all
}

/// The corner that a plane separates from the two others, or that alone lies in it, and whether it is above the others.
/// `sides` must not be the same nonzero sign three times.
fn lone(sides: [Sign; 3]) -> (usize, bool) {
    for i in 0..3 {
        let others = [sides[(i + 1) % 3], sides[(i + 2) % 3]];
        let none = |sign| !others.contains(&sign);
        match sides[i] {
            Sign::Positive if none(Sign::Positive) => return (i, true),
            Sign::Negative if none(Sign::Negative) => return (i, false),
            Sign::Zero if others == [Sign::Negative; 2] => return (i, true),
            Sign::Zero if others == [Sign::Positive; 2] => return (i, false),
            _ => {}
        }
    }
    (0, true)
}

/// The plane of a triangle, prepared to classify many points.
struct Plane {
    corners: [DVec3; 3],
    /// The normal, rounded to f64.
    normal: DVec3,
    /// For each component of the normal, the sum of the magnitudes of the two terms of the difference.
    magnitude: DVec3,
}

impl Plane {
    #[inline]
    fn through(&[a, b, c]: &[DVec3; 3]) -> Self {
        let (u, v) = (b - a, c - a);
        let left = DVec3::new(u.y * v.z, u.z * v.x, u.x * v.y);
        let right = DVec3::new(u.z * v.y, u.x * v.z, u.y * v.x);
        Self { corners: [a, b, c], normal: left - right, magnitude: left.abs() + right.abs() }
    }

    /// The side of a point, exactly: positive in the direction of the normal.
    #[inline]
    fn side(&self, p: DVec3, slow: &mut u64) -> Sign {
        self.fast_side(p).unwrap_or_else(|| self.exact_side(p, slow))
    }

    /// The side of a point, where floating point decides it.
    #[inline]
    fn fast_side(&self, p: DVec3) -> Option<Sign> {
        let d = p - self.corners[0];
        let determinant = self.normal.x * d.x + self.normal.y * d.y + self.normal.z * d.z;
        let permanent = self.magnitude.x * d.x.abs() + self.magnitude.y * d.y.abs() + self.magnitude.z * d.z.abs();
        if determinant.abs() > RELATIVE_ERROR * permanent {
            return Some(Sign::of(determinant));
        }
        // A sum of zeros is exact. This is the case for points in an axis-aligned plane.
        (permanent == 0.0).then_some(Sign::Zero)
    }

    /// The side of a point by exact arithmetic.
    #[cold]
    fn exact_side(&self, p: DVec3, slow: &mut u64) -> Sign {
        *slow += 1;
        let [a, b, c] = self.corners;
        // `orient3d` is positive behind the face.
        orient3d(a, c, b, p)
    }

    /// The sides of three points, of which the one with index `clipped` is known to lie in the plane.
    #[inline]
    fn sides(&self, points: &[DVec3; 3], in_plane: Option<usize>, slow: &mut u64) -> [Sign; 3] {
        self.decided_sides(self.fast_sides(points, in_plane), points, slow)
    }

    /// The sides of three points as far as floating point decides them; `in_plane` as for [`Self::sides`].
    #[inline]
    fn fast_sides(&self, points: &[DVec3; 3], in_plane: Option<usize>) -> [Option<Sign>; 3] {
        let mut sides = [Some(Sign::Zero); 3];
        for k in 0..3 {
            if in_plane != Some(k) {
                sides[k] = self.fast_side(points[k]);
            }
        }
        sides
    }

    /// Decides the remaining sides by exact arithmetic.
    #[inline]
    fn decided_sides(&self, fast: [Option<Sign>; 3], points: &[DVec3; 3], slow: &mut u64) -> [Sign; 3] {
        let mut sides = [Sign::Zero; 3];
        for k in 0..3 {
            sides[k] = fast[k].unwrap_or_else(|| self.exact_side(points[k], slow));
        }
        sides
    }

    /// The corners that define the plane.
    fn corners(&self) -> [DVec3; 3] {
        self.corners
    }
}

/// A projection of a plane onto a coordinate plane in which it keeps its area.
struct Projection {
    axes: [usize; 2],
}

impl Projection {
    /// The projection for the plane of a triangle that is not collinear. Exact: the corners are not collinear in the
    /// projection either.
    fn of(plane: &Plane) -> Self {
        let normal = plane.normal.abs();
        let largest = (0..3).max_by(|&i, &j| normal[i].total_cmp(&normal[j])).unwrap_or(0);
        let [a, b, c] = plane.corners();
        let candidates = [0, 1, 2].map(|k| Self { axes: [(largest + k + 1) % 3, (largest + k + 2) % 3] });
        let [first, ..] = &candidates;
        let axes = candidates.iter().find(|f| f.turn(a, b, c) != Sign::Zero).unwrap_or(first).axes;
        Self { axes }
    }

    /// The orientation of three points in the projection.
    fn turn(&self, a: DVec3, b: DVec3, c: DVec3) -> Sign {
        let [i, j] = self.axes;
        orient2d([a[i], a[j]], [b[i], b[j]], [c[i], c[j]])
    }

    /// Two triangles in the plane with at most one common vertex.
    ///
    /// The interiors of two convex polygons are disjoint if the line of an edge of one separates them. The polygons are
    /// disjoint if it separates them strictly.
    fn overlap(&self, p: &[DVec3; 3], q: &[DVec3; 3], shared: Option<(usize, usize)>) -> Contact {
        match shared {
            Some((i, j)) => self.overlap_at_a_vertex(p, i, q, j),
            None => self.overlap_without_a_vertex(p, q),
        }
    }

    fn overlap_without_a_vertex(&self, p: &[DVec3; 3], q: &[DVec3; 3]) -> Contact {
        let mut separated = false;
        for (t, other) in [(p, q), (q, p)] {
            let inner = self.turn(t[0], t[1], t[2]);
            for k in 0..3 {
                let sides = other.map(|x| self.turn(t[k], t[(k + 1) % 3], x));
                if sides.iter().all(|side| side.opposes(inner)) {
                    return Contact::Disjoint;
                }
                separated |= !sides.contains(&inner);
            }
        }
        if separated { Contact::Touching } else { Contact::Coplanar }
    }

    /// Corner `i` of `p` is corner `j` of `q`. A line that separates the triangles passes through that corner, so only
    /// the edges there are tested. In a fan of needles every two triangles share such a corner, so this case is kept
    /// fast.
    fn overlap_at_a_vertex(&self, p: &[DVec3; 3], i: usize, q: &[DVec3; 3], j: usize) -> Contact {
        let at = p[i];
        let ends = [[p[(i + 1) % 3], p[(i + 2) % 3]], [q[(j + 1) % 3], q[(j + 2) % 3]]];
        let mut separated = false;
        for (own, other) in [(ends[0], ends[1]), (ends[1], ends[0])] {
            for (end, third) in [(own[0], own[1]), (own[1], own[0])] {
                let inner = self.turn(at, end, third);
                let sides = other.map(|x| self.turn(at, end, x));
                if sides.iter().all(|side| side.opposes(inner)) {
                    return Contact::Neighbours;
                }
                separated |= !sides.contains(&inner);
            }
        }
        // Triangles separated by a line through the vertex have more in common if two of their edges overlap along that
        // line.
        match separated {
            false => Contact::Coplanar,
            true if self.edges_overlap(p, i, q, j) => Contact::Touching,
            true => Contact::Neighbours,
        }
    }

    /// Whether an edge at corner `i` of `p` and an edge at the same point of `q` have the same direction.
    fn edges_overlap(&self, p: &[DVec3; 3], i: usize, q: &[DVec3; 3], j: usize) -> bool {
        let at = p[i];
        let after = |x: DVec3| self.axes.map(|k| x[k].partial_cmp(&at[k]));
        [1, 2].into_iter().any(|k| {
            [1, 2].into_iter().any(|l| {
                let (x, y) = (p[(i + k) % 3], q[(j + l) % 3]);
                self.turn(at, x, y) == Sign::Zero && after(x) == after(y)
            })
        })
    }
}

/// A rounded common point of two triangles that should meet: the middle of their [`intersection`].
#[must_use]
pub fn common_point(p: &[DVec3; 3], q: &[DVec3; 3], coplanar: bool) -> DVec3 {
    let common = intersection(p, q, coplanar);
    common.iter().sum::<DVec3>() / common.len() as f64
}

/// The rounded corners of the intersection of two triangles that should meet: at least one point.
///
/// Positions should be in the range of [`crate::math::to_unit_range`].
#[must_use]
pub fn intersection(p: &[DVec3; 3], q: &[DVec3; 3], coplanar: bool) -> Vec<DVec3> {
    let normal = (q[1] - q[0]).cross(q[2] - q[0]).normalize_or_zero();
    let mut common = if coplanar { p.to_vec() } else { section(p, |x| normal.dot(x - q[0])) };
    for k in 0..3 {
        let inward = normal.cross(q[(k + 1) % 3] - q[k]).normalize_or_zero();
        let part = clip(&common, |x| flush_height(inward.dot(x - q[k])));
        // Rounding may move an intersection of one point outside; the point itself is then accurate enough.
        if !part.is_empty() {
            common = part.into_vec();
        }
    }
    common
}

/// Treats heights within rounding of the plane as 0.
fn flush_height(height: f64) -> f64 {
    if height.abs() < HEIGHT_TOLERANCE { 0.0 } else { height }
}

/// The ends of the segment in which a triangle meets the plane from which `height` is measured. If there is none, the
/// nearest corner.
fn section(p: &[DVec3; 3], height: impl Fn(DVec3) -> f64) -> Vec<DVec3> {
    let heights = p.map(|x| flush_height(height(x)));
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

#[cfg(test)]
mod tests;
