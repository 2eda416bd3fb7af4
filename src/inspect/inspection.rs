//! Everything that is said of one mesh, and whether it is good.

use serde::{Deserialize, Serialize};

use super::{
    Analysis, Answer, Attributes, CheckVerdict, DefectGroup, DefectKind, Findings, InspectOptions, Level, Measures,
    PrintMeasures, Shells, Statistics, Subject, find_defects, measures, print_measures, shells, statistics,
};
use crate::context::{Cancelled, Context};

/// The version of [`Inspection`]'s structure.
pub const INSPECTION_VERSION: u32 = 1;

/// Places kept of each kind of defect for pictures and lists.
const MOST_PLACES: usize = 10_000;

/// Everything that is to be said of one mesh: the `before` and `after` of a repair, and the answer of an analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Inspection {
    /// Version of this structure.
    pub version: u32,
    /// How closely it was looked at.
    pub level: Level,
    /// Counts, attributes and sizes.
    #[serde(flatten)]
    pub measures: Measures,
    /// Attributes, statistics and parts.
    #[serde(flatten)]
    pub characteristics: Characteristics,
    /// What is wrong where, by kind.
    pub defects: Vec<DefectGroup>,
    /// Kinds of which there may be more: their search met too many candidates and was given up.
    pub incomplete: Vec<DefectKind>,
    /// Whether the mesh keeps the rules of the level; none at level none.
    pub check: Option<CheckVerdict>,
    /// What a printer wants to know; absent at level `none` and for a mesh without faces.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub print: Option<PrintMeasures>,
}

impl Inspection {
    /// How many defects of a kind were found.
    #[must_use]
    pub fn count(&self, kind: DefectKind) -> u64 {
        self.defects.iter().find(|group| group.kind == kind).map_or(0, |group| group.count)
    }

    /// Shortens each list to its first `most` items and leaves out the statistics. Counts stay.
    pub fn abridge(&mut self, most: usize) {
        self.keep_places(most);
        for place in self.defects.iter_mut().flat_map(|group| &mut group.places) {
            place.faces.truncate(most);
            // A part of a line would be drawn as if it were all of it.
            if place.line.len() > 2 {
                place.line.clear();
            }
        }
        let shells = &mut self.characteristics.shells.list;
        // The only part is described by the measures of the mesh.
        shells.truncate(if shells.len() == 1 { 0 } else { most });
        self.characteristics.statistics = None;
    }

    /// Leaves out all places but so many of each kind. Counts stay.
    pub fn keep_places(&mut self, most: usize) {
        self.defects.iter_mut().for_each(|group| group.places.truncate(most));
        if let Some(wall) = self.print.as_mut().and_then(|print| print.thinnest_wall.as_mut()) {
            wall.places.truncate(most);
        }
    }
}

/// Looks at a mesh. The findings have more places than the report lists, and a mark on each face.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn inspect(
    subject: Subject<'_>,
    options: &InspectOptions,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    inspect_analysis(&Analysis::new(subject, context)?, options, context)
}

/// Looks at a mesh whose structure is known.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn inspect_analysis(
    analysis: &Analysis<'_>,
    options: &InspectOptions,
    context: &Context<'_>,
) -> Result<(Inspection, Findings), Cancelled> {
    let mut measures = measures(analysis, context)?;
    let mut findings = Findings::new(analysis.subject.soup.faces.len(), options.places.max(MOST_PLACES));
    if options.level == Level::Full {
        let found = analysis.intersections(context)?;
        found.report(analysis, &mut findings);
        measures.self_intersections = found.counts;
    }
    find_defects(analysis, &options.tolerances, options.level, &mut findings, context)?;
    let characteristics = characteristics(analysis, &measures, options.level, context)?;
    let print = match options.level {
        Level::None => None,
        Level::Basic | Level::Full => print_measures(analysis, &measures, options, context)?,
    };
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

/// What meshalyzer reports of a mesh (seed 004) beyond [`Measures`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Characteristics {
    /// The four attributes.
    pub attributes: Attributes,
    /// What the file itself says of its vertices and faces.
    pub elements: Elements,
    /// The edge-connected parts.
    pub shells: Shells,
    /// How faces and edges are shaped; none at level `none`.
    pub statistics: Option<Statistics>,
}

