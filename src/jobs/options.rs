//! The options of a job: which ones its mode has, and how they are read and checked.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use crate::analyze::AnalyzeOptions;
use crate::inspect::OptionsError;
use crate::options::{OptionsInJson, ReadOptionsError, read_options};
use crate::printing::profile::ProcessLimits;
use crate::repair::Options;

/// What a job does with its files.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Repair one model.
    #[default]
    Repair,
    /// Inspect one file or several, without changing them.
    Analyze,
}

impl Mode {
    /// Every mode.
    pub const ALL: [Self; 2] = [Self::Repair, Self::Analyze];

    /// The name used in JSON.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Repair => "repair",
            Self::Analyze => "analyze",
        }
    }

    /// The names of the mode's options.
    #[must_use]
    pub fn option_names(self) -> Vec<String> {
        match self {
            Self::Repair => Options::names(),
            Self::Analyze => AnalyzeOptions::names(),
        }
    }
}

/// The options of a job: `mode` (default `repair`), and the options of that mode next to it. Other options are refused.
#[expect(clippy::large_enum_variant, reason = "a job has one, and most jobs are repairs")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "mode", rename_all = "snake_case")]
pub enum JobOptions {
    /// Repair one model.
    #[schema(title = "RepairJobOptions")]
    Repair(Options),
    /// Inspect one file or several, without changing them.
    #[schema(title = "AnalyzeJobOptions")]
    Analyze(AnalyzeOptions),
}

/// Options that can't be read, are out of range, or contradict each other.
#[derive(Debug, thiserror::Error)]
pub enum JobOptionsError {
    /// The mode does not exist.
    #[error("`mode` must be `repair` or `analyze`; got {0}.")]
    Mode(Value),
    /// The option belongs to another mode.
    #[error("`{option}` is an option of mode `{}`; this job's mode is `{}`.", .of.as_str(), .mode.as_str())]
    OtherMode {
        /// The option's name.
        option: String,
        /// The mode that has the option.
        of: Mode,
        /// The job's mode.
        mode: Mode,
    },
    /// The option does not exist.
    #[error("There is no option `{option}`; those of mode `{}` are {}.", .mode.as_str(), .mode.option_names().join(", "))]
    Unknown {
        /// The unknown name.
        option: String,
        /// The job's mode.
        mode: Mode,
    },
    /// The value has the wrong type. Holds the option's name.
    #[error("`{0}` has a value of the wrong type; see its description in the OpenAPI document.")]
    Unreadable(String),
    /// A value is out of range.
    #[error(transparent)]
    Range(#[from] OptionsError),
}

impl JobOptionsError {
    /// The error of options that were read for a mode.
    fn of_mode(mode: Mode, error: ReadOptionsError) -> Self {
        match error {
            ReadOptionsError::Unknown { option, .. } => {
                match Mode::ALL.into_iter().find(|of| of.option_names().contains(&option)) {
                    Some(of) => Self::OtherMode { option, of, mode },
                    None => Self::Unknown { option, mode },
                }
            }
            ReadOptionsError::Unreadable { option, .. } => Self::Unreadable(option),
            ReadOptionsError::Range(error) => Self::Range(error),
        }
    }

    /// The name of the wrong option.
    #[must_use]
    pub fn option(&self) -> Option<&str> {
        match self {
            Self::Mode(_) => Some("mode"),
            Self::OtherMode { option, .. } | Self::Unknown { option, .. } | Self::Unreadable(option) => Some(option),
            Self::Range(error) => Some(error.option),
        }
    }
}

impl JobOptions {
    /// The mode of the options.
    #[must_use]
    pub fn mode(&self) -> Mode {
        match self {
            Self::Repair(_) => Mode::Repair,
            Self::Analyze(_) => Mode::Analyze,
        }
    }

    /// The deadline of the work, in seconds.
    #[must_use]
    pub fn deadline_s(&self) -> f64 {
        match self {
            Self::Repair(options) => options.deadline_s,
            Self::Analyze(options) => options.deadline_s,
        }
    }

    /// The limits that replace those of the process's profile.
    pub fn process_limits_mut(&mut self) -> &mut Option<ProcessLimits> {
        match self {
            Self::Repair(options) => &mut options.print.process_limits,
            Self::Analyze(options) => &mut options.process_limits,
        }
    }

    /// Whether the job offers pictures.
    #[must_use]
    pub fn pictures(&self) -> bool {
        match self {
            Self::Repair(options) => options.pictures,
            Self::Analyze(options) => options.pictures,
        }
    }

    /// The mode and the non-default options, as JSON fields.
    #[must_use]
    pub fn to_changed_fields(&self) -> Map<String, Value> {
        let mut fields = match self {
            Self::Repair(options) => options.to_changed_fields(),
            Self::Analyze(options) => options.to_changed_fields(),
        };
        fields.insert("mode".to_owned(), self.mode().as_str().into());
        fields
    }

