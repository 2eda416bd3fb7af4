//! Webhooks in the form of the Standard Webhooks specification, version 1: who may be reached, how messages are signed and sent, and
//! when they are sent again.
//!
//! ```text
//! jobs (the outbox, written with a job's end) -> dispatcher -> target (may it be reached?) -> sign -> post -> jobs (how it went)
//! ```

mod dispatcher;
mod post;
mod target;

pub use dispatcher::{Dispatcher, DispatcherConfig, Random, Schedule, ScheduleError, SystemRandom, new_secret};
pub use post::{Poster, PosterError};
pub use target::{TargetError, TargetPolicy};
