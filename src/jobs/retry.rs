use std::time::Duration;

use super::FailureKind;

/// How often a job is tried again and how long after.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RetryPolicy {
    /// Claims after which a failure that might pass (a full disk, a lost connection) is final.
    pub max_attempts: u32,
    /// Times a job may take its worker or its child process down before it is set aside.
    pub max_crashes: u32,
    /// Wait before the second try; it doubles with each further one.
    pub first_delay: Duration,
    /// Longest wait.
    pub longest_delay: Duration,
}

impl Default for RetryPolicy {
    fn default() -> Self {
        Self {
            max_attempts: 5,
            max_crashes: 3,
            first_delay: Duration::from_secs(1),
            longest_delay: Duration::from_secs(300),
        }
    }
}

impl RetryPolicy {
    /// Whether a job that failed so, at that attempt and after so many crashes, is not tried again.
    #[must_use]
    pub fn ends(&self, kind: FailureKind, attempt: u32, crashes: u32) -> bool {
        match kind {
            FailureKind::Final => true,
            FailureKind::Passing => attempt >= self.max_attempts,
            FailureKind::Crash => crashes >= self.max_crashes,
        }
    }

    /// The wait after try number `tries` (1 for the first) failed: exponential with full jitter over its upper half, so
    /// that jobs which failed together don't come back together. `random` is any 64 random bits.
    #[must_use]
    pub fn delay(&self, tries: u32, random: u64) -> Duration {
        let doubled = self.first_delay.saturating_mul(1_u32 << tries.saturating_sub(1).min(20));
        let longest = doubled.min(self.longest_delay);
        let half = longest / 2;
        let nanos = u64::try_from(half.as_nanos()).unwrap_or(u64::MAX);
        half + Duration::from_nanos(if nanos == 0 { 0 } else { random % nanos })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_double_with_jitter_and_stop_growing_at_the_longest() {
        let policy = RetryPolicy {
            first_delay: Duration::from_secs(1),
            longest_delay: Duration::from_secs(60),
            ..RetryPolicy::default()
        };
        for (tries, low, high) in [(1, 500, 1000), (2, 1000, 2000), (5, 8000, 16_000), (30, 30_000, 60_000)] {
            for random in [0, 1, u64::MAX / 3, u64::MAX] {
                let delay = policy.delay(tries, random).as_millis();
                assert!((low..=high).contains(&delay), "try {tries}: {delay} ms");
            }
        }
        assert_ne!(policy.delay(3, 1), policy.delay(3, 999_999_999));
    }
}