    /// Reads and checks the options that a client sent, and refuses unknown fields: serde cannot deny them in the variants of a
    /// tagged enum.
    ///
    /// # Errors
    /// [`JobOptionsError`], which names the option.
    pub fn from_fields(mut fields: Map<String, Value>) -> Result<Self, JobOptionsError> {
        let mode = match fields.remove("mode") {
            None => Mode::default(),
            Some(mode) => serde_json::from_value(mode.clone()).map_err(|_| JobOptionsError::Mode(mode))?,
        };
        let of_mode = |error| JobOptionsError::of_mode(mode, error);
        Ok(match mode {
            Mode::Repair => Self::Repair(read_options(fields).map_err(of_mode)?),
            Mode::Analyze => Self::Analyze(read_options(fields).map_err(of_mode)?),
        })
    }
}

impl Default for JobOptions {
    fn default() -> Self {
        Self::Repair(Options::default())
    }
}

#[cfg(test)]
mod tests {
    use crate::repair::{Category, PrintOptions};
    use crate::scene::Unit;
    use serde_json::json;

    use super::*;

    fn read(value: Value) -> Result<JobOptions, JobOptionsError> {
        JobOptions::from_fields(value.as_object().expect("an object").clone())
    }

    #[test]
    fn the_mode_decides_the_options_and_defaults_to_repair() {
        assert_eq!(read(json!({})).expect("options"), JobOptions::default());
        assert_eq!(read(json!({"mode": "repair", "max_tier": 1})).expect("options").mode(), Mode::Repair);
        let analyze = read(json!({"mode": "analyze", "level": "basic", "deadline_s": 9})).expect("options");
        assert_eq!((analyze.mode(), analyze.deadline_s()), (Mode::Analyze, 9.0));
        let written = serde_json::to_value(&analyze).expect("JSON");
        assert_eq!((&written["mode"], &written["level"]), (&json!("analyze"), &json!("basic")));
        assert_eq!(serde_json::from_value::<JobOptions>(written).expect("options"), analyze);
    }

    #[test]
    fn the_documented_options_are_those_that_serde_reads() {
        let some = Some(1.0);
        let all = Options {
            category: Some(Category::Holes),
            merge_distance: some,
            sew_ratio: some,
            stitch_threshold: some,
            stitch_distance: some,
            overlap_angle_deg: some,
            voxel_size: some,
            max_deviation: some,
            thickness: some,
            max_faces: Some(4),
            max_error: some,
            unit: Some(Unit::Inch),
            scale_to: Some(Unit::Millimetre),
            print: PrintOptions {
                process: Some("sls".to_owned()),
                process_limits: Some(ProcessLimits::default()),
                min_wall: some,
                seal_mm: some,
                keep_cavities_over_mm3: some,
                vent_diameter_mm: some,
                target_height_mm: some,
                target_longest_mm: some,
                ..PrintOptions::default()
            },
            ..Options::default()
        };
        let analysis = AnalyzeOptions {
            scale_to: Some(Unit::Millimetre),
            process: Some("sls".to_owned()),
            process_limits: Some(ProcessLimits::default()),
            ..AnalyzeOptions::default()
        };
        for (mode, options) in
            [(Mode::Repair, serde_json::to_value(&all)), (Mode::Analyze, serde_json::to_value(&analysis))]
        {
            let mut written: Vec<String> =
                options.expect("JSON").as_object().expect("fields").keys().cloned().collect();
            let mut named = mode.option_names();
            written.sort();
            named.sort();
            assert_eq!(written, named);
        }
    }

    #[test]
    fn an_unknown_or_wrong_option_is_refused_by_its_name_and_mode() {
        for (given, message) in [
            (json!({"level": "full"}), "`level` is an option of mode `analyze`; this job's mode is `repair`."),
            (json!({"mode": "analyze", "preset": "auto"}), "`preset` is an option of mode `repair`"),
            (json!({"mode": "destroy"}), "`mode` must be `repair` or `analyze`; got \"destroy\"."),
            (json!({"mode": "analyze", "levle": 1}), "no option `levle`; those of mode `analyze` are level, "),
            (json!({"mode": "analyze", "level": "deep"}), "`level` has a value of the wrong type"),
            (json!({"deadline_s": null}), "`deadline_s` has a value of the wrong type"),
            (json!({"mode": "analyze", "deadline_s": 0}), "`deadline_s` must be "),
            (json!({"mode": "analyze", "places": 5000}), "`places` must be "),
            (json!({"max_tier": 9}), "`max_tier` must be "),
        ] {
            let error = read(given).expect_err("refused").to_string();
            assert!(error.contains(message), "{error}");
        }
    }
}
