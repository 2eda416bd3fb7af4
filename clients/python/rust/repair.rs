//! The repair of one model.

use std::path::PathBuf;

use meshmend::repair::{
    AlternativeRequest, AlternativeRuns, OfferedFile, Remesher, RepairError, Repaired as RepairedFile,
    RepairedAlternative, repair as repair_file,
};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::call::Settings;
use crate::errors::{Failure, json_name};
use crate::model::Model;
use crate::options::{repair_options, report_as_json};

/// A repaired file and its report.
#[pyclass(frozen, module = "meshmend._engine")]
pub struct Repaired(RepairedFile);

#[pymethods]
impl Repaired {
    /// The file; empty if the repair returns none.
    fn bytes<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, &self.0.bytes)
    }

    /// The file's format; none if the repair returns no file.
    #[getter]
    fn format(&self) -> Option<String> {
        (self.0.report.verdict.file != OfferedFile::None).then(|| json_name(self.0.format))
    }

    /// The report as JSON.
    fn report(&self) -> PyResult<String> {
        report_as_json("repair", &self.0.report)
    }
}

/// Repairs a model with options in JSON. `blender` is a program for tier 3, or an empty path to look for one; without it tiers 1 and 2 run.
/// With the option `alternatives`, also returns the alternatives, each with its id.
#[pyfunction]
pub fn repair(
    py: Python<'_>,
    model: Model,
    options: &str,
    blender: Option<PathBuf>,
    settings: &Settings,
) -> PyResult<(Repaired, Vec<(String, Repaired)>)> {
    let options = &repair_options(options)?;
    let remesher = remesher(blender);
    let (repaired, alternatives) = settings.run(py, Some(options.deadline_s), |context| {
        let input = &model.read(&settings.limits)?;
        let limits = &settings.limits;
        let remesher = remesher.as_deref().map(|remesher| -> &dyn Remesher { remesher });
        let failure = |error| Failure::of_repair(&model.0, error);
        let mut repaired = repair_file(input, options, limits, remesher, context).map_err(failure)?;
        let request = AlternativeRequest { input, options, limits, remesher, context };
        let alternatives =
            if options.alternatives { alternatives_to(&mut repaired, request).map_err(failure)? } else { Vec::new() };
        Ok((repaired, alternatives))
    })?;
    let alternatives = alternatives.into_iter().map(|RepairedAlternative { id, repaired }| (id, Repaired(repaired)));
    Ok((Repaired(repaired), alternatives.collect()))
}

/// Makes the alternatives of a repair, and lists them in its report.
fn alternatives_to(
    default: &mut RepairedFile,
    request: AlternativeRequest<'_>,
) -> Result<Vec<RepairedAlternative>, RepairError> {
    let mut runs = AlternativeRuns::new(request, default)?;
    let mut all = Vec::new();
    while let Some(alternative) = runs.make_next()? {
        all.push(alternative);
    }
    default.report.alternatives = Some(runs.summary());
    Ok(all)
}

#[cfg(target_os = "linux")]
fn remesher(blender: Option<PathBuf>) -> Option<Box<dyn Remesher + Sync>> {
    use meshmend::blender::{BlenderConfig, OnDemandBlender};

    let program = Some(blender?).filter(|program| !program.as_os_str().is_empty());
    Some(Box::new(OnDemandBlender::new(BlenderConfig { program, ..BlenderConfig::default() })))
}

/// The engine runs Blender on Linux only.
#[cfg(not(target_os = "linux"))]
fn remesher(_: Option<PathBuf>) -> Option<Box<dyn Remesher + Sync>> {
    None
}
