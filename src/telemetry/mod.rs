
mod metrics;

pub use self::metrics::*;
