use super::task::Task;
use crate::format::Format;
use crate::repair::Report;

/// A file that a child may leave and a job then offers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Offered {
    /// Its name in the scratch folder, which is the artifact's.
    pub name: &'static str,
    /// The name to save it under.
    pub filename: String,
    pub media_type: &'static str,
}

/// What is told of the file whose name and format the report says, the model, comes from there; the others are these.
const BESIDE_THE_MODEL: [(&str, &str); 6] = [
    (Task::LOG, "text/plain; charset=utf-8"),
    (Task::REPORT, "application/json"),
    ("before.png", "image/png"),
    ("after.png", "image/png"),
    ("defects.glb", "model/gltf-binary"),
    ("defects.ply", "application/octet-stream"),
];

/// Every name that an attempt may have stored a file under.
pub(super) fn names() -> impl Iterator<Item = &'static str> {
    std::iter::once(Task::MODEL).chain(BESIDE_THE_MODEL.map(|(name, _)| name))
}

/// What a job on a file of this name offers, as far as the child left it: after a failure the log only.
pub(super) fn offered(input: &str, report: Option<&Report>) -> Vec<Offered> {
    let stem = stem(input);
    let beside = BESIDE_THE_MODEL
        .into_iter()
        .filter(|(name, _)| report.is_some() || *name == Task::LOG)
        .map(|(name, media_type)| Offered { name, filename: format!("{stem}-{name}"), media_type });
    let model = report.and_then(|report| report.output.as_ref()).map(|output| Offered {
        name: Task::MODEL,
        filename: format!("{stem}-repaired.{}", extension(output.format)),
        media_type: media_type(output.format),
    });
    beside.chain(model).collect()
}

/// A file name without its ending.
fn stem(name: &str) -> &str {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    if stem.is_empty() { "model" } else { stem }
}

fn extension(format: Format) -> &'static str {
    match format {
        Format::Stl => "stl",
        Format::Obj => "obj",
        Format::Ply => "ply",
        Format::Off => "off",
    }
}

fn media_type(format: Format) -> &'static str {
    match format {
        Format::Stl => "model/stl",
        Format::Obj => "model/obj",
        Format::Ply | Format::Off => "application/octet-stream",
    }
}
