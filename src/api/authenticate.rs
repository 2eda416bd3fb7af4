//! Authentication of requests: API keys and browser tokens, scopes, rate limits and origins (CORS).

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
use crate::access::{AccessKey, DEFAULT_TENANT, KeyKind, Scope, SecretHash, TenantLimits, TenantName};
use crate::jobs::Job;
use crate::telemetry;

/// Longest secret that is looked up, in bytes.
const SECRET_BYTES: usize = 256;
/// Age in milliseconds after which a key's recorded last use is updated.
const LAST_USE_MAX_AGE_MS: i128 = 300_000;
/// Request headers that a web page may send.
const CORS_REQUEST_HEADERS: &str = "authorization, content-type, content-disposition, idempotency-key, if-none-match, if-range, prefer, range, cache-control";
/// Response headers that a web page may read.
const CORS_RESPONSE_HEADERS: &str = "content-disposition, content-range, etag, idempotency-replayed, location, ratelimit, ratelimit-policy, \
                                     retry-after, x-request-id";

/// The authenticated caller of a request, set by [`authenticate`].
#[derive(Debug, Clone)]
pub(super) struct Caller {
    /// The tenant on whose behalf the request runs.
    pub tenant: TenantName,
    /// The API key or browser token; none if the service requires no keys.
    pub key: Option<AccessKey>,
    /// The tenant's limits.
    pub limits: TenantLimits,
}

impl Caller {
    /// Whether the caller has a scope.
    pub fn has_scope(&self, scope: Scope) -> bool {
        self.key.as_ref().is_none_or(|key| key.scopes.has(scope))
    }

    /// Whether the job is visible to the caller. A browser token sees only jobs that were submitted with the same token.
    pub fn sees(&self, job: &Job) -> bool {
        job.tenant == self.tenant.as_str()
            && self.token_id().is_none_or(|key| job.api_key_id.as_deref() == Some(key.as_str()))
    }

    /// Returns the id of the caller's browser token, which limits the visible jobs; none for other callers.
    pub fn token_id(&self) -> Option<String> {
        self.key.as_ref().filter(|key| key.kind == KeyKind::Browser).map(|key| key.id.clone())
    }

    /// Returns the caller's upload limit in bytes: the key's own limit, at most `service_limit`.
    pub fn max_bytes(&self, service_limit: u64) -> u64 {
        self.key.as_ref().and_then(|key| key.max_bytes).map_or(service_limit, |own| own.min(service_limit))
    }

    fn require(self, scope: Scope) -> Result<Self, Problem> {
        if self.has_scope(scope) {
            return Ok(self);
        }
        let detail = format!("The key lacks the scope '{scope}', which this request needs.");
        Err(Problem::new(ProblemCode::Forbidden, detail))
    }
}

/// Defines extractors that yield the caller if it has a scope, and otherwise reject with `forbidden`.
macro_rules! scope_extractors {
    ($($(#[$doc:meta])* $name:ident: $scope:expr;)*) => {$(
        $(#[$doc])*
        pub(super) struct $name(pub Caller);

        impl FromRequestParts<ApiState> for $name {
            type Rejection = Problem;

            async fn from_request_parts(parts: &mut Parts, _: &ApiState) -> Result<Self, Problem> {
                caller_of(parts)?.require($scope).map(Self)
            }
        }
    )*};
}

/// Yields any authenticated caller, whatever its scopes.
pub(super) struct AnyCaller(pub Caller);

impl FromRequestParts<ApiState> for AnyCaller {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &ApiState) -> Result<Self, Problem> {
        caller_of(parts).map(Self)
    }
}

/// Returns the caller of a request. Every route with a caller is behind [`authenticate`]; a request without one is rejected.
fn caller_of(parts: &Parts) -> Result<Caller, Problem> {
    let caller = parts.extensions.get::<Caller>().cloned();
    caller.ok_or_else(|| Problem::new(ProblemCode::Unauthorized, "The request is not authenticated."))
}

/// Yields a caller with the scope `admin`. Requires a key even if the service requires none: keys created now would remain
/// valid after the operator turns authentication on.
pub(super) struct RequireAdmin(pub Caller);

impl FromRequestParts<ApiState> for RequireAdmin {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &ApiState) -> Result<Self, Problem> {
        let caller = parts.extensions.get::<Caller>().cloned().filter(|caller| caller.key.is_some());
        let caller = caller.ok_or_else(|| {
            let detail = "This request needs a key with the scope 'admin', even on a service that requires no keys.";
            Problem::new(ProblemCode::Unauthorized, detail).with_header(header::WWW_AUTHENTICATE, "Bearer")
        })?;
        caller.require(Scope::Admin).map(Self)
    }
}

