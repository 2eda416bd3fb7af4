//! Delivers pending webhook messages: claims, signs and sends them, and retries failures by a schedule.

use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use time::OffsetDateTime;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::post::{Envelope, PostResult, Poster};
use crate::access::{IdSource, random_bytes};
use crate::jobs::{Clock, DeliveryAttempt, DeliveryResult, DueDelivery, Secrets, SigningSecret, Store, StoreError};
use crate::telemetry;

/// Maximum number of concurrent deliveries of one process.
const MAX_CONCURRENT: usize = 16;
/// Maximum number of concurrent deliveries of one tenant over all processes, so that slow receivers of one tenant delay nobody else.
const MAX_CONCURRENT_PER_TENANT: u32 = 4;

/// The delays before each retry of a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schedule(Vec<Duration>);

/// The error of a text that is not a [`Schedule`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a schedule is a comma-separated list of 1 to 50 delays in seconds, each at most 30 days")]
pub struct ScheduleError;

/// Maximum number of delays.
const MAX_WAITS: usize = 50;
/// Longest delay, in seconds.
const LONGEST_WAIT_S: f64 = 30.0 * 24.0 * 3600.0;

impl Schedule {
    /// Returns the delay after attempt number `tries` (from 1) failed, or `None` if that was the last attempt.
    ///
    /// Adds up to a fifth of the delay at random, so that messages that failed together are not retried together. `random` is any 64
    /// random bits.
    #[must_use]
    pub fn wait(&self, tries: u32, random: u64) -> Option<Duration> {
        let wait = *self.0.get(usize::try_from(tries).ok()?.checked_sub(1)?)?;
        let fifth = u64::try_from(wait.as_millis() / 5).unwrap_or(u64::MAX);
        Some(wait + Duration::from_millis(if fifth == 0 { 0 } else { random % fifth }))
    }
}

impl FromStr for Schedule {
    type Err = ScheduleError;

    fn from_str(text: &str) -> Result<Self, ScheduleError> {
        let seconds =
            |text: &str| text.trim().parse::<f64>().ok().filter(|seconds| (0.0..=LONGEST_WAIT_S).contains(seconds));
        let waits = text.split(',').map(|text| seconds(text).map(Duration::from_secs_f64));
        let waits = waits.collect::<Option<Vec<_>>>().ok_or(ScheduleError)?;
        if waits.len() <= MAX_WAITS { Ok(Self(waits)) } else { Err(ScheduleError) }
    }
}

/// The configuration of the dispatcher.
#[derive(Debug, Clone)]
pub struct DispatcherConfig {
    /// How long a claim lasts. Must be longer than any delivery takes.
    pub lease: Duration,
    /// The retry schedule.
    pub schedule: Schedule,
    /// Poll interval for pending deliveries that no notification reported.
    pub poll: Duration,
}

/// Delivers pending messages. Any number of processes may run a dispatcher on the same store.
pub struct Dispatcher {
    store: Arc<dyn Store>,
    poster: Poster,
    config: DispatcherConfig,
    clock: Arc<dyn Clock>,
    ids: Arc<dyn IdSource>,
}

impl Dispatcher {
    /// Creates a dispatcher that sends the pending messages of `store` through `poster`.
    #[must_use]
    pub fn new(
        store: Arc<dyn Store>,
        poster: Poster,
        config: DispatcherConfig,
        clock: Arc<dyn Clock>,
        ids: Arc<dyn IdSource>,
    ) -> Self {
        Self { store, poster, config, clock, ids }
    }

