//! The rules of a process profile, and the result of assessing a file against one.

use serde::{Deserialize, Serialize};

/// Most places that a rule lists.
const MAX_PLACES: usize = 20;

/// The result for one rule.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RuleResult {
    /// The rule.
    pub rule: PrintRule,
    /// Whether the file passes.
    pub result: RuleOutcome,
    /// How serious a failure is; absent if the rule does not fail.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub severity: Option<Severity>,
    /// The profile's limit, in the rule's own unit; absent if the rule has no number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<f64>,
    /// The measured value that is nearest to the limit or farthest beyond it; absent if there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<f64>,
    /// Number of features that break the rule.
    pub count: u64,
    /// Features that break the rule, the worst first; at most 20.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<RulePlace>,
    /// What to do about a failure, in words; absent if the file passes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
}

/// A rule of a process profile. Lengths are in millimetres, volumes in mm³.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum PrintRule {
    /// The file is a valid solid: closed, manifold, oriented outward, without intersections.
    Solid,
    /// Walls that are held on two or more sides are thick enough.
    SupportedWall,
    /// Walls that are held on at most one side are thick enough.
    FreeWall,
    /// Bars that are held at both ends are thick enough.
    Wire,
    /// Bars that are held at one end are thick enough.
    Pin,
    /// Raised details, which are lower than twice their width, are wide enough.
    EmbossedDetail,
    /// Holes are wide enough.
    Hole,
    /// Slots and other gaps within a solid are wide enough.
    Gap,
    /// Separate solids are far enough apart.
    Clearance,
    /// Sunk details, which are less deep than twice their width, are wide enough.
    EngravedDetail,
    /// Every separate solid has enough volume.
    PartVolume,
    /// Every cavity has an opening wide enough for powder or resin to leave. Sealed cavities count, and open ones in which a ball as
    /// wide as the escape hole fits. Further openings are not counted.
    EscapeHoles,
    /// The model fits the build volume, in some orientation along the axes.
    BuildVolume,
    /// The file has no more faces than print services accept.
    FaceCount,
    /// The file has no more bytes than print services accept.
    FileSize,
    /// The size is plausible in the file's unit, and a repaired file that names no unit is in millimetres.
    Unit,
}

/// Whether a file passes a rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum RuleOutcome {
    /// The file passes the rule.
    Pass,
    /// The file breaks the rule.
    Fail,
    /// The measurement was impossible or incomplete, for example because the file is not a valid solid.
    Undecided,
}

/// How serious it is that a file breaks a rule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Some print services refuse the model. Others accept this value.
    RefusedBySome,
    /// No source states that this value prints.
    BeyondAll,
}

/// A place where a file breaks a rule.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RulePlace {
    /// A point of the feature, in the file's unit.
    pub at: [f64; 3],
    /// The measured value, in the rule's own unit.
    pub value: f64,
    /// Area of the thin surface, in mm²; absent for rules that do not concern surface.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub area_mm2: Option<f64>,
}

impl PrintRule {
    /// All rules, in the order of a report.
    pub const ALL: [Self; 16] = [
        Self::Solid,
        Self::SupportedWall,
        Self::FreeWall,
        Self::Wire,
        Self::Pin,
        Self::EmbossedDetail,
        Self::Hole,
        Self::Gap,
        Self::Clearance,
        Self::EngravedDetail,
        Self::PartVolume,
        Self::EscapeHoles,
        Self::BuildVolume,
        Self::FaceCount,
        Self::FileSize,
        Self::Unit,
    ];

    /// The rule's subject, as sentences use it.
    #[must_use]
    pub fn in_words(self) -> &'static str {
        match self {
            Self::Solid => "valid solid",
            Self::SupportedWall => "thickness of supported walls",
            Self::FreeWall => "thickness of free walls",
            Self::Wire => "thickness of wires",
            Self::Pin => "thickness of pins",
            Self::EmbossedDetail => "width of embossed details",
            Self::Hole => "width of holes",
            Self::Gap => "width of gaps",
            Self::Clearance => "clearance between solids",
            Self::EngravedDetail => "width of engraved details",
            Self::PartVolume => "volume of separate solids",
            Self::EscapeHoles => "escape holes of cavities",
            Self::BuildVolume => "build volume",
            Self::FaceCount => "number of faces",
            Self::FileSize => "size of the file",
            Self::Unit => "unit",
        }
    }

    /// What to do about a failure.
    pub(super) fn remedy(self, limit: f64) -> String {
        match self {
            Self::Solid => "Repair the file.".to_owned(),
            Self::SupportedWall | Self::FreeWall | Self::Wire | Self::Pin => {
                format!("Thicken the walls with `min_wall={limit}`, or enlarge the model.")
            }
            Self::EmbossedDetail | Self::EngravedDetail => "Enlarge the detail or the model.".to_owned(),
            Self::Hole => "Widen or close the hole in the original model.".to_owned(),
            Self::Gap | Self::Clearance => "Widen the gap in the original model, or unite the parts.".to_owned(),
            Self::PartVolume => "Remove small solids with `islands=drop`, or enlarge the model.".to_owned(),
            Self::EscapeHoles => {
                format!(
                    "Drill holes with `voids=vent` and `vent_diameter_mm={limit}`, or close cavities with `voids=fill`."
                )
            }
            Self::BuildVolume => "Scale the model with `target_longest_mm`, or choose a larger printer.".to_owned(),
            Self::FaceCount => format!("Reduce the faces with `max_faces={limit}`."),
            Self::FileSize => "Reduce the faces with `max_faces`, or choose a smaller format.".to_owned(),
            Self::Unit => "State the unit with the option `unit`.".to_owned(),
        }
    }
}

impl RuleResult {
    /// A rule that the file passes.
    pub(super) fn pass(rule: PrintRule, limit: Option<f64>, measured: Option<f64>) -> Self {
        let result = RuleOutcome::Pass;
        Self { rule, result, severity: None, limit, measured, count: 0, places: Vec::new(), remedy: None }
    }

    /// A rule that could not be decided.
    pub(super) fn undecided(rule: PrintRule, limit: Option<f64>) -> Self {
        Self { result: RuleOutcome::Undecided, ..Self::pass(rule, limit, None) }
    }

    /// A rule that the file breaks with a value.
    pub(super) fn fail(rule: PrintRule, limit: f64, is_beyond_all: bool, measured: f64) -> Self {
        let severity = Some(if is_beyond_all { Severity::BeyondAll } else { Severity::RefusedBySome });
        let remedy = Some(rule.remedy(limit));
        Self { result: RuleOutcome::Fail, severity, remedy, count: 1, ..Self::pass(rule, Some(limit), Some(measured)) }
    }

    /// Lists the places that break the rule, the worst first.
    pub(super) fn at(mut self, mut places: Vec<RulePlace>) -> Self {
        places.sort_by(|a, b| a.value.total_cmp(&b.value));
        self.count = places.len() as u64;
        places.truncate(MAX_PLACES);
        self.places = places;
        self
    }
}
