//! Shared by `submit` and `watch`: following jobs of a service, downloading their files, and printing results.

mod error;
mod job;
mod service;
mod show;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::create_dir_all;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};

use clap::Args;
use futures::{Stream, StreamExt};
use meshmend::api::Problem;
use meshmend::jobs::{Artifact, JobId, JobOutcome, Status};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use sse_stream::SseStream;

pub use self::error::RemoteError;
pub use self::job::{REPORT, RemoteJob};
pub use self::service::{Service, ServiceArgs, Submission};
pub use self::show::{Console, Row};

use self::job::{RemoteFile, RemoteProgress};
use super::alternatives::{alternative_lines, path_of};
use super::engine::temporary_file_next_to;
use super::exit;

/// Extensions of the pictures and coloured meshes among the files of a job.
const PICTURE_EXTENSIONS: [&str; 3] = [".png", ".glb", ".ply"];

/// The flags for printed output and existing files.
#[derive(Debug, Args)]
pub struct DisplayArgs {
    /// Replace existing files.
    #[arg(long, env = "MESHMEND_FORCE")]
    pub force: bool,
    /// Print one JSON object per file instead of the path of its result.
    #[arg(long, env = "MESHMEND_JSON")]
    json: bool,
    /// Print only errors; no progress and no outcomes.
    #[arg(short, long, env = "MESHMEND_QUIET")]
    quiet: bool,
}

/// The files to download, and where to.
#[derive(Debug, Default)]
pub struct Downloads {
    /// The repaired model, with alternatives beside it, or the report of an analysis.
    pub result: Option<Target>,
    /// The full report.
    pub report: Option<Target>,
    /// Pictures and coloured meshes, into this folder.
    pub pictures: Option<PathBuf>,
}

/// One run of `submit` or `watch`: the service, the files to download, and the printed output.
pub struct Session<'a> {
    /// The service.
    pub service: Service,
    /// The output.
    pub console: Console,
    args: &'a DisplayArgs,
    downloads: Downloads,
    /// Accepted or followed jobs whose end has not been printed yet.
    open_jobs: Mutex<BTreeSet<JobId>>,
}

/// The result for one file or job, as `--json` prints it.
#[derive(Default, Serialize)]
struct ResultLine<'a> {
    name: &'a str,
    job: Option<JobId>,
    status: Option<Status>,
    outcome: Option<JobOutcome>,
    reused_from: Option<JobId>,
    /// Paths of the downloaded files, by their names in the job.
    files: BTreeMap<String, PathBuf>,
    message: String,
    problem: Option<&'a Problem>,
    exit_code: u8,
}

impl<'a> Session<'a> {
    /// A session that has no jobs yet.
    pub fn new(service: Service, args: &'a DisplayArgs, downloads: Downloads) -> Self {
        Self { service, console: Console::new(args.quiet), args, downloads, open_jobs: Mutex::default() }
    }

