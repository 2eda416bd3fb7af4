//! What operators see of the service: the names of its metrics, and the thread of a trace from a request to the worker.

use std::collections::HashMap;

use opentelemetry::propagation::TextMapPropagator;
use opentelemetry::trace::{Status, TraceContextExt};
use opentelemetry_sdk::propagation::TraceContextPropagator;
use serde::Serialize;
use serde_json::Value;
use tracing::Span;
use tracing_opentelemetry::OpenTelemetrySpanExt;

/// What a metric counts or measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Only grows, from 0 at the start of the process.
    Counter,
    /// A value as it is now.
    Gauge,
    /// Values by buckets.
    Histogram,
}

/// One metric of `/metrics`.
#[derive(Debug, Clone, Copy)]
pub struct Metric {
    /// Its name.
    pub name: &'static str,
    /// What it is.
    pub kind: Kind,
    /// The labels of its series.
    pub labels: &'static [&'static str],
    /// What it tells.
    pub help: &'static str,
}

macro_rules! metrics {
    ($($constant:ident: $kind:ident $name:literal [$($label:literal),*] $help:literal;)*) => {
        $(#[doc = $help] pub const $constant: &str = $name;)*

        /// Every metric there is.
        pub const METRICS: &[Metric] =
            &[$(Metric { name: $name, kind: Kind::$kind, labels: &[$($label),*], help: $help }),*];
    };
}

metrics! {
    BUILD_INFO: Gauge "meshmend_build_info" ["version"] "1, with the version of the program.";
    JOBS: Gauge "meshmend_jobs" ["status"] "Jobs that are not deleted, by status. Of the whole store, the same from every process.";
    QUEUE_WAIT: Gauge "meshmend_queue_wait_seconds" [] "How long the job has been due that waits longest, 0 where none waits. Of the whole store.";
    CLASS_JOBS: Gauge "meshmend_class_jobs" ["class", "status"] "Jobs that wait (`queued`) and run (`running`), by class of tenants, as `meshmend tenants set shop --class gold` names them. Of the whole store.";
    CLASS_QUEUE_WAIT: Gauge "meshmend_class_queue_wait_seconds" ["class"] "How long the job has been due that waits longest of a class of tenants, 0 where none waits. Of the whole store.";
    JOBS_SUBMITTED: Counter "meshmend_jobs_submitted_total" ["reused"] "Jobs that were accepted, `true` where an earlier result was taken.";
    UPLOAD_BYTES: Histogram "meshmend_upload_bytes" [] "Bytes of an accepted job's files together.";
    HTTP_REQUEST: Histogram "meshmend_http_request_seconds" ["method", "route", "status"] "Time from a request's headers to its answer's, by the route's template.";
    RATE_LIMITED: Counter "meshmend_rate_limited_total" [] "Requests that were refused since their tenant asked too often.";
    KEYS_REFUSED: Counter "meshmend_keys_refused_total" [] "Requests with a key that is unknown, revoked or expired.";
    JOB_WAIT: Histogram "meshmend_job_wait_seconds" [] "Time from a job's acceptance to its first claim.";
    WORKER_SLOTS: Gauge "meshmend_worker_slots" ["state"] "Jobs that this process can run at once, `busy` and `idle`.";
    ATTEMPT: Histogram "meshmend_attempt_seconds" [] "Time from a claim to the attempt's end.";
    ATTEMPTS: Counter "meshmend_attempts_total" ["status", "outcome"] "Attempts that ended, by the job's status then (`queued` where it is tried again) and what became of the model; that is empty where nothing was found out.";
    ATTEMPTS_DROPPED: Counter "meshmend_attempts_dropped_total" [] "Attempts whose job was canceled, deleted or given to another worker meanwhile.";
    LEASES_LOST: Counter "meshmend_leases_lost_total" [] "Jobs whose worker was lost, and which this process made claimable again or set aside.";
    STEP: Histogram "meshmend_step_seconds" ["tier", "action"] "Time of a repair's step, by tier (0 validates) and action.";
    STEPS: Counter "meshmend_steps_total" ["tier", "action", "status"] "Steps of repairs by how they ended: `done`, `failed`, `reverted`, `skipped`.";
    CHILD_CRASHES: Counter "meshmend_child_crashes_total" ["reason"] "Repair processes that ended without a result: `out_of_memory`, `cpu_limit`, `file_limit`, `crashed`.";
    KILLS: Counter "meshmend_kills_total" ["reason"] "Repair processes that were killed: `deadline`, `lease_lost`, `shutdown`, or for what they had too much of: `scratch`, `processes`.";
    BLENDER_RUNS: Counter "meshmend_blender_runs_total" [] "Blender processes that repairs started.";
    BLENDER_RESTARTS: Counter "meshmend_blender_restarts_total" [] "Of these, those that were started again after a crash.";
    WEBHOOK_DELIVERIES: Counter "meshmend_webhook_deliveries_total" ["result"] "Tries to deliver a webhook by how they ended: `delivered`, `retried`, `failed`, `gone`.";
    WEBHOOK: Histogram "meshmend_webhook_seconds" [] "Time of a try to deliver a webhook.";
    WEBHOOK_BACKLOG: Gauge "meshmend_webhook_backlog" [] "Webhooks that have not been delivered yet. Of the whole store.";
    WEBHOOK_OVERDUE: Gauge "meshmend_webhook_overdue_seconds" [] "How long the webhook has been due that waits longest. Of the whole store.";
    SWEEP: Histogram "meshmend_sweep_seconds" [] "Time of a look for what has expired.";
    SWEPT: Counter "meshmend_swept_total" ["what"] "Jobs that were `expired` or `forgotten`, webhook `messages` that were, and files of no job that were removed: `orphaned`.";
    STORE_ERRORS: Counter "meshmend_store_errors_total" ["kind"] "Errors of the database: `away` where the same may succeed in a while, `other`.";
    BLOB_ERRORS: Counter "meshmend_blob_errors_total" [] "Errors of the file store, missing files apart.";
    DATABASE_CONNECTIONS: Gauge "meshmend_database_connections" ["state"] "Connections of this process to the database, `busy` and `idle`.";
    DATABASE_CONNECTIONS_MAX: Gauge "meshmend_database_connections_max" [] "Most connections to the database that this process may hold.";
    PROCESS_CPU: Counter "process_cpu_seconds_total" [] "Processor time that this process has used, in whole seconds. Jobs run in processes of their own.";
    PROCESS_RESIDENT_MEMORY: Gauge "process_resident_memory_bytes" [] "Memory of this process that is in RAM.";
    PROCESS_VIRTUAL_MEMORY: Gauge "process_virtual_memory_bytes" [] "Address space of this process.";
    PROCESS_VIRTUAL_MEMORY_MAX: Gauge "process_virtual_memory_max_bytes" [] "Most address space that this process may have, 0 where there is no limit.";
    PROCESS_OPEN_FILES: Gauge "process_open_fds" [] "Files and connections that this process has open.";
    PROCESS_MAX_FILES: Gauge "process_max_fds" [] "Most files and connections that this process may have open.";
    PROCESS_THREADS: Gauge "process_threads" [] "Threads of this process.";
    PROCESS_START: Gauge "process_start_time_seconds" [] "When this process started, in seconds since 1970.";
    DISK_FREE: Gauge "meshmend_disk_free_bytes" ["folder"] "Free bytes of the disks of this process's folders: `files` where they are on a disk, `scratch`.";
}

impl Kind {
    /// Its name in Prometheus' text format.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Counter => "counter",
            Self::Gauge => "gauge",
            Self::Histogram => "histogram",
        }
    }
}

