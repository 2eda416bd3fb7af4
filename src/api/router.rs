//! The router and the middleware around every route: request id, tracing, compression, draining, panics, and rendering of problems.

use std::any::Any;
use std::future::poll_fn;
use std::pin::Pin;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{DefaultBodyLimit, MatchedPath, Request};
use axum::http::{Extensions, HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, Version, header};
use axum::middleware::{Next, from_fn, from_fn_with_state, map_response};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use http_body::{Frame, SizeHint};
use tower::ServiceExt;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{Predicate, SizeAbove};
use tower_http::decompression::RequestDecompressionLayer;
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, RequestId, SetRequestIdLayer};
use tracing::Instrument;
use tracing::field::Empty;
use utoipa_swagger_ui::SwaggerUi;

use super::authenticate::{authenticate, preflight, reject_while_draining};
use super::openapi;
use super::pages;
use super::problem::{PROBLEM_JSON, Problem, ProblemCode};
use super::state::ApiState;
use super::validation;
use crate::telemetry;

/// The header with the request's id.
const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
/// Longest request id accepted from a client, in characters.
const ID_CHARS: usize = 64;

/// Content codings of request bodies that the service decodes.
const CODINGS: [&str; 4] = ["gzip", "br", "zstd", "deflate"];
/// Smallest response that is compressed, in bytes.
const MIN_COMPRESSED_BYTES: u64 = 256;

/// Builds the router with all routes and middleware.
pub fn router(state: ApiState) -> Router {
    let authenticated = openapi::authenticated_routes()
        // Inside `authenticate`, which lets web pages read the response.
        .route_layer(from_fn_with_state(state.clone(), reject_while_draining))
        .route_layer(from_fn_with_state(state.clone(), authenticate));
    let (routes, document) = authenticated.merge(openapi::public_routes()).split_for_parts();
    let document = openapi::finish(document);
    validation::use_document(&document);
    let router = routes
        .merge(pages::routes())
        .route("/openapi-3.0.json", get(openapi_3_0))
        .with_state(state)
        // Swagger's scripts and styles are part of the binary, so the page works offline.
        .merge(SwaggerUi::new("/docs/api").url("/openapi.json", document))
        .fallback(route_not_found)
        .method_not_allowed_fallback(method_not_allowed)
        // Uploads have their own size limit as they stream in, and JSON bodies the limit of `ApiJson`.
        .layer(DefaultBodyLimit::disable())
        .layer(from_fn(preflight));
    // The path must be rewritten before routing.
    Router::new().fallback_service(add_layers(router).map_request(trim_trailing_slash))
}

/// Routes `/v1/jobs/` like `/v1/jobs`. Pages such as `/docs/` keep the slash, because their relative links need it.
fn trim_trailing_slash(mut request: Request) -> Request {
    let uri = request.uri();
    let path = uri.path();
    let (trimmed, query) = (path.trim_end_matches('/'), uri.query().map(|query| format!("?{query}")));
    if trimmed.len() == path.len() || trimmed.is_empty() || path.starts_with("/docs") {
        return request;
    }
    // If the new URI is invalid, the request keeps its URI and finds no route.
    if let Ok(uri) = format!("{trimmed}{}", query.unwrap_or_default()).parse() {
        *request.uri_mut() = uri;
    }
    request
}

async fn route_not_found(uri: Uri) -> Problem {
    let path: String = uri.path().chars().take(200).collect();
    Problem::new(ProblemCode::RouteNotFound, format!("There is no route '{path}'. See /docs."))
}

async fn method_not_allowed(uri: Uri) -> Problem {
    let path: String = uri.path().chars().take(200).collect();
    Problem::new(ProblemCode::MethodNotAllowed, format!("'{path}' does not support this method. See /docs."))
}

/// Serves the OpenAPI document in version 3.0.3.
async fn openapi_3_0() -> Result<Json<&'static serde_json::Value>, Problem> {
    static DOCUMENT: OnceLock<serde_json::Value> = OnceLock::new();
    if let Some(document) = DOCUMENT.get() {
        return Ok(Json(document));
    }
    let document = openapi::document_3_0().map_err(|error| Problem::internal(&error))?;
    Ok(Json(DOCUMENT.get_or_init(|| document)))
}

/// Adds the middleware of every request. The last layer is the outermost.
fn add_layers(router: Router) -> Router {
    router
        .layer(CatchPanicLayer::custom(panicked))
        .layer(from_fn(linger))
        .layer(RequestDecompressionLayer::new())
        .layer(from_fn(check_coding))
        .layer(from_fn(observe))
        .layer(CompressionLayer::new().no_deflate().compress_when(SizeAbove::new(MIN_COMPRESSED_BYTES).and(is_text)))
        .layer(map_response(weaken_etag))
        .layer(PropagateRequestIdLayer::new(REQUEST_ID))
        .layer(SetRequestIdLayer::new(REQUEST_ID, MakeRequestUuid))
        .layer(from_fn(remove_unsafe_request_id))
}

