//! The search for the least wall at each face: branch and bound over the tree, parallel over the faces.

use crate::context::{Cancelled, Context};
use crate::math::Box3;
use crate::math::{centre_and_radius, triangles_of, vec3a};
use glam::{DVec3, Vec3A};
use rayon::prelude::*;
use smallvec::SmallVec;

use super::facing::{Chord, Least};
use super::places::{OpposedPair, OpposedPairs};
use super::prepared::{Below, OPPOSED, Prepared, TILT};

/// Faces searched between two checks for cancellation, by their budget: the first stage has a small one.
const STAGES: [(usize, u64); 3] = [(1 << 14, 1 << 13), (256, 1 << 19), (8, 1 << 24)];
/// Steps for all faces together: a base, and a number per face.
const BUDGET: [u64; 2] = [1 << 30, 600];
/// Cost in steps of the comparison of two faces.
const PAIR_COST: u64 = 6;
/// Cost in steps of the visit of a node in a search for chords at concave edges; in other searches it is 1.
const CONCAVE_COST: u64 = 2;
/// The error of coordinates in the tree's frame, which are at most 1, and more than that.
const SLACK: f64 = 1e-6;
/// A face is wide if its radius is more than this share of the bound.
const WIDE: f64 = 2.0;
/// Planes that enclose a smaller angle than 1 degree form no tip. Sine of the angle.
const LEAST_TAPER: f64 = 0.017_452_406_437_283_5;
/// How far a chord at a corner can lean away from the perpendicular on a face, in radians: 61.9 degrees, since the face may be turned half as
/// much towards the chord as the foremost face there.
const FOREMOST: f32 = 1.08;
/// A bit more than the cosine of [`FOREMOST`], the least angle that is permitted anywhere: it saves computing most angles.
const COS_FOREMOST: f32 = 0.472;
/// How far a chord at a sharp concave edge can lean besides [`TILT`], as a share of the angle between the normals there: about a half at an
/// edge, and more at the bottom of a pit.
const LEAN: f32 = 0.75;
/// Share of the way to the line where the planes of two faces meet that a tip must reach.
const TIP_REACH: f64 = 0.8;

/// The thinnest places of one face.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Thinnest {
    pub wall: Option<(u32, Chord)>,
    pub tip: Option<(u32, Chord)>,
    /// The lower bound of the thickness where a budget ended the search.
    pub undecided: Option<f64>,
}

/// A question to the tree about one face.
struct Query<'a> {
    prepared: &'a Prepared<'a>,
    face: u32,
    normal: Vec3A,
    limit: f64,
    found: Thinnest,
    /// Whether chords at concave edges are searched; otherwise perpendicular chords.
    is_concave: bool,
    steps: u64,
}

/// The places that a query still has to visit, in the tree's frame.
#[derive(Clone, Copy)]
enum Reach {
    /// The places within a distance, given with its square, of a box around edges; if it is a single edge, those near it.
    Box { low: Vec3A, high: Vec3A, square: f32, edge: Option<Slab> },
    /// The places near the way from the middle of a face to the bound behind it. Behind a wide face, within some planes.
    Prism { axis: Slab, sides: Option<[Plane; 5]> },
}

/// The places within a distance of a segment, along each axis: where it starts, the reciprocal of its step, and the distance.
#[derive(Clone, Copy)]
struct Slab {
    start: Vec3A,
    reciprocal: Vec3A,
    margin: Vec3A,
}

/// A plane, by its unit normal and its distance from the origin. Places in front of it are not visited.
#[derive(Clone, Copy)]
struct Plane {
    normal: Vec3A,
    distance: f32,
}

