//! Webhooks as the Standard Webhooks specification, version 1, says: checks of target URLs, signatures, deliveries and retries.
//!
//! ```text
//! jobs (outbox, written in the transaction that ends a job) -> dispatcher -> target check -> signature -> post -> jobs (result)
//! ```

mod dispatcher;
mod post;
mod target;

pub use dispatcher::{Dispatcher, DispatcherConfig, Schedule, ScheduleError, new_secret};
pub use post::{Poster, PosterError};
pub use target::{TargetError, TargetPolicy};
