//! Stitching: closing cracks whose sides have different vertices.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::border::{Border, Meeting, Near};
use super::operator::{Applied, Counter, Operation, Scope};
use crate::math::Precision;
use crate::mesh::Surface;
use crate::repair::{Cancelled, Change, ChangeKind, Context};

pub use super::names::StitchPosition;

/// Cuts for each boundary edge: a vertex is on few edges, unless the input is crafted.
const MOST_CUTS: usize = 4;

/// The least cosine of the angle between boundary edges that are one straight line.
const STRAIGHT: f64 = 0.985;

/// What looking at a feature costs, in looks at an edge.
const STEPS_TO_CHOOSE: u64 = 16;

/// Vertices along a straight line that are looked at: as many as can be nearer than half of an edge.
const MOST_AHEAD: usize = 64;

/// How wide a crack may be.
#[derive(Debug, Clone, Copy)]
pub struct Stitch {
    /// Most of its width over the bounding box's diagonal; 0.001 by default. Between a vertex and an edge it is also held
    /// below half of the edge, and between vertices below half of the longer boundary edge at each: what is wider for its
    /// size is a hole.
    pub threshold: f64,
    /// Most of its width in the model's unit, instead of `threshold`.
    pub distance: Option<f64>,
    /// Where two vertices meet.
    pub position: StitchPosition,
    /// Whether positions that are made are rounded to f32.
    pub precision: Precision,
    /// Whether to count the vertices that are left though a feature is near enough, since the gap is too wide for the edges
    /// beside it.
    pub counts_left: bool,
    /// Share of an edge at either end of which the end is taken for the whole share, instead of cutting the edge there; 0.2
    /// by default.
    pub snap: f64,
    /// No vertex is moved and no edge bent farther than this, in the model's unit.
    pub max_deviation: f64,
}

impl Default for Stitch {
    fn default() -> Self {
        Self {
            threshold: 1e-3,
            distance: None,
            position: StitchPosition::Kept,
            precision: Precision::F32,
            counts_left: false,
            snap: 0.2,
            max_deviation: f64::INFINITY,
        }
    }
}

impl Stitch {
    /// Closes cracks like a needle: of all boundary vertices the one nearest to another vertex or edge across the crack is
    /// joined to it, again and again.
    ///
    /// ```text
    ///   ----a---b-------c----        ----a---b---e---c----
    ///                          ->                               vertices merge, and where the other side has none,
    ///   ----a'------e---c'---        ----'-------'---'----      its edge is cut at the vertex and bends to it
    /// ```
    ///
    /// What is left open after a merge falls into chains on both sides of it, whose vertices wait in the same queue: that
    /// is the recursion into them, all at once and the nearest first. A crack may also be between two parts. Not
    /// joined are: features straight ahead along the boundary, which would fold it and leave a T-junction; features whose
    /// boundary does not run along that of the vertex in the opposite direction, which are no side of the same crack.
    ///
    /// Precondition: none; best where faces are consistently wound. Result: no position is made but averages where they are asked for, no face goes, loses its
    /// area or turns over, and no edge has more faces than two that had one. Leaves: what is wider, triangles at the
    /// ends of cracks that are blunt, and what would break the above.
    ///
    /// After "Mesh Stitching: Techniques for Repairing Gaps and Cracks in 3D Models" and Patel, Marcum and Remotigue
    /// 2005, "Stitching and Filling: Creating Conformal Faceted Geometry".
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; what is stitched stays stitched.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let limit = self.distance.unwrap_or(self.threshold * surface.bounds().diagonal()).min(self.max_deviation);
        let Some(mut border) = Border::new(surface).filter(|_| limit > 0.0) else { return Ok(Applied::default()) };
        if self.position == StitchPosition::Average {
            border.meeting = if self.precision == Precision::F32 { Meeting::HalfwayInF32 } else { Meeting::Halfway };
        }
        let mut search = Search::new(&border, limit, self.snap.clamp(0.0, 0.5));
        let mut queue = Queue::new();
        for at in 0..border.vertices.len() {
            if at % 4096 == 0 {
                context.check()?;
            }
            let v = border.vertices[at];
            search.enqueue(&mut border, v, &mut queue);
        }
        let (mut merged, mut cut, mut bent, mut count) = (0u64, 0u64, 0.0f64, 0u64);
        let most_cuts = (MOST_CUTS * border.edges_before()) as u64;
        while let Some(Reverse((bits, v))) = queue.pop() {
            count += 1;
            if count.is_multiple_of(4096) {
                context.check()?;
            }
            let Some((distance, feature)) = search.nearest(&mut border, v) else { continue };
            if distance.to_bits() > bits {
                queue.push(Reverse((distance.to_bits(), v)));
                continue;
            }
            let kept = match feature {
                Feature::Vertex { from, to } if border.merge(from, to, limit) => {
                    merged += 1;
                    to
                }
                Feature::Edge { half_edge } if cut < most_cuts && border.cut(half_edge, v).is_some() => {
                    cut += 1;
                    bent = bent.max(distance);
                    v
                }
                _ => continue,
            };
            // Around what was joined there may be nearer features now, and others may be allowed.
            let around: Vec<u32> = border.neighbours(kept).collect();
            for v in around.into_iter().chain([kept]) {
                search.enqueue(&mut border, v, &mut queue);
            }
        }
        let mut limited = Vec::new();
        let too_wide = if self.counts_left { search.too_wide(&mut border, context)? } else { 0 };
        if too_wide > 0 {
            let option = if self.distance.is_some() { "stitch_distance" } else { "stitch_threshold" };
            limited.push((option, format!(
                "{too_wide} boundary vertices have a gap within it that is wider than half of the edges beside it; such a gap is a hole"
            )));
        }
        let left = border.gave_up();
        let moved = border.farthest().max(bent);
        if merged > 0 {
            surface.drop_unreferenced();
        }
        let changes = Change::list([(ChangeKind::CrackVerticesMerged, merged), (ChangeKind::CrackEdgesSplit, cut)]);
        Ok(Applied { changes, moved, left, limited, ..Applied::default() })
    }
}