impl Reach {
    /// When the reach meets a box, a value to visit boxes in order: the nearest first.
    #[inline]
    fn meets(&self, low: Vec3A, high: Vec3A) -> Option<f32> {
        match self {
            &Self::Box { low: from, high: to, square, edge } => {
                let middle = (from + to) * 0.5;
                let is_near = || (low - to).max(from - high).max(Vec3A::ZERO).length_squared() <= square;
                let meets = is_near() && edge.is_none_or(|edge| edge.enter(low, high).is_some());
                meets.then(|| (low - middle).max(middle - high).max(Vec3A::ZERO).length_squared())
            }
            Self::Prism { axis, sides } => {
                let (middle, half) = ((low + high) * 0.5, (high - low) * 0.5);
                let is_behind = |side: &Plane| side.normal.dot(middle) - side.normal.abs().dot(half) <= side.distance;
                axis.enter(low, high).filter(|_| sides.iter().flatten().all(is_behind))
            }
        }
    }
}

impl Slab {
    fn new(start: DVec3, step: DVec3, margin: DVec3) -> Self {
        // The clamp makes zero times a reciprocal zero.
        let reciprocal = vec3a(step.recip()).clamp(Vec3A::splat(f32::MIN), Vec3A::splat(f32::MAX));
        Self { start: vec3a(start), reciprocal, margin: vec3a(margin) }
    }

    /// The fraction of the segment at which it enters a box that is larger by the margin.
    #[inline]
    fn enter(&self, low: Vec3A, high: Vec3A) -> Option<f32> {
        // The slab test of Kay and Kajiya (1986).
        let a = (low - self.margin - self.start) * self.reciprocal;
        let b = (high + self.margin - self.start) * self.reciprocal;
        let enter = a.min(b).max_element().max(0.0);
        let leave = a.max(b).min_element().min(1.0);
        (enter <= leave + 1e-5).then_some(enter)
    }
}

