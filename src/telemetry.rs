//! Observability: the service's metrics, and trace propagation from a request to its worker.

use std::collections::HashMap;

use opentelemetry::propagation::TextMapPropagator;
use opentelemetry::trace::{Status, TraceContextExt};
use opentelemetry_sdk::propagation::TraceContextPropagator;
use serde::Serialize;
use serde_json::Value;
use tracing::Span;
use tracing_opentelemetry::OpenTelemetrySpanExt;

/// The type of a metric.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MetricKind {
    /// A value that only grows, from 0 at the start of the process.
    Counter,
    /// The current value.
    Gauge,
    /// A distribution of values in buckets.
    Histogram,
}

/// A metric of `/metrics`.
#[derive(Debug, Clone, Copy)]
pub struct Metric {
    /// The metric's name.
    pub name: &'static str,
    /// The metric's type.
    pub kind: MetricKind,
    /// The labels of the metric's series.
    pub labels: &'static [&'static str],
    /// The help text in `/metrics`.
    pub help: &'static str,
}

macro_rules! metrics {
    ($($constant:ident: $kind:ident $name:literal [$($label:literal),*] $help:literal;)*) => {
        $(#[doc = $help] pub const $constant: &str = $name;)*

        /// All metrics of the service.
        pub const METRICS: &[Metric] =
            &[$(Metric { name: $name, kind: MetricKind::$kind, labels: &[$($label),*], help: $help }),*];
    };
}

metrics! {
    BUILD_INFO: Gauge "meshmend_build_info" ["version"] "Always 1. The label `version` is the program's version.";
    JOBS: Gauge "meshmend_jobs" ["status"] "Jobs in the database by status, except deleted ones. Every process reports the same value.";
    QUEUE_WAIT: Gauge "meshmend_queue_wait_seconds" [] "Waiting time of the oldest queued job that is due, 0 if no job is queued. Every process reports the same value.";
    CLASS_JOBS: Gauge "meshmend_class_jobs" ["class", "status"] "Jobs that are `queued` and `running`, by tenant class as set by `meshmend tenants set shop --class gold`. Every process reports the same value.";
    CLASS_QUEUE_WAIT: Gauge "meshmend_class_queue_wait_seconds" ["class"] "Waiting time of a tenant class's oldest queued job that is due, 0 if no job is queued. Every process reports the same value.";
    JOBS_SUBMITTED: Counter "meshmend_jobs_submitted_total" ["reused"] "Accepted jobs. `reused` is `true` if an earlier job's result was reused.";
    UPLOAD_BYTES: Histogram "meshmend_upload_bytes" [] "Total size in bytes of an accepted job's files.";
    HTTP_REQUEST: Histogram "meshmend_http_request_seconds" ["method", "route", "status"] "Time from receiving a request's headers to sending the response headers, by route template.";
    RATE_LIMITED: Counter "meshmend_rate_limited_total" [] "Requests rejected because their tenant exceeded its rate limit.";
    KEYS_REFUSED: Counter "meshmend_keys_refused_total" [] "Requests rejected because their key is unknown, revoked or expired.";
    JOB_WAIT: Histogram "meshmend_job_wait_seconds" [] "Time from a job's acceptance to its first claim by a worker.";
    WORKER_SLOTS: Gauge "meshmend_worker_slots" ["state"] "Job slots of this process, `busy` and `idle`.";
    ATTEMPT: Histogram "meshmend_attempt_seconds" [] "Time from a worker's claim of a job to the end of the attempt.";
    ATTEMPTS: Counter "meshmend_attempts_total" ["status", "outcome"] "Attempts that ended, by the job's new status (`queued` if it will be retried) and outcome (empty if the attempt produced none).";
    ATTEMPTS_DROPPED: Counter "meshmend_attempts_dropped_total" [] "Attempts discarded because the job was canceled, deleted or given to another worker in the meantime.";
    LEASES_LOST: Counter "meshmend_leases_lost_total" [] "Jobs of lost workers that this process requeued or marked as failed.";
    STEP: Histogram "meshmend_step_seconds" ["tier", "action"] "Duration of a repair step, by tier (0 is validation) and action.";
    STEPS: Counter "meshmend_steps_total" ["tier", "action", "status"] "Repair steps by result: `done`, `failed`, `reverted`, `skipped`.";
    CHILD_CRASHES: Counter "meshmend_child_crashes_total" ["reason"] "Repair processes that ended without a result: `out_of_memory`, `cpu_limit`, `file_limit`, `crashed`.";
    KILLS: Counter "meshmend_kills_total" ["reason"] "Repair processes that were killed: `deadline`, `lease_lost`, `shutdown`, or for exceeding the limit of `scratch` space or `processes`.";
    BLENDER_RUNS: Counter "meshmend_blender_runs_total" [] "Blender processes started by repairs.";
    BLENDER_RESTARTS: Counter "meshmend_blender_restarts_total" [] "Blender processes restarted after a crash. Included in `meshmend_blender_runs_total`.";
    WEBHOOK_DELIVERIES: Counter "meshmend_webhook_deliveries_total" ["result"] "Webhook delivery attempts by result: `delivered`, `retried`, `failed`, `gone`.";
    WEBHOOK: Histogram "meshmend_webhook_seconds" [] "Duration of a webhook delivery attempt.";
    WEBHOOK_BACKLOG: Gauge "meshmend_webhook_backlog" [] "Webhook messages that have not been delivered yet. Every process reports the same value.";
    WEBHOOK_OVERDUE: Gauge "meshmend_webhook_overdue_seconds" [] "Time for which the oldest due webhook message has been due. Every process reports the same value.";
    SWEEP: Histogram "meshmend_sweep_seconds" [] "Duration of a sweep, which removes expired data.";
    SWEPT: Counter "meshmend_swept_total" ["item"] "Items removed by sweeps: `expired` files of jobs, `records` of old jobs, webhook `messages`, and `orphaned` files without a job.";
    STORE_ERRORS: Counter "meshmend_store_errors_total" ["kind"] "Database errors: `transient`, where a retry may succeed, and `other`.";
    BLOB_ERRORS: Counter "meshmend_blob_errors_total" [] "File store errors, except missing files.";
    DATABASE_CONNECTIONS: Gauge "meshmend_database_connections" ["state"] "Database connections of this process, `busy` and `idle`.";
    DATABASE_CONNECTIONS_MAX: Gauge "meshmend_database_connections_max" [] "Maximum number of database connections of this process.";
    PROCESS_CPU: Counter "process_cpu_seconds_total" [] "CPU time used by this process, in whole seconds. Jobs run in separate processes, which are not included.";
    PROCESS_RESIDENT_MEMORY: Gauge "process_resident_memory_bytes" [] "Resident memory of this process in bytes.";
    PROCESS_VIRTUAL_MEMORY: Gauge "process_virtual_memory_bytes" [] "Virtual memory of this process in bytes.";
    PROCESS_VIRTUAL_MEMORY_MAX: Gauge "process_virtual_memory_max_bytes" [] "Maximum virtual memory of this process in bytes, 0 if unlimited.";
    PROCESS_OPEN_FILES: Gauge "process_open_fds" [] "Open file descriptors of this process, including connections.";
    PROCESS_MAX_FILES: Gauge "process_max_fds" [] "Maximum number of open file descriptors of this process.";
    PROCESS_THREADS: Gauge "process_threads" [] "Threads of this process.";
    PROCESS_START: Gauge "process_start_time_seconds" [] "Start time of this process, in seconds since the Unix epoch.";
    DISK_FREE: Gauge "meshmend_disk_free_bytes" ["folder"] "Free bytes on the disks of this process's folders: `files`, unless the file store is a bucket, and `scratch`.";
}

impl MetricKind {
    /// Returns the type's name in the Prometheus text format.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Counter => "counter",
            Self::Gauge => "gauge",
            Self::Histogram => "histogram",
        }
    }
}