impl Operation for Stitch {
    const FIXES: &'static [Counter] =
        &[Counter::BoundaryEdges, Counter::MisorientedEdges, Counter::NonManifoldEdges, Counter::DuplicateFaces];
    const MAY_RAISE: &'static [Counter] = &[Counter::PinchedVertices];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let (usual, options) = (Self::default(), scope.options);
        Self {
            threshold: options.stitch_threshold.unwrap_or(usual.threshold),
            distance: options.stitch_distance,
            position: options.stitch_position,
            precision: scope.format.precision(),
            counts_left: options.stitch_threshold.is_some() || options.stitch_distance.is_some(),
            snap: options.stitch_epsilon,
            max_deviation: scope.max_deviation,
        }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}

/// What a vertex is joined to.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Feature {
    /// A vertex, of which one moves into the other.
    Vertex { from: u32, to: u32 },
    /// An edge, which is cut at the vertex.
    Edge { half_edge: u32 },
}

/// Vertices by the distance of the feature to which they may be joined, the nearest first. Distances are never negative, so that
/// their bits are in their order.
type Queue = BinaryHeap<Reverse<(u64, u32)>>;

/// The search for the feature nearest to a vertex.
struct Search {
    limit: f64,
    snap: f64,
    /// For each boundary vertex how wide a crack may be between it and another vertex.
    width: Vec<f64>,
    near: Vec<Near>,
}

impl Search {
    pub fn new(border: &Border<'_>, limit: f64, snap: f64) -> Self {
        let mut width = vec![0.0f64; border.vertices.len()];
        for ([a, b], length) in border.lengths() {
            for v in [a, b] {
                let width = &mut width[border.place(v)];
                *width = width.max(length * 0.5).min(limit);
            }
        }
        Self { limit, snap, width, near: Vec::new() }
    }

    /// The nearest feature to which a vertex may be joined, and how far it is.
    pub fn nearest(&mut self, border: &mut Border<'_>, v: u32) -> Option<(f64, Feature)> {
        let mut near = std::mem::take(&mut self.near);
        near.clear();
        if border.is_on_boundary(v) {
            border.near(v, self.limit, &mut near);
        }
        let found = if near.is_empty() { None } else { self.choose(border, v, &near) };
        self.near = near;
        found
    }

    /// Puts a vertex into the queue, where there is a feature to which it may be joined.
    fn enqueue(&mut self, border: &mut Border<'_>, v: u32, queue: &mut Queue) {
        if let Some((distance, _)) = self.nearest(border, v) {
            queue.push(Reverse((distance.to_bits(), v)));
        }
    }

