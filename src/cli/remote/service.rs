//! A service as this program asks it, and what is read of the jobs that it answers.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use backon::{BackoffBuilder, ExponentialBuilder};
use bytes::Bytes;
use clap::Args;
use futures::{Stream, StreamExt};
use meshmend::context::Stage;
use meshmend::jobs::{JobId, JobOutcome, Mode, ProblemKind, Status};
use reqwest::{Body, Client, RequestBuilder, Response, header};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use tokio_util::io::ReaderStream;
use url::Url;

use super::error::RemoteError;
use crate::cli::engine::remarks;
use crate::cli::exit;

/// Longest time for a connection to be made.
const CONNECT: Duration = Duration::from_secs(10);
/// Longest time for an answer that is not waited for on purpose.
const ANSWER: Duration = Duration::from_secs(30);
/// Longest silence in the midst of an answer, and of a connection on which something is sent. Streams of events have a sign of life
/// every 15 seconds.
const SILENCE: Duration = Duration::from_secs(45);
/// Seconds that the service may hold an answer until a job's status changes.
const HOLD_S: u64 = 20;
/// Bytes that are read and sent at a time.
const CHUNK: usize = 256 << 10;
/// Delays between tries, where the service does not say when to ask again.
const BACKOFF: ExponentialBuilder = ExponentialBuilder::new()
    .with_min_delay(Duration::from_millis(500))
    .with_max_delay(Duration::from_secs(15))
    .with_jitter()
    .without_max_times();

/// Where the service is, and who asks.
#[derive(Debug, Args)]
pub struct ServiceArgs {
    /// The service's address.
    #[arg(long, env = "MESHMEND_SERVER", value_name = "URL", default_value = "http://127.0.0.1:8080", value_parser = server)]
    pub server: Url,
    /// The key to ask with, if the service asks for one. Others on this machine can read command lines, so rather set the variable or
    /// use --api-key-file.
    #[arg(long, env = "MESHMEND_API_KEY", value_name = "KEY", hide_env_values = true, conflicts_with = "api_key_file")]
    api_key: Option<String>,
    /// A file that holds the key and nothing else.
    #[arg(long, env = "MESHMEND_API_KEY_FILE", value_name = "FILE")]
    api_key_file: Option<std::path::PathBuf>,
    /// Seconds to wait, over all tries of one request, for a service that can't be reached, is busy or has no room.
    #[arg(long, env = "MESHMEND_TIMEOUT_S", value_name = "SECONDS", default_value_t = 60)]
    timeout_s: u32,
}

impl ServiceArgs {
    /// A client of the service.
    ///
    /// # Errors
    /// When the key can't be read or used.
    pub fn open(&self) -> Result<Service, RemoteError> {
        let key = match (&self.api_key, &self.api_key_file) {
            (Some(key), _) => Some(key.clone()),
            (None, Some(path)) => {
                Some(std::fs::read_to_string(path).map_err(|e| RemoteError::local(path.display(), e))?)
            }
            (None, None) => None,
        };
        let mut headers = header::HeaderMap::new();
        if let Some(key) = key.as_deref().map(str::trim).filter(|key| !key.is_empty()) {
            let mut value = header::HeaderValue::from_str(&format!("Bearer {key}"))
                .map_err(|_| RemoteError::Local("the key has characters that no key has".to_owned()))?;
            value.set_sensitive(true);
            headers.insert(header::AUTHORIZATION, value);
        }
        let http = Client::builder()
            .user_agent(concat!("meshmend/", env!("CARGO_PKG_VERSION")))
            .default_headers(headers)
            .connect_timeout(CONNECT)
            .tcp_user_timeout(SILENCE)
            .build()
            .map_err(|error| RemoteError::local("no client can be made", error))?;
        Ok(Service { http, server: self.server.clone(), patience: Duration::from_secs(u64::from(self.timeout_s)) })
    }
}

