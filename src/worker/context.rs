//! What the attempts of a worker process share: its stores, its configuration, its scratch folder and its sandbox.

use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rustix::process::Pid;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tracing::Instrument;

use super::process::{Allowance, Excess};
use super::scratch::Scratch;
use super::task::{Confinement, ProcessLimits, Task};
use crate::blender::BlenderConfig;
use crate::blobs::{BlobError, Blobs, Stored, free_bytes};
use crate::format::{Format, Limits};
use crate::jobs::{Artifact, Artifacts, Input, Job, JobReport, Lease, Store, StoreError, StoredFile};
use crate::repair::{OfferedFile, RemesherInfo, promised_overrun};
use crate::sandbox::{Sandbox, SandboxMode, SandboxStatus};

/// What counts a job's processes where the kernel does not.
pub(super) const COUNTED_HERE: &str = "worker";

/// How workers run jobs.
#[derive(Debug, Clone)]
pub struct WorkerConfig {
    /// The program to start for a job's child process: this one.
    pub program: PathBuf,
    /// The folder that holds what no job may see: the database, the files, the scratch folders of others.
    pub private: PathBuf,
    /// Where scratch folders go.
    pub scratch: PathBuf,
    /// Jobs that run at the same time.
    pub slots: usize,
    /// Jobs of one tenant that may run at the same time, where nothing else is set for it.
    pub max_running: u32,
    /// How long results are kept after the end of their job, and then what is known of the job.
    pub retention: Retention,
    /// Bytes that must be free on the disks of the files and of the scratch folder for a job to be begun.
    pub min_free: u64,
    /// How long a claim holds without a heartbeat.
    pub lease: Duration,
    /// How long to wait before polling for work that no notification announced.
    pub poll: Duration,
    /// Most address space of a job's process, in bytes.
    pub job_memory: u64,
    /// Largest file that a job may write, in bytes.
    pub job_file: u64,
    /// Most that a job may write into its scratch folder, in bytes.
    pub job_scratch: u64,
    /// Most processes and threads of a job.
    pub job_processes: u64,
    /// What to do where the kernel can't sandbox jobs fully.
    pub sandbox: SandboxMode,
    /// Files and folders that a job may read beside those of the system and of Blender.
    pub readable: Vec<PathBuf>,
    /// Time after which a job's processes are killed, beyond its deadline and the 2 s and 10 % within which a repair keeps that.
    pub deadline_grace: Duration,
    /// What a reader may spend.
    pub limits: Limits,
    /// Tier 3, where there is one.
    pub remesher: Option<RemesherInfo>,
    /// What tier 3 may use.
    pub blender: BlenderConfig,
    /// Run Blender once on a small model at the start.
    pub blender_warm_up: bool,
}

/// How long what is left of a job is kept, both counted from its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Retention {
    /// Its files and its report.
    pub results: Duration,
    /// That there was one, and how it ended.
    pub jobs: Duration,
}

/// The two steps of stopping.
#[derive(Debug, Clone, Default)]
pub struct Shutdown {
    /// Take no new work; finish what runs.
    pub drain: CancellationToken,
    /// Stop at once: kill what runs and release it.
    pub now: CancellationToken,
}

