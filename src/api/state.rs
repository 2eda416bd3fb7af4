//! What every handler can reach: the stores, limits and clock of the service, and what it can do.

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
use crate::access::{TenantLimits, TenantName};
use crate::analyze::AnalyzeOptions;
use crate::blobs::Blobs;
use crate::format::{Format, Limits};
use crate::inspect::Level;
use crate::jobs::{Clock, Mode, Store};
use crate::repair::{Options, Preset, RemesherInfo};
use crate::sandbox::SandboxStatus;
use crate::webhooks::{Random, TargetPolicy};

/// What the API may spend on a request.
#[derive(Debug, Clone, Copy)]
pub struct ApiConfig {
    /// What an upload may hold.
    pub limits: Limits,
    /// Most files of one job.
    pub max_files: usize,
    /// Most jobs that may wait.
    pub max_queued: u64,
    /// What a tenant may use where nothing else is set for it.
    pub tenant_limits: TenantLimits,
    /// How long results are kept.
    pub retention: Duration,
    /// Bytes that must stay free on the disk of the files.
    pub min_free: u64,
    /// Whom webhooks may reach.
    pub webhook_targets: TargetPolicy,
    /// Longest silence in the middle of an upload.
    pub upload_idle: Duration,
    /// Whether uploads that are announced go straight to the store, where that is a bucket.
    pub presigned_uploads: bool,
    /// Whether downloads are sent on to the store, where that is a bucket.
    pub presigned_downloads: bool,
    /// How long to wait before polling for a change that no notification came for.
    pub poll: Duration,
}

/// What every handler can reach.
#[derive(Clone)]
pub struct ApiState {
    /// The jobs.
    pub store: Arc<dyn Store>,
    /// The files.
    pub blobs: Blobs,
    /// Whether it asks for keys.
    pub auth: Auth,
    /// How often each tenant asked lately.
    pub rates: Arc<Rates>,
    /// Limits and times.
    pub config: ApiConfig,
    /// What this service can do.
    pub capabilities: Arc<Capabilities>,
    /// What the probes and metrics say.
    pub health: Health,
    /// The wall clock.
    pub clock: Arc<dyn Clock>,
    /// Where secrets come from.
    pub random: Arc<dyn Random>,
    /// Cancelled when this process has no more jobs to finish: requests that wait end.
    pub stopping: CancellationToken,
}

/// Whether the service asks for keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Auth {
    /// Whoever asks without a key is the tenant `default` and may do everything.
    Open,
    /// Nothing without a key.
    Keys,
}

/// How a process is: what its probes and metrics say.
#[derive(Clone)]
pub struct Health {
    /// The jobs.
    pub store: Arc<dyn Store>,
    /// The files.
    pub blobs: Blobs,
    /// Where jobs get their scratch folders.
    pub scratch: PathBuf,
    /// Bytes that must stay free on the disks of the files and the scratch folders.
    pub min_free: u64,
    /// What was found at the start that does not make the process unready, such as whether there is a Blender.
    pub found: BTreeMap<&'static str, String>,
    /// Cancelled by the first signal to stop: from then on the process is not ready, serves reads and refuses the rest.
    pub draining: CancellationToken,
    /// Where the metrics are rendered.
    pub metrics: PrometheusHandle,
    /// Classes of tenants that the metrics have told of.
    pub classes: Arc<Mutex<BTreeSet<String>>>,
}

/// What this service can do right now.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Capabilities {
    /// Name and version of the engine.
    pub engine: String,
    /// Formats that can be sent.
    pub input_formats: Vec<Format>,
    /// Formats that can be asked for.
    pub output_formats: Vec<Format>,
    /// What a job can do.
    pub modes: Vec<Mode>,
    /// Presets of a repair.
    pub presets: Vec<Preset>,
    /// Levels of an analysis.
    pub levels: Vec<Level>,
    /// The tiers and whether they work.
    pub tiers: Vec<TierStatus>,
    /// Limits on an upload.
    pub limits: UploadLimits,
    /// What holds each job's processes; absent where jobs run in other processes than this one (`meshmend work`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sandbox: Option<SandboxStatus>,
    /// Every option of a repair with its default.
    pub default_options: Options,
    /// Every option of an analysis with its default.
    pub default_analyze_options: AnalyzeOptions,
}

/// One tier.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct TierStatus {
    /// Its number, 1 to 3.
    pub tier: u8,
    /// What it is.
    pub name: &'static str,
    /// Whether it works.
    pub available: bool,
    /// Why it does not, or what a person should know.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub detail: Option<String>,
    /// The program behind it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program: Option<RemesherInfo>,
}

/// Limits on an upload.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct UploadLimits {
    /// Largest upload in bytes: one file, or all files of a job together.
    pub max_bytes: u64,
    /// Most files of an analysis.
    pub max_files: usize,
    /// Most triangles of a file.
    pub max_file_faces: u64,
    /// Most vertices of a file.
    pub max_file_vertices: u64,
}

