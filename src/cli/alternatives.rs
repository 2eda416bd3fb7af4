//! The files of `--alternatives`: each further result is written beside the output file.

use std::io::Write;
use std::path::{Path, PathBuf};

use meshmend::repair::{
    Alternative, AlternativeRequest, AlternativeRuns, Alternatives, RepairError, Repaired, RepairedAlternative,
    draw_alternative, name_for_choice,
};

use super::engine::write_file;

/// Makes the alternatives of a repair, and writes each one beside `output`, as `OUT.ID.ext`. Adds the list of alternatives to the report
/// of `default`. With `pictures`, the drawings of each alternative are written to that folder, as `after-ID.png` and `change-ID.glb`.
///
/// # Errors
/// The message for the first file that cannot be written, or for a canceled repair.
pub fn write_alternatives(
    request: AlternativeRequest<'_>,
    default: &mut Repaired,
    output: &Path,
    pictures: Option<&Path>,
) -> Result<(), String> {
    let text = |error: RepairError| error.to_string();
    let mut runs = AlternativeRuns::new(request, default).map_err(text)?;
    while let Some(RepairedAlternative { id, repaired }) = runs.make_next().map_err(text)? {
        write_file(&path_of(output, &id), &repaired.bytes)?;
        if let Some(folder) = pictures {
            std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
            let AlternativeRequest { input, limits, context, .. } = request;
            match draw_alternative(input, &repaired.bytes, &repaired.report, limits, context) {
                Ok(drawings) => drawings.iter().try_for_each(|drawing| {
                    write_file(&folder.join(name_for_choice(drawing.name, &id)), &drawing.bytes)
                })?,
                Err(error) => drop(writeln!(std::io::stderr(), "  note: {id}: no picture was drawn: {error}")),
            }
        }
    }
    default.report.alternatives = Some(runs.summary());
    Ok(())
}

/// The path of an alternative: the path of the output file, with the id before the extension.
pub fn path_of(output: &Path, id: &str) -> PathBuf {
    let extension = output.extension().unwrap_or_default().to_string_lossy();
    output.with_extension(format!("{id}.{extension}"))
}

/// The lines of the summary about alternatives: those that are offered, with the path of each that was written, and those that are not.
pub fn alternative_lines(alternatives: &Alternatives, path: impl Fn(&str) -> Option<PathBuf>) -> Vec<String> {
    let offered = alternatives.offered.iter().filter(|offered| !offered.is_default);
    let mut lines: Vec<String> = offered
        .map(|offered| {
            let name = path(&offered.id).map_or_else(|| offered.id.clone(), |path| path.display().to_string());
            format!("  alternative: {name}: {} {}", offered.detail, figures(offered))
        })
        .collect();
    if lines.is_empty() {
        lines.push("  no alternatives: the file leaves no question open, or no other result can be used".to_owned());
    }
    let not_offered = alternatives.not_offered.iter();
    lines.extend(not_offered.map(|answer| format!("  not offered: {}: {}", answer.option, answer.reason)));
    lines
}

/// The volume, the parts and the weight of an alternative.
fn figures(offered: &Alternative) -> String {
    let volume = offered.volume_mm3.map_or_else(|| "unknown volume".to_owned(), |mm3| format!("{:.3} cm³", mm3 / 1e3));
    let parts = if offered.parts == 1 { "1 part".to_owned() } else { format!("{} parts", offered.parts) };
    let weight = offered.weight_g.map(|grams| format!(", {grams:.1} g")).unwrap_or_default();
    format!("({volume}, {parts}{weight})")
}
