//! What operators see of the service: the names of its metrics, and the thread of a trace from a request to the worker.

mod metrics;
mod trace;

pub use self::metrics::*;
pub use trace::{TRACEPARENT, answered, continue_from, failed, traceparent};
