use std::time::Duration;

use super::Repaired;
use crate::context::{Cancelled, Context};
use crate::format::{self, Limits, ReadError, ReadOptions};
use crate::render::{Drawing, Marked, RenderError, draw_change, draw_repaired};

/// Why a repair could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum DrawError {
    /// A file can't be read, which should not be once it was repaired.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The work was asked to stop, or its time ran out.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The drawing itself.
    #[error(transparent)]
    Render(#[from] RenderError),
}

/// Draws what was wrong with a file, what is wrong with its repaired one, and what became of its surface, all read from the
/// bytes of both, so that the drawings show what those hold.
///
/// # Errors
/// [`DrawError`]; the repaired file is good all the same.
pub fn draw(
    input: &[u8],
    repaired: &Repaired,
    limits: &Limits,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, DrawError> {
    // The deadline of the repair is that of its drawings too.
    let left = Duration::from_secs_f64(repaired.report.options.deadline_s)
        .saturating_sub(Duration::try_from_secs_f64(repaired.report.milliseconds / 1e3).unwrap_or_default());
    let context = &context.limited_to(left);
    context.check()?;
    let (unit, up) = (&repaired.report.unit, repaired.report.unit.up);
    let reading = |limits| ReadOptions { limits, twist_angle_deg: repaired.report.options.twist_angle_deg };
    let mut file = format::read_shape(input, &reading(*limits))?;
    file.settle_unit(repaired.report.options.unit, repaired.report.options.scale_to);
    let read = file.mesh.soup;
    let before = Marked { soup: &read, findings: &repaired.found_before };
    let after = match &repaired.found_after {
        Some(findings) => {
            Some((format::read_shape(&repaired.bytes, &reading(Limits::NONE))?.mesh_in(unit.used, up), findings))
        }
        None => None,
    };
    let unchanged = (repaired.bytes == input).then_some(before);
    let after = after.as_ref().map(|(soup, findings)| Marked { soup, findings });
    let shown = after.or(unchanged);
    let mut drawings = draw_repaired(before, shown, context)?;
    if let (Some(shown), Some(fates)) = (shown, &repaired.fates) {
        drawings.extend(draw_change(shown.soup, fates, context)?);
    }
    Ok(drawings)
}
