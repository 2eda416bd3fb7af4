//! Jobs: their data, their states, and the store that keeps them.
//!
//! The store has one trait for each subject, and [`Store`] combines them. Every statement that ends or extends a running job
//! ([`QueueStore`]) is fenced by (job, attempt, token), so that writes of a worker that lost its lease change nothing. The
//! transaction that ends a job also writes the webhook messages about it, which [`DeliveryStore`] then delivers.

mod error;
mod id;
mod job;
mod options;
mod profiles;
mod queue;
mod report;
mod sql;
mod store;
pub mod timestamp;
mod webhooks;

pub use error::{OpenFailure, StoreError};
pub use id::{JobId, JobIdError, UploadId, UploadIdError};
pub use job::{
    Artifact, Artifacts, Input, Job, JobOutcome, JobProblem, JobProgress, Metadata, ProblemKind, Status, StoredFile,
    StoredReport,
};
pub use options::{JobOptions, JobOptionsError, Mode};
pub use profiles::{NewProfile, ProfileName, TenantProfile, TenantProfileError};
pub use queue::{
    Claim, ClassLoad, Completion, Failure, FailureKind, KEY_HOLD, KEY_LIFE, KeyState, Lease, NewJob, NewUpload,
    Notifier, PendingUpload, QueuedCounts, RequestKey, RetryPolicy, Reused, UPLOAD_LIFE, UPLOAD_OPEN,
};
pub use report::{JobReport, Quote};
pub use sql::{BackupError, PostgresStore, SqlStore, SqliteStore};
pub use store::{
    AccessStore, CancelResult, Connections, DeliveryStore, DrawingStore, EndpointStore, IdempotencyStore, JobStore,
    ListQuery, Page, ProfileStore, QueueStore, RedeliveryResult, RetentionStore, StatusCount, Store, UploadStore,
};
pub use timestamp::{Clock, SystemClock};
pub use webhooks::{
    Backlog, Delivery, DeliveryAttempt, DeliveryQuery, DeliveryResult, DeliveryStatus, DueDelivery, Endpoint,
    EndpointChange, FAILING, JobEvent, JobMessage, NewEndpoint, Secrets, SigningSecret,
};
