//! Reading options from JSON, so that an error names the option.

use serde::de::DeserializeOwned;
use serde_json::{Map, Number, Value};
use utoipa::IntoParams;
use utoipa::openapi::path::Parameter;

use crate::analyze::AnalyzeOptions;
use crate::inspect::{InspectOptions, OptionsError};
use crate::repair::{Options, PrintOptions};

/// Options that JSON can give by name.
pub trait OptionsInJson: DeserializeOwned {
    /// The names of all options.
    fn names() -> Vec<String>;
    /// Checks that every option is in its range.
    ///
    /// # Errors
    /// [`OptionsError`] for the first option out of range.
    fn validate(&self) -> Result<(), OptionsError>;
}

impl OptionsInJson for Options {
    fn names() -> Vec<String> {
        names(Self::into_params(|| None)).chain(names(PrintOptions::into_params(|| None))).collect()
    }

    fn validate(&self) -> Result<(), OptionsError> {
        Self::validate(self)
    }
}

impl OptionsInJson for AnalyzeOptions {
    fn names() -> Vec<String> {
        let own = ["deadline_s", "intersections", "spacing", "pictures", "scale_to", "process", "process_limits"];
        names(InspectOptions::into_params(|| None)).chain(own.map(str::to_owned)).collect()
    }

    fn validate(&self) -> Result<(), OptionsError> {
        Self::validate(self)
    }
}

fn names(parameters: Vec<Parameter>) -> impl Iterator<Item = String> {
    parameters.into_iter().map(|parameter| parameter.name)
}

/// Options that can't be read or are out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReadOptionsError {
    /// The option does not exist.
    #[error("There is no option `{option}`; the options are {}.", .names.join(", "))]
    Unknown {
        /// The unknown name.
        option: String,
        /// The names of all options.
        names: Vec<String>,
    },
    /// The value has the wrong type, or is none of the option's choices.
    #[error("`{option}` can't be read: {detail}.")]
    Unreadable {
        /// The option's name.
        option: String,
        /// What was found, and what was expected.
        detail: String,
    },
    /// A value is out of range.
    #[error(transparent)]
    Range(#[from] OptionsError),
}

impl ReadOptionsError {
    /// The name of the wrong option.
    #[must_use]
    pub fn option(&self) -> &str {
        match self {
            Self::Unknown { option, .. } | Self::Unreadable { option, .. } => option,
            Self::Range(error) => error.option,
        }
    }
}

/// Reads and checks options, and refuses unknown names.
///
/// # Errors
/// [`ReadOptionsError`], which names the option.
pub fn read_options<T: OptionsInJson>(mut fields: Map<String, Value>) -> Result<T, ReadOptionsError> {
    let names = T::names();
    if let Some(option) = fields.keys().find(|option| !names.contains(option)).cloned() {
        return Err(ReadOptionsError::Unknown { option, names });
    }
    fields.values_mut().for_each(with_whole_numbers);
    // One by one first, so that an error names its option.
    for (option, value) in &fields {
        let alone = Map::from_iter([(option.clone(), value.clone())]);
        read::<T>(alone, option)?;
    }
    let options: T = read(fields, "options")?;
    options.validate()?;
    Ok(options)
}

fn read<T: DeserializeOwned>(fields: Map<String, Value>, option: &str) -> Result<T, ReadOptionsError> {
    serde_json::from_value(Value::Object(fields))
        .map_err(|error| ReadOptionsError::Unreadable { option: option.to_owned(), detail: error.to_string() })
}

/// A JSON number as a whole number, also if it is written with a fraction of zero. JSON Schema counts `30.0` as an integer, but
/// serde does not. Returns `None` for negative numbers, for fractions, and for floats from 2^53 on.
#[must_use]
pub fn whole_number(number: &Number) -> Option<u64> {
    /// Larger floats have no fractional digits, so they may have been rounded.
    const FLOAT_LIMIT: f64 = (1_u64 << 53) as f64;
    let written_as_float =
        || number.as_f64().filter(|value| value.fract() == 0.0 && (0.0..FLOAT_LIMIT).contains(value));
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a whole number within the range")]
    number.as_u64().or_else(|| written_as_float().map(|value| value as u64))
}

/// Converts each number in the value to a whole number if [`whole_number`] can.
pub fn with_whole_numbers(value: &mut Value) {
    match value {
        Value::Number(number) => {
            if let Some(whole) = whole_number(number) {
                *number = whole.into();
            }
        }
        Value::Array(items) => items.iter_mut().for_each(with_whole_numbers),
        Value::Object(fields) => fields.values_mut().for_each(with_whole_numbers),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn error(fields: Value) -> ReadOptionsError {
        let Value::Object(fields) = fields else { panic!("not an object") };
        read_options::<Options>(fields).expect_err("wrong options")
    }

    #[test]
    fn an_error_of_options_in_json_names_the_option() {
        let unknown = error(json!({"max_tier": 1, "max_teir": 2}));
        assert_eq!(unknown.option(), "max_teir");
        assert!(
            unknown.to_string().starts_with("There is no option `max_teir`; the options are preset, "),
            "{unknown}"
        );
        let unreadable = error(json!({"max_tier": 1, "output": "docx"}));
        assert_eq!(unreadable.option(), "output");
        assert!(unreadable.to_string().starts_with("`output` can't be read: unknown variant `docx`"), "{unreadable}");
        assert_eq!(error(json!({"max_tier": 9})).to_string(), "`max_tier` must be 1, 2 or 3; got 9.");
    }

    #[test]
    fn whole_numbers_may_be_written_with_a_fraction_of_zero() {
        let Value::Object(fields) = json!({"max_tier": 2.0, "process": "fdm-0.4"}) else { panic!("not an object") };
        let options: Options = read_options(fields).expect("options");
        assert_eq!((options.max_tier, options.print.process.as_deref()), (2, Some("fdm-0.4")));
    }
}
