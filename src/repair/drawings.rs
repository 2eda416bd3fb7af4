use std::time::Duration;

use super::Repaired;
use crate::context::{Cancelled, Context};
use crate::format::{self, Limits, ReadError};
use crate::inspect::{Findings, InspectOptions, Subject, inspect};
use crate::mesh::Soup;
use crate::render::{Drawing, Marked, RenderError, draw_repaired};

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

/// Draws what was wrong with a file and what is wrong with its repaired one: both are read and inspected for this, so
/// that the drawings show what the bytes hold, whatever the repair believed.
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
    let before = Looked::at(input, limits, context)?;
    let ours = Limits { max_bytes: u64::MAX, max_faces: u64::MAX, max_vertices: u64::MAX };
    let other = !repaired.bytes.is_empty() && repaired.bytes != input;
    let after = if other { Some(Looked::at(&repaired.bytes, &ours, context)?) } else { None };
    let unchanged = (repaired.bytes == input).then_some(&before);
    Ok(draw_repaired(before.marked(), after.as_ref().or(unchanged).map(Looked::marked), context)?)
}

/// A file that was read and inspected.
struct Looked {
    soup: Soup,
    findings: Findings,
}

impl Looked {
    fn at(bytes: &[u8], limits: &Limits, context: &Context<'_>) -> Result<Self, DrawError> {
        let soup = format::read(bytes, limits)?.soup;
        let (_, findings) = inspect(Subject::from(&soup), &InspectOptions::default(), context)?;
        Ok(Self { soup, findings })
    }

    fn marked(&self) -> Marked<'_> {
        Marked { soup: &self.soup, findings: &self.findings }
    }
}
