use std::sync::Arc;
use std::time::Duration;

use axum::http::header;
use tokio_util::sync::CancellationToken;

use super::admit::Auth;
use super::problem::{Problem, ProblemCode};
use super::rates::Rates;
use super::{Capabilities, Health};
use crate::access::TenantLimits;
use crate::blobs::Blobs;
use crate::format::Limits;
use crate::jobs::Store;
use crate::webhooks::Reach;

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
    pub webhook_reach: Reach,
    /// Longest silence in the middle of an upload.
    pub upload_idle: Duration,
    /// Whether uploads that are announced go straight to the store, where that is a bucket.
    pub presigned_uploads: bool,
    /// Whether downloads are sent on to the store, where that is a bucket.
    pub presigned_downloads: bool,
    /// How long to wait before looking for a change that no bell told of.
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
    /// Cancelled when this process has no more jobs to finish: requests that wait end.
    pub stopping: CancellationToken,
}

/// Seconds after which to send a request again that a stopping process refused. Mostly another process answers it then.
const RETRY_AFTER_S: u32 = 5;

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
}