/// An address of a service, with a path if it has one, and without who asks there.
fn server(text: &str) -> Result<Url, String> {
    let mut url = Url::parse(text).map_err(|error| format!("{error}; an address is like https://meshmend.example"))?;
    if !["http", "https"].contains(&url.scheme()) || !url.has_host() {
        return Err("an address is like https://meshmend.example".to_owned());
    }
    if !url.username().is_empty() || url.password().is_some() {
        return Err("an address has no user and password; a key goes into MESHMEND_API_KEY".to_owned());
    }
    if !url.path().ends_with('/') {
        url.set_path(&format!("{}/", url.path()));
    }
    Ok(url)
}

/// A service, and the way to it.
#[derive(Debug, Clone)]
pub struct Service {
    http: Client,
    server: Url,
    patience: Duration,
}

/// A file to make a job of.
#[derive(Debug)]
pub struct Submission<'a> {
    pub path: &'a Path,
    /// Its name, as the service is told.
    pub name: &'a str,
    /// Mode and options, as fields of the query.
    pub options: &'a [(String, String)],
    /// What makes it the same however often it is sent.
    pub key: &'a str,
}

impl Service {
    /// The address, as a person gives it.
    pub fn address(&self) -> &str {
        self.server.as_str().trim_end_matches('/')
    }

    /// Does something until it is done, fails for good, or patience is over; `waits` is told what is waited for and how long.
    pub async fn persist<T>(
        &self,
        mut waits: impl FnMut(&RemoteError, Duration),
        mut attempt: impl AsyncFnMut() -> Result<T, RemoteError>,
    ) -> Result<T, RemoteError> {
        let (mut delays, mut waited) = (BACKOFF.build(), Duration::ZERO);
        loop {
            let error = match attempt().await {
                Err(error) if error.may_pass() => error,
                done => return done,
            };
            let Some(delay) = delays.next().map(|delay| delay.max(error.retry_after().unwrap_or_default())) else {
                return Err(error);
            };
            waited += delay;
            if waited > self.patience {
                return Err(error);
            }
            waits(&error, delay);
            tokio::time::sleep(delay).await;
        }
    }

    /// The largest file that it takes, in bytes.
    pub async fn most_bytes(&self) -> Result<u64, RemoteError> {
        #[derive(Deserialize)]
        struct Capabilities {
            limits: Limits,
        }
        #[derive(Deserialize)]
        struct Limits {
            max_bytes: u64,
        }
        let capabilities: Capabilities = self.json(self.get("v1/capabilities").timeout(ANSWER)).await?;
        Ok(capabilities.limits.max_bytes)
    }

    /// Sends a file and makes a job of it; `sent` is told how many bytes went since it was told before.
    pub async fn submit(
        &self,
        submission: &Submission<'_>,
        sent: impl Fn(u64) + Send + Sync + 'static,
    ) -> Result<RemoteJob, RemoteError> {
        let unreadable = |error: std::io::Error| RemoteError::Local(error.to_string());
        let file = tokio::fs::File::open(submission.path).await.map_err(unreadable)?;
        let bytes = file.metadata().await.map_err(unreadable)?.len();
        let chunks = ReaderStream::with_capacity(file, CHUNK).inspect(move |chunk| {
            if let Ok(chunk) = chunk {
                sent(chunk.len() as u64);
            }
        });
        let mut url = self.at("v1/jobs");
        url.query_pairs_mut().append_pair("name", submission.name).extend_pairs(submission.options);
        let request = self
            .http
            .post(url)
            .header(header::CONTENT_TYPE, "application/octet-stream")
            .header(header::CONTENT_LENGTH, bytes)
            .header("idempotency-key", submission.key);
        self.json(request.body(Body::wrap_stream(chunks))).await
    }

