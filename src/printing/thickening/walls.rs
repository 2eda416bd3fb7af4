//! Opposed faces: for a face or a point, the faces on the other side of the material, or of the air in front.
//!
//! Two faces oppose each other if their normals point away from each other to within 36.9 degrees. The shortest segment
//! between them is a wall if it runs through material, and a gap if it runs through air.

use crate::math::{Box3, Tree, hit, nearest_on_segment, nearest_on_triangle};
use crate::mesh::Surface;
use glam::DVec3;
use smallvec::SmallVec;

/// The largest dot product of the normals of opposed faces: -cos(36.9 degrees). Wedges above that angle are edges.
const OPPOSED: f64 = -0.8;
/// Cosine of the largest angle, 60 degrees, between the segment and the normals at its ends.
const ALIGNED: f64 = 0.5;
/// Share at each end of a segment in which faces do not block it: they touch the segment's own ends.
const END: f64 = 1e-3;

/// Height of a triangle below which the rounding to f32 decides its normal, as a share of the largest coordinate.
const NOISE: f64 = 16.0 / (1 << 24) as f64;

/// The side of a face on which its opposed faces are searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WallSide {
    /// Behind the face: walls.
    Material,
    /// In front of the face: gaps.
    Air,
}

/// The shortest segment from a face to an opposed face. Its thickness is the diameter of the ball that touches the planes
/// of both faces where it is as thick as the segment is long, measured at a right angle to one of them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Opposed {
    /// The opposed face.
    pub face: u32,
    /// The end on the face itself, and the end on the opposed face.
    pub points: [DVec3; 2],
    /// The length of the segment, in the model's unit.
    pub distance: f64,
    /// The thickness, in the model's unit.
    pub thickness: f64,
}

impl Opposed {
    fn set(&mut self, points: [DVec3; 2], factor: f64) {
        self.points = points;
        self.distance = points[0].distance(points[1]);
        self.thickness = self.distance / factor;
    }
}

/// Finds opposed faces of a closed surface without intersections.
pub struct Walls<'a> {
    surface: &'a Surface,
    normals: Vec<DVec3>,
    tree: Tree,
    /// The distance up to which faces touch: positions are rounded.
    pub contact: f64,
}

impl<'a> Walls<'a> {
    /// Prepares the search.
    pub fn new(surface: &'a Surface) -> Self {
        let noise = noise_of(&surface.positions);
        let normals = (0..surface.faces.len()).map(|f| trusted_normal(surface.corners(f), noise)).collect();
        Self { surface, normals, tree: Tree::new(&surface.positions, &surface.faces), contact: noise }
    }

    /// The unit normal of a face; zero if it has no area.
    pub fn normal(&self, face: u32) -> DVec3 {
        self.normals[face as usize]
    }

    /// The `most` faces opposed to a face, nearer than `limit`, nearest first. Blocked segments are left out.
    pub fn of_face(&self, face: u32, limit: f64, side: WallSide, most: usize) -> Vec<Opposed> {
        self.nearest_unblocked(face, self.aligned(face, limit, side), most)
    }

    /// The faces opposed to a face, nearer than `limit`, also behind others.
    fn aligned(&self, face: u32, limit: f64, side: WallSide) -> Vec<Opposed> {
        let own = self.corners(face);
        let mut found = self.candidates(Box3::of(own), face, limit, side);
        found.retain_mut(|other| {
            let corners = self.corners(other.face);
            if self.least_depth(face, corners, side).max(self.least_depth(other.face, own, side)) >= limit {
                return false;
            }
            let [from, to] = nearest_of_triangles(own, corners);
            other.set([from, to], self.factor(face, other.face));
            other.thickness < limit && self.is_aligned(face, other, side)
        });
        found
    }

    /// As [`Walls::of_face`], for a point of a face.
    pub fn of_point(&self, (point, face): (DVec3, u32), limit: f64, side: WallSide, most: usize) -> Vec<Opposed> {
        let mut found = self.candidates(Box3::of([point]), face, limit, side);
        found.retain_mut(|other| {
            let to = nearest_on_triangle(point, self.corners(other.face));
            other.set([point, to], self.factor(face, other.face));
            other.thickness < limit && self.is_aligned(face, other, side)
        });
        self.nearest_unblocked(face, found, most)
    }

