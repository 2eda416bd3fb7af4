//! How often a tenant may ask, and the header fields that tell it (IETF draft `ratelimit-headers`).

use std::collections::HashMap;
use std::num::NonZeroU32;
use std::sync::{Arc, Mutex, PoisonError};

use axum::http::{HeaderName, HeaderValue};
use axum::response::Response;
use governor::clock::{Clock, DefaultClock};
use governor::middleware::StateInformationMiddleware;
use governor::state::{InMemoryState, NotKeyed};
use governor::{Quota, RateLimiter};

use super::problem::{Problem, ProblemCode};
use crate::access::TenantName;

const POLICY: HeaderName = HeaderName::from_static("ratelimit-policy");
const STATE: HeaderName = HeaderName::from_static("ratelimit");
/// The window of a policy, in seconds.
const WINDOW_S: u32 = 60;

type Bucket = RateLimiter<NotKeyed, InMemoryState, DefaultClock, StateInformationMiddleware>;

/// A bucket of requests for each tenant that asked, refilled evenly.
#[derive(Default)]
pub struct Rates {
    buckets: Mutex<HashMap<TenantName, (NonZeroU32, Arc<Bucket>)>>,
}

/// What is left to a tenant after a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Left {
    /// Requests in a window.
    of: u32,
    /// Requests that may still come at once.
    requests: u32,
    /// Seconds until all of them are there again, or after a refusal until the next.
    seconds: u64,
}

impl Rates {
    /// Takes one request out of the tenant's `per_minute`.
    ///
    /// # Errors
    /// What is left, where that is nothing.
    pub(super) fn take(&self, tenant: &TenantName, per_minute: NonZeroU32) -> Result<Left, Left> {
        let bucket = {
            let mut buckets = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
            let new = || {
                let bucket = RateLimiter::direct(Quota::per_minute(per_minute));
                (per_minute, Arc::new(bucket.with_middleware::<StateInformationMiddleware>()))
            };
            let known = buckets.entry(tenant.clone()).or_insert_with(new);
            if known.0 != per_minute {
                *known = new();
            }
            Arc::clone(&known.1)
        };
        let of = per_minute.get();
        match bucket.check() {
            Ok(state) => {
                let requests = state.remaining_burst_capacity();
                let used = u64::from(of.saturating_sub(requests));
                Ok(Left { of, requests, seconds: (used * u64::from(WINDOW_S)).div_ceil(u64::from(of)) })
            }
            Err(refused) => {
                let wait = refused.wait_time_from(DefaultClock::default().now());
                Err(Left { of, requests: 0, seconds: wait.as_secs() + 1 })
            }
        }
    }
}

impl Left {
    /// Tells it in the answer's header.
    pub fn tell(self, response: &mut Response) {
        let fields = [
            (POLICY, format!("\"tenant\";q={};w={WINDOW_S}", self.of)),
            (STATE, format!("\"tenant\";r={};t={}", self.requests, self.seconds)),
        ];
        for (name, value) in fields {
            if let Ok(value) = HeaderValue::from_str(&value) {
                response.headers_mut().insert(name, value);
            }
        }
    }

    /// That nothing is left.
    pub fn refused(self) -> Problem {
        let detail = format!("More than {} requests came within a minute. Ask again in {} s.", self.of, self.seconds);
        let seconds = u32::try_from(self.seconds).unwrap_or(WINDOW_S);
        Problem::new(ProblemCode::RateLimited, detail).retry_after(seconds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenant_that_asks_too_often_is_refused_and_others_are_not() {
        let rates = Rates::default();
        let (busy, calm): (TenantName, TenantName) = ("busy".parse().expect("a name"), "calm".parse().expect("a name"));
        let three = NonZeroU32::new(3).expect("three");
        for left in [2, 1, 0] {
            assert_eq!(rates.take(&busy, three).map(|state| state.requests), Ok(left));
        }
        let refused = rates.take(&busy, three).expect_err("nothing is left");
        assert!((1..=21).contains(&refused.seconds), "{refused:?}");
        assert!(rates.take(&calm, three).is_ok());
        assert!(rates.take(&busy, NonZeroU32::new(100).expect("a hundred")).is_ok(), "a new limit holds at once");
    }
}
