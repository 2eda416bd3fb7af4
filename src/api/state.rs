//! The state shared by all handlers: stores, configuration, clock, rate limits, and the service's capabilities.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use axum::http::{HeaderName, HeaderValue, header};
use axum::response::Response;
use governor::clock::{Clock as _, DefaultClock};
use governor::middleware::StateInformationMiddleware;
use governor::state::{InMemoryState, NotKeyed};
use governor::{Quota, RateLimiter};
use metrics_exporter_prometheus::PrometheusHandle;
use serde::Serialize;
use tokio_util::sync::CancellationToken;
use utoipa::ToSchema;

use super::problem::{Problem, ProblemCode};
use crate::access::{IdSource, TenantLimits, TenantName};
use crate::analyze::AnalyzeOptions;
use crate::blobs::Blobs;
use crate::format::{Format, Limits};
use crate::inspect::Level;
use crate::jobs::{Clock, Mode, Store};
use crate::repair::{Options, Preset, RemesherInfo};
use crate::sandbox::SandboxStatus;
use crate::webhooks::TargetPolicy;

/// Limits and timeouts of the API.
#[derive(Debug, Clone, Copy)]
pub struct ApiConfig {
    /// Limits on the size and contents of an uploaded file.
    pub limits: Limits,
    /// Maximum number of files per job.
    pub max_files: usize,
    /// Maximum number of queued jobs, over all tenants.
    pub max_queued: u64,
    /// Limits of tenants without their own settings.
    pub tenant_limits: TenantLimits,
    /// How long results are kept after a job ends.
    pub retention: Duration,
    /// Bytes that must stay free on the disk of the file store.
    pub min_free: u64,
    /// Which addresses webhooks may be sent to.
    pub webhook_targets: TargetPolicy,
    /// Longest time without any bytes during an upload.
    pub upload_idle: Duration,
    /// Whether clients send announced uploads directly to the bucket, if the file store is one.
    pub presigned_uploads: bool,
    /// Whether downloads are redirected to the bucket, if the file store is one.
    pub presigned_downloads: bool,
    /// Poll interval for job changes that no notification reported.
    pub poll: Duration,
}

/// The state shared by all handlers.
#[derive(Clone)]
pub struct ApiState {
    /// The database: jobs, keys, tenants, webhooks.
    pub store: Arc<dyn Store>,
    /// The file store.
    pub blobs: Blobs,
    /// Whether requests need an API key.
    pub auth: Auth,
    /// Rate limiters of the tenants.
    pub rates: Arc<Rates>,
    /// Limits and timeouts.
    pub config: ApiConfig,
    /// The service's formats, modes, tiers and limits.
    pub capabilities: Arc<Capabilities>,
    /// Data for probes and metrics.
    pub health: Health,
    /// The wall clock.
    pub clock: Arc<dyn Clock>,
    /// The source of ids and secrets.
    pub ids: Arc<dyn IdSource>,
    /// Cancelled when this process has no more jobs to finish. Requests that are waiting then end.
    pub stopping: CancellationToken,
}

/// Whether requests need an API key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Auth {
    /// A request without a key acts as the tenant `default`, with every scope but `admin`.
    Open,
    /// Every request needs a key.
    Keys,
}

/// The health of a process, as reported by its probes and metrics.
#[derive(Clone)]
pub struct Health {
    /// The database.
    pub store: Arc<dyn Store>,
    /// The file store.
    pub blobs: Blobs,
    /// The parent of the jobs' scratch folders.
    pub scratch: PathBuf,
    /// Bytes that must stay free on the disks of the file store and of the scratch folders.
    pub min_free: u64,
    /// Results of startup checks that do not affect readiness, such as whether Blender is available.
    pub startup_checks: BTreeMap<&'static str, String>,
    /// Cancelled by the first stop signal. The process is then not ready, serves reads and rejects other requests.
    pub draining: CancellationToken,
    /// Source of the names of files that the probes write.
    pub ids: Arc<dyn IdSource>,
    /// Renders the metrics.
    pub metrics: PrometheusHandle,
    /// Tenant classes that the metrics have reported so far.
    pub classes: Arc<Mutex<BTreeSet<String>>>,
}

