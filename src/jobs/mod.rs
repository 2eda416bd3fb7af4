//! Jobs: what they are, how they move from state to state, and the store that keeps them.
//!
//! The store is a trait ([`JobStore`]) whose every statement that ends or extends a running job is fenced by
//! (job, attempt, token), so that the write of a worker that lost its lease changes nothing. What webhooks tell of a job's end is
//! written with that end ([`WebhookStore`]).

mod access;
mod bell;
mod clock;
mod drawings;
mod job;
mod keys;
mod opening;
mod options;
mod postgres;
mod quote;
mod report;
mod retry;
mod row;
mod sqlite;
mod store;
pub mod timestamp;
mod uploads;
mod webhooks;

pub use access::AccessStore;
pub use bell::Bell;
pub use clock::{Clock, SystemClock};
pub use drawings::DrawingStore;
pub use job::{
    Artifact, Artifacts, Input, Job, JobId, JobIdError, JobProblem, JobProgress, Metadata, ProblemKind, Status,
    StoredFile,
};
pub use keys::{KEY_HOLD, KEY_LIFE, KeyState, RequestKey};
pub use opening::OpenFailure;
pub use options::{JobOptions, JobOptionsError, Mode, whole_number};
pub use postgres::PostgresStore;
pub use quote::Quote;
pub use report::{JobOutcome, JobReport, StoredReport};
pub use retry::RetryPolicy;
pub use sqlite::{BackupError, SqliteStore};
pub use store::{
    Cancelled, Claim, ClassLoad, Completion, Connections, Failure, FailureKind, JobStore, Lease, ListQuery, NewJob,
    Page, Reused, StatusCount, StoreError, Waiting,
};
pub use uploads::{NewUpload, PendingUpload, UPLOAD_LIFE, UPLOAD_OPEN, UploadId, UploadIdError, UploadStore};

pub use webhooks::{
    Attempt, Backlog, Delivery, DeliveryQuery, DeliveryStatus, DueDelivery, Endpoint, EndpointChange, FAILING,
    JobEvent, JobMessage, NewEndpoint, Redelivered, Secrets, SigningSecret, Verdict, WebhookStore,
};

/// All that a service keeps in its database.
pub trait Store: JobStore + DrawingStore + AccessStore + WebhookStore {}

impl<T: JobStore + DrawingStore + AccessStore + WebhookStore> Store for T {}
