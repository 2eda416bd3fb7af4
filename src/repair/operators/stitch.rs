//! Closes cracks whose two sides have different vertices, by merging vertices and splitting edges.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;

use glam::DVec3;

use super::border::{Border, MergePosition, NearbyEdge};
use super::holes::newell;
use super::operator::{Applied, Counter, Operation, Scope};
use crate::math::Precision;
use crate::mesh::{Edges, HalfEdge, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

pub use crate::repair::options::StitchPosition;

/// The most splits for each boundary edge, on average. Only crafted input has more vertices on an edge.
const MAX_SPLITS_PER_EDGE: usize = 4;

/// The least cosine of the angle between boundary edges that count as one straight line.
const MIN_STRAIGHT_COSINE: f64 = 0.985;

/// The cost of testing a candidate, in edge visits.
const COST_OF_CANDIDATE: u64 = 16;

/// The most vertices followed along a straight line: more cannot be closer than half of an edge.
const MAX_AHEAD: usize = 64;

/// The most edges of a hole whose shape decides whether it is a crack.
const MAX_EDGES_OF_SMALL_HOLE: usize = 12;

/// A small hole whose area divided by the square of half its perimeter is larger than this is no crack. A triangle of
/// this shape is a sixth as high as it is wide; a square has 0.25.
const MIN_ROUNDNESS: f64 = 0.08;

/// No small round hole.
const NONE: u32 = u32::MAX;

/// Closes cracks whose two sides have different vertices.
#[derive(Debug, Clone, Copy)]
pub struct Stitch {
    /// The largest width of a crack, as a share of the bounding box's diagonal; 0.001 by default. Between a
    /// vertex and an edge half of the edge is a further limit; between two vertices, half of the longer boundary edge at
    /// each of them. A wider gap is a hole.
    pub threshold: f64,
    /// The largest width of a crack in the model's unit, instead of `threshold`.
    pub distance: Option<f64>,
    /// Where two merged vertices are placed.
    pub position: StitchPosition,
    /// The precision to which new positions are rounded.
    pub precision: Precision,
    /// Whether to count the vertices that stay open although a feature is within the limit, because the gap is too wide
    /// for the adjacent edges.
    pub counts_left: bool,
    /// A vertex closer to an end of an edge than this share of the edge merges with the end instead of splitting the edge;
    /// 0.2 by default.
    pub snap: f64,
    /// No vertex moves and no edge bends farther than this, in the model's unit.
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
    /// Closes cracks from the narrowest place on: repeatedly joins the boundary vertex that is nearest to another vertex or
    /// edge across the crack.
    ///
    /// ```text
    ///   ----a---b-------c----        ----a---b---e---c----
    ///                          ->                               vertices merge; where the other side has no vertex,
    ///   ----a'------e---c'---        ----'-------'---'----      its edge splits and bends to the vertex
    /// ```
    ///
    /// One queue holds the vertices of every crack, nearest first, so no recursion into the remaining gaps is needed. The
    /// two sides of a crack may belong to two parts. Three kinds of features are not joined: features straight ahead along
    /// the boundary, which would fold it and leave a T-junction; features whose boundary does not run side by side in the
    /// opposite direction, since they are not the other side of the same crack; and features of the same small round
    /// hole, for example of a missing face, since filling restores it and stitching would bend the faces around it.
    ///
    /// Precondition: none; consistent winding gives the best result. Result: no new position unless averages are requested;
    /// no face disappears, loses its area or flips; no boundary edge gets more than two faces. Leaves: wider gaps, triangles
    /// at the blunt ends of cracks, and pairs whose joining would break these conditions.
    ///
    /// After "Mesh Stitching: Techniques for Repairing Gaps and Cracks in 3D Models" and Patel, Marcum and Remotigue
    /// 2005, "Stitching and Filling: Creating Conformal Faceted Geometry".
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; finished joins stay.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.run(surface, context)
    }
}

/// The note on cracks that are within the limit but too wide for their edges.
fn too_wide_note(too_wide: u64) -> String {
    format!(
        "{too_wide} boundary vertices have a gap within the limit that is wider than half of the adjacent edges; such a \
         gap counts as a hole"
    )
}

