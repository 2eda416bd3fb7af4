//! The HTTP client of `submit` and `watch`.

use std::path::Path;
use std::time::Duration;

use backon::{BackoffBuilder, ExponentialBuilder};
use bytes::Bytes;
use clap::Args;
use futures::{Stream, StreamExt};
use meshmend::jobs::{JobId, Status};
use reqwest::{Body, Client, RequestBuilder, Response, header};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use tokio_util::io::ReaderStream;
use url::Url;

use super::error::RemoteError;
use super::job::RemoteJob;

/// Time limit for connecting.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Time limit for an answer, except for long polls.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(30);
/// Longest time without data, while receiving and while sending. Event streams send a keep-alive every 15 seconds.
const IDLE_TIMEOUT: Duration = Duration::from_secs(45);
/// Seconds of a long poll: the service delays its answer until the status of the job changes.
const LONG_POLL_S: u64 = 20;
/// Bytes per read of an upload.
const CHUNK_BYTES: usize = 256 << 10;
/// Delays between retries, unless the service names a longer delay.
const BACKOFF: ExponentialBuilder = ExponentialBuilder::new()
    .with_min_delay(Duration::from_millis(500))
    .with_max_delay(Duration::from_secs(15))
    .with_jitter()
    .without_max_times();

/// The address of the service and the key.
#[derive(Debug, Args)]
pub struct ServiceArgs {
    /// Address of the service.
    #[arg(long, env = "MESHMEND_SERVER", value_name = "URL", default_value = "http://127.0.0.1:8080", value_parser = parse_server)]
    pub server: Url,
    /// API key, if the service requires one. Other users of this machine can read command lines, so prefer the
    /// environment variable or --api-key-file.
    #[arg(long, env = "MESHMEND_API_KEY", value_name = "KEY", hide_env_values = true, conflicts_with = "api_key_file")]
    api_key: Option<String>,
    /// File that contains only the API key.
    #[arg(long, env = "MESHMEND_API_KEY_FILE", value_name = "FILE")]
    api_key_file: Option<std::path::PathBuf>,
    /// Seconds to keep retrying one request while the service is unreachable, busy or full.
    #[arg(long, env = "MESHMEND_TIMEOUT_S", value_name = "SECONDS", default_value_t = 60)]
    timeout_s: u32,
}

impl ServiceArgs {
    /// Creates a client of the service.
    ///
    /// # Errors
    /// The key is unreadable or malformed.
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
                .map_err(|_| RemoteError::Local("the API key contains invalid characters".to_owned()))?;
            value.set_sensitive(true);
            headers.insert(header::AUTHORIZATION, value);
        }
        let http = Client::builder()
            .user_agent(concat!("meshmend/", env!("CARGO_PKG_VERSION")))
            .default_headers(headers)
            .connect_timeout(CONNECT_TIMEOUT)
            .tcp_user_timeout(IDLE_TIMEOUT)
            .build()
            .map_err(|error| RemoteError::local("cannot create an HTTP client", error))?;
        Ok(Service { http, server: self.server.clone(), max_wait: Duration::from_secs(u64::from(self.timeout_s)) })
    }
}

/// Parses `--server`. A path is allowed; a user and a password are not.
fn parse_server(text: &str) -> Result<Url, String> {
    let mut url =
        Url::parse(text).map_err(|error| format!("{error}; expected an address such as https://meshmend.example"))?;
    if !["http", "https"].contains(&url.scheme()) || !url.has_host() {
        return Err("expected an address such as https://meshmend.example".to_owned());
    }
    if !url.username().is_empty() || url.password().is_some() {
        return Err("the address must not contain a user or password; set MESHMEND_API_KEY instead".to_owned());
    }
    if !url.path().ends_with('/') {
        url.set_path(&format!("{}/", url.path()));
    }
    Ok(url)
}

/// A client of one service.
#[derive(Debug, Clone)]
pub struct Service {
    http: Client,
    server: Url,
    max_wait: Duration,
}

/// A file to submit as a job.
#[derive(Debug)]
pub struct Submission<'a> {
    /// The local file.
    pub path: &'a Path,
    /// The file name that the service gets.
    pub name: &'a str,
    /// Mode and options, as query fields.
    pub options: &'a [(String, String)],
    /// The idempotency key: retries with the same key give the same job.
    pub key: &'a str,
}

impl Service {
    /// The address as the user gave it, without a final slash.
    pub fn address(&self) -> &str {
        self.server.as_str().trim_end_matches('/')
    }

    /// Retries `attempt` with backoff while its error is transient, for at most `--timeout-s` seconds. `on_retry` gets each error and the
    /// delay before the next attempt.
    ///
    /// # Errors
    /// The last error.
    pub async fn retry_with_backoff<T>(
        &self,
        mut on_retry: impl FnMut(&RemoteError, Duration),
        mut attempt: impl AsyncFnMut() -> Result<T, RemoteError>,
    ) -> Result<T, RemoteError> {
        let (mut delays, mut waited) = (BACKOFF.build(), Duration::ZERO);
        loop {
            let error = match attempt().await {
                Err(error) if error.is_transient() => error,
                done => return done,
            };
            let Some(delay) = delays.next().map(|delay| delay.max(error.retry_after().unwrap_or_default())) else {
                return Err(error);
            };
            waited += delay;
            if waited > self.max_wait {
                return Err(error);
            }
            on_retry(&error, delay);
            tokio::time::sleep(delay).await;
        }
    }

