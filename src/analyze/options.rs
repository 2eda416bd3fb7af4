use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use crate::inspect::{InspectOptions, OptionsError};

/// How files are to be analysed. Every field has a default; unknown fields are refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(try_from = "Map<String, Value>")]
pub struct AnalyzeOptions {
    /// Seconds the analysis of all files may take from its start; then the job fails.
    #[schema(minimum = 1.0, maximum = 3600.0, default = 300.0)]
    pub deadline_s: f64,
    /// What to look for, and how.
    #[serde(flatten)]
    pub inspect: InspectOptions,
}

impl Default for AnalyzeOptions {
    fn default() -> Self {
        Self { deadline_s: 300.0, inspect: InspectOptions::default() }
    }
}

impl AnalyzeOptions {
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

/// Serde's flatten passes unknown fields over in silence, so the two layers are taken apart by hand.
impl TryFrom<Map<String, Value>> for AnalyzeOptions {
    type Error = serde_json::Error;

    fn try_from(mut fields: Map<String, Value>) -> Result<Self, Self::Error> {
        let mut options = Self::default();
        if let Some(seconds) = fields.remove("deadline_s") {
            options.deadline_s = serde_json::from_value(seconds)?;
        }
        options.inspect = serde_json::from_value(Value::Object(fields))?;
        Ok(options)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::inspect::Level;

    fn read(value: Value) -> Result<AnalyzeOptions, serde_json::Error> {
        serde_json::from_value(value)
    }

    #[test]
    fn options_are_read_back_from_what_they_are_written_as() {
        let inspect = InspectOptions { level: Level::Basic, ..InspectOptions::default() };
        let options = AnalyzeOptions { deadline_s: 7.5, inspect };
        assert_eq!(read(serde_json::to_value(&options).expect("JSON")).expect("options"), options);
        assert_eq!(read(json!({})).expect("options"), AnalyzeOptions::default());
    }

    #[test]
    fn unknown_fields_of_either_layer_and_values_out_of_range_are_refused() {
        for (given, named) in [(json!({"levle": "full"}), "levle"), (json!({"deadline_s": null}), "null")] {
            let error = read(given).expect_err("refused").to_string();
            assert!(error.contains(named), "{error}");
        }
        for (given, named) in [(json!({"deadline_s": 0}), "deadline_s"), (json!({"places": 1_000_000}), "places")] {
            assert_eq!(read(given).expect("readable").validate().expect_err("refused").option, named);
        }
    }
}