impl Operation<'_> for Stitch {
    const FIXES: &'static [Counter] =
        &[Counter::BoundaryEdges, Counter::MisorientedEdges, Counter::NonManifoldEdges, Counter::DuplicateFaces];
    const MAY_RAISE: &'static [Counter] = &[Counter::PinchedVertices];
    const ACTS_ON: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let (default, options) = (Self::default(), scope.options);
        Self {
            threshold: options.stitch_threshold.unwrap_or(default.threshold),
            distance: options.stitch_distance,
            position: options.stitch_position,
            precision: scope.format.precision(),
            counts_left: options.stitch_threshold.is_some() || options.stitch_distance.is_some(),
            snap: options.stitch_epsilon,
            max_deviation: scope.max_deviation,
        }
    }

    fn run_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: Arc<Edges>,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        let limit = self.distance.unwrap_or(self.threshold * surface.bounds().diagonal()).min(self.max_deviation);
        let Some(mut border) = Border::new(surface, &edges).filter(|_| limit > 0.0) else {
            return Ok(Applied::default());
        };
        if self.position == StitchPosition::Average {
            border.merge_position =
                if self.precision == Precision::F32 { MergePosition::MidpointF32 } else { MergePosition::Midpoint };
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
        let (mut merged, mut split, mut bent, mut count) = (0u64, 0u64, 0.0f64, 0u64);
        let max_splits = (MAX_SPLITS_PER_EDGE * border.edges_before()) as u64;
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
                Feature::Edge { half_edge } if split < max_splits && border.split_edge(half_edge, v).is_some() => {
                    split += 1;
                    bent = bent.max(distance);
                    v
                }
                _ => continue,
            };
            // The neighbours of a joined vertex may have nearer or newly allowed features.
            let around: Vec<u32> = border.neighbours(kept).collect();
            for v in around.into_iter().chain([kept]) {
                search.enqueue(&mut border, v, &mut queue);
            }
        }
        let mut limited = Vec::new();
        let too_wide = if self.counts_left { search.too_wide(&mut border, context)? } else { 0 };
        if too_wide > 0 {
            let option = if self.distance.is_some() { "stitch_distance" } else { "stitch_threshold" };
            limited.push((option, too_wide_note(too_wide)));
        }
        let left = border.exhausted_note();
        let moved = border.max_displacement().max(bent);
        if merged > 0 {
            Arc::make_mut(surface).drop_unreferenced();
        }
        let changes = Change::list([(ChangeKind::CrackVerticesMerged, merged), (ChangeKind::CrackEdgesSplit, split)]);
        Ok(Applied { changes, moved, left, limited, ..Applied::default() })
    }
}

/// The feature that a vertex is joined to.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Feature {
    /// A vertex: `from` merges into `to`.
    Vertex { from: u32, to: u32 },
    /// An edge, which is split at the vertex.
    Edge { half_edge: HalfEdge },
}

/// Vertices by the distance of the feature that they may join, nearest first. Distances are not negative, so their bit patterns
/// have the same order.
type Queue = BinaryHeap<Reverse<(u64, u32)>>;

/// The search for the feature nearest to a vertex.
struct Search {
    limit: f64,
    snap: f64,
    /// For each boundary vertex the largest width of a crack between it and another vertex.
    width: Vec<f64>,
    /// For each boundary vertex the number of its small round hole, or [`NONE`].
    hole_of_vertex: Vec<u32>,
    /// For each original boundary edge the same.
    hole_of_edge: Vec<u32>,
    nearby: Vec<NearbyEdge>,
}

impl Search {
    /// Derives the width limits from the boundary edges' lengths.
    pub fn new(border: &Border<'_>, limit: f64, snap: f64) -> Self {
        let mut width = vec![0.0f64; border.vertices.len()];
        for ([a, b], length) in border.edge_lengths() {
            for v in [a, b] {
                let width = &mut width[border.boundary_index(v)];
                *width = width.max(length * 0.5).min(limit);
            }
        }
        let hole_of_vertex = small_round_holes(border);
        let hole = |v: u32| hole_of_vertex[border.boundary_index(v)];
        let hole_of_edge = border.edge_lengths().map(|([a, b], _)| if hole(a) == hole(b) { hole(a) } else { NONE });
        let hole_of_edge = hole_of_edge.collect();
        Self { limit, snap, width, hole_of_vertex, hole_of_edge, nearby: Vec::new() }
    }