/// Why an attempt can't go on.
#[derive(Debug, thiserror::Error)]
pub(super) enum AttemptError {
    #[error(transparent)]
    Io(#[from] io::Error),
    #[error(transparent)]
    Blob(#[from] BlobError),
    #[error(transparent)]
    Store(#[from] StoreError),
    #[error("{0} from the repair process can't be read: {1}")]
    Json(&'static str, serde_json::Error),
}

/// What every attempt of a worker process needs.
pub(super) struct WorkerContext {
    pub name: String,
    pub store: Arc<dyn Store>,
    pub blobs: Blobs,
    pub config: WorkerConfig,
    pub scratch: Scratch,
    pub sandbox: Sandbox,
    /// What the sandbox was found to hold; none until it was tried.
    pub status: Option<SandboxStatus>,
}

impl WorkerContext {
    /// What holds a job's processes, with processor time for so long on every core.
    pub(super) fn confinement(&self, longest: Duration) -> Confinement {
        let cores = u32::try_from(std::thread::available_parallelism().map_or(1, usize::from)).unwrap_or(1);
        let limits = ProcessLimits {
            memory_bytes: self.config.job_memory,
            file_bytes: self.config.job_file,
            // A backstop behind the deadline, for a process that escapes its group.
            cpu: longest * cores + Duration::from_secs(5),
        };
        Confinement { limits, sandbox: self.sandbox.clone() }
    }

    /// Waits until a job's processes take too much, and answers what of; none where they ran longer than they may. The files that are in
    /// `folder` from the start are not counted.
    pub(super) async fn overrun(&self, job: &Job, folder: &Path, group: Pid) -> io::Result<Option<Excess>> {
        let model = job.artifacts.get(Task::MODEL).and_then(|model| Some(model.file.as_ref()?.bytes));
        let given = job.inputs.iter().map(|input| input.bytes).chain(model).sum();
        let counts = self.status.as_ref().is_some_and(|it| it.protections.processes.mechanisms == [COUNTED_HERE]);
        let allowance = Allowance {
            scratch_bytes: self.config.job_scratch.saturating_add(given),
            processes: counts.then_some(self.config.job_processes),
        };
        allowance.overrun(self.deadline(job), folder, group).await
    }

    /// The task of a job's child process: to do the job, or to draw the pictures of what it handed out.
    pub(super) fn task(&self, job: &Job, draw: Option<OfferedFile>) -> Task {
        let config = &self.config;
        Task {
            inputs: job.inputs.clone(),
            options: job.options.clone(),
            draw,
            limits: config.limits,
            confinement: self.confinement(self.deadline(job)),
            remesher: config.remesher.clone().filter(|_| draw.is_none()),
            blender: config.blender.clone(),
        }
    }

    /// The time after which a job's processes are killed: later than a repair takes by itself to keep its deadline.
    fn deadline(&self, job: &Job) -> Duration {
        let deadline = Duration::from_secs_f64(job.options.deadline_s().clamp(1.0, 3600.0));
        deadline + promised_overrun(deadline) + self.config.deadline_grace
    }

    /// Whether a job's processes may leave its process group.
    pub(super) fn loose(&self) -> bool {
        self.status.as_ref().is_none_or(|it| !it.protections.system_calls.enforced)
    }

    /// Bytes free on the disk that has the fewest, as an error where that is too few to begin a job.
    pub(super) fn room(&self) -> Result<u64, u64> {
        let scratch = free_bytes(&self.config.scratch).ok();
        let files = self.blobs.free_bytes().ok().flatten();
        let free = [scratch, files].into_iter().flatten().min().unwrap_or(u64::MAX);
        if free < self.config.min_free { Err(free) } else { Ok(free) }
    }
}

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

/// The pictures of a job on these files, which are drawn when somebody asks for them.
pub(super) fn pictures(inputs: &[Input], report: &JobReport) -> Artifacts {
    let picture = |(number, name): (usize, &'static str)| {
        let (_, media_type) = OF_EACH_FILE.into_iter().find(|&(known, _)| known == name)?;
        let filename = format!("{}-{name}", inputs.get(number)?.stem());
        Some((Task::drawing(number, name), Artifact { filename, media_type: media_type.to_owned(), file: None }))
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
    let offered_file = report.and_then(|report| match report.offered_file() {
        (OfferedFile::Model, format) => format.map(|format| {
            let filename = format!("{first}-repaired.{}", format.extension());
            Offered::new(Task::MODEL.to_owned(), filename, media_type(format))
        }),
        (OfferedFile::Original, _) => inputs.first().map(|input| Offered {
            name: Task::ORIGINAL.to_owned(),
            source: Task::input(0),
            filename: input.name.clone(),
            media_type: media_type(input.format).to_owned(),
        }),
        (OfferedFile::None, _) => None,
    });
    once.chain(offered_file).collect()
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

impl WorkerContext {
    /// Copies a job's files into the scratch folder.
    pub(super) async fn fetch_inputs(&self, job: &Job, folder: &Path) -> Result<(), BlobError> {
        for (number, input) in job.inputs.iter().enumerate() {
            let path = folder.join(Task::input(number));
            let fetch = retry_with_backoff(None, || self.blobs.fetch(&input.key, &input.sha256, &path));
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
        let stored = retry_with_backoff(Some(over), || self.blobs.put_files(&places)).await?;
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

/// How long to try again what an attempt needs to begin or to end.
const RETRY_TIME: Duration = Duration::from_secs(600);

/// An error of something that may be away for a while.
pub(super) trait Transient: Display {
    /// Whether the same may succeed in a while.
    fn is_transient(&self) -> bool;
}

impl Transient for StoreError {
    fn is_transient(&self) -> bool {
        self.is_transient()
    }
}

impl Transient for BlobError {
    fn is_transient(&self) -> bool {
        self.is_transient()
    }
}

/// Retries with backoff while the database or the file store is unavailable: the work is done, or could not be begun elsewhere either.
/// Between two tries it gives up when `over` is cancelled.
pub(super) async fn retry_with_backoff<T, E, F>(over: Option<&CancellationToken>, work: impl Fn() -> F) -> Result<T, E>
where
    E: Transient,
    F: Future<Output = Result<T, E>>,
{
    let until = Instant::now() + RETRY_TIME;
    let mut pause = Duration::from_millis(100);
    loop {
        match work().await {
            Err(error)
                if error.is_transient()
                    && Instant::now() < until
                    && !over.is_some_and(CancellationToken::is_cancelled) =>
            {
                tracing::warn!(%error, "trying again");
                tokio::time::sleep(pause).await;
                pause = (pause * 2).min(Duration::from_secs(5));
            }
            result => return result,
        }
    }
}
