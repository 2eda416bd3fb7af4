use std::sync::Arc;
use std::time::Duration;

use time::OffsetDateTime;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;
use uuid::Uuid;

use super::post::{Answer, Envelope};
use super::sign::{new_secret, signatures};
use super::{Poster, Schedule};
use crate::jobs::{Attempt, Clock, DueDelivery, Store, StoreError, SystemClock, Verdict};
use crate::telemetry;

/// Deliveries under way at the same time, in one process.
const AT_ONCE: usize = 16;
/// Of them those of one tenant, on all processes together, so that one whose receivers hang holds nobody else up.
const OF_ONE_TENANT: u32 = 4;

/// How deliveries are made.
#[derive(Debug, Clone)]
pub struct CourierConfig {
    /// How long a claim holds; longer than any delivery takes.
    pub lease: Duration,
    /// When failed deliveries are tried again.
    pub schedule: Schedule,
    /// How long to wait before looking for deliveries that no bell told of.
    pub poll: Duration,
}

/// Makes the deliveries that are due, as one of any number of processes that do.
pub struct Courier {
    store: Arc<dyn Store>,
    poster: Poster,
    config: CourierConfig,
}

impl Courier {
    /// Sends by `poster` what waits in `store`.
    #[must_use]
    pub fn new(store: Arc<dyn Store>, poster: Poster, config: CourierConfig) -> Self {
        Self { store, poster, config }
    }

    /// Runs until told to `drain`. What is under way then may finish until told to stop `now`; what does not is delivered again by
    /// whoever claims it when its lease ends.
    pub async fn run(self, drain: CancellationToken, now: CancellationToken) {
        let courier = Arc::new(self);
        let places = Arc::new(Semaphore::new(AT_ONCE));
        let mut under_way = JoinSet::new();
        while !drain.is_cancelled() {
            let place = tokio::select! {
                place = Arc::clone(&places).acquire_owned() => place,
                () = drain.cancelled() => break,
            };
            match courier.store.claim_delivery(courier.config.lease, OF_ONE_TENANT).await {
                Ok(Some(due)) => {
                    let courier = Arc::clone(&courier);
                    under_way.spawn(async move {
                        courier.deliver(due).await;
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
                () = courier.store.bell().deliveries() => {}
                // A tenant may have as many under way as it may, and more that is due.
                Some(_) = under_way.join_next(), if !under_way.is_empty() => {}
                () = tokio::time::sleep(courier.config.poll) => {}
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
            None => self.store.callback_secrets(&due.tenant, &new_secret()).await?,
        };
        let at = SystemClock.now_ms() / 1000;
        let signatures = signatures(&secrets, &due.message, at, &due.payload);
        let DueDelivery { url, message, payload, .. } = due;
        let answer = self.poster.post(Envelope { url, message, timestamp: at, signatures: &signatures, payload }).await;
        let verdict = self.judge(&answer, due.tries);
        let result = match verdict {
            Verdict::Delivered => "delivered",
            Verdict::Again(_) => "retried",
            Verdict::Failed => "failed",
            Verdict::Gone => "gone",
        };
        metrics::counter!(telemetry::WEBHOOK_DELIVERIES, "result" => result).increment(1);
        metrics::histogram!(telemetry::WEBHOOK).record(answer.took);
        tracing::debug!(tenant = due.tenant, message, result, status = answer.status, error = answer.error, "webhook");
        let attempt = Attempt {
            at: OffsetDateTime::from_unix_timestamp(at).unwrap_or(OffsetDateTime::UNIX_EPOCH),
            status: answer.status,
            error: answer.error,
            milliseconds: u64::try_from(answer.took.as_millis()).unwrap_or(u64::MAX),
        };
        self.store.settle_delivery(due, attempt, verdict).await
    }

    fn judge(&self, answer: &Answer, tries: u32) -> Verdict {
        match answer.status {
            Some(200..300) => Verdict::Delivered,
            Some(410) => Verdict::Gone,
            _ => match self.config.schedule.wait(tries, Uuid::new_v4().as_u64_pair().0) {
                Some(wait) => Verdict::Again(wait),
                None => Verdict::Failed,
            },
        }
    }
}
