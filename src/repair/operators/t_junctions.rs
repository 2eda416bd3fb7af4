//! Vertices on the edges of others.

use glam::DVec3;

use super::border::{Border, Near};
use super::operator::{Applied, Counter, Operation, Scope};
use crate::mesh::Surface;
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// The rounding of coordinates to f32, of which a few may add up where a vertex was put on an edge.
const ROUNDING: f64 = 4.0 * f32::EPSILON as f64;

/// How far from an edge a vertex may be that is taken to lie on it.
#[derive(Debug, Clone, Copy)]
pub struct SplitTJunctions {
    /// Share of the bounding box's diagonal; 1e-6 by default. What rounding to f32 may come to is always allowed.
    pub tolerance: f64,
    /// No edge is bent farther than this, in the model's unit.
    pub max_deviation: f64,
}

impl Default for SplitTJunctions {
    fn default() -> Self {
        Self { tolerance: 1e-6, max_deviation: f64::INFINITY }
    }
}

impl SplitTJunctions {
    /// Cuts boundary edges at the boundary vertices that lie on them, all at once, so that both sides have the same
    /// vertices.
    ///
    /// ```text
    ///        o                   o
    ///      /   \               / | \
    ///    a-------b           a-c-d---b       the face falls into a fan, and its pieces share
    ///    a-c-d---b    ->     a-c-d---b       edges with the neighbours
    ///     \ /\ /              \ /\ /
    /// ```
    ///
    /// Only where the boundary at the vertex runs along the edge. Precondition: none. Result: no position changes, no
    /// edge has more faces than two that had one. Leaves: vertices where that would not hold, or where a piece would
    /// have no area or be turned over.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; what is cut stays cut.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let bounds = surface.bounds();
        let rounding = ROUNDING * bounds.min.abs().max(bounds.max.abs()).max_element();
        let reach = (self.tolerance * bounds.diagonal()).max(rounding).min(self.max_deviation.max(f64::MIN_POSITIVE));
        let Some(mut border) = Border::new(surface) else { return Ok(Applied::default()) };
        let mut on_edges = vertices_on_edges(&mut border, reach, context)?;
        // By edge, and along each.
        on_edges.sort_unstable_by(|x, y| {
            x.edge.cmp(&y.edge).then(x.ratio.total_cmp(&y.ratio)).then(x.vertex.cmp(&y.vertex))
        });
        let (mut cut, mut moved) = (0, 0.0f64);
        for (count, it) in on_edges.iter().enumerate() {
            if count % 4096 == 0 {
                context.check()?;
            }
            if let Some(rest) = border.last_piece(it.edge)
                && border.cut(rest, it.vertex).is_some()
            {
                cut += 1;
                moved = moved.max(it.distance);
            }
        }
        let left = border.gave_up();
        Ok(Applied { changes: Change::list([(ChangeKind::TJunctionsSplit, cut)]), moved, left, ..Applied::default() })
    }
}

/// A vertex that lies on a boundary edge.
struct OnEdge {
    edge: u32,
    ratio: f64,
    vertex: u32,
    distance: f64,
}

fn vertices_on_edges(border: &mut Border<'_>, reach: f64, context: &Context<'_>) -> Result<Vec<OnEdge>, Cancelled> {
    let mut on_edges = Vec::new();
    let mut near: Vec<Near> = Vec::new();
    for at in 0..border.vertices.len() {
        if at % 4096 == 0 {
            context.check()?;
        }
        let vertex = border.vertices[at];
        near.clear();
        border.near(vertex, reach, &mut near);
        near.retain(|found| found.ratio > 0.0 && found.ratio < 1.0);
        if near.is_empty() {
            continue;
        }
        let courses = border.courses(vertex);
        for found in &near {
            let ends: [DVec3; 2] = found.ends.map(|v| border.position(v));
            if Border::run_along(&courses, &Border::courses_on(ends)) {
                let &Near { edge, ratio, distance, .. } = found;
                on_edges.push(OnEdge { edge, ratio, vertex, distance });
            }
        }
    }
    Ok(on_edges)
}

impl Operation for SplitTJunctions {
    const FIXES: &'static [Counter] = &[Counter::MisorientedEdges, Counter::NonManifoldEdges, Counter::DuplicateFaces];
    // A cut edge is two for a while, where only one of them finds its counterpart; joined at one end only, it is pinched.
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges, Counter::PinchedVertices];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { max_deviation: scope.max_deviation, ..Self::default() }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
