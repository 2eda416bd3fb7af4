//! The HTTP surface: one file a resource, errors as problem+json everywhere, and an OpenAPI document made from the code.
//!
//! ```text
//! request -> layers (request id, trace, panic, problem) -> router -> admit (who asks, how often) -> resource -> blobs + jobs
//! ```

mod admit;
mod artifacts;
mod caller;
mod capabilities;
mod catalogue;
mod check;
mod events;
mod extract;
mod file_name;
mod from_job;
mod from_upload;
mod health;
mod idempotency;
mod incoming;
mod job_view;
mod jobs;
mod keys;
mod layers;
mod linger;
mod manual;
mod openapi;
mod page;
mod problem;
mod problem_code;
mod rates;
mod reuse;
mod router;
mod state;
mod submit;
mod tenants;
mod tokens;
mod upload;
mod uploads;
mod wait;
mod webhooks;

pub use admit::Auth;
pub use capabilities::{Capabilities, TierStatus};
pub use catalogue::{ProblemDoc, catalogue};
pub use health::{Health, probes};
pub use openapi::{document, document_3_0};
pub use problem::{FieldError, Problem, ProblemCode};
pub use rates::Rates;
pub use router::router;
pub use state::{ApiConfig, ApiState};