scope_extractors! {
    /// Yields a caller that may read jobs.
    RequireJobsRead: Scope::JobsRead;
    /// Yields a caller that may submit, cancel and delete jobs.
    RequireJobsWrite: Scope::JobsWrite;
    /// Yields a caller that may manage webhook endpoints.
    RequireWebhooks: Scope::Webhooks;
    /// Yields a caller that may create browser tokens.
    RequireTokens: Scope::Tokens;
    /// Yields a caller that may read the service's metrics.
    RequireMetrics: Scope::Metrics;
}

/// Authenticates the request, applies the tenant's rate limit, and passes the request on with its [`Caller`].
pub(super) async fn authenticate(State(state): State<ApiState>, request: Request, next: Next) -> Response {
    let secret = bearer(request.headers());
    // The page has sent its token, so it may read any response, including an error.
    let page_origin = secret.filter(|secret| KeyKind::of_secret(secret) == Some(KeyKind::Browser));
    let page_origin = page_origin.and_then(|_| request.headers().get(header::ORIGIN).cloned());
    let has_body = ![Method::GET, Method::HEAD, Method::DELETE].contains(request.method());
    let mut response = match find_caller(&state, request.headers(), secret).await {
        Err(problem) => problem.into_response(),
        Ok(caller) => {
            tracing::Span::current().record("tenant", caller.tenant.as_str());
            match caller.limits.requests_per_minute.and_then(NonZeroU32::new) {
                None => run(caller, request, next).await,
                Some(per_minute) => match state.rates.take(&caller.tenant, per_minute) {
                    Ok(rate) => {
                        let mut response = run(caller, request, next).await;
                        rate.write_headers(&mut response);
                        response
                    }
                    Err(rate) => {
                        metrics::counter!(telemetry::RATE_LIMITED).increment(1);
                        let mut response = rate.to_problem().into_response();
                        rate.write_headers(&mut response);
                        response
                    }
                },
            }
        }
    };
    let rejections = [StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN, StatusCode::TOO_MANY_REQUESTS];
    if has_body && rejections.contains(&response.status()) {
        // The rest of the body is not read, so the connection can't be reused.
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    if let Some(origin) = page_origin {
        allow_origin(&mut response, origin);
        response.headers_mut().append(header::VARY, HeaderValue::from_static("origin"));
    }
    response
}

/// Lets pages of any origin read the response. For routes that need no key.
pub(super) async fn allow_any_origin(mut response: Response) -> Response {
    allow_origin(&mut response, HeaderValue::from_static("*"));
    response
}

fn allow_origin(response: &mut Response, origin: HeaderValue) {
    let headers = response.headers_mut();
    headers.insert(header::ACCESS_CONTROL_ALLOW_ORIGIN, origin);
    headers.insert(header::ACCESS_CONTROL_EXPOSE_HEADERS, HeaderValue::from_static(CORS_RESPONSE_HEADERS));
}

async fn run(caller: Caller, mut request: Request, next: Next) -> Response {
    request.extensions_mut().insert(caller);
    next.run(request).await
}

/// Rejects every request but reads while the process stops.
pub(super) async fn reject_while_draining(State(state): State<ApiState>, request: Request, next: Next) -> Response {
    match state.accept_work() {
        Err(problem) if ![Method::GET, Method::HEAD].contains(request.method()) => problem.into_response(),
        _ => next.run(request).await,
    }
}

/// Answers CORS preflight requests. Every origin is allowed: without a token a page gets no data.
pub(super) async fn preflight(request: Request, next: Next) -> Response {
    let is_preflight = request.method() == Method::OPTIONS
        && request.headers().contains_key(header::ACCESS_CONTROL_REQUEST_METHOD)
        && request.uri().path().starts_with("/v1/");
    if !is_preflight {
        return next.run(request).await;
    }
    let headers = [
        (header::ACCESS_CONTROL_ALLOW_ORIGIN, "*"),
        (header::ACCESS_CONTROL_ALLOW_METHODS, "GET, HEAD, POST, PUT, DELETE"),
        (header::ACCESS_CONTROL_ALLOW_HEADERS, CORS_REQUEST_HEADERS),
        (header::ACCESS_CONTROL_MAX_AGE, "600"),
    ];
    (StatusCode::NO_CONTENT, headers).into_response()
}

/// Returns the secret in the header `Authorization: Bearer`.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let (scheme, secret) = text_header(headers, &header::AUTHORIZATION)?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| secret.trim())
}