/// Tells the recorder of this process what each metric is. Counters that have one series begin at 0, so that their first
/// increase is seen as one.
pub fn describe() {
    for metric in METRICS {
        match metric.kind {
            Kind::Counter => metrics::describe_counter!(metric.name, metric.help),
            Kind::Gauge => metrics::describe_gauge!(metric.name, metric.help),
            Kind::Histogram => metrics::describe_histogram!(metric.name, metric.help),
        }
        if metric.kind == Kind::Counter && metric.labels.is_empty() {
            metrics::counter!(metric.name).increment(0);
        }
    }
    metrics::gauge!(BUILD_INFO, "version" => env!("CARGO_PKG_VERSION")).set(1);
}

/// The name that a value without fields has in JSON, as a label.
pub fn label(value: &impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(Value::String(name)) => name,
        _ => String::new(),
    }
}

/// The name of the header, and of what a job carries from its request to its worker (W3C Trace Context).
pub const TRACEPARENT: &str = "traceparent";

/// Makes a span part of the trace that a traceparent tells of, or the first of a new one, and notes the trace's name in the
/// span's field `trace_id`, so that all log lines of a piece of work share it in every process. A traceparent that can't be read
/// is passed over, as the standard asks. To be called before the span is entered.
pub fn continue_from(span: &Span, traceparent: Option<&str>) {
    let carrier = traceparent.map(|it| (TRACEPARENT.to_owned(), it.to_owned()));
    let parent = TraceContextPropagator::new().extract(&carrier.into_iter().collect::<HashMap<_, _>>());
    if parent.span().span_context().is_valid() {
        // Fails where nothing collects spans, as in tests of single modules.
        let _ = span.set_parent(parent);
    }
    let context = span.context();
    let context = context.span().span_context().clone();
    if context.is_valid() {
        span.record("trace_id", tracing::field::display(context.trace_id()));
    }
}

/// What to hand to whoever goes on with a span's work elsewhere; none where nothing collects spans.
#[must_use]
pub fn traceparent(span: &Span) -> Option<String> {
    let mut carrier = HashMap::new();
    TraceContextPropagator::new().inject_context(&span.context(), &mut carrier);
    carrier.remove(TRACEPARENT)
}

/// Notes what became of a request, by the names that OpenTelemetry has for it.
pub fn answered(span: &Span, route: &str, status: u16) {
    span.set_attribute("http.route", route.to_owned());
    span.set_attribute("http.response.status_code", i64::from(status));
    if status >= 500 {
        span.set_status(Status::error(""));
    }
}

/// Notes that a piece of work failed.
pub fn failed(span: &Span, why: String) {
    span.set_status(Status::error(why));
}
