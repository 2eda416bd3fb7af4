//! Deliveries that are due: claimed, signed, sent, and tried again by a schedule.

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
use uuid::Uuid;

use super::post::{Answer, Envelope, Poster};
use crate::jobs::{Clock, DeliveryAttempt, DeliveryResult, DueDelivery, Secrets, SigningSecret, Store, StoreError};
use crate::telemetry;

/// Deliveries under way at the same time, in one process.
const AT_ONCE: usize = 16;
/// Of them those of one tenant, on all processes together, so that one whose receivers hang holds nobody else up.
const OF_ONE_TENANT: u32 = 4;

/// How long to wait before each further try to deliver a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schedule(Vec<Duration>);

/// A text that is no schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a schedule is 1 to 50 numbers of seconds with commas between, each at most 30 days")]
pub struct ScheduleError;

/// Most waits, and the longest, in seconds.
const MAX_WAITS: usize = 50;
const LONGEST_WAIT_S: f64 = 30.0 * 24.0 * 3600.0;

impl Schedule {
    /// The wait after try number `tries` (1 for the first) failed; none when it was the last. Up to a fifth is added, so that messages
    /// which failed together don't come back together. `random` is any 64 random bits.
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

/// How deliveries are made.
#[derive(Debug, Clone)]
pub struct DispatcherConfig {
    /// How long a claim holds; longer than any delivery takes.
    pub lease: Duration,
    /// When failed deliveries are tried again.
    pub schedule: Schedule,
    /// How long to wait before polling for deliveries that no notification came for.
    pub poll: Duration,
}

/// Makes the deliveries that are due, as one of any number of processes that do.
pub struct Dispatcher {
    store: Arc<dyn Store>,
    poster: Poster,
    config: DispatcherConfig,
    clock: Arc<dyn Clock>,
    random: Arc<dyn Random>,
}

impl Dispatcher {
    /// Sends by `poster` what waits in `store`.
    #[must_use]
    pub fn new(
        store: Arc<dyn Store>,
        poster: Poster,
        config: DispatcherConfig,
        clock: Arc<dyn Clock>,
        random: Arc<dyn Random>,
    ) -> Self {
        Self { store, poster, config, clock, random }
    }

    /// Runs until told to `drain`. What is under way then may finish until told to stop `now`; what does not is delivered again by
    /// whoever claims it when its lease ends.
    pub async fn run(self, drain: CancellationToken, now: CancellationToken) {
        let dispatcher = Arc::new(self);
        let places = Arc::new(Semaphore::new(AT_ONCE));
        let mut under_way = JoinSet::new();
        while !drain.is_cancelled() {
            let place = tokio::select! {
                place = Arc::clone(&places).acquire_owned() => place,
                () = drain.cancelled() => break,
            };
            match dispatcher.store.claim_delivery(dispatcher.config.lease, OF_ONE_TENANT).await {
                Ok(Some(due)) => {
                    let dispatcher = Arc::clone(&dispatcher);
                    under_way.spawn(async move {
                        dispatcher.deliver(due).await;
                        drop(place);
                    });
                    while under_way.try_join_next().is_some() {}
                    continue;
                }
                Ok(None) => {}
                Err(error) => tracing::error!(%error, "could not look for webhooks to deliver"),
            }
            drop(place);
            tokio::select! {
                () = dispatcher.store.notifier().deliveries() => {}
                // A tenant may have as many under way as it may, and more that is due.
                Some(_) = under_way.join_next(), if !under_way.is_empty() => {}
                () = tokio::time::sleep(dispatcher.config.poll) => {}
                () = drain.cancelled() => {}
            }
        }
        tokio::select! {
            () = async { while under_way.join_next().await.is_some() {} } => {}
            () = now.cancelled() => {}
        }
    }

    async fn deliver(&self, due: DueDelivery) {
        match self.try_deliver(&due).await {
            Ok(true) => {
                let endpoint = due.endpoint.as_deref().unwrap_or_default();
                tracing::warn!(tenant = due.tenant, endpoint, "a webhook endpoint was disabled");
            }
            Ok(false) => {}
            Err(error) => tracing::error!(%error, delivery = due.id, "how a webhook fared could not be noted"),
        }
    }

