//! Asking a service for what this program can't or shall not do itself: what `submit` and `watch` have in common.

mod error;
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
use meshmend::jobs::{JobId, JobOutcome, Status};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use sse_stream::SseStream;

pub use self::error::RemoteError;
pub use self::service::{REPORT, RemoteJob, Service, ServiceArgs, Submission};
pub use self::show::{Console, Row};

use self::service::{RemoteFile, RemoteProgress};
use super::engine::temporary_beside;
use super::exit;

/// Endings of the pictures and coloured meshes that a job may leave.
const PICTURES: [&str; 3] = [".png", ".glb", ".ply"];

/// How results are told.
#[derive(Debug, Args)]
pub struct DisplayArgs {
    /// Replace files that are there already.
    #[arg(long, env = "MESHMEND_FORCE")]
    pub force: bool,
    /// Print a line of JSON for each file instead of its result's path.
    #[arg(long, env = "MESHMEND_JSON")]
    json: bool,
    /// Show neither progress nor outcomes, only what went wrong.
    #[arg(short, long, env = "MESHMEND_QUIET")]
    quiet: bool,
}

/// What of a job is downloaded, and where it goes.
#[derive(Debug, Default)]
pub struct Wanted {
    /// The model, or of an analysis the report.
    pub result: Option<Target>,
    /// The report.
    pub report: Option<Target>,
    /// Pictures and coloured meshes.
    pub pictures: Option<PathBuf>,
}

/// One conversation with a service: who is asked, what is wanted, and what is shown.
pub struct Session<'a> {
    pub service: Service,
    pub console: Console,
    args: &'a DisplayArgs,
    wanted: Wanted,
    /// Jobs that were submitted or are followed and whose end was not told of yet.
    open: Mutex<BTreeSet<JobId>>,
}

/// What became of one file or job, for programs.
#[derive(Default, Serialize)]
struct Line<'a> {
    name: &'a str,
    job: Option<JobId>,
    status: Option<Status>,
    outcome: Option<JobOutcome>,
    reused_from: Option<JobId>,
    /// What was written, by the names that the job has for it.
    files: BTreeMap<String, PathBuf>,
    message: String,
    problem: Option<&'a Problem>,
    exit_code: u8,
}

impl<'a> Session<'a> {
    pub fn new(service: Service, args: &'a DisplayArgs, wanted: Wanted) -> Self {
        Self { service, console: Console::new(args.quiet), args, wanted, open: Mutex::default() }
    }

    /// Does the work of a verb until it is done or interrupted, and gives its exit code. Jobs go on without whoever follows them.
    pub fn run(&self, work: impl Future<Output = u8>) -> ExitCode {
        let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
            Ok(runtime) => runtime,
            Err(error) => return exit::fail(exit::INTERNAL, error),
        };
        runtime.block_on(async {
            tokio::select! {
                code = work => ExitCode::from(code),
                Ok(()) = tokio::signal::ctrl_c() => self.interrupted(),
            }
        })
    }

    /// Notes that a job was accepted.
    pub fn mark_open(&self, id: JobId) {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).insert(id);
    }

    /// Gives a job's id and leaves it alone.
    pub fn print_submitted(&self, name: &str, job: &RemoteJob) -> u8 {
        let line =
            Line { name, job: Some(job.id), status: Some(job.status), message: "submitted".into(), ..Line::default() };
        self.print_result(&job.id.to_string(), &line)
    }

    /// Follows a job to its end, and gives what it left.
    pub async fn follow_to_end(&self, row: &Row, name: &str, id: JobId) -> u8 {
        self.mark_open(id);
        match follow(&self.service, id, row).await {
            Ok(job) => self.finish_job(row, name, &job).await,
            Err(error) => self.failed(row, name, Some(id), &error),
        }
    }

    /// Downloads what is wanted of a job that has ended, and says what became of it.
    async fn finish_job(&self, row: &Row, name: &str, job: &RemoteJob) -> u8 {
        let files = match self.fetch(job, row).await {
            Ok(files) => files,
            Err(error) => return self.failed(row, name, Some(job.id), &error),
        };
        self.open.lock().unwrap_or_else(PoisonError::into_inner).remove(&job.id);
        let (code, summary) = (job.code(), job.summary_lines());
        let lost = matches!(code, exit::BAD_INPUT | exit::INTERNAL | exit::NOT_PRINTABLE);
        row.finish(&summary, self.args.quiet && !lost);
        let line = Line {
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
                code.max(self.print_result(&path.map(|it| it.display().to_string()).unwrap_or_default(), &line))
            }
        }
    }

    /// Says why nothing came of a file or job.
    pub fn failed(&self, row: &Row, name: &str, job: Option<JobId>, error: &RemoteError) -> u8 {
        let mut text = vec![error.to_string()];
        text.extend(job.filter(|_| !error.is_gone()).map(|id| format!("  To go on: {}", self.watch_command(&[id]))));
        row.finish(&text, false);
        if let Some(id) = job {
            self.open.lock().unwrap_or_else(PoisonError::into_inner).remove(&id);
        }
        let (problem, exit_code) = (error.problem(), error.code());
        let line = Line { name, job, problem, exit_code, message: error.to_string(), ..Line::default() };
        if self.args.json { exit_code.max(self.print_result("", &line)) } else { exit_code }
    }

    async fn fetch(&self, job: &RemoteJob, row: &Row) -> Result<BTreeMap<String, PathBuf>, RemoteError> {
        let Wanted { result, report, pictures } = &self.wanted;
        let pictures = pictures.as_ref().map(|folder| Target::Folder(folder.clone()));
        let is_picture = |name: &str| PICTURES.iter().any(|ending| name.ends_with(ending));
        let drawn = job.artifacts.keys().map(String::as_str).filter(|name| is_picture(name));
        let wanted = job.result().into_iter().map(|name| (name, result.as_ref()));
        let wanted = wanted.chain([(REPORT, report.as_ref())]).chain(drawn.map(|name| (name, pictures.as_ref())));
        let mut files = BTreeMap::new();
        for (name, target) in wanted {
            let Some(target) = target else { continue };
            if let Some(path) = self.download(job, name, target, row).await? {
                files.insert(name.to_owned(), path);
            }
        }
        Ok(files)
    }

    /// Downloads a file of a job and gives its place; nothing where the job has no such file.
    ///
    /// It is written beside its place and moved there when its SHA-256 is right. What is there already stays, unless `force` is set.
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
            return Err(exists(&path));
        }
        if let Target::Folder(folder) = target {
            create_dir_all(folder).map_err(|error| RemoteError::local(folder.display(), error))?;
        }
        let waits = |error: &RemoteError, delay| row.show_retry(error, delay);
        let fetch = async || {
            row.start_transfer("fetching", file.bytes.unwrap_or_default());
            let chunks = self.service.file(job.id, name).await?;
            store(chunks, file, &path, self.args.force, row).await
        };
        self.service.persist(waits, fetch).await?;
        Ok(Some(path))
    }

    fn print_result(&self, result: &str, line: &Line<'_>) -> u8 {
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
        let open: Vec<JobId> = self.open.lock().unwrap_or_else(PoisonError::into_inner).iter().copied().collect();
        let open = if open.is_empty() {
            "no job is known to be under way".to_owned()
        } else {
            format!("what was submitted goes on. To follow it: {}", self.watch_command(&open))
        };
        self.console.print_note(&format!("meshmend: interrupted; {open}"));
        ExitCode::from(exit::INTERRUPTED)
    }

    fn watch_command(&self, jobs: &[JobId]) -> String {
        let jobs: Vec<String> = jobs.iter().map(ToString::to_string).collect();
        format!("meshmend watch {} --server {} --download .", jobs.join(" "), self.service.address())
    }
}

