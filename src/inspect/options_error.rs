/// An option outside what it may be.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("option '{option}' is {value}; it must be {expected}")]
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
