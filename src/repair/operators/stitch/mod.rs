//! Stitching: closing cracks whose sides have different vertices.

mod feature;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use feature::{Feature, Search};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::border::{Border, Meeting};
use super::{Applied, Counter, Operation, Scope};
use crate::math::Precision;
use crate::mesh::Surface;
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Cuts for each boundary edge: a vertex is on few edges, unless the input is crafted.
const MOST_CUTS: usize = 4;

/// Where two vertices that are stitched meet. A vertex that is joined to an edge stays where it is, and the edge bends to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum StitchPosition {
    /// Where one of them is, so that no position is new.
    #[default]
    Kept,
    /// Halfway between them.
    Average,
}

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
        // Distances are never negative, so that their bits are in their order.
        let mut queue: BinaryHeap<Reverse<(u64, u32)>> = BinaryHeap::new();
        for at in 0..border.vertices.len() {
            if at % 4096 == 0 {
                context.check()?;
            }
            let v = border.vertices[at];
            if let Some((distance, _)) = search.nearest(&mut border, v) {
                queue.push(Reverse((distance.to_bits(), v)));
            }
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
                if let Some((distance, _)) = search.nearest(&mut border, v) {
                    queue.push(Reverse((distance.to_bits(), v)));
                }
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
        &[Counter::BoundaryEdges, Counter::MisorientedEdges, Counter::NonmanifoldEdges, Counter::DuplicateFaces];
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
