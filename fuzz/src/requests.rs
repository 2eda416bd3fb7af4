//! The HTTP surface on any request, without a socket: the router with a database and a folder of its own.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes, to_bytes};
use axum::http::{Method, Request, StatusCode, header};
use meshmend::access::{SystemIds, TenantLimits};
use meshmend::api::{ApiConfig, ApiState, Auth, Capabilities, Health, Rates, router};
use meshmend::blobs::Blobs;
use meshmend::format::Limits;
use meshmend::jobs::{RetryPolicy, SqliteStore, Store, SystemClock};
use meshmend::webhooks::TargetPolicy;
use metrics_exporter_prometheus::PrometheusBuilder;
use tempfile::TempDir;
use tokio::runtime::Runtime;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use super::choices::Choices;

/// Small, so that what is too large is met often.
const MAX_BYTES: u64 = 64 << 10;
/// Largest answer: the OpenAPI document's page has scripts.
const LARGEST_ANSWER: usize = 8 << 20;
/// Longest time for a request, which never waits for a job here.
const LONGEST: Duration = Duration::from_secs(10);

/// A service that lasts as long as its thread.
struct Service {
    runtime: Runtime,
    router: Router,
    data: TempDir,
}

thread_local! {
    static SERVICE: Service = Service::new();
}

/// Sends the bytes as a form whose boundary is `X`.
///
/// # Panics
/// Where a handler panics or takes too long; an answer is a fault of the service's or an error that says nothing; a request that
/// was refused leaves a file; or a job that was accepted can't be deleted with its files.
pub fn form(bytes: &[u8]) {
    let request = Request::post("/v1/jobs").header(header::CONTENT_TYPE, "multipart/form-data; boundary=X");
    SERVICE.with(|service| service.send(request, bytes));
}

/// Sends a request that the bytes spell: a line with method and address, lines with headers, an empty line, the body.
///
/// # Panics
/// As [`form`].
pub fn request(bytes: &[u8]) {
    let end = bytes.windows(2).position(|two| two == b"\n\n").unwrap_or(bytes.len());
    let Ok(head) = std::str::from_utf8(&bytes[..end]) else { return };
    let body = bytes.get(end + 2..).unwrap_or_default();
    let mut lines = head.split('\n');
    let Some((method, address)) = lines.next().and_then(|line| line.split_once(' ')) else { return };
    let mut request = Request::builder().method(method).uri(address);
    for (name, value) in lines.filter_map(|line| line.split_once(':')) {
        request = request.header(name, value.trim());
    }
    SERVICE.with(|service| service.send(request, body));
}

impl Service {
    fn new() -> Self {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let data = tempfile::tempdir().expect("a folder");
        let state = runtime.block_on(state(data.path()));
        Self { router: router(state), runtime, data }
    }

    fn send(&self, request: axum::http::request::Builder, body: &[u8]) {
        // What no HTTP library would hand on is none of the service's.
        let Ok(request) = request.body(in_pieces(body)) else { return };
        let left = self.runtime.block_on(async {
            let job = tokio::time::timeout(LONGEST, self.answer(request)).await.expect("an answer in time");
            if let Some(address) = job {
                let delete = Request::delete(&address).body(Body::empty()).expect("a request");
                let deleted = self.router.clone().oneshot(delete).await.expect("routers never fail");
                assert_eq!(deleted.status(), StatusCode::NO_CONTENT, "{address}");
            }
            files_in(&self.data.path().join("blobs"))
        });
        assert!(left.is_empty(), "files were left: {left:?}");
    }

    /// Sees that the answer is one that a client can use, and tells the address of the job that was made, if one was.
    async fn answer(&self, request: Request<Body>) -> Option<String> {
        let has_body = request.method() != Method::HEAD;
        let answer = self.router.clone().oneshot(request).await.expect("routers never fail");
        let status = answer.status();
        assert!(!status.is_server_error(), "{answer:?}");
        let (parts, body) = answer.into_parts();
        let text = to_bytes(body, LARGEST_ANSWER).await.expect("an answer that ends");
        if status.is_client_error() {
            assert_eq!(parts.headers[header::CONTENT_TYPE], "application/problem+json");
        }
        if status.is_client_error() && has_body {
            let problem: serde_json::Value = serde_json::from_slice(&text).expect("a problem is JSON");
            assert_eq!(problem["status"], status.as_u16());
            assert!(problem["detail"].as_str().is_some_and(|it| !it.is_empty() && it.len() < 4096), "{problem}");
        }
        if status != StatusCode::ACCEPTED {
            return None;
        }
        let job: serde_json::Value = serde_json::from_slice(&text).expect("a job is JSON");
        assert_eq!(job["status"], "queued", "{job}");
        Some(parts.headers[header::LOCATION].to_str().expect("an address").to_owned())
    }
}

/// The body in pieces, as it might come over a network, and now and then broken off.
fn in_pieces(body: &[u8]) -> Body {
    let mut choices = Choices::from(body);
    let longest = *choices.one(&[1, 7, 100, 4096, usize::MAX]) as u64;
    let end = if choices.below(8) == 0 { choices.below(body.len() as u64 + 1) } else { body.len() };
    let mut pieces: Vec<io::Result<Bytes>> = Vec::new();
    let mut rest = &body[..end];
    while !rest.is_empty() {
        let (piece, after) = rest.split_at(1 + choices.below(longest.min(rest.len() as u64)));
        pieces.push(Ok(Bytes::copy_from_slice(piece)));
        rest = after;
    }
    if end < body.len() {
        pieces.push(Err(io::ErrorKind::ConnectionReset.into()));
    }
    Body::from_stream(futures::stream::iter(pieces))
}

fn files_in(folder: &Path) -> Vec<std::path::PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    entries.flat_map(|path| if path.is_dir() { files_in(&path) } else { vec![path] }).collect()
}

async fn state(data: &Path) -> ApiState {
    let store = SqliteStore::open(&data.join("jobs.db"), Arc::new(SystemClock), RetryPolicy::default()).await;
    let store: Arc<dyn Store> = Arc::new(store.expect("a database"));
    let blobs = Blobs::local(&data.join("blobs")).expect("a folder");
    let limits = Limits { max_bytes: MAX_BYTES, ..Limits::default() };
    let max_files = 3;
    let health = Health {
        store: Arc::clone(&store),
        blobs: blobs.clone(),
        scratch: data.to_owned(),
        min_free: 0,
        startup_checks: BTreeMap::new(),
        draining: CancellationToken::new(),
        ids: Arc::new(SystemIds),
        metrics: PrometheusBuilder::new().build_recorder().handle(),
        classes: Default::default(),
    };
    // No request waits for a job, since none is ever worked on.
    let stopping = CancellationToken::new();
    stopping.cancel();
    ApiState {
        store,
        blobs,
        auth: Auth::Open,
        rates: Arc::new(Rates::default()),
        config: ApiConfig {
            limits,
            max_files,
            max_queued: u64::from(u32::MAX),
            tenant_limits: TenantLimits::default(),
            retention: Duration::from_secs(3600),
            min_free: 0,
            webhook_targets: TargetPolicy::Public,
            upload_idle: LONGEST,
            presigned_uploads: false,
            presigned_downloads: false,
            poll: LONGEST,
        },
        capabilities: Arc::new(Capabilities::new(limits, max_files, Err("none is asked for".to_owned()), None)),
        health,
        clock: Arc::new(SystemClock),
        ids: Arc::new(SystemIds),
        stopping,
    }
}