    /// How many vertices still have the other side of a crack within the limit, at a width that the edges there do not allow.
    pub fn too_wide(&mut self, border: &mut Border<'_>, context: &Context<'_>) -> Result<u64, Cancelled> {
        let mut count = 0;
        let mut near = std::mem::take(&mut self.near);
        for at in 0..border.vertices.len() {
            if at % 4096 == 0 {
                context.check()?;
            }
            let v = border.vertices[at];
            if !border.is_on_boundary(v) {
                continue;
            }
            near.clear();
            border.near(v, self.limit, &mut near);
            let ahead = straight_ahead(border, v, self.limit);
            let courses = border.courses(v);
            let is_across = |it: &Near| {
                let ends = it.ends.map(|end| border.position(end));
                let width = self.width[border.place(v)];
                let is_wide = it.distance * 2.0 > border.length_before(it.half_edge) || it.distance >= width;
                is_wide
                    && !it.ends.iter().any(|end| ahead.contains(end))
                    && Border::run_along(&courses, &Border::courses_on(ends))
            };
            count += u64::from(near.iter().any(is_across));
        }
        self.near = near;
        Ok(count)
    }

    /// The nearest of the features near a vertex that is allowed.
    fn choose(&self, border: &mut Border<'_>, v: u32, near: &[Near]) -> Option<(f64, Feature)> {
        let ahead = straight_ahead(border, v, self.limit);
        let courses = border.courses(v);
        let mut best: Option<(f64, Feature)> = None;
        for it in near {
            border.steps = border.steps.saturating_sub(STEPS_TO_CHOOSE);
            if border.steps == 0 || best.is_some_and(|(distance, _)| distance <= it.distance) {
                break;
            }
            // An edge straight ahead is nearest at an end, which is no feature then.
            if it.distance * 2.0 > border.length_before(it.half_edge) {
                continue;
            }
            let snapped = if it.ratio <= self.snap {
                Some(it.ends[0])
            } else if it.ratio >= 1.0 - self.snap {
                Some(it.ends[1])
            } else {
                None
            };
            let vertex = snapped.filter(|end| !ahead.contains(end)).and_then(|w| self.merge(border, v, w));
            let found = vertex.or_else(|| {
                let inside = it.ratio > 0.0 && it.ratio < 1.0;
                let ends = it.ends.map(|end| border.position(end));
                let allowed =
                    inside && Border::run_along(&courses, &Border::courses_on(ends)) && border.may_cut(it.half_edge, v);
                allowed.then_some((it.distance, Feature::Edge { half_edge: it.half_edge }))
            });
            if let Some(found) = found.filter(|found| best.is_none_or(|best| found.0 < best.0)) {
                best = Some(found);
            }
        }
        best
    }

    /// Merging two vertices, whichever of them may move; the larger into the smaller if both.
    fn merge(&self, border: &mut Border<'_>, v: u32, w: u32) -> Option<(f64, Feature)> {
        let distance = border.position(v).distance(border.position(w));
        let width = self.width[border.place(v)].min(self.width[border.place(w)]);
        if distance >= width || !Border::run_along(&border.courses(v), &border.courses(w)) {
            return None;
        }
        let both = [(v.max(w), v.min(w)), (v.min(w), v.max(w))];
        let (from, to) = both
            .into_iter()
            .find(|&(from, to)| border.may_stray(from, to, self.limit) && border.may_merge(from, to))?;
        Some((distance, Feature::Vertex { from, to }))
    }
}

/// The vertices that the boundary leads to from a vertex without a bend, not farther than `reach`.
///
/// ```text
///    v----b----c        merging c into v would lay the boundary on itself, and b on the fold
/// ```
fn straight_ahead(border: &Border<'_>, v: u32, reach: f64) -> Vec<u32> {
    let mut ahead = Vec::new();
    let start = border.position(v);
    for first in border.neighbours(v) {
        let direction = (border.position(first) - start).normalize_or_zero();
        let (mut last, mut at) = (v, first);
        for _ in 0..MOST_AHEAD {
            ahead.push(at);
            if border.position(at).distance(start) > reach {
                break;
            }
            let straight = |&w: &u32| {
                let step = (border.position(w) - border.position(at)).normalize_or_zero();
                w != last && step.dot(direction) > STRAIGHT
            };
            let Some(next) = border.neighbours(at).find(straight) else { break };
            (last, at) = (at, next);
        }
    }
    ahead.push(v);
    ahead
}
