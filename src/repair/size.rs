//! The size of a model: its unit, the scale that the options ask for, and other units that the file may have.

use super::options::{Options, PrintOptions};
use crate::format::ReadFile;
use crate::inspect::{Inspection, OptionsError};
use crate::math::Box3;
use crate::printing::target_size::{TargetSize, scale_to_target};
use crate::printing::unit_candidates::{FileEvidence, UnitCandidates, units_in_doubt};
use crate::scene::{LengthUnit, Unit, UnitSource, Up};

/// Settles the unit of a file's lengths, and scales the model to the size that the options ask for. Returns the unit and the
/// scale factor, which is 1 without such a request. With such a request the unit counts as declared.
///
/// # Errors
/// [`OptionsError`] if the model has no extent in the direction that the option measures.
pub(super) fn settle_size(file: &mut ReadFile, options: &Options) -> Result<(LengthUnit, f64), OptionsError> {
    let Some((option, target)) = target_of(&options.print) else {
        return Ok((file.settle_unit(options.unit, options.scale_to), 1.0));
    };
    // The model gets its size from the target, so an implausible size in the assumed unit needs no warning.
    let declared = options.unit.or_else(|| file.own_unit().is_none().then_some(Unit::Millimetre));
    let unit = file.settle_unit(declared, options.scale_to);
    let finite = file.mesh.soup.positions.iter().copied().filter(|p| p.is_finite());
    let factor = scale_to_target(&Box3::of(finite), unit.used, unit.up.unwrap_or(Up::Z), target);
    let factor = factor.map_err(|error| OptionsError {
        option,
        value: error.to_string(),
        expected: "a size that the model can be scaled to",
    })?;
    file.scale(factor);
    let unit = LengthUnit { source: UnitSource::Declared, note: None, ..unit };
    file.unit = Some(unit.clone());
    Ok((unit, factor))
}

/// The size that the options ask for, with the option's name.
fn target_of(options: &PrintOptions) -> Option<(&'static str, TargetSize)> {
    let height = options.target_height_mm.map(|height| ("target_height_mm", TargetSize::HeightMm(height)));
    height.or_else(|| options.target_longest_mm.map(|longest| ("target_longest_mm", TargetSize::LongestMm(longest))))
}

/// The units that the file may have, ranked; `None` if the unit is known and plausible.
pub(super) fn other_units(
    inspection: &Inspection,
    unit: &LengthUnit,
    options: &Options,
    file: &FileEvidence,
) -> Option<UnitCandidates> {
    let printed = options.print.profile().and_then(|profile| profile.build_volume_mm);
    units_in_doubt(inspection, unit, file, printed.map(|volume| volume.size))
}