    /// Whether a vertex and an edge belong to the same small round hole.
    fn are_in_round_hole(&self, border: &Border<'_>, v: u32, edge: &NearbyEdge) -> bool {
        let hole = self.hole_of_vertex[border.boundary_index(v)];
        hole != NONE && self.hole_of_edge[edge.edge as usize] == hole
    }

    /// The nearest feature that a vertex may join, and its distance.
    pub fn nearest(&mut self, border: &mut Border<'_>, v: u32) -> Option<(f64, Feature)> {
        let mut nearby = std::mem::take(&mut self.nearby);
        nearby.clear();
        if border.is_on_boundary(v) {
            border.edges_near(v, self.limit, &mut nearby);
        }
        let feature = if nearby.is_empty() { None } else { self.choose(border, v, &nearby) };
        self.nearby = nearby;
        feature
    }

    /// Adds a vertex to the queue where it has a feature to join.
    fn enqueue(&mut self, border: &mut Border<'_>, v: u32, queue: &mut Queue) {
        if let Some((distance, _)) = self.nearest(border, v) {
            queue.push(Reverse((distance.to_bits(), v)));
        }
    }

    /// The number of vertices whose crack is within the limit but too wide for the adjacent edges.
    pub fn too_wide(&mut self, border: &mut Border<'_>, context: &Context<'_>) -> Result<u64, Cancelled> {
        let mut count = 0;
        let mut nearby = std::mem::take(&mut self.nearby);
        for at in 0..border.vertices.len() {
            if at % 4096 == 0 {
                context.check()?;
            }
            let v = border.vertices[at];
            if !border.is_on_boundary(v) {
                continue;
            }
            nearby.clear();
            border.edges_near(v, self.limit, &mut nearby);
            let ahead = straight_ahead(border, v, self.limit);
            let directions = border.boundary_directions(v);
            let is_across = |edge: &NearbyEdge| {
                let ends = edge.ends.map(|end| border.position(end));
                let width = self.width[border.boundary_index(v)];
                let is_wide = edge.distance * 2.0 > border.length_before(edge.half_edge) || edge.distance >= width;
                is_wide
                    && !edge.ends.iter().any(|end| ahead.contains(end))
                    && Border::are_opposed(&directions, &Border::boundary_directions_on(ends))
            };
            count += u64::from(nearby.iter().any(is_across));
        }
        self.nearby = nearby;
        Ok(count)
    }

    /// The nearest feature among `nearby` that the vertex may join.
    fn choose(&self, border: &mut Border<'_>, v: u32, nearby: &[NearbyEdge]) -> Option<(f64, Feature)> {
        let ahead = straight_ahead(border, v, self.limit);
        let directions = border.boundary_directions(v);
        let mut best: Option<(f64, Feature)> = None;
        for edge in nearby {
            border.budget = border.budget.saturating_sub(COST_OF_CANDIDATE);
            if border.budget == 0 || best.is_some_and(|(distance, _)| distance <= edge.distance) {
                break;
            }
            // For an edge straight ahead the closest point is an end, which is not a feature then.
            if edge.distance * 2.0 > border.length_before(edge.half_edge) || self.are_in_round_hole(border, v, edge) {
                continue;
            }
            let snapped = if edge.ratio <= self.snap {
                Some(edge.ends[0])
            } else if edge.ratio >= 1.0 - self.snap {
                Some(edge.ends[1])
            } else {
                None
            };
            let vertex = snapped.filter(|end| !ahead.contains(end)).and_then(|w| self.merge(border, v, w));
            let candidate = vertex.or_else(|| {
                let inside = edge.ratio > 0.0 && edge.ratio < 1.0;
                let ends = edge.ends.map(|end| border.position(end));
                let allowed = inside
                    && Border::are_opposed(&directions, &Border::boundary_directions_on(ends))
                    && border.can_split_edge(edge.half_edge, v);
                allowed.then_some((edge.distance, Feature::Edge { half_edge: edge.half_edge }))
            });
            if let Some(candidate) = candidate.filter(|candidate| best.is_none_or(|best| candidate.0 < best.0)) {
                best = Some(candidate);
            }
        }
        best
    }

