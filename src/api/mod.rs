//! The HTTP surface: one file a resource, errors as problem+json everywhere, and an OpenAPI document made from the code.
//!
//! ```text
//! request -> layers (request id, trace, panic, problem) -> router -> resource -> blobs + jobs
//! ```

mod artifacts;
mod capabilities;
mod events;
mod extract;
mod file_name;
mod from_upload;
mod health;
mod idempotency;
mod job_view;
mod jobs;
mod layers;
mod openapi;
mod problem;
mod router;
mod state;
mod submit;
mod upload;
mod uploads;
mod wait;

pub use capabilities::{Capabilities, TierStatus};
pub use openapi::document;
pub use problem::{Problem, ProblemCode};
pub use router::router;
pub use state::{ApiConfig, ApiState};
