//! What two triangles have in common, by the signs of determinants alone.
//!
//! The line in which two planes meet is cut by each triangle in an interval, and two more signs tell whether the
//! intervals overlap: Guigue and Devillers 2003, "Fast and Robust Triangle-Triangle Overlap Test Using Orientation
//! Predicates". Vertices that both have are known by their numbers, so their signs are known to be zero.

use glam::DVec3;

use super::predicates::{Sign, orient2d, orient3d};

/// Bound of the rounding error of a 3 by 3 determinant of differences, for each unit of its permanent: `O3DERRBOUND_A`
/// of Shewchuk 1997, which holds for an expansion along any row or column.
const ERROR: f64 = 7.771_561_172_376_103e-16;

/// Heights below this are those of points that lie in a plane, rounded. It moves a place, and decides nothing else.
const ROUNDED: f64 = 1e-13;

/// What two triangles have in common. Of two closed triangles exactly one of these holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contact {
    /// Nothing.
    Disjoint,
    /// The vertex or the edge that they share by its numbers, and no other point.
    Neighbours,
    /// All three vertices by their numbers.
    Same,
    /// Points beside those that they share, but the inside of neither meets the inside of the other.
    Touching,
    /// They lie in two planes, and the inside of one passes through the inside of the other.
    Crossing,
    /// They lie in one plane, and their insides overlap.
    Coplanar,
}

impl Contact {
    /// Whether they have nothing in common but the vertex or the edge that they share by its numbers.
    #[must_use]
    pub fn is_apart(self) -> bool {
        matches!(self, Self::Disjoint | Self::Neighbours)
    }
}

/// What the triangles `a` and `b`, given by numbers in `positions`, have in common, exactly.
///
/// Positions must be pairwise different and in the range of [`super::to_unit_range`], and the corners of neither
/// triangle on a line. `slow` grows by the determinants that floating point could not decide, which take a hundred
/// times as long as others.
///
/// # Panics
/// When a number is not one of `positions`.
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
        0 => meet(&p, &q, None, slow),
        1 => meet(&p, &q, Some(shared[0]), slow),
        2 => {
            let (i, j) = (3 - shared[0].0 - shared[1].0, 3 - shared[0].1 - shared[1].1);
            along_an_edge(&p, i, q[j], slow)
        }
        _ => Contact::Same,
    }
}

/// Two triangles with an edge in common: `p` without its corner `i`, and the same edge with `apex`.
fn along_an_edge(p: &[DVec3; 3], i: usize, apex: DVec3, slow: &mut u64) -> Contact {
    let plane = Plane::through(p);
    if plane.side(apex, slow) != Sign::Zero {
        return Contact::Neighbours;
    }
    let flat = Flat::of(&plane);
    let [u, v] = [p[(i + 1) % 3], p[(i + 2) % 3]];
    if flat.turn(u, v, p[i]) == flat.turn(u, v, apex) { Contact::Coplanar } else { Contact::Neighbours }
}