    /// A job, at once or as soon as its status is another.
    pub async fn job(&self, id: JobId, held: bool) -> Result<RemoteJob, RemoteError> {
        let wait = if held { HOLD_S } else { 0 };
        let request = self.get(&format!("v1/jobs/{id}?include=report&wait={wait}"));
        self.json(request.timeout(ANSWER + Duration::from_secs(wait))).await
    }

    /// Jobs of a status, the newest first.
    pub async fn jobs(&self, status: Status) -> Result<Vec<RemoteJob>, RemoteError> {
        #[derive(Deserialize)]
        struct Page {
            jobs: Vec<RemoteJob>,
        }
        let request = self.get(&format!("v1/jobs?limit=50&status={}", status.as_str()));
        Ok(self.json::<Page>(request.timeout(ANSWER)).await?.jobs)
    }

    /// What a job tells of itself, as server-sent events.
    pub async fn events(&self, id: JobId) -> Result<impl Stream<Item = Result<Bytes, RemoteError>>, RemoteError> {
        Ok(self.chunks(self.open(self.get(&format!("v1/jobs/{id}/events?include=report"))).await?))
    }

    /// A file of a job.
    pub async fn file(
        &self,
        id: JobId,
        name: &str,
    ) -> Result<impl Stream<Item = Result<Bytes, RemoteError>>, RemoteError> {
        Ok(self.chunks(self.open(self.get(&format!("v1/jobs/{id}/artifacts/{name}"))).await?))
    }

    fn at(&self, path: &str) -> Url {
        self.server.join(path).unwrap_or_else(|_| self.server.clone())
    }

    fn get(&self, path: &str) -> RequestBuilder {
        self.http.get(self.at(path))
    }

    fn lost(&self, error: &reqwest::Error) -> RemoteError {
        RemoteError::unreachable(self.address(), error)
    }

    async fn send(&self, request: RequestBuilder) -> Result<Response, RemoteError> {
        let response = request.send().await.map_err(|error| self.lost(&error))?;
        if response.status().is_success() {
            return Ok(response);
        }
        Err(RemoteError::of(self.address(), response).await)
    }

    async fn json<T: DeserializeOwned>(&self, request: RequestBuilder) -> Result<T, RemoteError> {
        let response = self.send(request).await?;
        let status = response.status();
        let body = response.bytes().await.map_err(|error| self.lost(&error))?;
        let strange = || RemoteError::Strange { server: self.address().to_owned(), status, retry_after: None };
        serde_json::from_slice(&body).map_err(|_| strange())
    }

    /// Sends a request whose answer is long: only its beginning has to come in time.
    async fn open(&self, request: RequestBuilder) -> Result<Response, RemoteError> {
        let answer = tokio::time::timeout(ANSWER, self.send(request)).await;
        answer.unwrap_or_else(|_| Err(RemoteError::silent(self.address())))
    }

    /// The bytes of an answer, which must not stop coming.
    fn chunks(&self, response: Response) -> impl Stream<Item = Result<Bytes, RemoteError>> + use<> {
        let this = self.clone();
        let chunks = Box::pin(response.bytes_stream());
        futures::stream::unfold(Some((chunks, this)), |from| async {
            let (mut chunks, this) = from?;
            match tokio::time::timeout(SILENCE, chunks.next()).await {
                Err(_) => Some((Err(RemoteError::silent(this.address())), None)),
                Ok(None) => None,
                Ok(Some(Err(error))) => Some((Err(this.lost(&error)), None)),
                Ok(Some(Ok(chunk))) => Some((Ok(chunk), Some((chunks, this)))),
            }
        })
    }
}

/// A job.
#[derive(Debug, Deserialize)]
pub struct RemoteJob {
    pub id: JobId,
    pub status: Status,
    pub outcome: Option<JobOutcome>,
    pub progress: Option<RemoteProgress>,
    pub input: RemoteInput,
    pub reused_from: Option<JobId>,
    report: Option<RemoteReport>,
    pub artifacts: BTreeMap<String, RemoteFile>,
    problem: Option<RemoteProblem>,
}