    /// Sends a message and notes how it went. True if its endpoint was disabled by that.
    async fn try_deliver(&self, due: &DueDelivery) -> Result<bool, StoreError> {
        let secrets = match &due.secrets {
            Some(secrets) => secrets.clone(),
            None => self.store.callback_secrets(&due.tenant, &new_secret(self.random.as_ref())).await?,
        };
        let at = self.clock.now_ms() / 1000;
        let signatures = signatures(&secrets, &due.message, at, &due.payload);
        let DueDelivery { url, message, payload, .. } = due;
        let answer = self.poster.post(Envelope { url, message, timestamp: at, signatures: &signatures, payload }).await;
        let verdict = self.judge(&answer, due.tries);
        let result = match verdict {
            DeliveryResult::Delivered => "delivered",
            DeliveryResult::RetryAfter(_) => "retried",
            DeliveryResult::Failed => "failed",
            DeliveryResult::Gone => "gone",
        };
        metrics::counter!(telemetry::WEBHOOK_DELIVERIES, "result" => result).increment(1);
        metrics::histogram!(telemetry::WEBHOOK).record(answer.took);
        tracing::debug!(tenant = due.tenant, message, result, status = answer.status, error = answer.error, "webhook");
        let attempt = DeliveryAttempt {
            at: OffsetDateTime::from_unix_timestamp(at).unwrap_or(OffsetDateTime::UNIX_EPOCH),
            status: answer.status,
            error: answer.error,
            milliseconds: u64::try_from(answer.took.as_millis()).unwrap_or(u64::MAX),
        };
        self.store.settle_delivery(due, attempt, verdict).await
    }

    fn judge(&self, answer: &Answer, tries: u32) -> DeliveryResult {
        let random = (self.random.bits() >> 64) as u64;
        match answer.status {
            Some(200..300) => DeliveryResult::Delivered,
            Some(410) => DeliveryResult::Gone,
            _ => match self.config.schedule.wait(tries, random) {
                Some(wait) => DeliveryResult::RetryAfter(wait),
                None => DeliveryResult::Failed,
            },
        }
    }
}

/// What secrets begin with, so that programs that search for leaked secrets find them.
const SECRET_PREFIX: &str = "whsec_";

/// Random numbers, passed in so that tests can hold them.
pub trait Random: Send + Sync {
    /// 128 bits in the form of a random UUID: 122 of them are random.
    fn bits(&self) -> u128;
}

/// The operating system's random numbers.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemRandom;

impl Random for SystemRandom {
    fn bits(&self) -> u128 {
        Uuid::new_v4().as_u128()
    }
}

/// A new secret of 32 bytes, 244 bits of them random.
#[must_use]
pub fn new_secret(random: &dyn Random) -> SigningSecret {
    let bytes = [random.bits().to_be_bytes(), random.bits().to_be_bytes()].concat();
    SigningSecret::new(format!("{SECRET_PREFIX}{}", STANDARD.encode(bytes)))
}

/// The header `webhook-signature` of a message sent at `timestamp`, in seconds since the Unix epoch: one signature for each secret
/// that is in force then.
fn signatures(secrets: &Secrets, message: &str, timestamp: i64, payload: &str) -> String {
    let previous = secrets.previous.as_ref().filter(|(_, until)| until.unix_timestamp() > timestamp);
    let enforced = std::iter::once(&secrets.current).chain(previous.map(|(secret, _)| secret));
    let signatures: Vec<String> = enforced.map(|secret| signature(secret, message, timestamp, payload)).collect();
    signatures.join(" ")
}

fn signature(secret: &SigningSecret, message: &str, timestamp: i64, payload: &str) -> String {
    let text = secret.reveal();
    // Only secrets of `new_secret` are stored, so this is the key; anything else would give signatures that nobody can verify.
    let key = STANDARD.decode(text.strip_prefix(SECRET_PREFIX).unwrap_or(text)).unwrap_or_default();
    #[expect(clippy::expect_used, reason = "HMAC takes keys of any length (RFC 2104)")]
    let mut mac = Hmac::<Sha256>::new_from_slice(&key).expect("a key of any length");
    mac.update(format!("{message}.{timestamp}.{payload}").as_bytes());
    format!("v1,{}", STANDARD.encode(mac.finalize().into_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::SystemClock;
    use standardwebhooks::Webhook;

    #[test]
    fn waits_are_as_given_with_up_to_a_fifth_more_and_end_with_the_last() {
        let schedule: Schedule = "5, 300,0.5".parse().expect("a schedule");
        for (tries, low, high) in [(1, 5000, 6000), (2, 300_000, 360_000), (3, 500, 600)] {
            for random in [0, 1, u64::MAX / 3, u64::MAX] {
                let wait = schedule.wait(tries, random).expect("a wait").as_millis();
                assert!((low..high).contains(&wait), "try {tries}: {wait} ms");
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
    fn the_specifications_own_example_is_signed_as_it_says() {
        let secret = SigningSecret::new("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw".into());
        let signed = signature(&secret, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1_614_265_330, "{\"test\": 2432232314}");
        assert_eq!(signed, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
    }

    #[test]
    fn both_secrets_sign_while_the_old_one_is_in_force_and_only_the_new_one_afterwards() {
        let now = SystemClock.now_ms() / 1000;
        let (old, new) = (new_secret(&SystemRandom), new_secret(&SystemRandom));
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
        assert!(!verifies(&new_secret(&SystemRandom), now));
        assert!(!verifies(&old, now + 60) && verifies(&new, now + 60));
    }
}
