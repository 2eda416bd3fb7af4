//! Options and reports as JSON, in the form of the HTTP API.

use meshmend::analyze::AnalyzeOptions;
use meshmend::options::{OptionsInJson, ReadOptionsError, read_options};
use meshmend::repair::Options;
use pyo3::prelude::*;

use serde::Serialize;

use crate::errors::{Failure, option_error};

fn read<T: OptionsInJson>(json: &str) -> PyResult<T> {
    let fields = serde_json::from_str(json).map_err(|error| option_error("options", &error.to_string()))?;
    read_options(fields).map_err(|error: ReadOptionsError| option_error(error.option(), &error.to_string()))
}

/// The checked options of a repair.
pub fn repair_options(json: &str) -> PyResult<Options> {
    read(json)
}

/// The checked options of an inspection.
pub fn inspect_options(json: &str) -> PyResult<AnalyzeOptions> {
    read(json)
}

/// A report with its mode, as the HTTP API has it.
#[derive(Serialize)]
struct WithMode<'a, T> {
    mode: &'static str,
    #[serde(flatten)]
    report: &'a T,
}

/// A report as the HTTP API has it.
pub fn report_as_json(mode: &'static str, report: &impl Serialize) -> PyResult<String> {
    as_json(&WithMode { mode, report })
}

/// A value as JSON.
pub fn as_json(value: &impl Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|error| Failure::Other(error.to_string()).into_exception(None, false))
}
