use std::sync::Arc;
use std::time::Duration;

use metrics_exporter_prometheus::PrometheusHandle;
use tokio_util::sync::CancellationToken;

use super::Capabilities;
use crate::blobs::Blobs;
use crate::format::Limits;
use crate::jobs::JobStore;

/// What the API may spend on a request.
#[derive(Debug, Clone, Copy)]
pub struct ApiConfig {
    /// What an upload may hold.
    pub limits: Limits,
    /// Most files of one job.
    pub max_files: usize,
    /// Most jobs that may wait.
    pub max_queued: u64,
    /// Bytes that must stay free on the disk of the files.
    pub min_free: u64,
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
    pub store: Arc<dyn JobStore>,
    /// The files.
    pub blobs: Blobs,
    /// Limits and times.
    pub config: ApiConfig,
    /// What this service can do.
    pub capabilities: Arc<Capabilities>,
    /// Where the metrics are rendered.
    pub metrics: PrometheusHandle,
    /// Cancelled when the service stops: requests that wait end.
    pub stopping: CancellationToken,
}