    /// The largest file that the service accepts, in bytes.
    pub async fn max_bytes(&self) -> Result<u64, RemoteError> {
        #[derive(Deserialize)]
        struct Capabilities {
            limits: Limits,
        }
        #[derive(Deserialize)]
        struct Limits {
            max_bytes: u64,
        }
        let capabilities: Capabilities = self.json(self.get("v1/capabilities").timeout(ANSWER_TIMEOUT)).await?;
        Ok(capabilities.limits.max_bytes)
    }

    /// Submits a file as a job. `sent` gets the number of bytes sent since its last call.
    pub async fn submit(
        &self,
        submission: &Submission<'_>,
        sent: impl Fn(u64) + Send + Sync + 'static,
    ) -> Result<RemoteJob, RemoteError> {
        let unreadable = |error: std::io::Error| RemoteError::Local(error.to_string());
        let file = tokio::fs::File::open(submission.path).await.map_err(unreadable)?;
        let bytes = file.metadata().await.map_err(unreadable)?.len();
        let chunks = ReaderStream::with_capacity(file, CHUNK_BYTES).inspect(move |chunk| {
            if let Ok(chunk) = chunk {
                sent(chunk.len() as u64);
            }
        });
        let mut url = self.url("v1/jobs");
        url.query_pairs_mut().append_pair("name", submission.name).extend_pairs(submission.options);
        let request = self
            .http
            .post(url)
            .header(header::CONTENT_TYPE, "application/octet-stream")
            .header(header::CONTENT_LENGTH, bytes)
            .header("idempotency-key", submission.key);
        self.json(request.body(Body::wrap_stream(chunks))).await
    }

    /// A job. With `long_poll`, the answer waits until the status of the job changes.
    pub async fn job(&self, id: JobId, long_poll: bool) -> Result<RemoteJob, RemoteError> {
        let wait = if long_poll { LONG_POLL_S } else { 0 };
        let request = self.get(&format!("v1/jobs/{id}?include=report&wait={wait}"));
        self.json(request.timeout(ANSWER_TIMEOUT + Duration::from_secs(wait))).await
    }

    /// Jobs with a status, newest first.
    pub async fn jobs(&self, status: Status) -> Result<Vec<RemoteJob>, RemoteError> {
        #[derive(Deserialize)]
        struct Page {
            jobs: Vec<RemoteJob>,
        }
        let request = self.get(&format!("v1/jobs?limit=50&status={}", status.as_str()));
        Ok(self.json::<Page>(request.timeout(ANSWER_TIMEOUT)).await?.jobs)
    }

    /// The event stream of a job, as server-sent events.
    pub async fn events(&self, id: JobId) -> Result<impl Stream<Item = Result<Bytes, RemoteError>>, RemoteError> {
        Ok(self.chunks(self.open_stream(self.get(&format!("v1/jobs/{id}/events?include=report"))).await?))
    }

    /// The bytes of a file of a job.
    pub async fn file(
        &self,
        id: JobId,
        name: &str,
    ) -> Result<impl Stream<Item = Result<Bytes, RemoteError>>, RemoteError> {
        Ok(self.chunks(self.open_stream(self.get(&format!("v1/jobs/{id}/artifacts/{name}"))).await?))
    }

    /// The URL of a path below the address.
    fn url(&self, path: &str) -> Url {
        self.server.join(path).unwrap_or_else(|_| self.server.clone())
    }

    fn get(&self, path: &str) -> RequestBuilder {
        self.http.get(self.url(path))
    }

    fn connection_error(&self, error: &reqwest::Error) -> RemoteError {
        RemoteError::unreachable(self.address(), error)
    }

    async fn send(&self, request: RequestBuilder) -> Result<Response, RemoteError> {
        let response = request.send().await.map_err(|error| self.connection_error(&error))?;
        if response.status().is_success() {
            return Ok(response);
        }
        Err(RemoteError::of(self.address(), response).await)
    }

    async fn json<T: DeserializeOwned>(&self, request: RequestBuilder) -> Result<T, RemoteError> {
        let response = self.send(request).await?;
        let status = response.status();
        let body = response.bytes().await.map_err(|error| self.connection_error(&error))?;
        let not_meshmend = || RemoteError::NotMeshmend { server: self.address().to_owned(), status, retry_after: None };
        serde_json::from_slice(&body).map_err(|_| not_meshmend())
    }

    /// Sends a request with a long answer: the time limit covers only the start of the answer.
    async fn open_stream(&self, request: RequestBuilder) -> Result<Response, RemoteError> {
        let answer = tokio::time::timeout(ANSWER_TIMEOUT, self.send(request)).await;
        answer.unwrap_or_else(|_| Err(RemoteError::silent(self.address())))
    }

    /// The bytes of an answer. A pause longer than the idle timeout is an error.
    fn chunks(&self, response: Response) -> impl Stream<Item = Result<Bytes, RemoteError>> + use<> {
        let client = self.clone();
        let chunks = Box::pin(response.bytes_stream());
        futures::stream::unfold(Some((chunks, client)), |state| async {
            let (mut chunks, client) = state?;
            match tokio::time::timeout(IDLE_TIMEOUT, chunks.next()).await {
                Err(_) => Some((Err(RemoteError::silent(client.address())), None)),
                Ok(None) => None,
                Ok(Some(Err(error))) => Some((Err(client.connection_error(&error)), None)),
                Ok(Some(Ok(chunk))) => Some((Ok(chunk), Some((chunks, client)))),
            }
        })
    }
}
