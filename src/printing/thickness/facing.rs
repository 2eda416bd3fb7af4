//! The least distance between two opposed facets across the overlap of their projections, where the view is free.

use glam::DVec3;
use smallvec::{SmallVec, smallvec};

use super::prepared::Prepared;
use crate::math::{Polygon, clip, covered, sides_along};

/// Views that are cut away from one overlap before the pair counts as undecided.
const MAX_CUTS: usize = 96;
/// Share of the way from a corner of a piece to its centre at which the view is tested.
pub(super) const NUDGE: f64 = 1e-6;
/// A piece whose area is below this fraction of the face's is dropped.
const SLIVER: f64 = 1e-14;
/// Width, in the scaled unit, below which an overlap comes from positions that were rounded to f32. Without this limit,
/// faces on both sides of an edge overlap in a strip that no cut narrows.
const HAIRLINE: f64 = 4e-7;
/// A face hides the ball beside a smooth convex edge if its normal's dot product with the touched face exceeds this.
/// Beside a sharper edge the wall is measured through the edge's rounding.
pub(super) const SMOOTH: f64 = 0.32;

/// Cosine of the angle between two planes from which the ball between them is at most 0.25 % thinner than the
/// perpendicular, so that only the perpendicular is measured.
const NEARLY_PARALLEL: f64 = 0.995;
/// Steps of the search for a face that hides a ball. If they run out, the ball counts.
const HIDING_BUDGET: u64 = 4096;
/// A point that is nearest to nothing.
const FAR_AWAY: DVec3 = DVec3::splat(1e100);

/// A place where two faces are opposed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chord {
    pub points: [DVec3; 2],
    /// Diameter of the ball that touches the first face at its point and also the other face.
    pub thickness: f64,
    /// A point in the material, on a neighbouring chord if this one runs along the surface.
    pub inside: DVec3,
}

/// Result of a search in one pair of faces.
pub(super) enum Least {
    Found(Chord),
    Nothing,
    /// The budget ended; every chord is at least this thick.
    Undecided(Chord),
}

/// The direction of the chords between two faces.
struct Way {
    direction: DVec3,
    /// Thickness per length of a chord.
    factor: f64,
    /// Whether the ball that touches both faces must be empty beside smooth edges.
    is_ball: bool,
}