    /// The merge of two vertices, in whichever direction is allowed; of two allowed directions the larger index moves.
    fn merge(&self, border: &mut Border<'_>, v: u32, w: u32) -> Option<(f64, Feature)> {
        let distance = border.position(v).distance(border.position(w));
        let width = self.width[border.boundary_index(v)].min(self.width[border.boundary_index(w)]);
        if distance >= width || !Border::are_opposed(&border.boundary_directions(v), &border.boundary_directions(w)) {
            return None;
        }
        let both = [(v.max(w), v.min(w)), (v.min(w), v.max(w))];
        let (from, to) = both
            .into_iter()
            .find(|&(from, to)| border.is_within_displacement(from, to, self.limit) && border.can_merge(from, to))?;
        Some((distance, Feature::Vertex { from, to }))
    }
}

/// For each boundary vertex the number of the small round hole around which it lies, or [`NONE`]. The boundary of such a
/// hole is one simple loop.
fn small_round_holes(border: &Border<'_>) -> Vec<u32> {
    let mut hole = vec![NONE; border.vertices.len()];
    let mut count = 0;
    for &start in &border.vertices {
        if hole[border.boundary_index(start)] != NONE {
            continue;
        }
        let Some(boundary) = small_loop(border, start).filter(|vertices| is_round(border, vertices)) else { continue };
        boundary.iter().for_each(|&v| hole[border.boundary_index(v)] = count);
        count += 1;
    }
    hole
}

/// The vertices of a boundary loop from `start` on; `None` if the loop is long, or meets another boundary.
fn small_loop(border: &Border<'_>, start: u32) -> Option<Vec<u32>> {
    let mut vertices = vec![start];
    let (mut last, mut at) = (start, start);
    loop {
        let mut neighbours = border.neighbours(at);
        let [one, other] = [neighbours.next()?, neighbours.next()?];
        if neighbours.next().is_some() || one == other {
            return None;
        }
        (last, at) = (at, if one == last { other } else { one });
        if at == start {
            return Some(vertices);
        }
        if vertices.len() == MAX_EDGES_OF_SMALL_HOLE {
            return None;
        }
        vertices.push(at);
    }
}

/// Whether a loop encloses a large area for its length.
fn is_round(border: &Border<'_>, vertices: &[u32]) -> bool {
    let points: Vec<DVec3> = vertices.iter().map(|&v| border.position(v)).collect();
    let next = points.iter().cycle().skip(1);
    let perimeter: f64 = points.iter().zip(next).map(|(a, b)| a.distance(*b)).sum();
    newell(&points).length() / 2.0 > MIN_ROUNDNESS * (perimeter / 2.0).powi(2)
}

/// The vertices that follow on the boundary in a straight line from a vertex, up to the first beyond `reach`.
///
/// ```text
///    v----b----c        merging c into v would fold the boundary onto itself, with b on the fold
/// ```
fn straight_ahead(border: &Border<'_>, v: u32, reach: f64) -> Vec<u32> {
    let mut ahead = Vec::new();
    let start = border.position(v);
    for first in border.neighbours(v) {
        let direction = (border.position(first) - start).normalize_or_zero();
        let (mut last, mut at) = (v, first);
        for _ in 0..MAX_AHEAD {
            ahead.push(at);
            if border.position(at).distance(start) > reach {
                break;
            }
            let straight = |&w: &u32| {
                let step = (border.position(w) - border.position(at)).normalize_or_zero();
                w != last && step.dot(direction) > MIN_STRAIGHT_COSINE
            };
            let Some(next) = border.neighbours(at).find(straight) else { break };
            (last, at) = (at, next);
        }
    }
    ahead.push(v);
    ahead
}
