//! The inspection of one model or several.

use meshmend::analyze::Analyst;
use pyo3::prelude::*;

use crate::call::Settings;
use crate::model::Model;
use crate::options::{inspect_options, report_as_json};

/// Inspects models with options in JSON, and returns the report as JSON.
#[pyfunction]
pub fn inspect(py: Python<'_>, models: Vec<Model>, options: &str, settings: &Settings) -> PyResult<String> {
    let options = inspect_options(options)?;
    let report = settings.run(py, Some(options.deadline_s), |context| {
        let mut analyst = Analyst::new(&options, &settings.limits, models.len(), context)?;
        for model in &models {
            analyst.add(&model.0, None, &model.read(&settings.limits)?)?;
        }
        Ok(analyst.finish()?)
    })?;
    report_as_json("analyze", &report)
}