    /// As [`Walls::of_face`] for the nearest wall through material, but faces may block the segment to an opposed face for
    /// which `is_known` holds.
    pub fn nearest_wall(&self, face: u32, limit: f64, is_known: impl Fn(u32) -> bool) -> Option<Opposed> {
        let mut found = self.aligned(face, limit, WallSide::Material);
        found.sort_by(|a, b| a.thickness.total_cmp(&b.thickness).then(a.face.cmp(&b.face)));
        found
            .into_iter()
            .find(|other| other.distance <= self.contact || is_known(other.face) || self.is_clear(face, other))
    }

    /// The share of a step from a point at which it first meets a face other than `own`.
    pub fn first_hit(&self, from: DVec3, step: DVec3, own: u32) -> Option<f64> {
        let first = self.tree.first_hit([from, step], Some(own), &mut u64::MAX.clone(), |face| self.corners(face));
        first.map(|(share, _)| share)
    }

    /// The share of the thickness of a wedge that a segment at a right angle to one of its sides measures.
    pub fn factor(&self, face: u32, other: u32) -> f64 {
        (1.0 - self.normal(face).dot(self.normal(other))) / 2.0
    }

    /// The number of faces.
    pub fn face_count(&self) -> usize {
        self.normals.len()
    }

    /// The corners of a face.
    pub fn corners(&self, face: u32) -> [DVec3; 3] {
        self.surface.corners(face as usize)
    }

    /// The opposed faces whose boxes are within `limit` of a box, in the directions of aligned segments.
    fn candidates(&self, mut bounds: Box3, face: u32, limit: f64, side: WallSide) -> Vec<Opposed> {
        let mut found = Vec::new();
        let normal = self.normal(face);
        if normal == DVec3::ZERO {
            return found;
        }
        let way = if side == WallSide::Material { -normal } else { normal };
        let margin = DVec3::splat(2.0 * self.contact);
        bounds.min -= margin + limit * reach_of_cone(-way);
        bounds.max += margin + limit * reach_of_cone(way);
        self.tree.overlapping(&bounds, |other| {
            let opposite = self.normal(other);
            if opposite != DVec3::ZERO && normal.dot(opposite) <= OPPOSED && self.faces_side(face, other, side) {
                found.push(Opposed { face: other, points: [DVec3::ZERO; 2], distance: 0.0, thickness: 0.0 });
            }
            true
        });
        found
    }

    /// The least distance of three points from the plane of a face, on the given side.
    fn least_depth(&self, face: u32, points: [DVec3; 3], side: WallSide) -> f64 {
        let ([origin, ..], normal) = (self.corners(face), self.normal(face));
        let sign = if side == WallSide::Material { -1.0 } else { 1.0 };
        points.iter().map(|&p| (p - origin).dot(normal) * sign).fold(f64::INFINITY, f64::min)
    }

    /// Whether each of two faces has a part on the given side of the other.
    fn faces_side(&self, face: u32, other: u32, side: WallSide) -> bool {
        let behind = |face: u32, other: u32| {
            let ([origin, ..], normal) = (self.corners(face), self.normal(face));
            let sign = if side == WallSide::Material { -1.0 } else { 1.0 };
            self.corners(other).iter().any(|&p| (p - origin).dot(normal) * sign > 0.0)
        };
        behind(face, other) && behind(other, face)
    }

    /// Whether a segment leaves its face on the given side, and arrives from that side at the opposed face.
    fn is_aligned(&self, face: u32, other: &Opposed, side: WallSide) -> bool {
        let [from, to] = other.points;
        let sign = if side == WallSide::Material { 1.0 } else { -1.0 };
        if other.distance <= self.contact {
            return self.is_wedge(face, other.face, from.midpoint(to), sign);
        }
        let step = (to - from) * (sign / other.distance);
        step.dot(self.normal(face)) <= -ALIGNED && step.dot(self.normal(other.face)) >= ALIGNED
    }

