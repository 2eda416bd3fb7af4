use std::path::Path;

use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use super::patience::patiently;
use super::pool::Pool;
use super::task::Task;
use crate::blobs::{BlobError, Blobs, Stored};
use crate::format::Format;
use crate::jobs::{Artifact, Artifacts, Input, Job, JobReport, Lease, StoredFile};
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
    pub media_type: String,
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

/// The pictures of a job on these files, which are drawn when somebody asks for them.
pub(super) fn pictures(inputs: &[Input], report: &JobReport) -> Artifacts {
    let picture = |(number, name): (usize, &'static str)| {
        let (_, media_type) = OF_EACH_FILE.into_iter().find(|&(known, _)| known == name)?;
        let filename = format!("{}-{name}", inputs.get(number)?.stem());
        Some((of_file(number, name), Artifact { filename, media_type: media_type.to_owned(), file: None }))
    };
    report.drawings().into_iter().filter_map(picture).collect()
}

/// The pictures of a job that are not drawn yet, as a child may leave them.
pub(super) fn undrawn(job: &Job) -> Vec<Offered> {
    let waiting = job.artifacts.iter().filter(|(_, artifact)| artifact.file.is_none());
    let offered = |(name, artifact): (&String, &Artifact)| Offered {
        name: name.clone(),
        source: name.clone(),
        filename: artifact.filename.clone(),
        media_type: artifact.media_type.clone(),
    };
    waiting.map(offered).collect()
}

/// What a job on these files offers beside its pictures, as far as the child left it: after a failure the log only.
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
            media_type: media_type(input.format).to_owned(),
        }),
        (HandedOut::None, _) => None,
    });
    once.chain(handed_out).collect()
}

impl Offered {
    /// A file that the child leaves under the artifact's name.
    fn new(name: String, filename: String, media_type: &str) -> Self {
        Self { source: name.clone(), name, filename, media_type: media_type.to_owned() }
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

impl Pool {
    /// Copies a job's files into the scratch folder.
    pub(super) async fn fetch_inputs(&self, job: &Job, folder: &Path) -> Result<(), BlobError> {
        for (number, input) in job.inputs.iter().enumerate() {
            let path = folder.join(Task::input(number));
            let fetch = patiently(None, || self.blobs.fetch(&input.key, &input.sha256, &path));
            fetch.instrument(tracing::info_span!("fetch", bytes = input.bytes)).await?;
        }
        Ok(())
    }

    /// Stores those files that are there under the hold's own keys, where nobody sees them yet.
    pub(super) async fn store_files(
        &self,
        held: &Lease,
        folder: &Path,
        files: Vec<Offered>,
        over: &CancellationToken,
    ) -> Result<Artifacts, BlobError> {
        let key = |name: &str| Blobs::artifact_key(held.id, &held.token, name);
        let places: Vec<_> = files.iter().map(|file| (key(&file.name), folder.join(&file.source))).collect();
        let stored = patiently(Some(over), || self.blobs.put_files(&places)).await?;
        let artifact = |(Offered { name, filename, media_type, .. }, stored): (Offered, Option<Stored>)| {
            let Stored { bytes, sha256, .. } = stored?;
            let file = Some(StoredFile { key: key(&name), bytes, sha256 });
            Some((name, Artifact { filename, media_type, file }))
        };
        Ok(files.into_iter().zip(stored).filter_map(artifact).collect())
    }

    /// Removes what was stored under a hold that was lost.
    pub(super) async fn drop_files(&self, held: &Lease) {
        if let Err(error) = self.blobs.delete_claim(held.id, &held.token).await {
            tracing::warn!(%error, "files of a lost hold were left");
        }
    }
}
