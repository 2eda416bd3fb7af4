//! Chords that end at a concave edge or vertex: necks, grooves opposite a wall, pits.

use crate::math::{longest_squared, nearest_on_triangle};
use glam::DVec3;
use smallvec::{SmallVec, smallvec};

use super::facing::{Chord, Least, NUDGE, SMOOTH};
use super::prepared::{Prepared, TILT};

/// Distance in units of a face's longest side at which a point counts as on an edge or a vertex.
const TOUCHING: f64 = 1e-9;
/// Cost in steps of finding the nearest points of two faces, and of examining a chord between them.
const CHORD_COST: u64 = 16;

impl Prepared<'_> {
    /// The shortest chord between a concave edge of `f` and face `h`, if it is thinner than `limit`, lies in the material, and neither end can
    /// shorten it much by sliding along the surface: by at most the sine of [`TILT`] per length.
    pub(super) fn least_concave(&self, [f, h]: [u32; 2], limit: f64, steps: &mut u64) -> Least {
        if self.is_no_wall([f, h], limit) || self.share_a_vertex(f, h) {
            return Least::Nothing;
        }
        *steps = steps.saturating_sub(CHORD_COST);
        let Some([p, q]) = self.nearest_points(f, h) else { return Least::Nothing };
        let length = p.distance(q);
        // A shorter chord depends on the rounding of its ends.
        if length >= limit || length <= self.rounding {
            return Least::Nothing;
        }
        *steps = steps.saturating_sub(CHORD_COST);
        let u = (q - p) / length;
        // A face that the chord reaches from outside is not foremost there.
        if u.dot(self.normal(f)) > 0.0 || u.dot(self.normal(h)) < 0.0 {
            return Least::Nothing;
        }
        if !self.may_end(f, p, u) || !self.may_end(h, q, -u) {
            return Least::Nothing;
        }
        // At the points themselves each face alone allows the least sliding.
        if self.shortens_much(f, p, u) || self.shortens_much(h, q, -u) {
            return Least::Nothing;
        }
        if !self.is_foremost(f, p, u) || !self.is_foremost(h, q, -u) {
            return Least::Nothing;
        }
        let Some(first) = self.end(f, p, u) else { return Least::Nothing };
        let Some(second) = self.end(h, q, -u) else { return Least::Nothing };
        let slope = first.slope.max(second.slope);
        let thickness = length / (1.0 - slope * slope).sqrt();
        if thickness >= limit {
            return Least::Nothing;
        }
        let is_end = |face: u32| first.around.contains(&face) || second.around.contains(&face);
        if self.blocker([first.inner, second.inner], steps, is_end).is_some() {
            return Least::Nothing;
        }
        let chord = Chord { points: [p, q], thickness, inside: (first.inner + second.inner) / 2.0 };
        if *steps == 0 { Least::Undecided(chord) } else { Least::Found(chord) }
    }

    /// Whether the planes alone rule out a chord: face `h` lies in front of face `f`, all concave edges of `f` lie in front of
    /// `h`, or they lie too far behind it.
    fn is_no_wall(&self, [f, h]: [u32; 2], limit: f64) -> bool {
        let ([a, ..], others) = (self.corners(f), self.corners(h));
        let (n, m) = (self.normal(f), self.normal(h));
        let depths = || self.concave_edges(f).flatten().map(|p| (others[0] - p).dot(m));
        others.iter().all(|q| (q - a).dot(n) > self.rounding)
            || depths().all(|depth| depth < -self.rounding)
            || depths().all(|depth| depth > limit + self.rounding)
    }

    /// The sharp concave edges of a face.
    pub(super) fn concave_edges(&self, f: u32) -> impl Iterator<Item = [DVec3; 2]> {
        let (corners, mask) = (self.corners(f), self.concave[f as usize]);
        (0..3).filter(move |i| mask >> i & 1 == 1).map(move |i| [corners[i], corners[(i + 1) % 3]])
    }

    /// The nearest points of the sharp concave edges of face `f` and of face `h`, which don't intersect: at a corner, or
    /// at two edges.
    fn nearest_points(&self, f: u32, h: u32) -> Option<[DVec3; 2]> {
        let h = self.corners(h);
        let between = |edge: [DVec3; 2]| {
            let sides = (0..3).map(move |j| nearest_on_edges(edge, [h[j], h[(j + 1) % 3]]));
            sides.chain(edge.map(|p| [p, nearest_on_triangle(p, h)]))
        };
        let distance = |pair: &[DVec3; 2]| pair[0].distance_squared(pair[1]);
        self.concave_edges(f).flat_map(between).min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// Whether no face at `p` faces a chord in direction `u` much better than face `f`. The other faces at the root of a
    /// rib are no part of the rib.
    fn is_foremost(&self, f: u32, p: DVec3, u: DVec3) -> bool {
        let facing = |k: u32| -u.dot(self.normal(k));
        let best = self.faces_at(f, p).into_iter().map(facing).fold(0.0, f64::max);
        facing(f) >= 0.5 * best
    }

    /// Whether [`Prepared::end`] may find an end. This test takes less time, and only needles may fail it wrongly. The chord must be steep on
    /// the face, or slide little from the middle of an edge through `p` into both of the edge's faces, or from a corner along no edge.
    fn may_end(&self, f: u32, p: DVec3, u: DVec3) -> bool {
        let (face, corners) = (self.surface.faces[f as usize], self.corners(f));
        let most = TILT.sin() * (1.0 + 1e-9);
        let facing = u.dot(self.normal(f));
        if 1.0 - facing * facing <= most * most {
            return true;
        }
        let slides = |step: DVec3| {
            let rate = u.dot(step);
            rate > 0.0 && rate * rate > most * most * step.length_squared()
        };
        let slides_into = |f: u32, along: DVec3| slides(self.normal(f).cross(along));
        let may_end_on = |i: usize| {
            let along = corners[(i + 1) % 3] - corners[i];
            let into_others = || self.faces_at_edge(f, i).filter(|&g| g != f).any(|g| slides_into(g, -along));
            !slides(along) && !slides(-along) && !slides_into(f, along) && !into_others()
        };
        if let Some(i) = corner_at(corners, p) {
            let at = corners[i];
            let around = || self.stars.of(face[i]).iter().flat_map(|&k| self.surface.faces[k as usize]);
            return may_end_on(i)
                || may_end_on((i + 2) % 3)
                || around().all(|v| !slides(self.surface.positions[v as usize] - at));
        }
        (0..3).filter(|&i| is_on_edge(p, corners, i)).any(may_end_on)
    }

    /// The end of a chord that leaves the surface at `p` of face `f` in the direction `u`. A point on the face's border
    /// also counts as the limit of points within the face or along its edges, so that a sharp convex edge beside a wall
    /// does not hide the wall. None if the chord does not leave into the material, or shortens too much.
    fn end(&self, f: u32, p: DVec3, u: DVec3) -> Option<End> {
        let corners = self.corners(f);
        let [a, b, c] = corners;
        let middles = [(a + b + c) / 3.0, (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0];
        let inner = |k: usize| if k == 0 { p } else { p.lerp(middles[k - 1], NUDGE) };
        let star = self.faces_at(f, p);
        let ends = (0..5).filter(|&k| k < 2 || is_on_edge(p, corners, k - 2)).map(inner);
        ends.filter_map(|inner| self.end_at([p, inner], (&star, self.faces_at(f, inner)), u))
            .min_by(|x, y| x.slope.total_cmp(&y.slope))
    }

    /// The end at a point close to `p`, where the faces `around` meet; `star` are those at `p`. None as for [`Prepared::end`].
    fn end_at(&self, [p, inner]: [DVec3; 2], (star, around): (&Faces, Faces), u: DVec3) -> Option<End> {
        let inward: DVec3 = around.iter().map(|&k| self.normal(k)).sum();
        if around.iter().any(|&k| self.normal(k) == DVec3::ZERO) || u.dot(inward) >= 0.0 {
            return None;
        }
        let is_smooth = |k: u32| around.iter().any(|&a| self.normal(a).dot(self.normal(k)) > SMOOTH);
        let beside = star.iter().filter(|&&k| !around.contains(&k) && is_smooth(k)).map(|&k| self.slope_in(k, p, u));
        let mut slope = 0.0f64;
        for rate in around.iter().map(|&k| self.slope_in(k, inner, u)).chain(beside) {
            slope = slope.max(rate);
            if slope > TILT.sin() {
                return None;
            }
        }
        Some(End { slope, inner, around })
    }

    /// The faces that meet at a point of face `f`.
    pub(super) fn faces_at(&self, f: u32, p: DVec3) -> Faces {
        let (face, corners) = (self.surface.faces[f as usize], self.corners(f));
        if let Some(i) = corner_at(corners, p) {
            self.stars.of(face[i]).iter().copied().collect()
        } else if let Some(i) = (0..3).find(|&i| is_on_edge(p, corners, i)) {
            self.faces_at_edge(f, i).collect()
        } else {
            smallvec![f]
        }
    }

    /// The faces at edge `i` of face `f`.
    fn faces_at_edge(&self, f: u32, i: usize) -> impl Iterator<Item = u32> {
        let face = self.surface.faces[f as usize];
        let [a, b] = [face[i], face[(i + 1) % 3]];
        self.stars.of(a).iter().copied().filter(move |&k| self.surface.faces[k as usize].contains(&b))
    }

    /// Whether a chord in direction `u` shortens by more than the sine of [`TILT`] per length as its end slides from `p` within
    /// one face. It cannot where it is steeper.
    fn shortens_much(&self, k: u32, p: DVec3, u: DVec3) -> bool {
        let n = self.normal(k);
        let is_steep = (u - n * u.dot(n)).length() <= TILT.sin();
        !is_steep && self.slope_in(k, p, u) > TILT.sin()
    }

    /// The largest rate at which a chord in direction `u` shortens as its end slides from `p` within one face.
    fn slope_in(&self, k: u32, p: DVec3, u: DVec3) -> f64 {
        let corners = self.corners(k);
        let n = self.normal(k);
        let along = u - n * u.dot(n);
        let length = along.length();
        if length == 0.0 {
            return 0.0;
        }
        // A direction leads into the face if it does not lead out across an edge through the point.
        let through: SmallVec<[usize; 3]> = (0..3).filter(|&i| is_on_edge(p, corners, i)).collect();
        let leads_in = |t: DVec3| {
            through.iter().all(|&i| {
                let (a, b) = (corners[i], corners[(i + 1) % 3]);
                n.cross(b - a).dot(t) >= -1e-9 * (b - a).length()
            })
        };
        if leads_in(along / length) {
            return length;
        }
        let edges = through.iter().flat_map(|&i| {
            let t = (corners[(i + 1) % 3] - corners[i]).normalize_or_zero();
            [t, -t]
        });
        edges.filter(|&t| leads_in(t)).map(|t| u.dot(t)).fold(0.0, f64::max)
    }
}

type Faces = SmallVec<[u32; 8]>;

/// One end of a chord.
struct End {
    /// Rate at which the chord shortens as this end slides along the surface, at most.
    slope: f64,
    /// The end, or a point close to it.
    inner: DVec3,
    /// The faces at the end.
    around: Faces,
}

/// The corner of a triangle at which one of its points lies.
fn corner_at(corners: [DVec3; 3], p: DVec3) -> Option<usize> {
    let near = TOUCHING * longest_squared(corners).sqrt();
    (0..3).find(|&i| corners[i].distance(p) <= near)
}

/// Whether a point of a triangle lies on its edge `i`.
fn is_on_edge(p: DVec3, corners: [DVec3; 3], i: usize) -> bool {
    let (a, b) = (corners[i], corners[(i + 1) % 3]);
    let longest = longest_squared(corners);
    (b - a).cross(p - a).length_squared() <= TOUCHING * TOUCHING * longest * (b - a).length_squared()
}

/// The nearest points of two segments (Ericson 2005, "Real-Time Collision Detection", section 5.1.9).
fn nearest_on_edges([a, b]: [DVec3; 2], [c, d]: [DVec3; 2]) -> [DVec3; 2] {
    let (u, v, w) = (b - a, d - c, a - c);
    let (uu, vv, uv) = (u.length_squared(), v.length_squared(), u.dot(v));
    let (uw, vw) = (u.dot(w), v.dot(w));
    let denominator = uu * vv - uv * uv;
    let mut s = if denominator > 1e-14 * uu * vv { ((uv * vw - uw * vv) / denominator).clamp(0.0, 1.0) } else { 0.0 };
    let mut t = if vv > 0.0 { (uv * s + vw) / vv } else { 0.0 };
    if !(0.0..=1.0).contains(&t) {
        t = t.clamp(0.0, 1.0);
        s = if uu > 0.0 { ((uv * t - uw) / uu).clamp(0.0, 1.0) } else { 0.0 };
    }
    [a + u * s, c + v * t]
}
