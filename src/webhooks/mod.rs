//! Webhooks in the form of the Standard Webhooks specification, version 1: who may be reached, how messages are signed and sent, and
//! when they are sent again.
//!
//! ```text
//! jobs (the outbox, written with a job's end) -> courier -> target (may it be reached?) -> sign -> post -> jobs (how it went)
//! ```

mod courier;
mod post;
mod schedule;
mod sign;
mod target;

pub use courier::{Courier, CourierConfig};
pub use post::{Poster, PosterError};
pub use schedule::{Schedule, ScheduleError};
pub use sign::new_secret;
pub use target::{Reach, TargetError};
