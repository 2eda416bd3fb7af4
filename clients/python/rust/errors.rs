//! The engine's errors as exceptions of the package.

use meshmend::analyze::AnalyzeError;
use meshmend::context::Cancelled;
use meshmend::format::{FileLocation, ReadError};
use meshmend::inspect::OptionsError;
use meshmend::repair::RepairError;
use pyo3::prelude::*;
use serde::Serialize;

pyo3::import_exception!(meshmend.errors, InvalidModel);
pyo3::import_exception!(meshmend.errors, InvalidOption);
pyo3::import_exception!(meshmend.errors, DeadlineExceeded);
pyo3::import_exception!(meshmend.errors, Cancellation);
pyo3::import_exception!(meshmend.errors, EngineFailure);

/// An option that the engine refuses.
pub fn option_error(option: &str, message: &str) -> PyErr {
    InvalidOption::new_err((message.to_owned(), option.to_owned()))
}

/// A model that the engine cannot read. `name` is the name of the file.
pub fn read_error(name: &str, error: &ReadError) -> PyErr {
    let (byte, line) = match error.place {
        Some(FileLocation::Byte(byte)) => (Some(byte), None),
        Some(FileLocation::Line(line)) => (None, Some(line)),
        None => (None, None),
    };
    model_error(name, &error.to_string(), json_name(error.kind), byte, line)
}

/// A model that is refused, with the kind of the problem and its place.
pub fn model_error(name: &str, message: &str, kind: String, byte: Option<u64>, line: Option<u64>) -> PyErr {
    InvalidModel::new_err((format!("{name}: {message}"), kind, byte, line))
}

/// The name in JSON of a choice without data.
pub fn json_name(choice: impl Serialize) -> String {
    serde_json::to_value(choice).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
}

/// Why a call has no result.
pub enum Failure {
    /// An exception of Python: of the operating system, or of a callback.
    Python(PyErr),
    /// An option is out of range.
    Options(OptionsError),
    /// The named model cannot be read.
    Read(String, ReadError),
    /// The work was cancelled, or its deadline passed.
    Stopped,
    /// Another reason, in words.
    Other(String),
}

impl From<Cancelled> for Failure {
    fn from(_: Cancelled) -> Self {
        Self::Stopped
    }
}

impl From<AnalyzeError> for Failure {
    fn from(error: AnalyzeError) -> Self {
        match error {
            AnalyzeError::Read { name, error, .. } => Self::Read(name, error),
            AnalyzeError::Options(error) => Self::Options(error),
            AnalyzeError::Cancelled(_) => Self::Stopped,
        }
    }
}

impl Failure {
    /// The failure of the repair of the named model.
    pub fn of_repair(name: &str, error: RepairError) -> Self {
        match error {
            RepairError::Read(error) => Self::Read(name.to_owned(), error),
            RepairError::Options(error) => Self::Options(error),
            RepairError::Cancelled(_) | RepairError::OutOfTime(_) => Self::Stopped,
            RepairError::Write(_) | RepairError::Unfaithful => Self::Other(error.to_string()),
        }
    }

    /// The exception for this failure of a call with a deadline.
    pub fn into_exception(self, deadline_s: Option<f64>, is_cancelled: bool) -> PyErr {
        match self {
            Self::Python(error) => error,
            Self::Options(error) => option_error(error.option, &error.to_string()),
            Self::Read(name, error) => read_error(&name, &error),
            Self::Stopped => match deadline_s.filter(|_| !is_cancelled) {
                Some(seconds) => DeadlineExceeded::new_err(format!(
                    "The deadline of {seconds} s passed before there was a result; raise `deadline_s`, or pass fewer faces."
                )),
                None => Cancellation::new_err("The call was cancelled."),
            },
            Self::Other(message) => EngineFailure::new_err(message),
        }
    }
}