    /// Runs until `drain` is cancelled, then waits for running deliveries until `abort` is cancelled. After an interrupted delivery's
    /// lease ends, another process claims and repeats the delivery.
    pub async fn run(self, drain: CancellationToken, abort: CancellationToken) {
        let dispatcher = Arc::new(self);
        let permits = Arc::new(Semaphore::new(MAX_CONCURRENT));
        let mut deliveries = JoinSet::new();
        while !drain.is_cancelled() {
            let permit = tokio::select! {
                permit = Arc::clone(&permits).acquire_owned() => permit,
                () = drain.cancelled() => break,
            };
            match dispatcher.store.claim_delivery(dispatcher.config.lease, MAX_CONCURRENT_PER_TENANT).await {
                Ok(Some(due)) => {
                    let dispatcher = Arc::clone(&dispatcher);
                    deliveries.spawn(async move {
                        dispatcher.deliver(due).await;
                        drop(permit);
                    });
                    while deliveries.try_join_next().is_some() {}
                    continue;
                }
                Ok(None) => {}
                Err(error) => tracing::error!(%error, "failed to claim webhook delivery"),
            }
            drop(permit);
            tokio::select! {
                () = dispatcher.store.notifier().deliveries() => {}
                // When a delivery ends, a tenant at its concurrency limit may have another delivery due.
                Some(_) = deliveries.join_next(), if !deliveries.is_empty() => {}
                () = tokio::time::sleep(dispatcher.config.poll) => {}
                () = drain.cancelled() => {}
            }
        }
        tokio::select! {
            () = async { while deliveries.join_next().await.is_some() {} } => {}
            () = abort.cancelled() => {}
        }
    }

    /// Delivers a claimed message, and logs what the operator should know.
    async fn deliver(&self, due: DueDelivery) {
        match self.try_deliver(&due).await {
            Ok(true) => {
                let endpoint = due.endpoint.as_deref().unwrap_or_default();
                tracing::warn!(tenant = due.tenant, endpoint, "disabled webhook endpoint");
            }
            Ok(false) => {}
            Err(error) => tracing::error!(%error, delivery = due.id, "failed to record webhook delivery"),
        }
    }

    /// Sends a message and records the result. Returns true if the result disabled the endpoint.
    async fn try_deliver(&self, due: &DueDelivery) -> Result<bool, StoreError> {
        let secrets = match &due.secrets {
            Some(secrets) => secrets.clone(),
            None => self.store.callback_secrets(&due.tenant, &new_secret(self.ids.as_ref())).await?,
        };
        let at = self.clock.now_ms() / 1000;
        let signatures = signatures(&secrets, &due.message, at, &due.payload);
        let DueDelivery { url, message, payload, .. } = due;
        let response =
            self.poster.post(Envelope { url, message, timestamp: at, signatures: &signatures, payload }).await;
        let verdict = self.judge(&response, due.tries);
        let result = match verdict {
            DeliveryResult::Delivered => "delivered",
            DeliveryResult::RetryAfter(_) => "retried",
            DeliveryResult::Failed => "failed",
            DeliveryResult::Gone => "gone",
        };
        metrics::counter!(telemetry::WEBHOOK_DELIVERIES, "result" => result).increment(1);
        metrics::histogram!(telemetry::WEBHOOK).record(response.elapsed);
        tracing::debug!(
            tenant = due.tenant,
            message,
            result,
            status = response.status,
            error = response.error,
            "attempted webhook delivery"
        );
        let attempt = DeliveryAttempt {
            at: OffsetDateTime::from_unix_timestamp(at).unwrap_or(OffsetDateTime::UNIX_EPOCH),
            status: response.status,
            error: response.error,
            milliseconds: u64::try_from(response.elapsed.as_millis()).unwrap_or(u64::MAX),
        };
        self.store.settle_delivery(due, attempt, verdict).await
    }

    /// Decides how a delivery goes on after a response.
    fn judge(&self, response: &PostResult, tries: u32) -> DeliveryResult {
        let random = self.ids.random().as_u64_pair().0;
        match response.status {
            Some(200..300) => DeliveryResult::Delivered,
            Some(410) => DeliveryResult::Gone,
            _ => match self.config.schedule.wait(tries, random) {
                Some(wait) => DeliveryResult::RetryAfter(wait),
                None => DeliveryResult::Failed,
            },
        }
    }
}

/// Prefix of every secret, by which secret scanners recognise leaked secrets.
const SECRET_PREFIX: &str = "whsec_";

/// Creates a signing secret of 32 bytes, with 244 random bits.
#[must_use]
pub fn new_secret(ids: &dyn IdSource) -> SigningSecret {
    SigningSecret::new(format!("{SECRET_PREFIX}{}", STANDARD.encode(random_bytes(ids))))
}

