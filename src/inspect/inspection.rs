//! The complete inspection report of one mesh, and the verdict whether the mesh is good.

use serde::{Deserialize, Serialize};

use super::{
    Analysis, Answer, Attributes, CheckVerdict, DefectGroup, DefectKind, FileFacts, Findings, InspectOptions, Level,
    Measures, PrintMeasures, Shells, Statistics, Subject, find_defects, measures, print_measures, shells, statistics,
};
use crate::context::{Cancelled, Context};
use crate::math::threads;

/// Version of the structure of [`Inspection`].
pub const INSPECTION_VERSION: u32 = 1;

/// Number of places of each defect kind that findings keep for pictures and lists.
const MOST_PLACES: usize = 10_000;

/// Inspection report of one mesh: `before` and `after` of a repair, and the result of an analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Inspection {
    /// Version of this structure.
    pub version: u32,
    /// Level of the inspection.
    pub level: Level,
    /// Counts, attributes and sizes.
    #[serde(flatten)]
    pub measures: Measures,
    /// Attributes, statistics and parts.
    #[serde(flatten)]
    pub characteristics: Characteristics,
    /// Defects grouped by kind, with their places.
    pub defects: Vec<DefectGroup>,
    /// Kinds whose count is a lower bound, because their search exceeded its budget.
    pub incomplete: Vec<DefectKind>,
    /// Verdict of the level's rules; `null` at level `none`.
    pub check: Option<CheckVerdict>,
    /// Measures for printing; absent at level `none` and for a mesh without faces.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub print: Option<PrintMeasures>,
}

impl Inspection {
    /// Number of defects of a kind.
    #[must_use]
    pub fn count(&self, kind: DefectKind) -> u64 {
        self.defects.iter().find(|group| group.kind == kind).map_or(0, |group| group.count)
    }

    /// Shortens each list to its first `most` items and removes the statistics. Keeps all counts.
    pub fn abridge(&mut self, most: usize) {
        self.keep_places(most);
        for place in self.defects.iter_mut().flat_map(|group| &mut group.places) {
            place.faces.truncate(most);
            // A truncated line would look like the whole line in a drawing.
            if place.line.len() > 2 {
                place.line.clear();
            }
        }
        let shells = &mut self.characteristics.shells.list;
        // The measures of the mesh already describe a single part.
        shells.truncate(if shells.len() == 1 { 0 } else { most });
        self.characteristics.statistics = None;
    }

    /// Keeps the first `most` places of each kind. Keeps all counts.
    pub fn keep_places(&mut self, most: usize) {
        self.defects.iter_mut().for_each(|group| group.places.truncate(most));
        if let Some(wall) = self.print.as_mut().and_then(|print| print.thinnest_wall.as_mut()) {
            wall.places.truncate(most);
        }
    }
}

/// Inspects a mesh. The returned findings have more places than the report lists, and a mark on each face.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn inspect(
    subject: Subject<'_>,
    options: &InspectOptions,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    inspect_analysis(&Analysis::new(subject, context)?, options, context)
}

/// Inspects a mesh whose structure is already analysed.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn inspect_analysis(
    analysis: &Analysis<'_>,
    options: &InspectOptions,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    let mut measures = measures(analysis, context)?;
    let mut findings = Findings::new(analysis.file_faces().len(), options.places.max(MOST_PLACES));
    if options.level == Level::Full {
        let intersections = analysis.intersections(context)?;
        intersections.report(analysis, &mut findings);
        measures.self_intersections = intersections.counts;
    }
    // Both computations need it.
    analysis.extent();
    let find = || find_defects(analysis, &options.tolerances, options.level, &mut findings, context);
    let describe = || {
        let characteristics = characteristics(analysis, &measures, options.level, context)?;
        let print = match options.level {
            Level::None => None,
            Level::Basic | Level::Full => print_measures(analysis, &measures, options, context)?,
        };
        Ok((characteristics, print))
    };
    let (found, described) = threads::join(analysis.surface.faces.len(), find, describe);
    found?;
    let (characteristics, print) = described?;
    let inspection = Inspection {
        version: INSPECTION_VERSION,
        level: options.level,
        characteristics,
        defects: findings.groups(options.places),
        incomplete: findings.incomplete().to_vec(),
        check: CheckVerdict::new(options.level, &measures, &findings),
        print,
        measures,
    };
    Ok((inspection, findings))
}