/// Finds the caller by its secret. Without a secret the caller is the default tenant, if the service allows that.
async fn find_caller(state: &ApiState, headers: &HeaderMap, secret: Option<&str>) -> Result<Caller, Problem> {
    let origin = headers.get(header::ORIGIN);
    let key_and_limits = match secret {
        Some(secret) => Some(find_key(state, secret).await?),
        None if headers.contains_key(header::AUTHORIZATION) => {
            return Err(unauthorized("The header Authorization must have the form 'Bearer KEY'."));
        }
        None if state.auth == Auth::Keys => {
            return Err(unauthorized("This service requires an API key. Send it as 'Authorization: Bearer KEY'."));
        }
        None => None,
    };
    if let Some((key, _)) = &key_and_limits {
        tracing::Span::current().record("key_id", key.id.as_str());
    }
    match &key_and_limits {
        Some((key, _)) if key.kind == KeyKind::Browser => {
            let own = key.origin.as_deref();
            if own.is_some() && origin.and_then(|origin| origin.to_str().ok()) != own {
                return Err(wrong_origin("This token was created for pages of another origin."));
            }
        }
        Some(_) => {}
        // Any web page could make its visitor's browser send this request.
        None if origin.is_some_and(|origin| !is_same_origin(origin, headers.get(header::HOST))) => {
            return Err(wrong_origin("Pages of other origins need a token. Create one with POST /v1/browser-tokens."));
        }
        None => {}
    }
    let (tenant, key, limits) = match key_and_limits {
        Some((key, limits)) => (key.tenant.clone(), Some(key), limits),
        None => (TenantName::default(), None, state.store.limits(DEFAULT_TENANT).await?),
    };
    Ok(Caller { tenant, key, limits: limits.or(state.config.tenant_limits) })
}

/// Returns the key of a secret and the limits of its tenant. Records the key's use if the last record is old.
async fn find_key(state: &ApiState, secret: &str) -> Result<(AccessKey, TenantLimits), Problem> {
    let key_and_limits =
        if secret.len() <= SECRET_BYTES { state.store.find_key(&SecretHash::of(secret)).await? } else { None };
    let Some((key, limits)) = key_and_limits else {
        metrics::counter!(telemetry::KEYS_REFUSED).increment(1);
        return Err(unauthorized("This key is unknown, revoked or expired."));
    };
    let now_ms = i128::from(state.clock.now_ms());
    let is_stale = |last: OffsetDateTime| now_ms - last.unix_timestamp_nanos() / 1_000_000 > LAST_USE_MAX_AGE_MS;
    if key.last_used_at.is_none_or(is_stale) {
        let (store, id) = (state.store.clone(), key.id.clone());
        tokio::spawn(async move {
            if let Err(error) = store.touch_key(&id).await {
                tracing::warn!(%error, "failed to record key use");
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

/// Whether an origin is that of the requested host.
fn is_same_origin(origin: &HeaderValue, host: Option<&HeaderValue>) -> bool {
    let origin = origin.to_str().ok().and_then(|origin| origin.split_once("://"));
    origin.is_some_and(|(_, name)| host.is_some_and(|host| host.as_bytes().eq_ignore_ascii_case(name.as_bytes())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pages_of_the_same_host_and_port_have_the_same_origin() {
        let same = |origin: &str, host: &str| {
            is_same_origin(&origin.parse().expect("a header"), Some(&host.parse().expect("a header")))
        };
        assert!(same("http://127.0.0.1:8080", "127.0.0.1:8080"));
        assert!(same("https://Mend.example", "mend.example"));
        for origin in ["null", "http://evil.example", "http://127.0.0.1:8081", "http://127.0.0.1:8080.evil.example"] {
            assert!(!same(origin, "127.0.0.1:8080"), "{origin}");
        }
        assert!(!is_same_origin(&HeaderValue::from_static("http://a"), None));
    }
}