impl Capabilities {
    /// `remesher` is tier 3, or why there is none.
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
            ],
            levels: vec![Level::None, Level::Basic, Level::Full],
            tiers: vec![
                tier(1, "clean", true),
                tier(2, "mend", true),
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

/// Header fields of the IETF draft `ratelimit-headers`.
const RATE_POLICY: HeaderName = HeaderName::from_static("ratelimit-policy");
const RATE_STATE: HeaderName = HeaderName::from_static("ratelimit");
/// The window of a policy, in seconds.
const WINDOW_S: u32 = 60;

type Bucket = RateLimiter<NotKeyed, InMemoryState, DefaultClock, StateInformationMiddleware>;

/// A bucket of requests for each tenant that asked, refilled evenly.
#[derive(Default)]
pub struct Rates {
    buckets: Mutex<HashMap<TenantName, (NonZeroU32, Arc<Bucket>)>>,
}

/// What is left to a tenant after a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct RateState {
    /// Requests in a window.
    of: u32,
    /// Requests that may still come at once.
    requests: u32,
    /// Seconds until all of them are there again, or after a refusal until the next.
    seconds: u64,
}

impl Rates {
    /// Takes one request out of the tenant's `per_minute`.
    ///
    /// # Errors
    /// What is left, where that is nothing.
    pub(super) fn take(&self, tenant: &TenantName, per_minute: NonZeroU32) -> Result<RateState, RateState> {
        let bucket = {
            let mut buckets = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
            let new = || {
                let bucket = RateLimiter::direct(Quota::per_minute(per_minute));
                (per_minute, Arc::new(bucket.with_middleware::<StateInformationMiddleware>()))
            };
            let known = buckets.entry(tenant.clone()).or_insert_with(new);
            if known.0 != per_minute {
                *known = new();
            }
            Arc::clone(&known.1)
        };
        let of = per_minute.get();
        match bucket.check() {
            Ok(state) => {
                let requests = state.remaining_burst_capacity();
                let used = u64::from(of.saturating_sub(requests));
                Ok(RateState { of, requests, seconds: (used * u64::from(WINDOW_S)).div_ceil(u64::from(of)) })
            }
            Err(refused) => {
                let wait = refused.wait_time_from(DefaultClock::default().now());
                Err(RateState { of, requests: 0, seconds: wait.as_secs() + 1 })
            }
        }
    }
}

impl RateState {
    /// Writes it into the header of an answer.
    pub fn write_headers(self, response: &mut Response) {
        let fields = [
            (RATE_POLICY, format!("\"tenant\";q={};w={WINDOW_S}", self.of)),
            (RATE_STATE, format!("\"tenant\";r={};t={}", self.requests, self.seconds)),
        ];
        for (name, value) in fields {
            if let Ok(value) = HeaderValue::from_str(&value) {
                response.headers_mut().insert(name, value);
            }
        }
    }

    /// The problem that nothing is left.
    pub fn refused(self) -> Problem {
        let detail = format!("More than {} requests came within a minute. Ask again in {} s.", self.of, self.seconds);
        let seconds = u32::try_from(self.seconds).unwrap_or(WINDOW_S);
        Problem::new(ProblemCode::RateLimited, detail).retry_after(seconds)
    }
}

/// Seconds after which to send a request again that a stopping process refused. Mostly another process answers it then.
const RETRY_AFTER_S: u32 = 5;
/// Seconds after which a client may try again where there was no room.
const BUSY_RETRY_AFTER_S: u32 = 30;

impl ApiState {
    /// Refuses requests that begin new work while the process stops.
    pub(super) fn accept_work(&self) -> Result<(), Problem> {
        if !self.health.draining.is_cancelled() {
            return Ok(());
        }
        let detail = "This process is stopping and accepts no new work. Send the request again.";
        Err(Problem::new(ProblemCode::Unavailable, detail)
            .retry_after(RETRY_AFTER_S)
            .with_header(header::CONNECTION, "close"))
    }
    /// Whether the disk has room for so many bytes more.
    pub(super) fn check_free_space(&self, bytes: u64) -> Result<(), Problem> {
        let free = self.blobs.free_bytes().map_err(|error| Problem::internal(&error))?;
        if free.is_some_and(|free| free < self.config.min_free.saturating_add(bytes)) {
            let detail = "The service has no room for more files now. Send the model again later.";
            return Err(busy(ProblemCode::StorageFull, detail));
        }
        Ok(())
    }
}

/// That a job may be taken later. The upload is not read.
pub(super) fn busy(code: ProblemCode, detail: impl Into<String>) -> Problem {
    Problem::new(code, detail).retry_after(BUSY_RETRY_AFTER_S).with_header(header::CONNECTION, "close")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenant_that_asks_too_often_is_refused_and_others_are_not() {
        let rates = Rates::default();
        let (busy, calm): (TenantName, TenantName) = ("busy".parse().expect("a name"), "calm".parse().expect("a name"));
        let three = NonZeroU32::new(3).expect("three");
        for left in [2, 1, 0] {
            assert_eq!(rates.take(&busy, three).map(|state| state.requests), Ok(left));
        }
        let refused = rates.take(&busy, three).expect_err("nothing is left");
        assert!((1..=21).contains(&refused.seconds), "{refused:?}");
        assert!(rates.take(&calm, three).is_ok());
        assert!(rates.take(&busy, NonZeroU32::new(100).expect("a hundred")).is_ok(), "a new limit holds at once");
    }
}
