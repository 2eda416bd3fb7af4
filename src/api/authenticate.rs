//! Who is let in, on whose behalf, how often, and from which pages.

use std::num::NonZeroU32;

use axum::extract::{FromRequestParts, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use time::OffsetDateTime;

use super::extract::text_header;
use super::problem::{Problem, ProblemCode};
use super::state::{ApiState, Auth};
use crate::access::{AccessKey, DEFAULT_TENANT, KeyKind, Scope, TenantLimits, TenantName, Token};
use crate::jobs::Job;
use crate::telemetry;

/// Longest secret that is looked at, in bytes.
const SECRET_BYTES: usize = 256;
/// How old the record of a key's last use may become.
const TOUCH_AFTER_MS: i128 = 300_000;
/// What a page may send, and may read of an answer.
const PAGE_SENDS: &str = "authorization, content-type, content-disposition, idempotency-key, if-none-match, if-range, prefer, range, cache-control";
const PAGE_READS: &str = "content-disposition, content-range, etag, idempotency-replayed, location, ratelimit, ratelimit-policy, \
                          retry-after, x-request-id";

/// Who asks: made by `authenticate` for every request that needs one.
#[derive(Debug, Clone)]
pub(super) struct Caller {
    /// On whose behalf.
    pub tenant: TenantName,
    /// With which key; none where the service is open.
    pub key: Option<AccessKey>,
    /// What the tenant may use.
    pub limits: TenantLimits,
}

impl Caller {
    /// Whether the caller may do what the scope is for.
    pub fn may(&self, scope: Scope) -> bool {
        self.key.as_ref().is_none_or(|key| key.scopes.has(scope))
    }

    /// Whether the job exists for the caller: a page sees what was submitted with its own token and nothing else.
    pub fn sees(&self, job: &Job) -> bool {
        job.tenant == self.tenant.as_str()
            && self.only_made_by().is_none_or(|key| job.made_by.as_deref() == Some(key.as_str()))
    }

    /// The key with which a job must have been submitted for the caller to see it.
    pub fn only_made_by(&self) -> Option<String> {
        self.key.as_ref().filter(|key| key.kind == KeyKind::Browser).map(|key| key.id.clone())
    }

    /// The largest upload that the caller may send, where the service takes `most` bytes.
    pub fn max_bytes(&self, most: u64) -> u64 {
        self.key.as_ref().and_then(|key| key.max_bytes).map_or(most, |own| own.min(most))
    }

    fn must(self, scope: Scope) -> Result<Self, Problem> {
        if self.may(scope) {
            return Ok(self);
        }
        let detail = format!("The key does not allow this: it lacks the scope '{scope}'.");
        Err(Problem::new(ProblemCode::Forbidden, detail))
    }
}

/// Extractors that give the caller to handlers which need a scope, and answer for those who lack it.
macro_rules! callers {
    ($($(#[$doc:meta])* $name:ident: $scope:expr;)*) => {$(
        $(#[$doc])*
        pub(super) struct $name(pub Caller);

        impl FromRequestParts<ApiState> for $name {
            type Rejection = Problem;

            async fn from_request_parts(parts: &mut Parts, _: &ApiState) -> Result<Self, Problem> {
                let caller = parts.extensions.get::<Caller>().cloned();
                // Nobody comes here but through `authenticate`; who does is not let in.
                let caller = caller.ok_or_else(|| Problem::new(ProblemCode::Unauthorized, "Nobody asked."))?;
                caller.must($scope).map(Self)
            }
        }
    )*};
}

/// Who may manage tenants and keys. A key is needed even where the service is open: keys made meanwhile would outlast that.
pub(super) struct MayAdminister(pub Caller);

impl FromRequestParts<ApiState> for MayAdminister {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &ApiState) -> Result<Self, Problem> {
        let caller = parts.extensions.get::<Caller>().cloned().filter(|caller| caller.key.is_some());
        let caller = caller.ok_or_else(|| {
            let detail = "This address needs a key with the scope 'admin', also on a service that asks for no keys.";
            Problem::new(ProblemCode::Unauthorized, detail).with_header(header::WWW_AUTHENTICATE, "Bearer")
        })?;
        caller.must(Scope::Admin).map(Self)
    }
}

callers! {
    /// Who may look at jobs.
    MayRead: Scope::JobsRead;
    /// Who may submit, cancel and delete jobs.
    MayWrite: Scope::JobsWrite;
    /// Who may manage webhook endpoints.
    MayManageWebhooks: Scope::Webhooks;
    /// Who may make tokens for browsers.
    MayMakeTokens: Scope::Tokens;
    /// Who may read the service's metrics.
    MayReadMetrics: Scope::Metrics;
}

/// Lets a request in with its [`Caller`], or answers it.
pub(super) async fn authenticate(State(state): State<ApiState>, request: Request, next: Next) -> Response {
    let shown = bearer(request.headers());
    // The page has shown its secret, so whatever the answer is may be read by it.
    let page = shown.filter(|secret| KeyKind::of_secret(secret) == Some(KeyKind::Browser));
    let page = page.and_then(|_| request.headers().get(header::ORIGIN).cloned());
    let has_body = ![Method::GET, Method::HEAD, Method::DELETE].contains(request.method());
    let mut response = match find_caller(&state, request.headers(), shown).await {
        Err(problem) => problem.into_response(),
        Ok(caller) => {
            tracing::Span::current().record("tenant", caller.tenant.as_str());
            match caller.limits.requests_per_minute.and_then(NonZeroU32::new) {
                None => run(caller, request, next).await,
                Some(per_minute) => match state.rates.take(&caller.tenant, per_minute) {
                    Ok(left) => {
                        let mut response = run(caller, request, next).await;
                        left.write_headers(&mut response);
                        response
                    }
                    Err(left) => {
                        metrics::counter!(telemetry::RATE_LIMITED).increment(1);
                        let mut response = left.refused().into_response();
                        left.write_headers(&mut response);
                        response
                    }
                },
            }
        }
    };
    let refused = [StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN, StatusCode::TOO_MANY_REQUESTS];
    if has_body && refused.contains(&response.status()) {
        // The rest of the body is not read, so the connection can't be used again.
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    if let Some(origin) = page {
        let_read(&mut response, origin);
        response.headers_mut().append(header::VARY, HeaderValue::from_static("origin"));
    }
    response
}

/// Lets any page read an answer, whatever it says: of what needs no secret of the page's own.
pub(super) async fn readable(mut response: Response) -> Response {
    let_read(&mut response, HeaderValue::from_static("*"));
    response
}

fn let_read(response: &mut Response, origin: HeaderValue) {
    let headers = response.headers_mut();
    headers.insert(header::ACCESS_CONTROL_ALLOW_ORIGIN, origin);
    headers.insert(header::ACCESS_CONTROL_EXPOSE_HEADERS, HeaderValue::from_static(PAGE_READS));
}

async fn run(caller: Caller, mut request: Request, next: Next) -> Response {
    request.extensions_mut().insert(caller);
    next.run(request).await
}

/// Serves reads and refuses every other request while the process stops.
pub(super) async fn refuse_while_draining(State(state): State<ApiState>, request: Request, next: Next) -> Response {
    match state.accept_work() {
        Err(problem) if ![Method::GET, Method::HEAD].contains(request.method()) => problem.into_response(),
        _ => next.run(request).await,
    }
}

/// Answers a page's browser that asks whether the page may ask. It may: without a secret of its own it gets nothing.
pub(super) async fn preflight(request: Request, next: Next) -> Response {
    let asked = request.headers().contains_key(header::ACCESS_CONTROL_REQUEST_METHOD);
    if request.method() != Method::OPTIONS || !asked || !request.uri().path().starts_with("/v1/") {
        return next.run(request).await;
    }
    let headers = [
        (header::ACCESS_CONTROL_ALLOW_ORIGIN, "*"),
        (header::ACCESS_CONTROL_ALLOW_METHODS, "GET, HEAD, POST, PUT, DELETE"),
        (header::ACCESS_CONTROL_ALLOW_HEADERS, PAGE_SENDS),
        (header::ACCESS_CONTROL_MAX_AGE, "600"),
    ];
    (StatusCode::NO_CONTENT, headers).into_response()
}

/// The secret of `Authorization: Bearer`.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let (scheme, secret) = text_header(headers, &header::AUTHORIZATION)?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| secret.trim())
}

async fn find_caller(state: &ApiState, headers: &HeaderMap, shown: Option<&str>) -> Result<Caller, Problem> {
    let origin = headers.get(header::ORIGIN);
    let known = match shown {
        Some(secret) => Some(find_key(state, secret).await?),
        None if headers.contains_key(header::AUTHORIZATION) => {
            return Err(unauthorized("The header Authorization must be 'Bearer' and a key."));
        }
        None if state.auth == Auth::Keys => {
            return Err(unauthorized("This service asks for a key. Send it as 'Authorization: Bearer KEY'."));
        }
        None => None,
    };
    if let Some((key, _)) = &known {
        tracing::Span::current().record("key_id", key.id.as_str());
    }
    match &known {
        Some((key, _)) if key.kind == KeyKind::Browser => {
            let own = key.origin.as_deref();
            if own.is_some() && origin.and_then(|origin| origin.to_str().ok()) != own {
                return Err(wrong_origin("The token is for pages of another origin."));
            }
        }
        Some(_) => {}
        // Any page could send its visitor's browser here.
        None if origin.is_some_and(|origin| !is_same(origin, headers.get(header::HOST))) => {
            return Err(wrong_origin("Pages of other origins need a token. Ask for one by POST /v1/browser-tokens."));
        }
        None => {}
    }
    let (tenant, key, limits) = match known {
        Some((key, limits)) => (key.tenant.clone(), Some(key), limits),
        None => (TenantName::default(), None, state.store.limits(DEFAULT_TENANT).await?),
    };
    Ok(Caller { tenant, key, limits: limits.or(state.config.tenant_limits) })
}

/// The key of a secret, if it is worth something, and its tenant's limits.
async fn find_key(state: &ApiState, secret: &str) -> Result<(AccessKey, TenantLimits), Problem> {
    let known = if secret.len() <= SECRET_BYTES { state.store.find_key(&Token::of(secret)).await? } else { None };
    let Some((key, limits)) = known else {
        metrics::counter!(telemetry::KEYS_REFUSED).increment(1);
        return Err(unauthorized("The key is unknown, revoked or expired."));
    };
    let now_ms = i128::from(state.clock.now_ms());
    let is_stale = |last: OffsetDateTime| now_ms - last.unix_timestamp_nanos() / 1_000_000 > TOUCH_AFTER_MS;
    if key.last_used_at.is_none_or(is_stale) {
        let (store, id) = (state.store.clone(), key.id.clone());
        tokio::spawn(async move {
            if let Err(error) = store.touch_key(&id).await {
                tracing::warn!(%error, "the use of a key was not noted");
            }
        });
    }
    Ok((key, limits))
}

fn unauthorized(detail: &str) -> Problem {
    Problem::new(ProblemCode::Unauthorized, detail).with_header(header::WWW_AUTHENTICATE, "Bearer")
}

fn wrong_origin(detail: &str) -> Problem {
    Problem::new(ProblemCode::OriginNotAllowed, detail)
}

/// Whether an origin is that of the host that was asked.
fn is_same(origin: &HeaderValue, host: Option<&HeaderValue>) -> bool {
    let origin = origin.to_str().ok().and_then(|origin| origin.split_once("://"));
    origin.is_some_and(|(_, name)| host.is_some_and(|host| host.as_bytes().eq_ignore_ascii_case(name.as_bytes())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_hosts_own_pages_are_of_its_origin() {
        let same = |origin: &str, host: &str| {
            is_same(&origin.parse().expect("a header"), Some(&host.parse().expect("a header")))
        };
        assert!(same("http://127.0.0.1:8080", "127.0.0.1:8080"));
        assert!(same("https://Mend.example", "mend.example"));
        for origin in ["null", "http://evil.example", "http://127.0.0.1:8081", "http://127.0.0.1:8080.evil.example"] {
            assert!(!same(origin, "127.0.0.1:8080"), "{origin}");
        }
        assert!(!is_same(&HeaderValue::from_static("http://a"), None));
    }
}
