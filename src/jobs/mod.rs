//! Jobs: what they are, how they move from state to state, and the store that keeps them.
//!
//! The store is one trait for each subject, and [`Store`] for all of them. Every statement that ends or extends a running job
//! ([`QueueStore`]) is fenced by (job, attempt, token), so that the write of a worker that lost its lease changes nothing. The
//! transaction that ends a job also writes the webhook messages about it ([`DeliveryStore`] sends them).

mod access;
mod bell;
mod clock;
mod drawings;
mod error;
mod job;
mod keys;
mod opening;
mod options;
mod postgres;
mod queue;
mod quote;
mod report;
mod retention;
mod retry;
mod row;
mod sql;
mod sqlite;
mod store;
pub mod timestamp;
mod uploads;
mod webhooks;

pub use access::AccessStore;
pub use bell::Bell;
pub use clock::{Clock, SystemClock};
pub use drawings::DrawingStore;
pub use error::StoreError;
pub use job::{
    Artifact, Artifacts, Input, Job, JobId, JobIdError, JobProblem, JobProgress, Metadata, ProblemKind, Status,
    StoredFile,
};
pub use keys::{IdempotencyStore, KEY_HOLD, KEY_LIFE, KeyState, RequestKey};
pub use opening::OpenFailure;
pub use options::{JobOptions, JobOptionsError, Mode, whole_number};
pub use postgres::PostgresStore;
pub use queue::{Claim, ClassLoad, Completion, Failure, FailureKind, Lease, QueueStore, Waiting};
pub use quote::Quote;
pub use report::{JobOutcome, JobReport, StoredReport};
pub use retention::RetentionStore;
pub use retry::RetryPolicy;
pub use sql::SqlStore;
pub use sqlite::{BackupError, SqliteStore};
pub use store::{Cancelled, Connections, JobStore, ListQuery, NewJob, Page, Reused, StatusCount, Store};
pub use uploads::{NewUpload, PendingUpload, UPLOAD_LIFE, UPLOAD_OPEN, UploadId, UploadIdError, UploadStore};
pub use webhooks::{
    Attempt, Backlog, Delivery, DeliveryQuery, DeliveryStatus, DeliveryStore, DueDelivery, Endpoint, EndpointChange,
    EndpointStore, FAILING, JobEvent, JobMessage, NewEndpoint, Redelivered, Secrets, SigningSecret, Verdict,
};