/// What an event `progress` says.
#[derive(Deserialize)]
struct ProgressEvent {
    status: Status,
    #[serde(flatten)]
    progress: RemoteProgress,
}

/// Follows a job until it has ended.
///
/// Its events are listened to. Where they break off, or something on the way does not let them through, the job is asked for, with an
/// answer that is held until its status changes, and then listened to again.
async fn follow(service: &Service, id: JobId, row: &Row) -> Result<RemoteJob, RemoteError> {
    loop {
        match service.events(id).await {
            Ok(events) => {
                if let Some(job) = listen(events, row).await {
                    return Ok(job);
                }
            }
            Err(error) if error.may_pass() || matches!(error, RemoteError::Strange { .. }) => {}
            Err(error) => return Err(error),
        }
        let job =
            service.persist(|error, delay| row.show_retry(error, delay), async || service.job(id, true).await).await?;
        if job.status.is_final() {
            return Ok(job);
        }
        if let Some(progress) = job.progress {
            row.show_progress(job.status, progress);
        }
    }
}

/// The job, if its end is told of before the events end.
async fn listen(events: impl Stream<Item = Result<bytes::Bytes, RemoteError>>, row: &Row) -> Option<RemoteJob> {
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

/// Where files go that are downloaded.
#[derive(Debug, Clone)]
pub enum Target {
    /// To this place.
    File(PathBuf),
    /// Into this folder, which is made, under the names that the service gives.
    Folder(PathBuf),
}

impl Target {
    /// Sees that something can be written there, before a service works for it.
    pub fn check(&self, force: bool) -> Result<(), RemoteError> {
        let inside = match self {
            Self::File(path) if !force && path.exists() => return Err(exists(path)),
            Self::File(path) => path.clone(),
            Self::Folder(folder) => {
                create_dir_all(folder).map_err(|error| RemoteError::local(folder.display(), error))?;
                folder.join("any")
            }
        };
        temporary_beside(&inside).map_err(|error| RemoteError::local(inside.display(), error))?;
        Ok(())
    }

    fn path(&self, file: &RemoteFile) -> PathBuf {
        match self {
            Self::File(path) => path.clone(),
            // Whatever a service says, it stays in the folder.
            Self::Folder(folder) => folder.join(Path::new(&file.filename).file_name().unwrap_or("result".as_ref())),
        }
    }
}

/// Writes the bytes of a file beside its place and moves it there when its SHA-256 is right.
async fn store(
    chunks: impl Stream<Item = Result<bytes::Bytes, RemoteError>>,
    file: &RemoteFile,
    path: &Path,
    force: bool,
    row: &Row,
) -> Result<(), RemoteError> {
    let failed = |error: std::io::Error| RemoteError::local(path.display(), error);
    let mut chunks = std::pin::pin!(chunks);
    let mut beside = temporary_beside(path).map_err(failed)?;
    let mut digest = Sha256::new();
    while let Some(chunk) = chunks.next().await {
        let chunk = chunk?;
        digest.update(&chunk);
        beside.write_all(&chunk).map_err(failed)?;
        row.advance(chunk.len() as u64);
    }
    if file.sha256.as_ref().is_some_and(|expected| *expected != hex::encode(digest.finalize())) {
        return Err(RemoteError::Damaged { name: path.display().to_string() });
    }
    let moved = if force { beside.persist(path) } else { beside.persist_noclobber(path) };
    moved.map(drop).map_err(|error| match error.error.kind() {
        std::io::ErrorKind::AlreadyExists => exists(path),
        _ => failed(error.error),
    })
}

fn exists(path: &Path) -> RemoteError {
    RemoteError::local(path.display(), "there is a file already; --force replaces it")
}
