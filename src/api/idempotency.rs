//! Support for the header `Idempotency-Key`: a retried request does not create a second job.
//!
//! Source: "The Idempotency-Key HTTP Header Field", IETF draft.

use std::sync::Arc;

use axum::http::{HeaderMap, HeaderName};
use tokio::task::JoinHandle;
use tracing::Instrument;

use super::extract::text_header;
use super::problem::{Problem, ProblemCode};
use crate::access::TenantName;
use crate::jobs::{Job, JobId, JobStore, KEY_HOLD, KeyState, RequestKey, Store};

/// The request header.
const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");
/// The response header that marks a response to a retried request.
pub(super) const REPLAYED: HeaderName = HeaderName::from_static("idempotency-replayed");
/// Longest key, in bytes.
const KEY_BYTES: usize = 255;

/// The state of a request's idempotency key.
pub(super) enum IdempotencyState {
    /// The request has no key.
    NoKey,
    /// The key is new, and this request holds it.
    Held(HeldKey),
    /// An earlier request with this key created a job.
    Used {
        /// The fingerprint of the earlier request.
        fingerprint: String,
        /// The job that the earlier request created.
        job: JobId,
    },
}

/// A key held while its request is in progress. The key is released if the request creates no job.
pub(super) struct HeldKey {
    store: Arc<dyn Store>,
    tenant: TenantName,
    key: Option<String>,
    job: JobId,
    renewal: JoinHandle<()>,
}

/// Looks up the request's key, and holds the key if it is new.
pub(super) async fn hold(
    store: &Arc<dyn Store>,
    tenant: &TenantName,
    headers: &HeaderMap,
    job: JobId,
) -> Result<IdempotencyState, Problem> {
    let Some(given) = headers.get(IDEMPOTENCY_KEY) else { return Ok(IdempotencyState::NoKey) };
    // The draft demands a quoted string; many clients send the bare key.
    let key = text_header(headers, &IDEMPOTENCY_KEY).unwrap_or_default().trim();
    let key = key.strip_prefix('"').and_then(|key| key.strip_suffix('"')).unwrap_or(key);
    let is_valid = given.len() <= KEY_BYTES && !key.is_empty() && key.bytes().all(|byte| byte.is_ascii_graphic());
    if !is_valid || headers.get_all(IDEMPOTENCY_KEY).iter().count() > 1 {
        let detail = format!(
            "The header Idempotency-Key must occur once, with 1 to {KEY_BYTES} visible ASCII characters, such as a UUID."
        );
        return Err(Problem::invalid_request(detail));
    }
    // Created before the key is held: dropping `held` releases the key if the response is lost or the client disconnects.
    let held = HeldKey::new(Arc::clone(store), tenant.clone(), key.to_owned(), job);
    let state = store.hold_key(tenant.as_str(), key, job).await?;
    if state == KeyState::Held {
        return Ok(IdempotencyState::Held(held));
    }
    held.forget();
    match state {
        KeyState::Used { fingerprint, job } => Ok(IdempotencyState::Used { fingerprint, job }),
        KeyState::InUse | KeyState::Held => Err(Problem::key_in_use()),
    }
}

impl HeldKey {
    fn new(store: Arc<dyn Store>, tenant: TenantName, key: String, job: JobId) -> Self {
        let (renewal_store, owner, name) = (Arc::clone(&store), tenant.clone(), key.clone());
        let renewal = async move {
            loop {
                tokio::time::sleep(KEY_HOLD / 3).await;
                if let Err(error) = renewal_store.hold_key(owner.as_str(), &name, job).await {
                    tracing::warn!(%error, "failed to renew idempotency key");
                }
            }
        };
        Self { store, tenant, key: Some(key), job, renewal: tokio::spawn(renewal.in_current_span()) }
    }

    /// Returns the key with the request's fingerprint, for the transaction that creates the job.
    pub fn with_fingerprint(&self, fingerprint: String) -> Option<RequestKey> {
        self.key.clone().map(|key| RequestKey { key, fingerprint })
    }

    /// Releases the key and waits for the release, so that the client can retry a corrected request with the same key.
    pub async fn release(mut self) {
        self.renewal.abort();
        if let Some(key) = self.key.take() {
            release_key(self.store.as_ref(), &self.tenant, &key, self.job).await;
        }
    }

    /// Keeps the key: it now belongs to the job that the request created, or was never held.
    pub fn forget(mut self) {
        self.key = None;
    }
}

/// Releases the key if it is still held. The store never releases a key that belongs to a job, even if the response was lost.
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
        tracing::warn!(%error, "failed to release idempotency key; it expires on its own");
    }
}

/// Creates the problem for a key that was used with a different request.
pub(super) fn reused() -> Problem {
    let detail = "This Idempotency-Key was already used with other files or options. Use a new key for a new request.";
    Problem::new(ProblemCode::IdempotencyKeyReused, detail)
}

/// Returns the job that an earlier request with the same key created.
pub(super) async fn job_of_key(store: &dyn JobStore, id: JobId) -> Result<Job, Problem> {
    match store.get(id).await? {
        Some(job) if !job.purged => Ok(job),
        _ => {
            let detail = format!("The job '{id}', which the first request with this key created, was deleted.");
            Err(Problem::new(ProblemCode::JobDeleted, detail))
        }
    }
}