impl Query<'_> {
    /// Thickness from which a chord no longer matters.
    fn bound(&self) -> f64 {
        self.found.wall.map_or(self.limit, |(_, chord)| chord.thickness)
    }

    /// The places of all faces at less than the bound: behind the face, or around it for concave edges.
    fn reach(&self) -> Reach {
        let (bound, frame) = (self.bound(), self.prepared.tree.frame);
        let distance = bound * frame.scale() * 1.000_01 + SLACK;
        if self.is_concave {
            let mut edges = self.prepared.concave_edges(self.face).map(|edge| edge.map(|p| frame.to_tree(p)));
            let first = edges.next().unwrap_or_default();
            let others: SmallVec<[_; 2]> = edges.collect();
            let bounds = Box3::of(first.into_iter().chain(others.iter().copied().flatten()));
            let [low, high] = [bounds.min, bounds.max].map(vec3a);
            let edge = others.is_empty().then(|| Slab::new(first[0], first[1] - first[0], DVec3::splat(distance)));
            #[expect(clippy::cast_possible_truncation, reason = "the slack covers the rounding")]
            let square = (distance * distance) as f32;
            return Reach::Box { low, high, square, edge };
        }
        let corners = self.prepared.corners(self.face);
        let (centre, radius) = centre_and_radius(corners);
        let step = -self.prepared.normal(self.face) * bound * frame.scale();
        // The slack covers the f32 rounding in the frame, whose coordinates are at most 1.
        let margin = DVec3::splat(SLACK + radius * frame.scale() * 1.000_01);
        let sides = (radius > WIDE * bound).then(|| self.sides(corners.map(|p| frame.to_tree(p)), distance));
        Reach::Prism { axis: Slab::new(frame.to_tree(centre), step, margin), sides }
    }

    /// The planes around the places from which a chord can end at the face, which has these corners in the tree's frame: the
    /// face's own, one as far behind it as the bound, and one beside each edge. Chords are tilted by half of [`OPPOSED`] at most.
    fn sides(&self, corners: [DVec3; 3], distance: f64) -> [Plane; 5] {
        let normal = self.prepared.normal(self.face);
        #[expect(clippy::cast_possible_truncation, reason = "the slack covers the rounding")]
        let plane = |normal: DVec3, through: DVec3, beyond: f64| Plane {
            normal: vec3a(normal),
            distance: (normal.dot(through) + beyond + SLACK) as f32,
        };
        let beside = |k: usize| {
            let outward = (corners[(k + 1) % 3] - corners[k]).cross(normal).normalize_or_zero();
            plane(outward, corners[k], distance * TILT.sin())
        };
        [plane(normal, corners[0], 0.0), plane(-normal, corners[0], distance), beside(0), beside(1), beside(2)]
    }

    fn may_be_opposed(&self, below: &Below) -> bool {
        #[expect(clippy::cast_possible_truncation, reason = "the slack covers the rounding")]
        let most = if self.is_concave {
            // At each end, the better one of the two faces lies within half of the angle at the edge.
            let angle = (self.prepared.spread[self.face as usize] + below.spread) / 2.0 + 2.0 * TILT as f32;
            -angle.min(std::f32::consts::PI).cos()
        } else {
            OPPOSED as f32
        };
        below.least_dot(self.normal) <= most + 1e-4
    }

    /// Whether a chord from the edges that `reach` is about can end in a box, which has these faces: on neither face may it lean more than
    /// an edge allows. Always true for perpendicular chords.
    #[expect(clippy::cast_possible_truncation, reason = "the slack covers the rounding")]
    fn may_end_in(&self, reach: &Reach, [low, high]: [Vec3A; 2], below: &Below) -> bool {
        let &Reach::Box { low: from, high: to, .. } = reach else { return true };
        let way = (low + high - from - to) * 0.5;
        let (distance, radius) = (way.length(), (high - low + to - from).length() * 0.5 + 4.0 * SLACK as f32);
        if radius >= distance {
            return true;
        }
        let direction = way / distance;
        let may_lean = |most_dot: f32, spread: f32| {
            let angle = || (radius / distance).asin() + (FOREMOST + spread / 4.0).max(TILT as f32 + LEAN * spread);
            most_dot >= COS_FOREMOST || most_dot >= angle().min(std::f32::consts::PI).cos() - 1e-4
        };
        may_lean(-self.normal.dot(direction), self.prepared.spread[self.face as usize])
            && may_lean(below.most_dot(direction), below.spread)
    }

    fn run(&mut self) {
        let Some(bvh) = &self.prepared.tree.bvh else { return };
        let cost = if self.is_concave { CONCAVE_COST } else { 1 };
        let mut reach = self.reach();
        let mut stack: SmallVec<[u32; 64]> = SmallVec::new();
        stack.push(0);
        while let Some(at) = stack.pop() {
            let node = &bvh.nodes[at as usize];
            let left = self.steps.checked_sub(cost);
            self.steps = left.unwrap_or(0);
            if left.is_none() {
                self.found.undecided = Some(0.0);
                return;
            }
            if reach.meets(node.aabb().min, node.aabb().max).is_none() {
                continue;
            }
            if node.is_leaf() {
                for &face in triangles_of(bvh, node) {
                    self.steps = self.steps.saturating_sub(PAIR_COST);
                    let before = self.bound();
                    self.compare(face);
                    if self.bound() < before {
                        reach = self.reach();
                    }
                }
                continue;
            }
            let children = [node.first_index, node.first_index + 1];
            let [a, b] = children.map(|child| {
                let aabb = bvh.nodes[child as usize].aabb();
                let entry = reach.meets(aabb.min, aabb.max);
                let below = &self.prepared.below[child as usize];
                entry.filter(|_| self.may_be_opposed(below) && self.may_end_in(&reach, [aabb.min, aabb.max], below))
            });
            match (a, b) {
                (Some(a), Some(b)) if b < a => stack.extend(children),
                (Some(_), Some(_)) => stack.extend([children[1], children[0]]),
                (Some(_), None) => stack.push(children[0]),
                (None, Some(_)) => stack.push(children[1]),
                (None, None) => {}
            }
        }
    }

    /// Looks for a chord between this face and another one that is thinner than those found before.
    fn compare(&mut self, other: u32) {
        let (n, m) = (self.prepared.normal(self.face), self.prepared.normal(other));
        if other == self.face || m == DVec3::ZERO {
            return;
        }
        let pair = [self.face, other];
        let least = if self.is_concave {
            self.prepared.least_concave(pair, self.bound(), &mut self.steps)
        } else if n.dot(m) <= OPPOSED {
            self.prepared.least_facing(pair, self.bound(), &mut self.steps)
        } else {
            return;
        };
        match least {
            Least::Nothing => {}
            Least::Undecided(chord) => {
                let lower = chord.thickness.min(self.found.undecided.unwrap_or(f64::INFINITY));
                self.found.undecided = Some(lower);
            }
            Least::Found(chord) if self.prepared.is_tip(pair, &chord, &mut self.steps) => {
                if self.found.tip.is_none_or(|(_, tip)| chord.thickness < tip.thickness) {
                    self.found.tip = Some((other, chord));
                }
            }
            Least::Found(chord) => self.found.wall = Some((other, chord)),
        }
    }
}

