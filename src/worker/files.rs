use super::task::Task;
use crate::format::Format;
use crate::jobs::{Input, JobReport};
use crate::repair::HandedOut;

/// A file that a child may leave and a job then offers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Offered {
    /// The artifact's name.
    pub name: String,
    /// Its name in the scratch folder.
    pub source: String,
    /// The name to save it under.
    pub filename: String,
    pub media_type: &'static str,
}

/// What a job may offer once, whatever its mode, but for the file that it hands out, which the report's verdict says.
const OF_THE_JOB: [(&str, &str); 3] = [
    (Task::LOG, "text/plain; charset=utf-8"),
    (Task::REPORT, "application/json"),
    (Task::FULL_REPORT, "application/json"),
];

/// What it may offer of each of its files.
const OF_EACH_FILE: [(&str, &str); 11] = [
    ("before.png", "image/png"),
    ("after.png", "image/png"),
    ("defects.png", "image/png"),
    ("defects.glb", "model/gltf-binary"),
    ("defects.ply", "application/octet-stream"),
    ("defects-preview.glb", "model/gltf-binary"),
    ("remaining.glb", "model/gltf-binary"),
    ("change.png", "image/png"),
    ("change.glb", "model/gltf-binary"),
    ("change.ply", "application/octet-stream"),
    ("change-preview.glb", "model/gltf-binary"),
];

/// What a drawing of the job's file `number`, counted from 0, is called: as it is for the first, `2-defects.png` and so
/// on for the others.
pub(super) fn of_file(number: usize, name: &str) -> String {
    if number == 0 { name.to_owned() } else { format!("{}-{name}", number + 1) }
}

/// Every name that an attempt at a job of so many files may have stored a file under.
pub(super) fn names(files: usize) -> Vec<String> {
    let once = [Task::MODEL, Task::ORIGINAL].into_iter().chain(OF_THE_JOB.map(|(name, _)| name)).map(str::to_owned);
    let each = (0..files).flat_map(|number| OF_EACH_FILE.map(|(name, _)| of_file(number, name)));
    once.chain(each).collect()
}

/// What a job on these files offers, as far as the child left it: after a failure the log only.
pub(super) fn offered(inputs: &[Input], report: Option<&JobReport>) -> Vec<Offered> {
    let first = inputs.first().map_or("model", Input::stem);
    let once = OF_THE_JOB
        .into_iter()
        .filter(|(name, _)| report.is_some() || *name == Task::LOG)
        .map(|(name, media_type)| Offered::new(name.to_owned(), format!("{first}-{name}"), media_type));
    let handed_out = report.and_then(|report| match report.handed_out() {
        (HandedOut::Model, format) => format.map(|format| {
            let filename = format!("{first}-repaired.{}", format.extension());
            Offered::new(Task::MODEL.to_owned(), filename, media_type(format))
        }),
        (HandedOut::Original, _) => inputs.first().map(|input| Offered {
            name: Task::ORIGINAL.to_owned(),
            source: Task::input(0),
            filename: input.name.clone(),
            media_type: media_type(input.format),
        }),
        (HandedOut::None, _) => None,
    });
    let drawn = inputs.iter().enumerate().filter(|_| report.is_some()).flat_map(|(number, input)| {
        let stem = input.stem();
        OF_EACH_FILE.map(|(name, media_type)| Offered::new(of_file(number, name), format!("{stem}-{name}"), media_type))
    });
    once.chain(handed_out).chain(drawn).collect()
}

impl Offered {
    /// A file that the child leaves under the artifact's name.
    fn new(name: String, filename: String, media_type: &'static str) -> Self {
        Self { source: name.clone(), name, filename, media_type }
    }
}

fn media_type(format: Format) -> &'static str {
    match format {
        Format::Stl => "model/stl",
        Format::Obj => "model/obj",
        Format::Glb => "model/gltf-binary",
        Format::ThreeMf => "model/3mf",
        Format::Zip => "application/zip",
        Format::Ply | Format::Off | Format::Mesh => "application/octet-stream",
    }
}