/// What this service supports.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Capabilities {
    /// Name and version of the engine.
    pub engine: String,
    /// Supported input formats.
    pub input_formats: Vec<Format>,
    /// Supported output formats.
    pub output_formats: Vec<Format>,
    /// Job modes.
    pub modes: Vec<Mode>,
    /// Repair presets.
    pub presets: Vec<Preset>,
    /// Analysis levels.
    pub levels: Vec<Level>,
    /// The repair tiers and their availability.
    pub tiers: Vec<TierStatus>,
    /// Limits on uploads.
    pub limits: UploadLimits,
    /// The sandbox of job processes. Absent if jobs run in a separate worker (`meshmend work`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sandbox: Option<SandboxStatus>,
    /// Every repair option with its default.
    pub default_options: Options,
    /// Every analysis option with its default.
    pub default_analyze_options: AnalyzeOptions,
}

/// A repair tier.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct TierStatus {
    /// The tier's number, 1 to 3.
    pub tier: u8,
    /// The tier's name.
    pub name: &'static str,
    /// Whether the tier is available.
    pub available: bool,
    /// Why the tier is unavailable, or other details.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detail: Option<String>,
    /// The external program that the tier runs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program: Option<RemesherInfo>,
}

/// Limits on uploads.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct UploadLimits {
    /// Maximum upload size in bytes, for all files of a job together.
    pub max_bytes: u64,
    /// Maximum number of files of an analysis.
    pub max_files: usize,
    /// Maximum number of triangles per file.
    pub max_file_faces: u64,
    /// Maximum number of vertices per file.
    pub max_file_vertices: u64,
}

impl Capabilities {
    /// Collects the capabilities. `remesher` is the program of tier 3, or the reason why it is unavailable.
    #[must_use]
    pub fn new(
        limits: Limits,
        max_files: usize,
        remesher: Result<RemesherInfo, String>,
        sandbox: Option<SandboxStatus>,
    ) -> Self {
        let formats = Format::ALL.to_vec();
        let (program, missing) = match remesher {
            Ok(info) => (Some(info), None),
            Err(reason) => (None, Some(reason)),
        };
        let tier = |tier, name, available| TierStatus { tier, name, available, detail: None, program: None };
        Self {
            engine: crate::ENGINE.to_owned(),
            input_formats: formats.clone(),
            output_formats: formats,
            modes: Mode::ALL.to_vec(),
            presets: vec![
                Preset::Auto,
                Preset::BasicCleanup,
                Preset::FillHoles,
                Preset::FullRepair,
                Preset::ConservativeRepair,
                Preset::ManifoldRepair,
                Preset::BlenderRemesh,
                Preset::Generated,
            ],
            levels: vec![Level::None, Level::Basic, Level::Full],
            tiers: vec![
                tier(1, "cleanup", true),
                tier(2, "repair", true),
                TierStatus { detail: missing, available: program.is_some(), program, ..tier(3, "Blender", false) },
            ],
            limits: UploadLimits {
                max_bytes: limits.max_bytes,
                max_files,
                max_file_faces: limits.max_faces,
                max_file_vertices: limits.max_vertices,
            },
            sandbox,
            default_options: Options::default(),
            default_analyze_options: AnalyzeOptions::default(),
        }
    }
}

/// Response headers: "RateLimit header fields for HTTP", IETF draft.
const RATE_POLICY: HeaderName = HeaderName::from_static("ratelimit-policy");
const RATE_STATE: HeaderName = HeaderName::from_static("ratelimit");
/// Window of the rate limit, in seconds.
const WINDOW_S: u32 = 60;

/// A token bucket of requests.
type Bucket = RateLimiter<NotKeyed, InMemoryState, DefaultClock, StateInformationMiddleware>;

/// One token bucket of requests per tenant, refilled evenly.
#[derive(Default)]
pub struct Rates {
    buckets: Mutex<HashMap<TenantName, (NonZeroU32, Arc<Bucket>)>>,
}

/// The state of a tenant's rate limit after a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct RateState {
    /// Requests allowed per window.
    limit: u32,
    /// Requests that may be sent immediately.
    remaining: u32,
    /// Seconds until the bucket is full, or after a rejection until the next request is allowed.
    reset_s: u64,
}

