use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Analysis, DefectGroup, Findings, Measures, Subject, intersections, measures};
use crate::context::{Cancelled, Context};

/// The version of [`Inspection`]'s structure.
pub const INSPECTION_VERSION: u32 = 1;

/// Places kept of each kind of defect for pictures and lists.
const MOST_PLACES: usize = 10_000;

/// How closely a mesh is looked at, after Parasolid's `PK_check_mesh_*` (seed 002).
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize, ToSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// Counts and attributes only; no defect is looked for.
    None,
    /// Without what needs a search in space: slits, self-intersections and other neighbours that do not share an edge.
    Basic,
    /// Everything.
    #[default]
    Full,
}

/// What to look for, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct InspectOptions {
    /// How closely.
    pub level: Level,
    /// Places of each kind of defect that the report lists.
    pub places: usize,
}

impl Default for InspectOptions {
    fn default() -> Self {
        Self { level: Level::Full, places: 20 }
    }
}

/// Everything that is to be said of one mesh: the `before` and `after` of a repair, and the answer of an analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Inspection {
    /// Version of this structure.
    pub version: u32,
    /// How closely it was looked at.
    pub level: Level,
    /// Counts, attributes and sizes.
    #[serde(flatten)]
    pub measures: Measures,
    /// What is wrong where, by kind.
    pub defects: Vec<DefectGroup>,
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
    let analysis = Analysis::new(subject, context)?;
    let mut measures = measures(&analysis, context)?;
    let mut findings = Findings::new(subject.soup.faces.len(), options.places.max(MOST_PLACES));
    if options.level == Level::Full {
        let found = intersections(&analysis, context)?;
        found.report(&analysis, &mut findings);
        measures.self_intersections = found.counts;
    }
    let inspection = Inspection {
        version: INSPECTION_VERSION,
        level: options.level,
        measures,
        defects: findings.groups(options.places),
    };
    Ok((inspection, findings))
}