/// Removes a request id that is unsafe to log.
async fn remove_unsafe_request_id(mut request: Request, next: Next) -> Response {
    let is_safe = |id: &HeaderValue| {
        id.len() <= ID_CHARS && id.as_bytes().iter().all(|b| b.is_ascii_alphanumeric() || b"-_.".contains(b))
    };
    if request.headers().get(&REQUEST_ID).is_some_and(|id| !is_safe(id)) {
        request.headers_mut().remove(&REQUEST_ID);
    }
    next.run(request).await
}

/// Traces, counts and logs the request. Renders a problem with the request's id and path.
async fn observe(request: Request, next: Next) -> Response {
    let id = request.extensions().get::<RequestId>().and_then(|id| id.header_value().to_str().ok());
    let id = id.unwrap_or_default().to_owned();
    // A client may invent methods, and the metrics keep every label value for ever.
    let known_methods = ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"];
    let method = known_methods.into_iter().find(|method| request.method() == *method).unwrap_or("other");
    let path = request.uri().path().to_owned();
    let route = request.extensions().get::<MatchedPath>().map_or("none", MatchedPath::as_str).to_owned();
    let traceparent = request.headers().get(telemetry::TRACEPARENT).and_then(|value| value.to_str().ok());
    // Error level, so that log lines carry the span's fields at every log level.
    let span = tracing::error_span!(
        "request",
        otel.kind = "server",
        otel.name = format!("{method} {route}"),
        request_id = id,
        method,
        path,
        tenant = Empty,
        key_id = Empty,
        trace_id = Empty
    );
    telemetry::continue_from(&span, traceparent);
    let started = Instant::now();
    let mut response = next.run(request).instrument(span.clone()).await;
    let mut code = None;
    if let Some(mut problem) = response.extensions_mut().remove::<Problem>() {
        problem.request_id = id;
        problem.instance = path;
        code = Some(problem.code);
        response = problem.render(response);
    } else if is_foreign_error(&response) {
        let error_code = match response.status() {
            StatusCode::NOT_FOUND => ProblemCode::RouteNotFound,
            StatusCode::METHOD_NOT_ALLOWED => ProblemCode::MethodNotAllowed,
            StatusCode::PAYLOAD_TOO_LARGE => ProblemCode::PayloadTooLarge,
            status if status.is_server_error() => ProblemCode::Internal,
            _ => ProblemCode::InvalidRequest,
        };
        code = Some(error_code);
        let mut problem = Problem::new(error_code, "The service could not handle the request. See /docs.");
        problem.status = response.status().as_u16();
        problem.title = response.status().canonical_reason().unwrap_or("Error").to_owned();
        problem.request_id = id;
        problem.instance = path;
        response = problem.render(response);
    }
    response.headers_mut().insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    let status = response.status().as_u16();
    let elapsed = started.elapsed();
    telemetry::record_response(&span, &route, status);
    span.in_scope(|| log(status, code, elapsed));
    let labels = [("method", method.to_owned()), ("route", route), ("status", status.to_string())];
    metrics::histogram!(telemetry::HTTP_REQUEST, &labels).record(elapsed);
    response
}

/// Logs how a request ended. The span adds the request's id, method, path, tenant and key.
fn log(status: u16, code: Option<ProblemCode>, elapsed: Duration) {
    let milliseconds = elapsed.as_secs_f64() * 1000.0;
    let code_name = code.map(ProblemCode::name);
    let code_name = code_name.as_deref();
    match (status, code) {
        // An unavailable database or a full disk is a matter for the operator; the client can retry.
        (503, _) => tracing::warn!(status, code = code_name, milliseconds, "request failed"),
        (500.., _) => tracing::error!(status, code = code_name, milliseconds, "request failed"),
        // At debug level, since network scanners would otherwise flood the log.
        (_, Some(ProblemCode::RouteNotFound)) => {
            tracing::debug!(status, code = code_name, milliseconds, "request rejected");
        }
        (400.., _) => tracing::info!(status, code = code_name, milliseconds, "request rejected"),
        _ => tracing::debug!(status, milliseconds, "request succeeded"),
    }
}

/// Whether the response is an error that a library rendered without a problem.
fn is_foreign_error(response: &Response) -> bool {
    let is_error = response.status().is_client_error() || response.status().is_server_error();
    let media_type = response.headers().get(header::CONTENT_TYPE);
    let is_json = media_type.is_some_and(|m| *m == PROBLEM_JSON || m.as_bytes().starts_with(b"application/json"));
    is_error && !is_json
}

