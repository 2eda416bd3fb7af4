//! The pictures and coloured meshes of a repair, drawn from the bytes of the input and of the returned file.

use std::time::Duration;

use super::judge::inspect_measured;
use super::options::Options;
use super::report::{OfferedFile, Report};
use super::size::settle_size;
use crate::analyze::{DrawError, subject};
use crate::context::Context;
use crate::format::{self, Limits, ReadOptions};
use crate::inspect::{Analysis, CompareOptions, Original};
use crate::mesh::Soup;
use crate::printing::thickness::{Space, thickness_field};
use crate::render::{self, Drawing, Marked, draw_change, draw_remaining, draw_repaired, draw_thickness};
use crate::scene::LengthUnit;

impl Report {
    /// The names of the drawings that [`draw`] makes of the input and of the returned file.
    #[must_use]
    pub fn drawings(&self) -> Vec<&'static str> {
        let offered_file = match self.verdict.file {
            OfferedFile::Model => self.after.as_ref(),
            OfferedFile::Original => Some(self.after.as_ref().unwrap_or(&self.before)),
            OfferedFile::None => None,
        };
        let mut names =
            render::names_of_repair(self.before.measures.faces, offered_file.map(|after| after.measures.faces));
        if offered_file.is_some() && self.verdict.passes && self.options.print.wall_limit_mm().is_some() {
            names.extend(render::THICKNESS);
        }
        if offered_file.is_some() && !self.verdict.passes {
            names.push(render::REMAINING);
        }
        names
    }
}

/// Draws the defects of the input, the defects of the repaired file, and the changes of the surface. Both files are read again, so the
/// drawings show exactly their contents. The time limit is that of the repair, `deadline_s`.
///
/// # Errors
/// [`DrawError`] if a file cannot be read, a drawing fails, or the time is over. The repaired file stays valid.
pub fn draw(
    input: &[u8],
    repaired: Option<&[u8]>,
    options: &Options,
    limits: &Limits,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, DrawError> {
    let context = &context.limited_to(Duration::from_secs_f64(options.deadline_s));
    with_input(input, (options, limits), context, |before| {
        let draw_both = |after: &Analysis<'_>, repaired: Marked<'_>, is_printable: bool| {
            let mut drawings = draw_repaired(before.marked, Some(repaired), context)?;
            drawings.extend(draw_change(repaired.soup, &before.original.provenance(after, context)?, context)?);
            match options.print.wall_limit_mm() {
                _ if !is_printable => drawings.push(draw_remaining(repaired, context)?),
                Some(limit_mm) => drawings.extend(draw_walls(after, repaired.soup, limit_mm, context)?),
                None => {}
            }
            Ok(drawings)
        };
        match repaired {
            None => Ok(draw_repaired(before.marked, None, context)?),
            Some(bytes) if bytes == input => draw_both(before.analysis, before.marked, before.is_printable),
            Some(bytes) => with_result(bytes, (options, before), context, draw_both),
        }
    })
}

/// Draws the result of an alternative: `after.png`, and `change.glb`, which is coarse for a large model. `report` is the report of the
/// alternative, and `limits` are those of its repair.
///
/// # Errors
/// [`DrawError`] if a file cannot be read, a drawing fails, or the time is over.
pub fn draw_alternative(
    input: &[u8],
    repaired: &[u8],
    report: &Report,
    limits: &Limits,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, DrawError> {
    let options = &report.options;
    with_input(input, (options, limits), context, |before| {
        with_result(repaired, (options, before), context, |after, marked, _| {
            Ok(render::draw_alternative(marked, &before.original.provenance(after, context)?, context)?)
        })
    })
}

/// The input of a repair, read and inspected.
struct InspectedInput<'a> {
    unit: &'a LengthUnit,
    analysis: &'a Analysis<'a>,
    marked: Marked<'a>,
    original: Original<'a>,
    is_printable: bool,
}

/// Reads and inspects the input of a repair with these options and limits.
fn with_input<T>(
    bytes: &[u8],
    (options, limits): (&Options, &Limits),
    context: &Context<'_>,
    draw: impl FnOnce(&InspectedInput<'_>) -> Result<T, DrawError>,
) -> Result<T, DrawError> {
    context.check()?;
    let mut file = format::read_shape(bytes, &reading(options, *limits))?;
    // The repair refuses a file that cannot be scaled, so this cannot fail here.
    let (unit, _) = settle_size(&mut file, options).unwrap_or_default();
    let analysis = Analysis::new(subject(&file.mesh, Some(&unit)), context)?;
    let (inspection, findings) = inspect_measured(&analysis, context)?;
    draw(&InspectedInput {
        unit: &unit,
        analysis: &analysis,
        marked: Marked { soup: &file.mesh.soup, findings: &findings },
        original: Original::new(&analysis, &inspection.measures, CompareOptions::BRIEF),
        is_printable: inspection.measures.printable(),
    })
}

/// Reads and inspects the result of a repair, and passes on its analysis, its marked mesh, and whether it is printable.
fn with_result<T>(
    bytes: &[u8],
    (options, before): (&Options, &InspectedInput<'_>),
    context: &Context<'_>,
    draw: impl FnOnce(&Analysis<'_>, Marked<'_>, bool) -> Result<T, DrawError>,
) -> Result<T, DrawError> {
    let &LengthUnit { used, up, .. } = before.unit;
    let mesh = format::read_shape(bytes, &reading(options, Limits::NONE))?.mesh_in(used, up);
    let after = Analysis::new(subject(&mesh, Some(before.unit)), context)?;
    let (inspection, findings) = inspect_measured(&after, context)?;
    draw(&after, Marked { soup: &mesh.soup, findings: &findings }, inspection.measures.printable())
}

fn reading(options: &Options, limits: Limits) -> ReadOptions {
    ReadOptions { limits, twist_angle_deg: options.twist_angle_deg }
}

/// Draws the wall thickness of a printable result. `soup` has the faces of its file.
fn draw_walls(
    after: &Analysis<'_>,
    soup: &Soup,
    limit_mm: f64,
    context: &Context<'_>,
) -> Result<Vec<Drawing>, DrawError> {
    let field = thickness_field(&after.surface, Space::Material, context)?;
    let mut of_face = vec![f32::INFINITY; soup.faces.len()];
    for (&source, &value) in after.surface.source.iter().zip(&field.at_faces) {
        of_face[source as usize] = value;
    }
    let mm = after.facts.unit.map_or(1.0, |unit| unit.used.millimetres());
    Ok(draw_thickness(soup, &of_face, [limit_mm / mm, mm], context)?)
}