/// Two triangles with at most one vertex in common: corner `i` of `p` is corner `j` of `q`.
fn meet(p: &[DVec3; 3], q: &[DVec3; 3], shared: Option<(usize, usize)>, slow: &mut u64) -> Contact {
    let apart = if shared.is_some() { Contact::Neighbours } else { Contact::Disjoint };
    let plane_p = Plane::through(p);
    let sides_q = plane_p.sides(q, shared.map(|s| s.1), slow);
    if on_one_side(sides_q, shared.is_some()) {
        return apart;
    }
    if sides_q == [Sign::Zero; 3] {
        return Flat::of(&plane_p).overlap(p, q, shared);
    }
    let plane_q = Plane::through(q);
    let sides_p = plane_q.sides(p, shared.map(|s| s.0), slow);
    if on_one_side(sides_p, shared.is_some()) {
        return apart;
    }
    // Each triangle with the corner that is alone on its side first, turned so that the other's is above it.
    let ((i, i_above), (j, j_above)) = (lone(sides_p), lone(sides_q));
    let mut order_p = [i, (i + 1) % 3, (i + 2) % 3];
    let mut order_q = [j, (j + 1) % 3, (j + 2) % 3];
    if !i_above {
        order_q.swap(1, 2);
    }
    if !j_above {
        order_p.swap(1, 2);
    }
    // The intervals end where the edges from those corners go through the other's plane. Of two edges that have a
    // vertex in common these are the same point.
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

/// Whether a plane has nothing in common with a triangle but a vertex that is known to be in it.
fn on_one_side(sides: [Sign; 3], vertex_in_plane: bool) -> bool {
    let count = |sign| sides.map(|side| u8::from(side == sign)).into_iter().sum::<u8>();
    let all = if vertex_in_plane { 2 } else { 3 };
    count(Sign::Positive) == all || count(Sign::Negative) == all
}

/// The corner that a plane parts from the two others, or that alone lies in it, and whether it is above the others.
/// Not all of `sides` are strictly the same.
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

/// The plane of a triangle, ready to tell sides of many points.
struct Plane {
    corners: [DVec3; 3],
    /// The normal, rounded.
    normal: DVec3,
    /// For each component of the normal the sum of the magnitudes that it is a difference of.
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

    /// Positive where the normal points, exactly.
    #[inline]
    fn side(&self, p: DVec3, slow: &mut u64) -> Sign {
        let d = p - self.corners[0];
        let determinant = self.normal.x * d.x + self.normal.y * d.y + self.normal.z * d.z;
        let permanent = self.magnitude.x * d.x.abs() + self.magnitude.y * d.y.abs() + self.magnitude.z * d.z.abs();
        if determinant.abs() > ERROR * permanent {
            return Sign::of(determinant);
        }
        // A sum of zeros is no rounded number; so it is with points of one plane along the axes.
        if permanent == 0.0 {
            return Sign::Zero;
        }
        *slow += 1;
        let [a, b, c] = self.corners;
        // `orient3d` is positive behind the face.
        orient3d(a, c, b, p)
    }

    /// The sides of three points, of which the one numbered `inside` is known to be in the plane.
    #[inline]
    fn sides(&self, points: &[DVec3; 3], inside: Option<usize>, slow: &mut u64) -> [Sign; 3] {
        let mut sides = [Sign::Zero; 3];
        for k in 0..3 {
            if inside != Some(k) {
                sides[k] = self.side(points[k], slow);
            }
        }
        sides
    }

    /// The corners that the plane goes through.
    fn corners(&self) -> [DVec3; 3] {
        self.corners
    }
}

/// A coordinate plane on which a plane is projected without losing a dimension.
struct Flat {
    axes: [usize; 2],
}

impl Flat {
    /// For the plane of a triangle whose corners are not on a line: exact, as its corners are not on a line in the
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

    /// How three points turn in the projection.
    fn turn(&self, a: DVec3, b: DVec3, c: DVec3) -> Sign {
        let [i, j] = self.axes;
        orient2d([a[i], a[j]], [b[i], b[j]], [c[i], c[j]])
    }

    /// Two triangles of the plane with at most one vertex in common.
    ///
    /// Convex polygons have no inside in common where the line of an edge of one of them parts them, and no point
    /// where it does so strictly.
    fn overlap(&self, p: &[DVec3; 3], q: &[DVec3; 3], shared: Option<(usize, usize)>) -> Contact {
        match shared {
            Some((i, j)) => self.overlap_at_a_vertex(p, i, q, j),
            None => self.overlap_without_a_vertex(p, q),
        }
    }

    fn overlap_without_a_vertex(&self, p: &[DVec3; 3], q: &[DVec3; 3]) -> Contact {
        let mut parted = false;
        for (t, other) in [(p, q), (q, p)] {
            let inner = self.turn(t[0], t[1], t[2]);
            for k in 0..3 {
                let sides = other.map(|x| self.turn(t[k], t[(k + 1) % 3], x));
                if sides.iter().all(|side| side.opposes(inner)) {
                    return Contact::Disjoint;
                }
                parted |= !sides.contains(&inner);
            }
        }
        if parted { Contact::Touching } else { Contact::Coplanar }
    }

    /// Corner `i` of `p` is corner `j` of `q`. A line that parts them goes through it, so it is that of an edge there. In a fan
    /// of needles every two have such a corner, so this is kept short.
    fn overlap_at_a_vertex(&self, p: &[DVec3; 3], i: usize, q: &[DVec3; 3], j: usize) -> Contact {
        let at = p[i];
        let ends = [[p[(i + 1) % 3], p[(i + 2) % 3]], [q[(j + 1) % 3], q[(j + 2) % 3]]];
        let mut parted = false;
        for (own, other) in [(ends[0], ends[1]), (ends[1], ends[0])] {
            for (end, third) in [(own[0], own[1]), (own[1], own[0])] {
                let inner = self.turn(at, end, third);
                let sides = other.map(|x| self.turn(at, end, x));
                if sides.iter().all(|side| side.opposes(inner)) {
                    return Contact::Neighbours;
                }
                parted |= !sides.contains(&inner);
            }
        }
        // Parted by a line through the vertex, they have more in common where edges run along it together.
        match parted {
            false => Contact::Coplanar,
            true if self.edges_run_together(p, i, q, j) => Contact::Touching,
            true => Contact::Neighbours,
        }
    }

    /// Whether of the edges at corner `i` of `p` and those at the same point of `q` two have the same direction.
    fn edges_run_together(&self, p: &[DVec3; 3], i: usize, q: &[DVec3; 3], j: usize) -> bool {
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

#[cfg(test)]
mod tests;