/// Attributes, element counts, parts and shape statistics of a mesh, as the tool meshalyzer reports them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Characteristics {
    /// Whether the mesh is closed, manifold, consistent and outward.
    pub attributes: Attributes,
    /// Counts of the file's own vertices and faces.
    pub elements: Elements,
    /// Edge-connected parts.
    pub shells: Shells,
    /// Statistics of face and edge shapes; `null` at level `none`.
    pub statistics: Option<Statistics>,
}

/// Computes the characteristics of a measured mesh.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn characteristics(
    analysis: &Analysis<'_>,
    measures: &Measures,
    level: Level,
    context: &Context<'_>,
) -> Result<Characteristics, Cancelled> {
    let (shells, orientation) = shells(analysis, context)?;
    let attributes = Attributes::new(measures, &orientation);
    let statistics = match level {
        Level::None => None,
        Level::Basic | Level::Full => Some(statistics(analysis, &attributes, &orientation, context)?),
    };
    Ok(Characteristics { attributes, elements: Elements::new(analysis, measures), shells, statistics })
}

/// Counts of the file's own vertices and faces, before coincident vertices are merged.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Elements {
    /// Number of vertices in the file.
    pub vertices: u64,
    /// Used vertices that share their position with another vertex. Absent if no vertex of the file is used twice, as
    /// in STL, which stores the corners of each face separately.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub indistinguishable_vertices: Option<u64>,
    /// Faces that name a vertex more than once, by index or by position.
    pub repeated_vertex_faces: u64,
    /// Faces with three different vertices whose area is zero, exactly or in f64.
    pub collinear_faces: u64,
    /// Vertices that a face names and the file lacks. Absent if the format cannot have such faces or its reader
    /// rejects them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing_vertices: Option<u64>,
    /// Faces that name a missing vertex. No other count includes these faces.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub faces_without_vertex: Option<u64>,
    /// Whether vertices are numbered 1, 2, 3 and so on; absent if the format has no vertex numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vertices_contiguous: Option<bool>,
    /// Whether faces are numbered 1, 2, 3 and so on; absent if the format has no face numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub faces_contiguous: Option<bool>,
}

impl Elements {
    /// Counts the elements of the file. Takes the number of degenerate faces from `measures`. O(n).
    #[must_use]
    pub fn new(analysis: &Analysis<'_>, measures: &Measures) -> Self {
        let FileFacts { numbering, stored_vertices, .. } = analysis.facts;
        let vertices = analysis.file_positions().len();
        let mut used = vec![false; vertices];
        let mut used_before = |v: u32| used.get_mut(v as usize).is_some_and(|used| std::mem::replace(used, true));
        let shared = stored_vertices.is_none() && analysis.file_faces().iter().flatten().any(|&v| used_before(v));
        let faces = &analysis.surface.faces;
        let repeated = faces.iter().filter(|[a, b, c]| a == b || b == c || c == a).count() as u64;
        Self {
            vertices: stored_vertices.unwrap_or(vertices as u64),
            indistinguishable_vertices: (shared || numbering.is_some()).then_some(analysis.ingest.merged_vertices),
            repeated_vertex_faces: repeated,
            collinear_faces: measures.degenerate_faces.saturating_sub(repeated),
            missing_vertices: numbering.map(|numbering| numbering.missing_vertices),
            faces_without_vertex: numbering.map(|numbering| numbering.faces_without_vertex),
            vertices_contiguous: numbering.map(|numbering| numbering.vertices_contiguous),
            faces_contiguous: numbering.map(|numbering| numbering.faces_contiguous),
        }
    }
}

/// Shape limits for a good mesh, as in meshalyzer's option `-g`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Thresholds {
    /// Exclusive upper limit of face aspect ratios.
    pub aspect_ratio: f64,
    /// Exclusive lower limit of edge angles, in radians.
    pub edge_angle: f64,
    /// Exclusive lower limit of edge lengths, in the model's unit.
    pub edge_length: f64,
}

/// Verdict whether a mesh is good, with the reasons against it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Goodness {
    /// Whether the mesh has no shortfall.
    pub good: bool,
    /// The applied shape limits.
    pub thresholds: Thresholds,
    /// Every shortfall of the mesh.
    pub reasons: Vec<Shortfall>,
}

