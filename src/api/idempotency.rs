//! `Idempotency-Key` after the IETF's draft of that name: a request that is sent again makes no second job.

use std::sync::Arc;

use axum::http::{HeaderMap, HeaderName};
use sha2::{Digest, Sha256};
use tokio::task::JoinHandle;
use tracing::Instrument;

use super::extract::text_header;
use super::incoming::Upload;
use super::problem::{Problem, ProblemCode};
use crate::access::TenantName;
use crate::jobs::{JobId, KEY_HOLD, KeyState, RequestKey, Store};

/// The request's header.
const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");
/// The header of an answer that was given before.
pub(super) const REPLAYED: HeaderName = HeaderName::from_static("idempotency-replayed");
/// Longest key, in bytes.
const KEY_BYTES: usize = 255;
/// Seconds to wait for a request that is under way.
const RETRY_AFTER_S: u32 = 2;

/// What a request's key says.
pub(super) enum Asked {
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

/// A key that is held while its request is under way, and given back if that comes to nothing.
pub(super) struct HeldKey {
    store: Arc<dyn Store>,
    tenant: TenantName,
    key: Option<String>,
    job: JobId,
    renewal: JoinHandle<()>,
}

/// Looks the request's key up, and holds it.
pub(super) async fn ask(
    store: &Arc<dyn Store>,
    tenant: &TenantName,
    headers: &HeaderMap,
    job: JobId,
) -> Result<Asked, Problem> {
    let Some(given) = headers.get(IDEMPOTENCY_KEY) else { return Ok(Asked::NoKey) };
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
    // Before it is, so that it is given back too where the answer is lost, or the client hangs up meanwhile.
    let held = HeldKey::new(Arc::clone(store), tenant.clone(), key.to_owned(), job);
    let state = store.hold_key(tenant.as_str(), key, job).await?;
    if state == KeyState::Held {
        return Ok(Asked::Held(held));
    }
    held.leave();
    match state {
        KeyState::Used { fingerprint, job } => Ok(Asked::Before { fingerprint, job }),
        KeyState::InUse | KeyState::Held => Err(in_use()),
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

    /// Gives it back, and waits until that is done, so that whoever hears the answer can send a better request with it.
    pub async fn give_back(mut self) {
        self.renewal.abort();
        if let Some(key) = self.key.take() {
            release(self.store.as_ref(), &self.tenant, &key, self.job).await;
        }
    }

    /// Lets the key be, for it is known with the job that the request made, or was never held.
    pub fn leave(mut self) {
        self.key = None;
    }
}

/// Gives it back, if it is held: never one that is known with a job, though nobody may have heard that it is.
impl Drop for HeldKey {
    fn drop(&mut self) {
        self.renewal.abort();
        let Some(key) = self.key.take() else { return };
        let (store, tenant, job) = (Arc::clone(&self.store), self.tenant.clone(), self.job);
        tokio::spawn(async move { release(store.as_ref(), &tenant, &key, job).await }.in_current_span());
    }
}

async fn release(store: &dyn Store, tenant: &TenantName, key: &str, job: JobId) {
    if let Err(error) = store.release_key(tenant.as_str(), key, job).await {
        tracing::warn!(%error, "an idempotency key was not given back and will be free in a while");
    }
}

/// What tells one request from another: its files, its options, and what else it says.
pub(super) fn fingerprint(upload: &Upload) -> String {
    let files: Vec<_> = upload.inputs.iter().map(|input| (&input.name, input.bytes, &input.sha256)).collect();
    let bytes = serde_json::to_vec(&(files, &upload.options, &upload.notes)).unwrap_or_default();
    hex::encode(Sha256::digest(&bytes))
}

/// That the key came with another request before.
pub(super) fn reused() -> Problem {
    let detail = "The Idempotency-Key came with other files or options before. Send a new key with a new request.";
    Problem::new(ProblemCode::IdempotencyKeyReused, detail)
}

/// That a request with the key is under way.
pub(super) fn in_use() -> Problem {
    let detail = "A request with this Idempotency-Key is under way. Ask again when it may have ended.";
    Problem::new(ProblemCode::IdempotencyKeyInUse, detail).retry_after(RETRY_AFTER_S)
}
