use serde::Serialize;
use serde_json::{Map, Value};

/// The fields of options that differ from their defaults, as JSON.
#[must_use]
pub fn changed_fields<T: Serialize>(options: &T, defaults: &T) -> Map<String, Value> {
    let [fields, defaults] = [options, defaults].map(|it| serde_json::to_value(it).unwrap_or_default());
    let Value::Object(mut fields) = fields else { return Map::new() };
    fields.retain(|name, value| defaults.get(name.as_str()) != Some(value));
    fields
}

/// An option outside what it may be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`{option}` must be {expected}; got {value}.")]
pub struct OptionsError {
    /// The option's name.
    pub option: &'static str,
    /// What was given.
    pub value: String,
    /// What is allowed, in words.
    pub expected: &'static str,
}

impl OptionsError {
    /// Checks that a number lies in its range; one that is none does not.
    ///
    /// # Errors
    /// The error, when it does not.
    pub fn unless_within(
        option: &'static str,
        value: f64,
        (low, high): (f64, f64),
        expected: &'static str,
    ) -> Result<(), Self> {
        if (low..=high).contains(&value) { Ok(()) } else { Err(Self { option, value: value.to_string(), expected }) }
    }
}
