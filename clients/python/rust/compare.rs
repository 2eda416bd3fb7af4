//! The comparison of two models.

use meshmend::context::Context;
use meshmend::format::{self, ReadMesh};
use meshmend::inspect::{Analysis, CompareOptions, Comparison, Measures, Original, measures};
use pyo3::prelude::*;
use serde::Serialize;

use crate::call::Settings;
use crate::errors::{Failure, option_error};
use crate::model::Model;
use crate::options::as_json;

/// The allowed numbers of samples, as in the command line.
const SAMPLES: std::ops::RangeInclusive<u32> = 100..=10_000_000;

/// A compared model.
#[derive(Serialize)]
struct Side {
    format: format::Format,
    dialect: String,
    measures: Measures,
    warnings: Vec<String>,
}

/// The comparison and both models.
#[derive(Serialize)]
struct Report {
    before: Side,
    after: Side,
    comparison: Comparison,
}

/// Compares two models, and returns the report as JSON. By default the number of samples is that of the command line.
#[pyfunction]
pub fn compare(
    py: Python<'_>,
    models: (Model, Model),
    samples: Option<u32>,
    deadline_s: Option<f64>,
    settings: &Settings,
) -> PyResult<String> {
    let samples = samples.unwrap_or(CompareOptions::default().samples);
    if !SAMPLES.contains(&samples) {
        let message = format!("`samples` must be from {} to {}; got {samples}.", SAMPLES.start(), SAMPLES.end());
        return Err(option_error("samples", &message));
    }
    if deadline_s.is_some_and(|seconds| !(1.0..=3600.0).contains(&seconds)) {
        return Err(option_error("deadline_s", "`deadline_s` must be from 1 to 3600 seconds."));
    }
    let options = CompareOptions { samples, vertices: samples, inside: samples };
    let report = settings.run(py, deadline_s, |context| {
        let read = |model: &Model| -> Result<ReadMesh, Failure> {
            let bytes = model.read(&settings.limits)?;
            format::read(&bytes, &settings.limits).map_err(|error| Failure::Read(model.0.clone(), error))
        };
        measure([read(&models.0)?, read(&models.1)?], options, context)
    })?;
    as_json(&report)
}

/// Measures both models and compares them.
fn measure([before, after]: [ReadMesh; 2], options: CompareOptions, context: &Context<'_>) -> Result<Report, Failure> {
    let (measured, measured_after, comparison) = {
        let before = Analysis::new((&before.soup).into(), context)?;
        let after = Analysis::new((&after.soup).into(), context)?;
        let (measured, measured_after) = (measures(&before, context)?, measures(&after, context)?);
        let comparison = Original::new(&before, &measured, options).compare(&after, &measured_after, context)?;
        (measured, measured_after, comparison)
    };
    let side = |mesh: ReadMesh, measures| Side {
        format: mesh.format,
        dialect: mesh.dialect,
        measures,
        warnings: mesh.warnings,
    };
    Ok(Report { before: side(before, measured), after: side(after, measured_after), comparison })
}
