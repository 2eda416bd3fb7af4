use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    Analysis, Characteristics, CheckVerdict, DefectGroup, DefectKind, Findings, Measures, OptionsError, PrintMeasures,
    Subject, Tolerances, characteristics, find_defects, measures, print_measures,
};
use crate::context::{Cancelled, Context};
use crate::scene::Unit;

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

impl Level {
    /// Whether a kind of defect is looked for. Sheets are at level basic as far as their two sides have the same faces.
    #[must_use]
    pub fn looks_for(self, kind: DefectKind) -> bool {
        use DefectKind as K;
        match self {
            Self::None => false,
            Self::Basic => !matches!(kind, K::Slit | K::SelfIntersection | K::TJunction | K::Crack | K::InnerShell),
            Self::Full => true,
        }
    }
}

/// What to look for, and how. Every field has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema, IntoParams)]
#[serde(default)]
#[into_params(parameter_in = Query)]
pub struct InspectOptions {
    /// How closely.
    pub level: Level,
    /// Places of each kind of defect that the report lists.
    #[schema(minimum = 0, maximum = 1000)]
    pub places: usize,
    /// How closely things must agree to count as the same.
    pub tolerances: Tolerances,
    /// The unit of the file's lengths, whatever it says itself. Without it, and where the file says none, millimetres are assumed.
    pub unit: Option<Unit>,
    /// The direction in which the model is built, of any length but zero.
    #[schema(min_items = 3, max_items = 3)]
    pub up: [f64; 3],
    /// An angle from the vertical, in degrees from 0 to 90, for which the area of overhangs is told beside 30, 45 and 60.
    #[schema(minimum = 0.0, maximum = 90.0)]
    pub overhang_deg: f64,
    /// Sides of the printer's build volume, in millimetres.
    #[schema(min_items = 3, max_items = 3)]
    pub build_volume: Option<[f64; 3]>,
    /// Whether walls are measured of a printable mesh only. A repair asks for that of its input: what is printed is the result, and
    /// walls of a mesh with faults take winding numbers, which is half of the time of a small repair.
    #[serde(skip)]
    #[schema(ignore)]
    #[param(ignore)]
    pub walls_of_printable_only: bool,
}

impl Default for InspectOptions {
    fn default() -> Self {
        Self {
            level: Level::Full,
            places: 20,
            tolerances: Tolerances::default(),
            unit: None,
            up: [0.0, 0.0, 1.0],
            overhang_deg: 45.0,
            build_volume: None,
            walls_of_printable_only: false,
        }
    }
}

impl InspectOptions {
    /// Checks every range.
    ///
    /// # Errors
    /// The first option that is out of its range.
    pub fn validate(&self) -> Result<(), OptionsError> {
        #[expect(clippy::cast_precision_loss, reason = "compared with a small bound")]
        let places = self.places as f64;
        OptionsError::unless_within("places", places, (0.0, 1000.0), "between 0 and 1000 places of each kind")?;
        self.tolerances.validate().map_err(|error| OptionsError {
            option: error.name,
            value: error.value.to_string(),
            expected: "a finite number that is not negative",
        })?;
        let degrees = "between 0 and 90 degrees from the vertical";
        OptionsError::unless_within("overhang_deg", self.overhang_deg, (0.0, 90.0), degrees)?;
        let up: f64 = self.up.iter().map(|x| x.abs()).sum();
        OptionsError::unless_within("up", up, (f64::MIN_POSITIVE, f64::MAX), "a direction that is not zero")?;
        let smallest = self.build_volume.map_or(1.0, |sides| sides.into_iter().fold(f64::MAX, f64::min));
        OptionsError::unless_within("build_volume", smallest, (f64::MIN_POSITIVE, f64::MAX), "three lengths above zero")
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