/// One property that keeps a mesh from being good.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Shortfall {
    /// The missing property.
    pub lack: Lack,
    /// Number of affected elements, or the worst value; `null` if no figure applies.
    pub value: Option<f64>,
}

/// A property that a good mesh has and this mesh lacks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Lack {
    /// There are boundary edges, or no face at all.
    Closed,
    /// There are non-manifold edges or vertices.
    Manifold,
    /// There are misoriented edges.
    Consistent,
    /// The mesh is not outward, or its orientation is unknown; the value counts the parts turned the wrong way.
    Outward,
    /// There are pairs of intersecting faces.
    NoIntersectingFaces,
    /// The search for intersecting faces did not run or did not finish.
    IntersectionsChecked,
    /// There are vertices that no face uses.
    NoOrphanVertices,
    /// Faces name vertices that the file lacks.
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
    /// Two neighbouring faces almost coincide; the value is the smallest edge angle.
    EdgeAngle,
    /// An edge is too short; the value is the smallest length.
    EdgeLength,
}

/// Decides whether a mesh is good as the tool meshalyzer defines the term. A good mesh is closed, manifold and
/// outward. No face intersects another, is degenerate or has a non-finite corner. No vertex is orphaned or missing.
/// Numbers are contiguous if the format has numbers, and shapes are within the thresholds.
///
/// The inspection must be at level `full`; otherwise intersections are unknown and the mesh is never good.
#[must_use]
pub fn goodness(inspection: &Inspection, thresholds: Thresholds) -> Goodness {
    let (measures, traits) = (&inspection.measures, &inspection.characteristics);
    let mut reasons = Vec::new();
    let mut lacks = |lack, when: bool, value: Option<f64>| {
        if when {
            reasons.push(Shortfall { lack, value });
        }
    };
    #[expect(clippy::cast_precision_loss, reason = "a figure to show")]
    let count = |n: u64| Some(n as f64);
    lacks(Lack::Closed, traits.attributes.closed != Answer::Yes, count(measures.boundary_edges));
    let nonmanifold = measures.non_manifold_edges + measures.non_manifold_vertices;
    lacks(Lack::Manifold, traits.attributes.manifold != Answer::Yes, count(nonmanifold));
    lacks(Lack::Consistent, traits.attributes.consistent == Answer::No, count(measures.misoriented_edges));
    let inward = count(traits.shells.inward).filter(|_| traits.shells.inward > 0);
    lacks(Lack::Outward, traits.attributes.outward != Answer::Yes, inward);
    let pairs = measures.self_intersections.pairs;
    lacks(Lack::NoIntersectingFaces, pairs.is_some_and(|n| n > 0), pairs.and_then(count));
    lacks(Lack::IntersectionsChecked, pairs.is_none() || !measures.self_intersections.complete, None);
    lacks(Lack::NoOrphanVertices, measures.unreferenced_vertices > 0, count(measures.unreferenced_vertices));
    let missing = traits.elements.missing_vertices.unwrap_or(0);
    lacks(Lack::NoMissingVertices, missing > 0, count(missing));
    lacks(Lack::NoDegenerateFaces, measures.degenerate_faces > 0, count(measures.degenerate_faces));
    lacks(Lack::FiniteFaces, measures.non_finite_faces > 0, count(measures.non_finite_faces));
    lacks(Lack::ContiguousVertices, traits.elements.vertices_contiguous == Some(false), None);
    lacks(Lack::ContiguousFaces, traits.elements.faces_contiguous == Some(false), None);
    let shapes = traits.statistics.as_ref();
    let ratio = shapes.and_then(|s| s.face_aspect_ratio.as_ref()).map(|d| d.max);
    lacks(Lack::AspectRatio, ratio.is_none_or(|x| x >= thresholds.aspect_ratio), ratio);
    let angle = shapes.and_then(|s| s.edge_angle.distribution.as_ref()).map(|d| d.min);
    lacks(Lack::EdgeAngle, angle.is_none_or(|x| x <= thresholds.edge_angle), angle);
    let length = shapes.and_then(|s| s.edge_length.as_ref()).map(|d| d.min);
    lacks(Lack::EdgeLength, length.is_none_or(|x| x <= thresholds.edge_length), length);
    Goodness { good: reasons.is_empty(), thresholds, reasons }
}