impl Rates {
    /// Takes one request from the tenant's budget of `per_minute` requests.
    ///
    /// # Errors
    /// The state of the limit, if no request remains.
    pub(super) fn take(&self, tenant: &TenantName, per_minute: NonZeroU32) -> Result<RateState, RateState> {
        let bucket = {
            let mut buckets = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
            let new = || {
                let bucket = RateLimiter::direct(Quota::per_minute(per_minute));
                (per_minute, Arc::new(bucket.with_middleware::<StateInformationMiddleware>()))
            };
            let entry = buckets.entry(tenant.clone()).or_insert_with(new);
            if entry.0 != per_minute {
                *entry = new();
            }
            Arc::clone(&entry.1)
        };
        let limit = per_minute.get();
        match bucket.check() {
            Ok(state) => {
                let remaining = state.remaining_burst_capacity();
                let used = u64::from(limit.saturating_sub(remaining));
                let reset_s = (used * u64::from(WINDOW_S)).div_ceil(u64::from(limit));
                Ok(RateState { limit, remaining, reset_s })
            }
            Err(rejected) => {
                let wait = rejected.wait_time_from(DefaultClock::default().now());
                Err(RateState { limit, remaining: 0, reset_s: wait.as_secs() + 1 })
            }
        }
    }
}

impl RateState {
    /// Adds the rate limit headers to a response.
    pub fn write_headers(self, response: &mut Response) {
        let fields = [
            (RATE_POLICY, format!("\"tenant\";q={};w={WINDOW_S}", self.limit)),
            (RATE_STATE, format!("\"tenant\";r={};t={}", self.remaining, self.reset_s)),
        ];
        for (name, value) in fields {
            if let Ok(value) = HeaderValue::from_str(&value) {
                response.headers_mut().insert(name, value);
            }
        }
    }

    /// Creates the problem for a request above the limit.
    pub fn to_problem(self) -> Problem {
        let detail =
            format!("The limit of {} requests per minute is exceeded. Retry in {} s.", self.limit, self.reset_s);
        let seconds = u32::try_from(self.reset_s).unwrap_or(WINDOW_S);
        Problem::new(ProblemCode::RateLimited, detail).retry_after(seconds)
    }
}

/// Seconds to wait after a stopping process rejected a request. Usually another process handles the retry.
const RETRY_AFTER_S: u32 = 5;
/// Seconds to wait while the queue or the disk is full.
const BUSY_RETRY_AFTER_S: u32 = 30;

impl ApiState {
    /// Checks that the process accepts new work.
    ///
    /// # Errors
    /// `unavailable` while the process is stopping.
    pub(super) fn accept_work(&self) -> Result<(), Problem> {
        if !self.health.draining.is_cancelled() {
            return Ok(());
        }
        let detail = "This process is stopping and accepts no new work. Retry; another process may accept the request.";
        Err(Problem::new(ProblemCode::Unavailable, detail)
            .retry_after(RETRY_AFTER_S)
            .with_header(header::CONNECTION, "close"))
    }
    /// Checks that the disk has space for `bytes` more.
    ///
    /// # Errors
    /// `storage_full` if it has not.
    pub(super) fn check_free_space(&self, bytes: u64) -> Result<(), Problem> {
        let free = self.blobs.free_bytes().map_err(|error| Problem::internal(&error))?;
        if free.is_some_and(|free| free < self.config.min_free.saturating_add(bytes)) {
            let detail = "The service's disk is full. Send the model again later.";
            return Err(busy(ProblemCode::StorageFull, detail));
        }
        Ok(())
    }
}

/// Creates a problem for a full queue or disk. The connection is closed, since the upload is not read.
pub(super) fn busy(code: ProblemCode, detail: impl Into<String>) -> Problem {
    Problem::new(code, detail).retry_after(BUSY_RETRY_AFTER_S).with_header(header::CONNECTION, "close")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenant_above_its_rate_limit_is_rejected_and_others_are_not() {
        let rates = Rates::default();
        let (busy, calm): (TenantName, TenantName) = ("busy".parse().expect("a name"), "calm".parse().expect("a name"));
        let three = NonZeroU32::new(3).expect("three");
        for remaining in [2, 1, 0] {
            assert_eq!(rates.take(&busy, three).map(|state| state.remaining), Ok(remaining));
        }
        let rejected = rates.take(&busy, three).expect_err("no request remains");
        assert!((1..=21).contains(&rejected.reset_s), "{rejected:?}");
        assert!(rates.take(&calm, three).is_ok());
        assert!(rates.take(&busy, NonZeroU32::new(100).expect("a hundred")).is_ok(), "a new limit applies immediately");
    }
}