    /// Runs a command until it ends or is interrupted, and returns the exit code. After an interrupt, jobs continue on the service.
    pub fn run(&self, command: impl Future<Output = u8>) -> ExitCode {
        let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
            Ok(runtime) => runtime,
            Err(error) => return exit::fail(exit::INTERNAL, error),
        };
        runtime.block_on(async {
            tokio::select! {
                code = command => ExitCode::from(code),
                Ok(()) = tokio::signal::ctrl_c() => self.interrupted(),
            }
        })
    }

    /// Records that a job was accepted.
    pub fn mark_open(&self, id: JobId) {
        self.open_jobs.lock().unwrap_or_else(PoisonError::into_inner).insert(id);
    }

    /// Prints a job's id, for `--no-wait`, and returns the exit code.
    pub fn print_submitted(&self, name: &str, job: &RemoteJob) -> u8 {
        let line = ResultLine {
            name,
            job: Some(job.id),
            status: Some(job.status),
            message: "submitted".into(),
            ..ResultLine::default()
        };
        self.print_result(&job.id.to_string(), &line)
    }

    /// Follows a job to its end, downloads its files, and returns the exit code.
    pub async fn follow_to_end(&self, row: &Row, name: &str, id: JobId) -> u8 {
        self.mark_open(id);
        match follow(&self.service, id, row).await {
            Ok(job) => self.finish_job(row, name, &job).await,
            Err(error) => self.failed(row, name, Some(id), &error),
        }
    }

    /// Downloads the files of an ended job and prints the outcome.
    async fn finish_job(&self, row: &Row, name: &str, job: &RemoteJob) -> u8 {
        let files = match self.fetch(job, row).await {
            Ok(files) => files,
            Err(error) => return self.failed(row, name, Some(job.id), &error),
        };
        self.open_jobs.lock().unwrap_or_else(PoisonError::into_inner).remove(&job.id);
        let (code, mut summary) = (job.code(), job.summary_lines());
        let path = |id: &str| files.get(&Artifact::model_of(id)).cloned();
        summary.extend(job.alternatives.iter().flat_map(|alternatives| alternative_lines(alternatives, path)));
        let has_failed = matches!(code, exit::BAD_INPUT | exit::INTERNAL | exit::NOT_PRINTABLE);
        row.finish(&summary, self.args.quiet && !has_failed);
        let line = ResultLine {
            name,
            job: Some(job.id),
            status: Some(job.status),
            outcome: job.outcome,
            reused_from: job.reused_from,
            message: summary.into_iter().next().unwrap_or_default(),
            exit_code: code,
            files,
            problem: None,
        };
        let result = job.result().and_then(|result| line.files.get(result));
        match (result, self.args.json) {
            (None, false) => code,
            (path, _) => {
                code.max(self.print_result(&path.map(|path| path.display().to_string()).unwrap_or_default(), &line))
            }
        }
    }

    /// Prints why a file or job has no result, and returns the exit code.
    pub fn failed(&self, row: &Row, name: &str, job: Option<JobId>, error: &RemoteError) -> u8 {
        let mut text = vec![error.to_string()];
        text.extend(job.filter(|_| !error.is_gone()).map(|id| format!("  To continue: {}", self.watch_command(&[id]))));
        row.finish(&text, false);
        if let Some(id) = job {
            self.open_jobs.lock().unwrap_or_else(PoisonError::into_inner).remove(&id);
        }
        let (problem, exit_code) = (error.problem(), error.code());
        let line = ResultLine { name, job, problem, exit_code, message: error.to_string(), ..ResultLine::default() };
        if self.args.json { exit_code.max(self.print_result("", &line)) } else { exit_code }
    }

    /// Downloads the requested files of a job, and returns their paths by name.
    async fn fetch(&self, job: &RemoteJob, row: &Row) -> Result<BTreeMap<String, PathBuf>, RemoteError> {
        let Downloads { result, report, pictures } = &self.downloads;
        let pictures = pictures.as_ref().map(|folder| Target::Folder(folder.clone()));
        let is_picture = |name: &str| PICTURE_EXTENSIONS.iter().any(|extension| name.ends_with(extension));
        let drawings = job.artifacts.keys().map(String::as_str).filter(|name| is_picture(name));
        let requested = job.result().into_iter().map(|name| (name, result.clone()));
        let others =
            job.alternative_models().map(|(name, id)| (name, result.as_ref().map(|target| target.of_alternative(id))));
        let requested = requested.chain(others).chain([(REPORT, report.clone())]);
        let mut files = BTreeMap::new();
        for (name, target) in requested.chain(drawings.map(|name| (name, pictures.clone()))) {
            let Some(target) = target else { continue };
            if let Some(path) = self.download(job, name, &target, row).await? {
                files.insert(name.to_owned(), path);
            }
        }
        Ok(files)
    }

    /// Downloads a file of a job and returns its path; `None` if the job has no file of this name.
    ///
    /// The bytes go into a temporary file, which is renamed once its SHA-256 is verified. An existing file stays unless `force` is set.
    async fn download(
        &self,
        job: &RemoteJob,
        name: &str,
        target: &Target,
        row: &Row,
    ) -> Result<Option<PathBuf>, RemoteError> {
        let Some(file) = job.artifacts.get(name) else { return Ok(None) };
        let path = target.path(file);
        if !self.args.force && path.exists() {
            return Err(already_exists(&path));
        }
        if let Target::Folder(folder) = target {
            create_dir_all(folder).map_err(|error| RemoteError::local(folder.display(), error))?;
        }
        let on_retry = |error: &RemoteError, delay| row.show_retry(error, delay);
        let fetch = async || {
            row.start_transfer("downloading", file.bytes.unwrap_or_default());
            let chunks = self.service.file(job.id, name).await?;
            write_verified(chunks, file, &path, self.args.force, row).await
        };
        self.service.retry_with_backoff(on_retry, fetch).await?;
        Ok(Some(path))
    }

    fn print_result(&self, result: &str, line: &ResultLine<'_>) -> u8 {
        let text = if self.args.json { serde_json::to_string(line) } else { Ok(result.to_owned()) };
        match text.map_err(std::io::Error::from).and_then(|text| self.console.print_result(&text)) {
            Ok(()) => exit::PRINTABLE,
            Err(error) => {
                self.console.print_note(&format!("meshmend: standard output: {error}"));
                exit::INTERNAL
            }
        }
    }

    fn interrupted(&self) -> ExitCode {
        let open_jobs: Vec<JobId> =
            self.open_jobs.lock().unwrap_or_else(PoisonError::into_inner).iter().copied().collect();
        let status = if open_jobs.is_empty() {
            "no submitted job is unfinished".to_owned()
        } else {
            format!("submitted jobs continue. To follow them: {}", self.watch_command(&open_jobs))
        };
        self.console.print_note(&format!("meshmend: interrupted; {status}"));
        ExitCode::from(exit::INTERRUPTED)
    }

    fn watch_command(&self, jobs: &[JobId]) -> String {
        let jobs: Vec<String> = jobs.iter().map(ToString::to_string).collect();
        format!("meshmend watch {} --server {} --download .", jobs.join(" "), self.service.address())
    }
}

