//! The assessment of a returned file against the rules of a printing process.

use super::input::RepairError;
use crate::analyze::subject;
use crate::context::Context;
use crate::format::{self, Limits, ReadOptions};
use crate::inspect::{Analysis, measure_analysis};
use crate::printing::profile::Profile;
use crate::printing::readiness::{AssessedFile, PrintReadiness, assess};
use crate::scene::LengthUnit;

/// Reads a written file back and assesses it. Lengths are in `unit`. Returns `None` if there is no time left.
///
/// # Errors
/// [`RepairError`] if the job was canceled or the file cannot be read back.
pub(super) fn assess_output(
    bytes: &[u8],
    unit: &LengthUnit,
    profile: &Profile,
    context: &Context<'_>,
) -> Result<Option<PrintReadiness>, RepairError> {
    let mut file = format::read_shape(bytes, &ReadOptions::within(Limits::NONE))?;
    file.settle_unit(file.own_unit().is_none().then_some(unit.used), Some(unit.used));
    let assessed = || {
        let analysis = Analysis::new(subject(&file.mesh, Some(unit)), context)?;
        let measures = measure_analysis(&analysis, context)?;
        let assessed = AssessedFile { analysis: &analysis, measures: &measures, bytes: bytes.len() as u64 };
        assess(assessed, profile, context)
    };
    Ok(context.unless_late(assessed())?)
}
