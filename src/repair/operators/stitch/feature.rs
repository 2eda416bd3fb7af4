use crate::repair::operators::border::{Border, Near};
use crate::repair::{Cancelled, Context};

/// The least cosine of the angle between boundary edges that are one straight line.
const STRAIGHT: f64 = 0.985;

/// What looking at a feature costs, in looks at an edge.
const STEPS_TO_CHOOSE: u64 = 16;

/// Vertices along a straight line that are looked at: as many as can be nearer than half of an edge.
const MOST_AHEAD: usize = 64;

/// What a vertex is joined to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Feature {
    /// A vertex, of which one moves into the other.
    Vertex { from: u32, to: u32 },
    /// An edge, which is cut at the vertex.
    Edge { half_edge: u32 },
}

/// The search for the feature nearest to a vertex.
pub(super) struct Search {
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
