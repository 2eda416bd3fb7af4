//! Splits boundary edges at vertices that lie on them (T-junctions).

use std::sync::Arc;

use glam::DVec3;

use super::border::{Border, NearbyEdge};
use super::operator::{Applied, Counter, Operation, Scope};
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// The f32 rounding error of a coordinate, relative to the coordinate; a vertex placed on an edge may add up a few of them.
const ROUNDING: f64 = 4.0 * f32::EPSILON as f64;

/// Splits boundary edges at the vertices that lie on them.
#[derive(Debug, Clone, Copy)]
pub struct SplitTJunctions {
    /// The largest distance between vertex and edge, as a share of the bounding box's diagonal; 1e-6 by default, but never
    /// below the f32 rounding error.
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
    /// Splits each boundary edge at all boundary vertices that lie on it, so that both sides have the same vertices.
    ///
    /// ```text
    ///        o                   o
    ///      /   \               / | \
    ///    a-------b           a-c-d---b       the face becomes a fan whose faces share
    ///    a-c-d---b    ->     a-c-d---b       edges with the neighbours
    ///     \ /\ /              \ /\ /
    /// ```
    ///
    /// Only vertices whose boundary runs side by side with the edge count. Precondition: none. Result: no position changes,
    /// and no boundary edge gets more than two faces. Leaves: vertices where these conditions would break, or where a new
    /// face would have no area or be flipped.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; finished splits stay.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.run(surface, context)
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
    let mut nearby: Vec<NearbyEdge> = Vec::new();
    for at in 0..border.vertices.len() {
        if at % 4096 == 0 {
            context.check()?;
        }
        let vertex = border.vertices[at];
        nearby.clear();
        border.edges_near(vertex, reach, &mut nearby);
        nearby.retain(|edge| edge.ratio > 0.0 && edge.ratio < 1.0);
        if nearby.is_empty() {
            continue;
        }
        let directions = border.boundary_directions(vertex);
        for &NearbyEdge { edge, ends, ratio, distance, .. } in &nearby {
            let ends: [DVec3; 2] = ends.map(|v| border.position(v));
            if Border::are_opposed(&directions, &Border::boundary_directions_on(ends)) {
                on_edges.push(OnEdge { edge, ratio, vertex, distance });
            }
        }
    }
    Ok(on_edges)
}

impl Operation<'_> for SplitTJunctions {
    const FIXES: &'static [Counter] = &[Counter::MisorientedEdges, Counter::NonManifoldEdges, Counter::DuplicateFaces];
    // Splitting an edge can leave one half unmatched until the other half is split; matched at one end only, it is pinched.
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges, Counter::PinchedVertices];
    const ACTS_ON: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { max_deviation: scope.max_deviation, ..Self::default() }
    }

    fn run_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: Arc<Edges>,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        let bounds = surface.bounds();
        let rounding = ROUNDING * bounds.min.abs().max(bounds.max.abs()).max_element();
        let reach = (self.tolerance * bounds.diagonal()).max(rounding).min(self.max_deviation.max(f64::MIN_POSITIVE));
        let Some(mut border) = Border::new(surface, &edges) else { return Ok(Applied::default()) };
        let mut on_edges = vertices_on_edges(&mut border, reach, context)?;
        // By edge, and in order along each edge.
        on_edges.sort_unstable_by(|x, y| {
            x.edge.cmp(&y.edge).then(x.ratio.total_cmp(&y.ratio)).then(x.vertex.cmp(&y.vertex))
        });
        let (mut split, mut moved) = (0, 0.0f64);
        for (count, junction) in on_edges.iter().enumerate() {
            if count % 4096 == 0 {
                context.check()?;
            }
            if let Some(rest) = border.last_piece(junction.edge)
                && border.split_edge(rest, junction.vertex).is_some()
            {
                split += 1;
                moved = moved.max(junction.distance);
            }
        }
        let left = border.exhausted_note();
        Ok(Applied { changes: Change::list([(ChangeKind::TJunctionsSplit, split)]), moved, left, ..Applied::default() })
    }
}
