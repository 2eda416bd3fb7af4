use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Answer, Inspection};

/// What a good mesh must keep to beyond having nothing wrong, after meshalyzer's option `-g` (seed 004).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Thresholds {
    /// Aspect ratios of faces must be less than this.
    pub aspect_ratio: f64,
    /// Edge angles must be greater than this, in radians.
    pub edge_angle: f64,
    /// Edges must be longer than this.
    pub edge_length: f64,
}

/// Whether a mesh is good, and if not, why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Goodness {
    /// No reason was found against it.
    pub good: bool,
    /// What it was held to.
    pub thresholds: Thresholds,
    /// Everything that it lacks.
    pub reasons: Vec<Shortfall>,
}

/// One thing that keeps a mesh from being good.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Shortfall {
    /// What is lacking.
    pub lack: Lack,
    /// How many elements are at fault, or the worst value; none where there is no figure.
    pub value: Option<f64>,
}

/// What a mesh can lack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Lack {
    /// There are boundary edges, or no face at all.
    Closed,
    /// There are non-manifold edges or vertices.
    Manifold,
    /// There are misoriented edges.
    Consistent,
    /// It is not turned outward, or that can't be told; the value counts the parts turned the wrong way.
    Outward,
    /// There are pairs of intersecting faces.
    NoIntersectingFaces,
    /// Intersecting faces were not looked for, or not to the end.
    IntersectionsChecked,
    /// There are vertices that no face uses.
    NoOrphanVertices,
    /// Faces name vertices that are not there.
    NoMissingVertices,
    /// There are degenerate faces.
    NoDegenerateFaces,
    /// There are faces with a corner that is not a finite number.
    FiniteFaces,
    /// Vertices are not numbered 1, 2, 3 and so on.
    ContiguousVertices,
    /// Faces are not numbered 1, 2, 3 and so on.
    ContiguousFaces,
    /// A face is too thin; the value is the largest aspect ratio.
    AspectRatio,
    /// Two faces are too close; the value is the smallest edge angle.
    EdgeAngle,
    /// An edge is too short; the value is the smallest length.
    EdgeLength,
}

/// Holds a mesh to what meshalyzer calls good: closed, manifold, outward, no intersecting, degenerate or unreadable
/// face, no orphaned or missing vertex, contiguous numbers where the format has numbers, and shapes within the thresholds.
///
/// It should have been looked at at level `full`, without which intersections are not known and it can't be good.
#[must_use]
pub fn goodness(inspection: &Inspection, thresholds: Thresholds) -> Goodness {
    let (measures, it) = (&inspection.measures, &inspection.characteristics);
    let mut reasons = Vec::new();
    let mut lacks = |lack, when: bool, value: Option<f64>| {
        if when {
            reasons.push(Shortfall { lack, value });
        }
    };
    #[expect(clippy::cast_precision_loss, reason = "a figure to show")]
    let count = |n: u64| Some(n as f64);
    lacks(Lack::Closed, it.attributes.closed != Answer::Yes, count(measures.boundary_edges));
    let nonmanifold = measures.nonmanifold_edges + measures.nonmanifold_vertices;
    lacks(Lack::Manifold, it.attributes.manifold != Answer::Yes, count(nonmanifold));
    lacks(Lack::Consistent, it.attributes.consistent == Answer::No, count(measures.misoriented_edges));
    let inward = count(it.shells.inward).filter(|_| it.shells.inward > 0);
    lacks(Lack::Outward, it.attributes.outward != Answer::Yes, inward);
    let pairs = measures.self_intersections.pairs;
    lacks(Lack::NoIntersectingFaces, pairs.is_some_and(|n| n > 0), pairs.and_then(count));
    lacks(Lack::IntersectionsChecked, pairs.is_none() || !measures.self_intersections.complete, None);
    lacks(Lack::NoOrphanVertices, measures.unreferenced_vertices > 0, count(measures.unreferenced_vertices));
    let missing = it.elements.missing_vertices.unwrap_or(0);
    lacks(Lack::NoMissingVertices, missing > 0, count(missing));
    lacks(Lack::NoDegenerateFaces, measures.degenerate_faces > 0, count(measures.degenerate_faces));
    lacks(Lack::FiniteFaces, measures.nonfinite_faces > 0, count(measures.nonfinite_faces));
    lacks(Lack::ContiguousVertices, it.elements.vertices_contiguous == Some(false), None);
    lacks(Lack::ContiguousFaces, it.elements.faces_contiguous == Some(false), None);
    let shapes = it.statistics.as_ref();
    let ratio = shapes.and_then(|s| s.face_aspect_ratio.as_ref()).map(|d| d.max);
    lacks(Lack::AspectRatio, ratio.is_none_or(|x| x >= thresholds.aspect_ratio), ratio);
    let angle = shapes.and_then(|s| s.edge_angle.distribution.as_ref()).map(|d| d.min);
    lacks(Lack::EdgeAngle, angle.is_none_or(|x| x <= thresholds.edge_angle), angle);
    let length = shapes.and_then(|s| s.edge_length.as_ref()).map(|d| d.min);
    lacks(Lack::EdgeLength, length.is_none_or(|x| x <= thresholds.edge_length), length);
    Goodness { good: reasons.is_empty(), thresholds, reasons }
}