/// Returns the header `webhook-signature` of a message sent at `timestamp`, in seconds since the Unix epoch. The header has one
/// signature for each secret that is valid then.
fn signatures(secrets: &Secrets, message: &str, timestamp: i64, payload: &str) -> String {
    let previous = secrets.previous.as_ref().filter(|(_, until)| until.unix_timestamp() > timestamp);
    let valid_secrets = std::iter::once(&secrets.current).chain(previous.map(|(secret, _)| secret));
    let signatures: Vec<String> = valid_secrets.map(|secret| signature(secret, message, timestamp, payload)).collect();
    signatures.join(" ")
}

/// Signs a message with one secret.
fn signature(secret: &SigningSecret, message: &str, timestamp: i64, payload: &str) -> String {
    let text = secret.reveal();
    // Only secrets of `new_secret` are stored, so decoding succeeds. Any other key would yield signatures that nobody can verify.
    let key = STANDARD.decode(text.strip_prefix(SECRET_PREFIX).unwrap_or(text)).unwrap_or_default();
    #[expect(clippy::expect_used, reason = "HMAC takes keys of any length (RFC 2104)")]
    let mut mac = Hmac::<Sha256>::new_from_slice(&key).expect("a key of any length");
    mac.update(format!("{message}.{timestamp}.{payload}").as_bytes());
    format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::SystemIds;
    use crate::jobs::SystemClock;
    use standardwebhooks::Webhook;

    #[test]
    fn delays_follow_the_schedule_with_up_to_a_fifth_added() {
        let schedule: Schedule = "5, 300,0.5".parse().expect("a schedule");
        for (tries, low, high) in [(1, 5000, 6000), (2, 300_000, 360_000), (3, 500, 600)] {
            for random in [0, 1, u64::MAX / 3, u64::MAX] {
                let delay = schedule.wait(tries, random).expect("a delay").as_millis();
                assert!((low..high).contains(&delay), "attempt {tries}: {delay} ms");
            }
        }
        assert_ne!(schedule.wait(2, 1), schedule.wait(2, 59_999));
        assert_eq!((schedule.wait(0, 0), schedule.wait(4, 0), schedule.wait(u32::MAX, 0)), (None, None, None));
        let many = vec!["1"; 51].join(",");
        for wrong in ["", "1,", "a", "-1", "NaN", "inf", "1e9", &many] {
            assert_eq!(wrong.parse::<Schedule>(), Err(ScheduleError), "{wrong}");
        }
    }

    #[test]
    fn the_example_of_the_specification_gets_the_specified_signature() {
        let secret = SigningSecret::new("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw".into());
        let signed = signature(&secret, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1_614_265_330, "{\"test\": 2432232314}");
        assert_eq!(signed, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
    }

    #[test]
    fn both_secrets_sign_until_the_old_one_expires() {
        let now = SystemClock.now_ms() / 1000;
        let (old, new) = (new_secret(&SystemIds), new_secret(&SystemIds));
        assert_ne!(old, new);
        assert!(!format!("{new:?}").contains(&new.reveal()[6..]));
        let until = OffsetDateTime::from_unix_timestamp(now).expect("a time") + Duration::from_secs(60);
        let secrets = Secrets { current: new.clone(), previous: Some((old.clone(), until)) };
        let verifies = |secret: &SigningSecret, at: i64| {
            let mut headers = axum::http::HeaderMap::new();
            let signed = signatures(&secrets, "msg_1", at, "{}");
            for (name, value) in
                [("webhook-id", "msg_1"), ("webhook-timestamp", &at.to_string()), ("webhook-signature", &signed)]
            {
                headers.insert(name, value.parse().expect("a header"));
            }
            Webhook::new(secret.reveal()).expect("a secret").verify(b"{}", &headers).is_ok()
        };
        assert!(verifies(&old, now) && verifies(&new, now));
        assert!(!verifies(&new_secret(&SystemIds), now));
        assert!(!verifies(&old, now + 60) && verifies(&new, now + 60));
    }
}