    /// Whether two faces that touch at a point enclose a wedge there: unit steps from the point into both faces end
    /// opposite each other, with nothing between them. `sign` is negative for a wedge of air.
    fn is_wedge(&self, face: u32, other: u32, point: DVec3, sign: f64) -> bool {
        let [own, opposite] = [face, other].map(|f| self.corners(f));
        let shared: SmallVec<[DVec3; 3]> = own
            .into_iter()
            .filter(|&p| p.distance(nearest_on_triangle(p, opposite)) <= self.contact)
            .chain(opposite.into_iter().filter(|&p| p.distance(nearest_on_triangle(p, own)) <= self.contact))
            .collect();
        let far = shared.iter().copied().max_by(|a, b| a.distance(point).total_cmp(&b.distance(point)));
        // Along a common edge only the steps across it count.
        let along = far.map_or(DVec3::ZERO, |far| far - point);
        let along = if along.length() > 2.0 * self.contact { along.normalize() } else { DVec3::ZERO };
        let [a, b] = [own, opposite].map(|corners| {
            let step = corners.into_iter().sum::<DVec3>() / 3.0 - point;
            step - along * step.dot(along)
        });
        let reach = a.length().min(b.length()) / 2.0;
        let [from, to] = [a, b].map(|step| point + step.normalize_or_zero() * reach);
        let distance = from.distance(to);
        if distance <= 0.0 {
            return false;
        }
        let step = (to - from) * (sign / distance);
        let is_opposed = step.dot(self.normal(face)) <= -ALIGNED && step.dot(self.normal(other)) >= ALIGNED;
        is_opposed && self.is_clear(face, &Opposed { face: other, points: [from, to], distance, thickness: distance })
    }

    fn nearest_unblocked(&self, face: u32, mut found: Vec<Opposed>, most: usize) -> Vec<Opposed> {
        found.sort_by(|a, b| a.thickness.total_cmp(&b.thickness).then(a.face.cmp(&b.face)));
        let is_free = |other: &Opposed| other.distance <= self.contact || self.is_clear(face, other);
        found.into_iter().filter(is_free).take(most).collect()
    }

    /// Whether no other face meets a segment between its ends.
    fn is_clear(&self, face: u32, other: &Opposed) -> bool {
        let [from, to] = other.points;
        let mut clear = true;
        self.tree.along(from, to, |between| {
            if between != face && between != other.face {
                let at = hit(from, to - from, self.corners(between));
                clear = at.is_none_or(|at| at <= END || at >= 1.0 - END);
            }
            clear
        });
        clear
    }
}

/// How far unit steps within the angle of [`ALIGNED`] around a direction reach along each axis; at least 0.
fn reach_of_cone(way: DVec3) -> DVec3 {
    let along = |cosine: f64| {
        if cosine >= ALIGNED {
            return 1.0;
        }
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        (cosine * ALIGNED + sine * (1.0 - ALIGNED * ALIGNED).sqrt()).max(0.0)
    };
    DVec3::from(way.to_array().map(along))
}

/// The height of a triangle between some positions below which rounding decides its normal.
pub fn noise_of(positions: &[DVec3]) -> f64 {
    NOISE * positions.iter().fold(0.0f64, |most, p| most.max(p.abs().max_element()))
}

/// The unit normal of a triangle; zero if its least height is below `noise`, so that rounding decides the normal.
pub fn trusted_normal([a, b, c]: [DVec3; 3], noise: f64) -> DVec3 {
    let normal = (b - a).cross(c - a);
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    if normal.length() > noise * longest { normal.normalize_or_zero() } else { DVec3::ZERO }
}

/// The nearest points of two triangles that do not intersect.
pub fn nearest_of_triangles(one: [DVec3; 3], other: [DVec3; 3]) -> [DVec3; 2] {
    let mut best = [one[0], other[0]];
    let mut least = f64::INFINITY;
    let mut offer = |pair: [DVec3; 2]| {
        let square = pair[0].distance_squared(pair[1]);
        if square < least {
            (least, best) = (square, pair);
        }
    };
    for p in one {
        offer([p, nearest_on_triangle(p, other)]);
    }
    for q in other {
        offer([nearest_on_triangle(q, one), q]);
    }
    for i in 0..3 {
        for j in 0..3 {
            offer(nearest_of_segments([one[i], one[(i + 1) % 3]], [other[j], other[(j + 1) % 3]]));
        }
    }
    best
}

/// The nearest points of two segments, where both are interior or one is an end.
fn nearest_of_segments([a, b]: [DVec3; 2], [c, d]: [DVec3; 2]) -> [DVec3; 2] {
    let (u, v, w) = (b - a, d - c, a - c);
    let (uu, uv, vv) = (u.dot(u), u.dot(v), v.dot(v));
    let (uw, vw) = (u.dot(w), v.dot(w));
    let determinant = uu * vv - uv * uv;
    let s = if determinant > 1e-12 * uu * vv { ((uv * vw - vv * uw) / determinant).clamp(0.0, 1.0) } else { 0.0 };
    let q = nearest_on_segment(a + u * s, [c, d]);
    let p = nearest_on_segment(q, [a, b]);
    [p, nearest_on_segment(p, [c, d])]
}