/// The data of an event `progress`.
#[derive(Deserialize)]
struct ProgressEvent {
    status: Status,
    #[serde(flatten)]
    progress: RemoteProgress,
}

/// Follows a job until it has ended.
///
/// It reads the job's event stream. If the stream breaks off, or a proxy blocks it, a long poll for the job takes its place until the
/// job's status changes; then the stream is opened again.
async fn follow(service: &Service, id: JobId, row: &Row) -> Result<RemoteJob, RemoteError> {
    loop {
        match service.events(id).await {
            Ok(events) => {
                if let Some(job) = read_events(events, row).await {
                    return Ok(job);
                }
            }
            Err(error) if error.is_transient() || matches!(error, RemoteError::NotMeshmend { .. }) => {}
            Err(error) => return Err(error),
        }
        let job = service
            .retry_with_backoff(|error, delay| row.show_retry(error, delay), async || service.job(id, true).await)
            .await?;
        if job.status.is_final() {
            return Ok(job);
        }
        if let Some(progress) = job.progress {
            row.show_progress(job.status, progress);
        }
    }
}

/// Shows the progress of an event stream. Returns the job if the stream reports its end.
async fn read_events(events: impl Stream<Item = Result<bytes::Bytes, RemoteError>>, row: &Row) -> Option<RemoteJob> {
    let mut events = std::pin::pin!(SseStream::from_bytes_stream(events));
    while let Some(Ok(event)) = events.next().await {
        let data = event.data.unwrap_or_default();
        match event.event.as_deref() {
            Some("done") => return serde_json::from_str(&data).ok(),
            Some("progress") => {
                if let Ok(ProgressEvent { status, progress }) = serde_json::from_str(&data) {
                    row.show_progress(status, progress);
                }
            }
            _ => {}
        }
    }
    None
}

/// Where downloads go.
#[derive(Debug, Clone)]
pub enum Target {
    /// To this path.
    File(PathBuf),
    /// Into this folder, which is created if missing, with the names from the service.
    Folder(PathBuf),
}

impl Target {
    /// Checks, before any work on the service, that the target can be written.
    ///
    /// # Errors
    /// The file exists, or the folder is not writable.
    pub fn check(&self, force: bool) -> Result<(), RemoteError> {
        let probe = match self {
            Self::File(path) if !force && path.exists() => return Err(already_exists(path)),
            Self::File(path) => path.clone(),
            Self::Folder(folder) => {
                create_dir_all(folder).map_err(|error| RemoteError::local(folder.display(), error))?;
                folder.join("any")
            }
        };
        temporary_file_next_to(&probe).map_err(|error| RemoteError::local(probe.display(), error))?;
        Ok(())
    }

    /// The target of an alternative's model.
    fn of_alternative(&self, id: &str) -> Self {
        match self {
            Self::File(path) => Self::File(path_of(path, id)),
            Self::Folder(folder) => Self::Folder(folder.clone()),
        }
    }

    /// The path of a downloaded file.
    fn path(&self, file: &RemoteFile) -> PathBuf {
        match self {
            Self::File(path) => path.clone(),
            // Only the last component of the name counts, so a hostile service cannot leave the folder.
            Self::Folder(folder) => folder.join(Path::new(&file.filename).file_name().unwrap_or("result".as_ref())),
        }
    }
}

/// Writes the bytes into a temporary file and renames the file once its SHA-256 is verified.
async fn write_verified(
    chunks: impl Stream<Item = Result<bytes::Bytes, RemoteError>>,
    file: &RemoteFile,
    path: &Path,
    force: bool,
    row: &Row,
) -> Result<(), RemoteError> {
    let failed = |error: std::io::Error| RemoteError::local(path.display(), error);
    let mut chunks = std::pin::pin!(chunks);
    let mut temporary = temporary_file_next_to(path).map_err(failed)?;
    let mut digest = Sha256::new();
    while let Some(chunk) = chunks.next().await {
        let chunk = chunk?;
        digest.update(&chunk);
        temporary.write_all(&chunk).map_err(failed)?;
        row.advance(chunk.len() as u64);
    }
    if file.sha256.as_ref().is_some_and(|expected| *expected != hex::encode(digest.finalize())) {
        return Err(RemoteError::Damaged { name: path.display().to_string() });
    }
    let renamed = if force { temporary.persist(path) } else { temporary.persist_noclobber(path) };
    renamed.map(drop).map_err(|error| match error.error.kind() {
        std::io::ErrorKind::AlreadyExists => already_exists(path),
        _ => failed(error.error),
    })
}

fn already_exists(path: &Path) -> RemoteError {
    RemoteError::local(path.display(), "the file exists already; --force replaces it")
}