/// Registers every metric's help text with this process's recorder. Sets counters without labels to 0, so that Prometheus sees their first
/// increase.
pub fn describe() {
    for metric in METRICS {
        match metric.kind {
            MetricKind::Counter => metrics::describe_counter!(metric.name, metric.help),
            MetricKind::Gauge => metrics::describe_gauge!(metric.name, metric.help),
            MetricKind::Histogram => metrics::describe_histogram!(metric.name, metric.help),
        }
        if metric.kind == MetricKind::Counter && metric.labels.is_empty() {
            metrics::counter!(metric.name).increment(0);
        }
    }
    metrics::gauge!(BUILD_INFO, "version" => env!("CARGO_PKG_VERSION")).set(1);
}

/// Returns the JSON name of a value without fields, for use as a label.
pub fn label(value: &impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(Value::String(name)) => name,
        _ => String::new(),
    }
}

/// The name of the trace context, as an HTTP header and in a job's record (W3C Trace Context).
pub const TRACEPARENT: &str = "traceparent";

/// Makes a span part of the trace of `traceparent`, or the root of a new trace. Call this before entering the span.
///
/// Records the trace's id in the span's field `trace_id`, so that the log lines of a job share the id in every process. An invalid
/// `traceparent` is ignored, as the standard demands.
pub fn continue_from(span: &Span, traceparent: Option<&str>) {
    let carrier = traceparent.map(|value| (TRACEPARENT.to_owned(), value.to_owned()));
    let parent = TraceContextPropagator::new().extract(&carrier.into_iter().collect::<HashMap<_, _>>());
    if parent.span().span_context().is_valid() {
        // Fails if no trace subscriber is installed, as in unit tests.
        let _ = span.set_parent(parent);
    }
    let context = span.context();
    let context = context.span().span_context().clone();
    if context.is_valid() {
        span.record("trace_id", tracing::field::display(context.trace_id()));
    }
}

/// Returns the trace context to pass on to later work on a span, or `None` if no trace subscriber is installed.
#[must_use]
pub fn traceparent(span: &Span) -> Option<String> {
    let mut carrier = HashMap::new();
    TraceContextPropagator::new().inject_context(&span.context(), &mut carrier);
    carrier.remove(TRACEPARENT)
}

/// Records the response to a request in its span, under OpenTelemetry's attribute names.
pub fn record_response(span: &Span, route: &str, status: u16) {
    span.set_attribute("http.route", route.to_owned());
    span.set_attribute("http.response.status_code", i64::from(status));
    if status >= 500 {
        span.set_status(Status::error(""));
    }
}

/// Marks a span as failed.
pub fn failed(span: &Span, reason: String) {
    span.set_status(Status::error(reason));
}