impl Prepared<'_> {
    /// Whether a chord lies in a wedge that ends in a sharp edge or point: the faces have a common vertex, or the way
    /// to the line where their planes meet is free for [`TIP_REACH`] of its length.
    pub(super) fn is_tip(&self, [f, h]: [u32; 2], chord: &Chord, steps: &mut u64) -> bool {
        if self.share_a_vertex(f, h) {
            return true;
        }
        let (n, m) = (self.normal(f), self.normal(h));
        let step = chord.points[1] - chord.points[0];
        let is_across = |normal: DVec3| step.dot(normal).abs() >= -OPPOSED * step.length();
        if n.cross(m).length() < LEAST_TAPER || n.dot(m) > OPPOSED || !is_across(n) || !is_across(m) {
            return false;
        }
        let way = (n + m).normalize_or_zero();
        let middle = chord.inside;
        let length = (chord.points[0] - middle).dot(n) / way.dot(n);
        if !(length.is_finite() && length > 0.0) {
            return false;
        }
        let end = middle + way * (length * TIP_REACH);
        self.blocker([middle, end], steps, |_| false).is_none()
    }

    /// Searches all faces given, and returns what was found for each, in the same order. With the walls already known,
    /// searches for thinner places at concave edges; otherwise for perpendicular chords.
    fn search(
        &self,
        faces: &[u32],
        limit: f64,
        known: Option<&[Thinnest]>,
        context: &Context<'_>,
    ) -> Result<Vec<Thinnest>, Cancelled> {
        let mut found = vec![Thinnest::default(); faces.len()];
        let mut left = BUDGET[0] + BUDGET[1] * faces.len() as u64;
        let mut open: Vec<usize> = (0..faces.len()).collect();
        for (block, most) in STAGES {
            let mut unfinished = Vec::new();
            for part in open.chunks(block) {
                context.check()?;
                let budget = most.min(left);
                let results: Vec<(Thinnest, u64)> = part
                    .par_iter()
                    .map(|&i| {
                        let (face, normal) = (faces[i], vec3a(self.normal(faces[i])));
                        let wall = known.and_then(|known| known[face as usize].wall);
                        let (found, is_concave) = (Thinnest { wall, ..Thinnest::default() }, known.is_some());
                        let mut query = Query { prepared: self, face, normal, limit, found, is_concave, steps: budget };
                        query.run();
                        (query.found, budget - query.steps)
                    })
                    .collect();
                for (&i, (result, steps)) in part.iter().zip(results) {
                    left = left.saturating_sub(steps);
                    found[i] = result;
                    if steps >= budget {
                        found[i].undecided = Some(result.undecided.unwrap_or(0.0));
                        unfinished.push(i);
                    }
                }
            }
            open = unfinished;
        }
        Ok(found)
    }

    /// The thinnest places of each face below `limit` (in the scaled unit).
    pub(super) fn thinnest(&self, limit: f64, context: &Context<'_>) -> Result<Vec<Thinnest>, Cancelled> {
        self.thinnest_of(&[], limit, context)
    }

    /// Like [`Prepared::thinnest`], for the faces of which the thinnest place is not `known`. `known` may be empty.
    pub(super) fn thinnest_of(
        &self,
        known: &[Option<Thinnest>],
        limit: f64,
        context: &Context<'_>,
    ) -> Result<Vec<Thinnest>, Cancelled> {
        // No chord is longer, and the search needs a finite limit.
        let limit = limit.min(2.0 * self.surface.bounds().diagonal());
        let is_open = |&f: &u32| known.get(f as usize).is_none_or(Option::is_none) && self.normal(f) != DVec3::ZERO;
        let measured: Vec<u32> = (0u32..).take(self.len()).filter(is_open).collect();
        let concave: Vec<u32> = measured.iter().copied().filter(|&f| self.spread[f as usize] > 0.0).collect();
        let mut all = vec![Thinnest::default(); self.len()];
        all.iter_mut().zip(known).for_each(|(own, known)| *own = known.unwrap_or_default());
        for (face, known) in (0u32..).zip(known) {
            known.iter().for_each(|known| known.mirror(face, &mut all));
        }
        for (faces, is_concave) in [(measured, false), (concave, true)] {
            let found = self.search(&faces, limit, is_concave.then_some(&all[..]), context)?;
            for (&f, found) in faces.iter().zip(found) {
                all[f as usize].merge(&found);
                found.mirror(f, &mut all);
            }
        }
        Ok(all)
    }

    /// The places as pairs in the model's unit.
    pub(super) fn pairs(&self, all: &[Thinnest]) -> OpposedPairs {
        let pair = |f: u32, place: Option<(u32, Chord)>| {
            place.map(|(other, chord)| {
                let points = chord.points.map(|p| p / self.scale);
                let thickness = chord.thickness / self.scale;
                OpposedPair { faces: [f, other], points, distance: points[0].distance(points[1]), thickness }
            })
        };
        let each = || (0u32..).zip(all);
        let undecided: Vec<u32> = each().filter(|(_, t)| t.undecided.is_some()).map(|(f, _)| f).collect();
        OpposedPairs {
            walls: each().filter_map(|(f, t)| pair(f, t.wall)).collect(),
            tips: each().filter_map(|(f, t)| pair(f, t.tip)).collect(),
            is_complete: undecided.is_empty(),
            undecided_faces: undecided,
        }
    }
}

impl Thinnest {
    /// Merges the places of face `f` into what was found for the faces opposite.
    fn mirror(&self, f: u32, all: &mut [Self]) {
        let reverse = |(_, chord): (u32, Chord)| {
            let [p, q] = chord.points;
            Some((f, Chord { points: [q, p], ..chord }))
        };
        if let Some(wall) = self.wall {
            all[wall.0 as usize].merge(&Self { wall: reverse(wall), ..Self::default() });
        }
        if let Some(tip) = self.tip {
            all[tip.0 as usize].merge(&Self { tip: reverse(tip), ..Self::default() });
        }
    }

    /// Keeps the thinner of two places; the first of equally thin ones stays.
    fn merge(&mut self, other: &Self) {
        let thinner = |a: Option<(u32, Chord)>, b: Option<(u32, Chord)>| match (a, b) {
            (Some(x), Some(y)) => Some(if y.1.thickness < x.1.thickness { y } else { x }),
            (x, y) => x.or(y),
        };
        self.wall = thinner(self.wall, other.wall);
        self.tip = thinner(self.tip, other.tip);
        self.undecided = match (self.undecided, other.undecided) {
            (Some(x), Some(y)) => Some(x.min(y)),
            (x, y) => x.or(y),
        };
    }
}