/// Finds the characteristics of a mesh that was measured.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn characteristics(
    analysis: &Analysis<'_>,
    measures: &Measures,
    level: Level,
    context: &Context<'_>,
) -> Result<Characteristics, Cancelled> {
    let (shells, turning) = shells(analysis, context)?;
    let attributes = Attributes::new(measures, &turning);
    let statistics = match level {
        Level::None => None,
        Level::Basic | Level::Full => Some(statistics(analysis, &attributes, &turning, context)?),
    };
    Ok(Characteristics { attributes, elements: Elements::new(analysis, measures), shells, statistics })
}

/// What the file itself says of its vertices and faces, before vertices are merged.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Elements {
    /// Vertices in the file.
    pub vertices: u64,
    /// Used vertices of the file that can't be told from another one, since they stand at its position. None where no
    /// vertex of the file is used twice, as in STL, which has no numbers: there, it is the rule.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub indistinguishable_vertices: Option<u64>,
    /// Faces that name a vertex more than once, by its number or by its position.
    pub repeated_vertex_faces: u64,
    /// Faces of three different vertices that lie on a line, or so near one that f64 finds no area.
    pub collinear_faces: u64,
    /// Vertices that a face names and the file does not give. None where the format can't have them, or its reader refuses
    /// them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing_vertices: Option<u64>,
    /// Faces that name such a vertex; nothing else counts them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub faces_without_vertex: Option<u64>,
    /// Whether vertices are numbered 1, 2, 3 and so on; none where the format has no numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vertices_contiguous: Option<bool>,
    /// Whether faces are numbered 1, 2, 3 and so on; none where the format has no numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub faces_contiguous: Option<bool>,
}

impl Elements {
    /// Counts, with the degenerate faces that `measures` has found. Linear.
    #[must_use]
    pub fn new(analysis: &Analysis<'_>, measures: &Measures) -> Self {
        let (soup, numbering) = (analysis.subject.soup, analysis.subject.numbering);
        let mut used = vec![false; soup.positions.len()];
        let mut used_before = |v: u32| used.get_mut(v as usize).is_some_and(|it| std::mem::replace(it, true));
        let shared = soup.faces.iter().flatten().any(|&v| used_before(v));
        let faces = &analysis.surface.faces;
        let repeated = faces.iter().filter(|[a, b, c]| a == b || b == c || c == a).count() as u64;
        Self {
            vertices: soup.positions.len() as u64,
            indistinguishable_vertices: (shared || numbering.is_some()).then_some(analysis.ingest.merged_vertices),
            repeated_vertex_faces: repeated,
            collinear_faces: measures.degenerate_faces.saturating_sub(repeated),
            missing_vertices: numbering.map(|it| it.missing_vertices),
            faces_without_vertex: numbering.map(|it| it.faces_without_vertex),
            vertices_contiguous: numbering.map(|it| it.vertices_contiguous),
            faces_contiguous: numbering.map(|it| it.faces_contiguous),
        }
    }
}

/// What a good mesh must keep to beyond having nothing wrong, after meshalyzer's option `-g` (seed 004).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Thresholds {
    /// Aspect ratios of faces must be less than this.
    pub aspect_ratio: f64,
    /// Edge angles must be greater than this, in radians.
    pub edge_angle: f64,
    /// Edges must be longer than this.
    pub edge_length: f64,
}

/// Whether a mesh is good, and if not, why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Goodness {
    /// No reason was found against it.
    pub good: bool,
    /// What it was held to.
    pub thresholds: Thresholds,
    /// Everything that it lacks.
    pub reasons: Vec<Shortfall>,
}

/// One thing that keeps a mesh from being good.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Shortfall {
    /// What is lacking.
    pub lack: Lack,
    /// How many elements are at fault, or the worst value; none where there is no figure.
    pub value: Option<f64>,
}

/// What a mesh can lack.
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
    let nonmanifold = measures.non_manifold_edges + measures.non_manifold_vertices;
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
    lacks(Lack::FiniteFaces, measures.non_finite_faces > 0, count(measures.non_finite_faces));
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
