//! `Idempotency-Key` after the IETF's draft of that name: a request that is sent again makes no second job.

use std::sync::Arc;

use axum::http::{HeaderMap, HeaderName};
use tokio::task::JoinHandle;
use tracing::Instrument;

use super::extract::text_header;
use super::problem::{Problem, ProblemCode};
use crate::access::TenantName;
use crate::jobs::{Job, JobId, JobStore, KEY_HOLD, KeyState, RequestKey, Store};

/// The request's header.
const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");
/// The header of an answer that was given before.
pub(super) const REPLAYED: HeaderName = HeaderName::from_static("idempotency-replayed");
/// Longest key, in bytes.
const KEY_BYTES: usize = 255;

/// How a request's key was used before.
pub(super) enum KeyUse {
    /// The request has none.
    NoKey,
    /// It is new.
    Held(HeldKey),
    /// It came with this request before.
    Before {
        /// Of that request.
        fingerprint: String,
        /// Which it made.
        job: JobId,
    },
}

/// A key that is held while its request is under way, and released if that makes no job.
pub(super) struct HeldKey {
    store: Arc<dyn Store>,
    tenant: TenantName,
    key: Option<String>,
    job: JobId,
    renewal: JoinHandle<()>,
}

/// Looks the request's key up, and holds it.
pub(super) async fn hold(
    store: &Arc<dyn Store>,
    tenant: &TenantName,
    headers: &HeaderMap,
    job: JobId,
) -> Result<KeyUse, Problem> {
    let Some(given) = headers.get(IDEMPOTENCY_KEY) else { return Ok(KeyUse::NoKey) };
    // A string in quotes, says the draft; many clients send none.
    let key = text_header(headers, &IDEMPOTENCY_KEY).unwrap_or_default().trim();
    let key = key.strip_prefix('"').and_then(|key| key.strip_suffix('"')).unwrap_or(key);
    let is_fine = given.len() <= KEY_BYTES && !key.is_empty() && key.bytes().all(|byte| byte.is_ascii_graphic());
    if !is_fine || headers.get_all(IDEMPOTENCY_KEY).iter().count() > 1 {
        let detail = format!(
            "The header Idempotency-Key must be given once, with 1 to {KEY_BYTES} visible ASCII characters, such as a UUID."
        );
        return Err(Problem::invalid_request(detail));
    }
    // Made before the key is held, so that the key is released too where the answer is lost, or the client hangs up meanwhile.
    let held = HeldKey::new(Arc::clone(store), tenant.clone(), key.to_owned(), job);
    let state = store.hold_key(tenant.as_str(), key, job).await?;
    if state == KeyState::Held {
        return Ok(KeyUse::Held(held));
    }
    held.forget();
    match state {
        KeyState::Used { fingerprint, job } => Ok(KeyUse::Before { fingerprint, job }),
        KeyState::InUse | KeyState::Held => Err(Problem::key_in_use()),
    }
}

impl HeldKey {
    fn new(store: Arc<dyn Store>, tenant: TenantName, key: String, job: JobId) -> Self {
        let (renewed, whose, name) = (Arc::clone(&store), tenant.clone(), key.clone());
        let renewal = async move {
            loop {
                tokio::time::sleep(KEY_HOLD / 3).await;
                if let Err(error) = renewed.hold_key(whose.as_str(), &name, job).await {
                    tracing::warn!(%error, "an idempotency key could not be held");
                }
            }
        };
        Self { store, tenant, key: Some(key), job, renewal: tokio::spawn(renewal.in_current_span()) }
    }

    /// The key, for the transaction that accepts the request.
    pub fn with(&self, fingerprint: String) -> Option<RequestKey> {
        self.key.clone().map(|key| RequestKey { key, fingerprint })
    }

    /// Releases it, and waits until that is done, so that a client that has the answer can send a better request with the key.
    pub async fn release(mut self) {
        self.renewal.abort();
        if let Some(key) = self.key.take() {
            release_key(self.store.as_ref(), &self.tenant, &key, self.job).await;
        }
    }

    /// Does not release the key, for it is known with the job that the request made, or was never held.
    pub fn forget(mut self) {
        self.key = None;
    }
}

/// Releases it, if it is held: never one that is known with a job, though nobody may have heard that it is.
impl Drop for HeldKey {
    fn drop(&mut self) {
        self.renewal.abort();
        let Some(key) = self.key.take() else { return };
        let (store, tenant, job) = (Arc::clone(&self.store), self.tenant.clone(), self.job);
        tokio::spawn(async move { release_key(store.as_ref(), &tenant, &key, job).await }.in_current_span());
    }
}

async fn release_key(store: &dyn Store, tenant: &TenantName, key: &str, job: JobId) {
    if let Err(error) = store.release_key(tenant.as_str(), key, job).await {
        tracing::warn!(%error, "an idempotency key was not given back and will be free in a while");
    }
}

/// That the key came with another request before.
pub(super) fn reused() -> Problem {
    let detail = "The Idempotency-Key came with other files or options before. Send a new key with a new request.";
    Problem::new(ProblemCode::IdempotencyKeyReused, detail)
}

/// The job that the same request made before.
pub(super) async fn job_of_key(store: &dyn JobStore, id: JobId) -> Result<Job, Problem> {
    match store.get(id).await? {
        Some(job) if !job.purged => Ok(job),
        _ => {
            let detail = format!("The job {id}, which this request made, was deleted.");
            Err(Problem::new(ProblemCode::JobDeleted, detail))
        }
    }
}
