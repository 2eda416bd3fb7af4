//! The files of a job: which ones a child may leave, and their way between the scratch folder and the file store.

use std::path::Path;

use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use super::context::{WorkerContext, retry_with_backoff};
use super::task::Task;
use crate::blobs::{BlobError, Blobs, Stored};
use crate::format::Format;
use crate::jobs::{Artifact, Artifacts, Input, Job, JobReport, Lease, StoredFile};
use crate::repair::{ALTERNATIVE_DRAWINGS, OfferedFile, name_for_choice};

/// A file that a child may leave in the scratch folder, to be stored as an artifact of the job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ArtifactSource {
    /// The artifact's name.
    pub name: String,
    /// The file's name in the scratch folder.
    pub source: String,
    /// The name for the download.
    pub filename: String,
    /// The media type.
    pub media_type: String,
}

/// The artifacts of every job, of either mode. The report's verdict says whether there is a model besides.
const JOB_ARTIFACTS: [(&str, &str); 3] = [
    (Task::LOG, "text/plain; charset=utf-8"),
    (Task::REPORT, "application/json"),
    (Task::FULL_REPORT, "application/json"),
];

/// The artifacts of each of a job's files.
const FILE_ARTIFACTS: [(&str, &str); 14] = [
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
    ("thickness.png", "image/png"),
    ("thickness.glb", "model/gltf-binary"),
    ("thickness.ply", "application/octet-stream"),
];

/// The pictures of a job on `inputs`, as artifacts that are not drawn yet.
pub(super) fn pictures(inputs: &[Input], report: &JobReport) -> Artifacts {
    let picture = |(number, name): (usize, &'static str)| {
        let (_, media_type) = FILE_ARTIFACTS.into_iter().find(|&(known, _)| known == name)?;
        let filename = format!("{}-{name}", inputs.get(number)?.stem());
        Some((Task::drawing(number, name), Artifact { filename, media_type: media_type.to_owned(), file: None }))
    };
    report.drawings().into_iter().filter_map(picture).collect()
}

/// The pictures of a job that are not drawn yet, as files that a child may leave.
pub(super) fn undrawn_files(job: &Job) -> Vec<ArtifactSource> {
    let undrawn = job.artifacts.iter().filter(|(_, artifact)| artifact.file.is_none());
    let source = |(name, artifact): (&String, &Artifact)| ArtifactSource {
        name: name.clone(),
        source: name.clone(),
        filename: artifact.filename.clone(),
        media_type: artifact.media_type.clone(),
    };
    undrawn.map(source).collect()
}

/// The files to store at the end of an attempt, besides pictures. Without a report, that is only the log.
pub(super) fn result_files(inputs: &[Input], report: Option<&JobReport>) -> Vec<ArtifactSource> {
    let first = inputs.first().map_or("model", Input::stem);
    let once = JOB_ARTIFACTS
        .into_iter()
        .filter(|(name, _)| report.is_some() || *name == Task::LOG)
        .map(|(name, media_type)| ArtifactSource::new(name.to_owned(), format!("{first}-{name}"), media_type));
    let offered_file = report.and_then(|report| match report.offered_file() {
        (OfferedFile::Model, format) => format.map(|format| {
            let filename = format!("{first}-repaired.{}", format.extension());
            ArtifactSource::new(Task::MODEL.to_owned(), filename, media_type(format))
        }),
        (OfferedFile::Original, _) => inputs.first().map(|input| ArtifactSource {
            name: Task::ORIGINAL.to_owned(),
            source: Task::input(0),
            filename: input.name.clone(),
            media_type: media_type(input.format).to_owned(),
        }),
        (OfferedFile::None, _) => None,
    });
    let alternatives = report.into_iter().flat_map(JobReport::alternatives).flat_map(|(id, format)| {
        let model = format!("{first}-{id}.{}", format.extension());
        let model = ArtifactSource::new(Artifact::model_of(id), model, media_type(format));
        let named = |name: String, media_type| {
            let filename = format!("{first}-{name}");
            ArtifactSource::new(name, filename, media_type)
        };
        let report = named(Artifact::report_of(id), "application/json");
        let is_drawn = |(name, _): &(&str, &str)| ALTERNATIVE_DRAWINGS.contains(name);
        let drawings = FILE_ARTIFACTS.into_iter().filter(is_drawn);
        let drawings = drawings.map(|(name, media_type)| named(name_for_choice(name, id), media_type));
        [model, report].into_iter().chain(drawings).collect::<Vec<_>>()
    });
    once.chain(offered_file).chain(alternatives).collect()
}

impl ArtifactSource {
    /// A file with the artifact's name in the scratch folder.
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

impl WorkerContext {
    /// Copies a job's input files into the scratch folder.
    ///
    /// # Errors
    /// When a file is missing or damaged, or the file store stays unavailable.
    pub(super) async fn fetch_inputs(&self, job: &Job, folder: &Path) -> Result<(), BlobError> {
        for (number, input) in job.inputs.iter().enumerate() {
            let path = folder.join(Task::input(number));
            let fetch = retry_with_backoff(None, || self.blobs.fetch(&input.key, &input.sha256, &path));
            fetch.instrument(tracing::info_span!("fetch", bytes = input.bytes)).await?;
        }
        Ok(())
    }

    /// Stores the existing ones of `files` under keys of this claim. Nobody sees them until the store publishes them.
    ///
    /// # Errors
    /// When a file can't be read or stored.
    pub(super) async fn store_files(
        &self,
        held: &Lease,
        folder: &Path,
        files: Vec<ArtifactSource>,
        stop: &CancellationToken,
    ) -> Result<Artifacts, BlobError> {
        let key = |name: &str| Blobs::artifact_key(held.id, &held.token, name);
        let sources: Vec<_> = files.iter().map(|file| (key(&file.name), folder.join(&file.source))).collect();
        let stored = retry_with_backoff(Some(stop), || self.blobs.put_files(&sources)).await?;
        let artifact =
            |(ArtifactSource { name, filename, media_type, .. }, stored): (ArtifactSource, Option<Stored>)| {
                let Stored { bytes, sha256, .. } = stored?;
                let file = Some(StoredFile { key: key(&name), bytes, sha256 });
                Some((name, Artifact { filename, media_type, file }))
            };
        Ok(files.into_iter().zip(stored).filter_map(artifact).collect())
    }

    /// Deletes the files that were stored under a lost claim.
    pub(super) async fn drop_files(&self, held: &Lease) {
        if let Err(error) = self.blobs.delete_claim(held.id, &held.token).await {
            tracing::warn!(%error, "could not delete files of a lost claim");
        }
    }
}