/// Logs a panic in a handler and responds with an internal error. The service continues.
fn panicked(panic: Box<dyn Any + Send + 'static>) -> Response {
    let message = panic.downcast_ref::<String>().map(String::as_str);
    let message = message.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
    tracing::error!(message, "handler panicked");
    Problem::new(ProblemCode::Internal, "The service failed to handle the request. Retry later.").into_response()
}

/// Rejects a request with an unsupported Content-Encoding.
async fn check_coding(request: Request, next: Next) -> Response {
    let mut codings = request.headers().get_all(header::CONTENT_ENCODING).iter();
    let (coding, second_coding) = (codings.next(), codings.next());
    let is_supported = |coding: &HeaderValue| {
        coding
            .to_str()
            .is_ok_and(|coding| CODINGS.iter().chain(&["identity"]).any(|name| coding.eq_ignore_ascii_case(name)))
    };
    if second_coding.is_none() && coding.is_none_or(is_supported) {
        return next.run(request).await;
    }
    let detail = format!(
        "`Content-Encoding` must be one of {}. Use one of these, or send the body uncompressed.",
        CODINGS.join(", ")
    );
    Problem::new(ProblemCode::UnsupportedMediaType, detail).with_header(header::CONNECTION, "close").into_response()
}

/// Whether a response is text, which compresses well. Models and images stay uncompressed, so that clients can request byte ranges.
fn is_text(_: StatusCode, _: Version, headers: &HeaderMap, _: &Extensions) -> bool {
    let media_type = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let kinds = ["application/json", "application/problem+json", "text/", "application/javascript", "image/svg+xml"];
    kinds.iter().any(|kind| media_type.starts_with(kind)) && !media_type.starts_with("text/event-stream")
}

/// Marks the entity tag of a compressed response as weak: a strong tag identifies the exact bytes (RFC 9110, 8.8.3).
async fn weaken_etag(mut response: Response) -> Response {
    if response.headers().contains_key(header::CONTENT_ENCODING)
        && let Some(tag) = response.headers().get(header::ETAG).and_then(|tag| tag.to_str().ok())
        && !tag.starts_with("W/")
        && let Ok(weak) = HeaderValue::from_str(&format!("W/{tag}"))
    {
        response.headers_mut().insert(header::ETAG, weak);
    }
    response
}

/// Most bytes of a rejected body that are drained.
const DRAIN_BYTES: usize = 4 << 20;
/// Longest time for which a rejected body is drained.
const DRAIN_TIME: Duration = Duration::from_secs(2);

/// Lingering close: drains a rejected body briefly, since otherwise the reset discards our response.
async fn linger(request: Request, next: Next) -> Response {
    // A client that sent `Expect: 100-continue` sends no body after a rejection.
    if request.body().is_end_stream() || request.headers().contains_key(header::EXPECT) {
        return next.run(request).await;
    }
    let (parts, body) = request.into_parts();
    let body = SharedBody(Arc::new(Mutex::new(body)));
    let response = next.run(Request::from_parts(parts, Body::new(body.clone()))).await;
    let is_rejected = response.status().is_client_error() || response.status().is_server_error();
    // After a timeout the client sends nothing more.
    if is_rejected && response.status() != StatusCode::REQUEST_TIMEOUT {
        let _ = tokio::time::timeout(DRAIN_TIME, drain(body)).await;
    }
    response
}

/// Reads and discards up to [`DRAIN_BYTES`] of a body.
async fn drain(mut body: SharedBody) {
    let mut remaining = DRAIN_BYTES;
    while let Some(Ok(frame)) = poll_fn(|context| Pin::new(&mut body).poll_frame(context)).await {
        let Some(unread) = remaining.checked_sub(frame.data_ref().map_or(0, Bytes::len)) else { break };
        remaining = unread;
    }
}

/// A request body that can still be drained after the handler has dropped it.
#[derive(Clone)]
struct SharedBody(Arc<Mutex<Body>>);

impl SharedBody {
    fn with<T>(&self, act: impl FnOnce(&mut Body) -> T) -> T {
        act(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl HttpBody for SharedBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        self.with(|body| Pin::new(body).poll_frame(context))
    }

    fn is_end_stream(&self) -> bool {
        self.with(|body| body.is_end_stream())
    }

    fn size_hint(&self) -> SizeHint {
        self.with(|body| body.size_hint())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trailing_slash_is_removed_except_in_paths_of_the_documentation() {
        for (path, served) in [
            ("/v1/jobs/", "/v1/jobs"),
            ("/v1/jobs/?limit=2", "/v1/jobs?limit=2"),
            ("/v1/jobs?limit=2", "/v1/jobs?limit=2"),
            ("/readyz/", "/readyz"),
            ("/docs/", "/docs/"),
            ("/docs/api/", "/docs/api/"),
            ("/", "/"),
            ("//", "//"),
        ] {
            let request = Request::builder().uri(path).body(Body::empty()).expect("a request");
            assert_eq!(trim_trailing_slash(request).uri(), served, "{path}");
        }
    }
}