impl Prepared<'_> {
    /// The least thickness below `limit` between two opposed faces, measured from `f`: by perpendiculars on `f`, and
    /// by balls that touch both faces. Only chords that no other face blocks count.
    pub fn least_facing(&self, [f, h]: [u32; 2], limit: f64, steps: &mut u64) -> Least {
        let (n, m) = (self.normal(f), self.normal(h));
        let (p, q) = (self.corners(f), self.corners(h));
        let cosine = -n.dot(m);
        // A ball's thickness is at least its chord, and a chord at least the distance of a plane from the other face's corners.
        let distances = p.map(|x| (q[0] - x).dot(m));
        if distances.iter().all(|&distance| distance >= limit) || distances.iter().all(|&distance| distance < 0.0) {
            return Least::Nothing;
        }
        let upright = overlap(p, q, m, -n);
        if area(&upright) <= SLIVER.sqrt() * area(&p).min(area(&q)) {
            return Least::Nothing;
        }
        let way = Way { direction: -n, factor: 1.0, is_ball: false };
        let first = self.least_in([f, h], &way, upright, (limit, steps));
        if cosine > NEARLY_PARALLEL {
            return first;
        }
        let bound = if let Least::Found(chord) = &first { chord.thickness } else { limit };
        // The ball's thickness is at least the perpendicular's times this.
        let sum = m - n;
        let length = sum.length();
        let way = Way { direction: sum / length, factor: 2.0 / length, is_ball: true };
        let slanted = overlap(p, q, m, way.direction);
        match (self.least_in([f, h], &way, slanted, (bound, steps)), first) {
            (Least::Nothing, first) => first,
            (second @ Least::Undecided(_), Least::Nothing) => second,
            (Least::Undecided(_), first) => first,
            (found @ Least::Found(_), _) => found,
        }
    }

    fn least_in(&self, [f, h]: [u32; 2], way: &Way, start: Polygon, (limit, steps): (f64, &mut u64)) -> Least {
        if is_hairline(&start) {
            return Least::Nothing;
        }
        let (m, [q, ..]) = (self.normal(h), self.corners(h));
        let rate = way.direction.dot(m);
        let length = |p: DVec3| (q - p).dot(m) / rate;
        let small = SLIVER * area(&self.corners(f));
        let mut pieces: SmallVec<[Polygon; 4]> = smallvec![start];
        for _ in 0..MAX_CUTS {
            let corners =
                pieces.iter().enumerate().flat_map(|(i, piece)| piece.iter().map(move |&p| (i, p, length(p))));
            let least = corners.min_by(|x, y| x.2.total_cmp(&y.2)).filter(|x| x.2 * way.factor < limit);
            let Some((i, point, least)) = least else { return Least::Nothing };
            let piece = pieces.swap_remove(i);
            let inner = point.lerp(piece.iter().sum::<DVec3>() / piece.len() as f64, NUDGE);
            let end = inner + way.direction * length(inner);
            let points = [point, point + way.direction * least];
            let chord = Chord { points, thickness: (least * way.factor).max(0.0), inside: (inner + end) / 2.0 };
            if *steps == 0 {
                return Least::Undecided(chord);
            }
            if let Some(k) = self.blocker([inner, end], steps, |face| face == f || face == h) {
                pieces.extend(without_shadow(&piece, self.corners(k), way.direction));
            } else if let Some((normal, origin)) = way.is_ball.then(|| self.hiding([f, h], chord, steps)).flatten() {
                pieces.push(clip(&piece, |x| normal.dot(x - origin)));
            } else {
                return Least::Found(chord);
            }
            pieces.retain(|piece| piece.len() > 2 && area(piece) > small && !is_hairline(piece));
        }
        let corners = pieces.iter().flatten().map(|&p| (p, length(p)));
        let Some((point, least)) = corners.min_by(|x, y| x.1.total_cmp(&y.1)) else { return Least::Nothing };
        if least * way.factor >= limit {
            return Least::Nothing;
        }
        let points = [point, point + way.direction * least];
        Least::Undecided(Chord { points, thickness: least * way.factor, inside: (points[0] + points[1]) / 2.0 })
    }

    /// The part of face `f` in which a smooth neighbour hides the ball between `f` and `h`: a half-space that keeps
    /// the points where the ball clears the neighbour's plane. None if the ball is clear.
    fn hiding(&self, [f, h]: [u32; 2], chord: Chord, steps: &mut u64) -> Option<(DVec3, DVec3)> {
        let (n, m) = (self.normal(f), self.normal(h));
        let radius = chord.thickness / 2.0;
        let centre = chord.points[0] - n * radius;
        let smooth = SMOOTH..1.0 - 1e-9;
        let is_smooth = |k: DVec3| smooth.contains(&n.dot(k)) || smooth.contains(&m.dot(k));
        let mut left = HIDING_BUDGET.min(*steps);
        *steps -= left;
        let found = self.tree.nearest(centre, radius * (1.0 - 1e-6), &mut left, |face| {
            if is_smooth(self.normal(face)) { self.corners(face) } else { [FAR_AWAY; 3] }
        });
        *steps += left;
        let found = found?;
        let k = self.normal(found.face);
        let (y, z) = (self.corners(h)[0], self.corners(found.face)[0]);
        // A ball that touches `f` at p and the plane with normal m through y has the radius (y - p).m / (1 - n.m):
        // (y - p).m / (1 - n.m) <= (z - p).k / (1 - n.k): linear in p.
        let (a, b) = (1.0 / (1.0 - n.dot(m)), 1.0 / (1.0 - n.dot(k)));
        let normal = m * a - k * b;
        let height = y.dot(m) * a - z.dot(k) * b;
        let square = normal.length_squared();
        let origin = normal * (height / square);
        (square > 0.0 && origin.is_finite() && normal.dot(chord.points[0] - origin) < 0.0).then_some((normal, origin))
    }
}

/// The part of triangle `p` from which a ray in `direction` meets triangle `q`, which has the normal `m`.
fn overlap(p: [DVec3; 3], q: [DVec3; 3], m: DVec3, direction: DVec3) -> Polygon {
    let part = clip(&covered(p, q, direction), |x| -m.dot(x - q[0]));
    if part.len() < 3 { Polygon::new() } else { part }
}

/// The parts of a convex polygon from which rays in `direction` don't meet a triangle.
fn without_shadow(polygon: &[DVec3], triangle: [DVec3; 3], direction: DVec3) -> SmallVec<[Polygon; 4]> {
    let mut parts = SmallVec::new();
    let mut rest: Polygon = polygon.iter().copied().collect();
    for (across, start) in sides_along(triangle, direction) {
        parts.push(clip(&rest, |x| -across.dot(x - start)));
        rest = clip(&rest, |x| across.dot(x - start));
    }
    parts
}

/// Whether a convex polygon is narrower than [`HAIRLINE`], up to a factor of 2.
fn is_hairline(polygon: &[DVec3]) -> bool {
    let Some(&first) = polygon.first() else { return true };
    let length = polygon.iter().map(|p| p.distance_squared(first)).fold(0.0, f64::max).sqrt();
    area(polygon) <= HAIRLINE * length
}

/// Twice the area of a convex polygon.
fn area(polygon: &[DVec3]) -> f64 {
    let [first, rest @ ..] = polygon else { return 0.0 };
    rest.windows(2).map(|w| (w[0] - first).cross(w[1] - first)).sum::<DVec3>().length()
}
