use std::time::Duration;

use super::judge::inspect_measured;
use super::options::Options;
use super::report::{OfferedFile, Report};
use crate::analyze::{DrawError, subject};
use crate::context::Context;
use crate::format::{self, Limits, ReadOptions};
use crate::inspect::{Analysis, CompareOptions, Original};
use crate::render::{self, Drawing, Marked, draw_change, draw_remaining, draw_repaired};

impl Report {
    /// The names of the drawings that [`draw`] makes of the input and the file that is handed out.
    #[must_use]
    pub fn drawings(&self) -> Vec<&'static str> {
        let offered_file = match self.verdict.file {
            OfferedFile::Model => self.after.as_ref(),
            OfferedFile::Original => Some(self.after.as_ref().unwrap_or(&self.before)),
            OfferedFile::None => None,
        };
        let mut names =
            render::names_of_repair(self.before.measures.faces, offered_file.map(|after| after.measures.faces));
        if offered_file.is_some() && !self.verdict.passes {
            names.push(render::REMAINING);
        }
        names
    }
}

/// Draws what is wrong with a file, what is wrong with its repaired one, and what became of its surface, all read from the
/// bytes of both, so that the drawings show what those hold. They may take as long as the repair.
///
/// # Errors
/// [`DrawError`]; the repaired file is good all the same.
pub fn draw(
    input: &[u8],
    repaired: Option<&[u8]>,
    options: &Options,
    limits: &Limits,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, DrawError> {
    let context = &context.limited_to(Duration::from_secs_f64(options.deadline_s));
    context.check()?;
    let reading = |limits| ReadOptions { limits, twist_angle_deg: options.twist_angle_deg };
    let mut file = format::read_shape(input, &reading(*limits))?;
    let unit = file.settle_unit(options.unit, options.scale_to);
    let analysis = Analysis::new(subject(&file.mesh, Some(&unit)), context)?;
    let (inspection, findings) = inspect_measured(&analysis, context)?;
    let before = Marked { soup: &file.mesh.soup, findings: &findings };
    let original = Original::new(&analysis, &inspection.measures, CompareOptions::BRIEF);
    let draw_both = |after: &Analysis<'_>, found: Marked<'_>, is_printable: bool| {
        let mut drawings = draw_repaired(before, Some(found), context)?;
        drawings.extend(draw_change(found.soup, &original.provenance(after, context)?, context)?);
        if !is_printable {
            drawings.push(draw_remaining(found, context)?);
        }
        Ok(drawings)
    };
    match repaired {
        None => Ok(draw_repaired(before, None, context)?),
        Some(bytes) if bytes == input => draw_both(&analysis, before, inspection.measures.printable()),
        Some(bytes) => {
            let mesh = format::read_shape(bytes, &reading(Limits::NONE))?.mesh_in(unit.used, unit.up);
            let after = Analysis::new(subject(&mesh, Some(&unit)), context)?;
            let (inspection, findings) = inspect_measured(&after, context)?;
            draw_both(&after, Marked { soup: &mesh.soup, findings: &findings }, inspection.measures.printable())
        }
    }
}