/// What was sent.
#[derive(Debug, Deserialize)]
pub struct RemoteInput {
    pub name: String,
}

/// How far a job is.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct RemoteProgress {
    pub stage: Option<Stage>,
    pub tier: Option<u8>,
    pub percent: u8,
    pub queue_position: Option<u64>,
}

/// A file to download.
#[derive(Debug, Deserialize)]
pub struct RemoteFile {
    pub filename: String,
    /// None of pictures that are not drawn yet.
    pub bytes: Option<u64>,
    /// None of pictures.
    pub sha256: Option<String>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct RemoteReport {
    mode: Mode,
    summary: Option<String>,
    red_flags: Vec<RedFlag>,
    assumptions: Vec<Assumption>,
    warnings: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct RedFlag {
    detail: String,
}

#[derive(Debug, Deserialize)]
struct Assumption {
    detail: String,
    option: Option<String>,
}

#[derive(Debug, Deserialize)]
struct RemoteProblem {
    title: String,
    detail: String,
    code: ProblemKind,
}

impl RemoteReport {
    /// What a person should know.
    fn remarks(&self) -> impl Iterator<Item = String> {
        let flags = self.red_flags.iter().map(|flag| flag.detail.as_str());
        let assumptions = self.assumptions.iter().map(|it| (it.detail.as_str(), it.option.as_deref()));
        remarks(flags, assumptions, &self.warnings)
    }
}

impl RemoteJob {
    /// The file that the job was for: the model, or of an analysis the report. None where a repair made no model.
    pub fn result(&self) -> Option<&'static str> {
        let name = match self.report.as_ref()?.mode {
            Mode::Repair => MODEL,
            Mode::Analyze => REPORT,
        };
        self.artifacts.contains_key(name).then_some(name)
    }

    /// What became of it, in words, and then what a person should know.
    pub fn summary_lines(&self) -> Vec<String> {
        let report = self.report.as_ref();
        let head = match (&self.problem, self.status) {
            (Some(problem), _) => format!("{}: {}", problem.title, problem.detail),
            (None, Status::Canceled) => "the job was canceled".to_owned(),
            (None, Status::Expired) => "the job ended so long ago that its files are deleted".to_owned(),
            (None, _) => match (report.and_then(|report| report.summary.clone()), self.outcome) {
                (Some(summary), _) => summary,
                (None, Some(JobOutcome::Printable)) => "printable as it is".to_owned(),
                (None, Some(JobOutcome::NotPrintable)) => "not printable; the report says why".to_owned(),
                (None, Some(JobOutcome::Undecided)) => {
                    "nothing is wrong that was looked for, and not everything was".to_owned()
                }
                (None, _) => self.status.as_str().to_owned(),
            },
        };
        let remarks = report.into_iter().flat_map(RemoteReport::remarks);
        let unchanged = self.artifacts.contains_key(ORIGINAL).then(|| "  note: no model was made".to_owned());
        std::iter::once(head).chain(remarks).chain(unchanged).collect()
    }

    /// The exit code that says so.
    pub fn code(&self) -> u8 {
        if let Some(problem) = &self.problem {
            return match problem.code {
                ProblemKind::BadInput | ProblemKind::BadOutput => exit::BAD_INPUT,
                ProblemKind::NotPrintable => exit::NOT_PRINTABLE,
                _ => exit::INTERNAL,
            };
        }
        // What an analysis did not look for is not held against the file.
        let printable = self.outcome.is_some_and(|outcome| outcome.is_printable() != Some(false));
        if printable { exit::PRINTABLE } else { exit::PARTIAL }
    }
}

/// The name of a repair's result among a job's files.
const MODEL: &str = "model";
/// The name of the upload, where nothing made it better.
const ORIGINAL: &str = "original";
/// The name of a job's whole report among its files.
pub const REPORT: &str = "report-full.json";
