//! The HTTP API: one file per resource, errors as `application/problem+json`, and an OpenAPI document generated from the code.
//!
//! ```text
//! request -> router (request id, trace, panics, problems) -> authenticate (key, tenant, rate limit) -> resource -> blobs + jobs
//! ```

mod artifacts;
mod authenticate;
mod extract;
mod idempotency;
mod intake;
mod job;
mod jobs;
mod keys;
mod openapi;
mod pages;
mod problem;
mod problem_code;
mod profiles;
mod router;
mod service;
mod state;
mod submit;
mod tenants;
mod validation;
mod webhook_deliveries;
mod webhook_endpoints;

pub use openapi::{document, document_3_0};
pub use problem::{FieldError, Problem};
pub use problem_code::{ProblemCode, ProblemDoc, catalogue};
pub use router::router;
pub use service::probes;
pub use state::{ApiConfig, ApiState, Auth, Capabilities, Health, Rates, TierStatus};
