use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use crate::inspect::{InspectOptions, OptionsError, changed_fields};
use crate::scene::Unit;

/// How files are to be analysed. Every field has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(default)]
pub struct AnalyzeOptions {
    /// Seconds the analysis of all files may take from its start; then the job fails.
    #[schema(minimum = 1.0, maximum = 3600.0)]
    pub deadline_s: f64,
    /// Whether to count the faces of each file that intersect those of another.
    pub intersections: bool,
    /// Whether to measure the distance from each vertex to the nearest surface of another file.
    pub spacing: bool,
    /// Whether what was found can be had as pictures: `defects.png`, `defects.glb` and `defects.ply` for the first file, `2-defects.png`
    /// and so on for the others. They are drawn when somebody asks for one of them first.
    pub pictures: bool,
    /// The unit that lengths are brought into; without it they stay as they are. Lengths among these options are in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_to: Option<Unit>,
    /// What to look for, and how.
    #[serde(flatten)]
    pub inspect: InspectOptions,
}

impl Default for AnalyzeOptions {
    fn default() -> Self {
        Self {
            deadline_s: 300.0,
            intersections: true,
            spacing: true,
            pictures: true,
            scale_to: None,
            inspect: InspectOptions::default(),
        }
    }
}

impl AnalyzeOptions {
    /// The options that differ from their defaults, as JSON.
    #[must_use]
    pub fn to_changed_fields(&self) -> Map<String, Value> {
        changed_fields(self, &Self::default())
    }

    /// Checks every range.
    ///
    /// # Errors
    /// The first option that is out of its range.
    pub fn validate(&self) -> Result<(), OptionsError> {
        let seconds = "between 1 and 3600 seconds";
        OptionsError::unless_within("deadline_s", self.deadline_s, (1.0, 3600.0), seconds)?;
        self.inspect.validate()
    }
}
