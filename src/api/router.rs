use std::sync::OnceLock;

use axum::extract::{DefaultBodyLimit, Request};
use axum::http::Uri;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::get;
use axum::{Json, Router};
use tower::ServiceExt;
use utoipa_swagger_ui::SwaggerUi;

use super::authenticate::{authenticate, preflight, refuse_while_draining};
use super::check;
use super::layers;
use super::openapi;
use super::pages;
use super::problem::{Problem, ProblemCode};
use super::state::ApiState;

/// The whole HTTP surface.
pub fn router(state: ApiState) -> Router {
    let authenticated = openapi::guarded()
        // Within `authenticate`, which lets pages read the answer.
        .route_layer(from_fn_with_state(state.clone(), refuse_while_draining))
        .route_layer(from_fn_with_state(state.clone(), authenticate));
    let (routes, document) = authenticated.merge(openapi::open()).split_for_parts();
    let document = openapi::complete(document);
    check::use_document(&document);
    let router = routes
        .merge(pages::routes())
        .route("/openapi-3.0.json", get(openapi_3_0))
        .with_state(state)
        // Its scripts and styles are in the binary too: it works offline.
        .merge(SwaggerUi::new("/docs/api").url("/openapi.json", document))
        .fallback(no_route)
        .method_not_allowed_fallback(wrong_method)
        // Uploads are counted as they stream in, and other bodies by `ApiJson`.
        .layer(DefaultBodyLimit::disable())
        .layer(from_fn(preflight));
    // Paths are rewritten before any route is chosen.
    Router::new().fallback_service(layers::add(router).map_request(trim_trailing_slash))
}

/// Serves `/v1/jobs/` like `/v1/jobs`. Pages such as `/docs/` keep the slash, which their relative links need.
fn trim_trailing_slash(mut request: Request) -> Request {
    let uri = request.uri();
    let path = uri.path();
    let (trimmed, query) = (path.trim_end_matches('/'), uri.query().map(|query| format!("?{query}")));
    if trimmed.len() == path.len() || trimmed.is_empty() || path.starts_with("/docs") {
        return request;
    }
    // Without a change the request goes on, and no route is found.
    if let Ok(uri) = format!("{trimmed}{}", query.unwrap_or_default()).parse() {
        *request.uri_mut() = uri;
    }
    request
}

async fn no_route(uri: Uri) -> Problem {
    let path: String = uri.path().chars().take(200).collect();
    Problem::new(ProblemCode::RouteNotFound, format!("There is nothing at '{path}'. See /docs."))
}

async fn wrong_method(uri: Uri) -> Problem {
    let path: String = uri.path().chars().take(200).collect();
    Problem::new(ProblemCode::MethodNotAllowed, format!("'{path}' can't be asked with this method. See /docs."))
}

/// The OpenAPI document for code generators that do not read version 3.1.
async fn openapi_3_0() -> Result<Json<&'static serde_json::Value>, Problem> {
    static DOCUMENT: OnceLock<serde_json::Value> = OnceLock::new();
    if let Some(document) = DOCUMENT.get() {
        return Ok(Json(document));
    }
    let document = openapi::document_3_0().map_err(|error| Problem::internal(&error))?;
    Ok(Json(DOCUMENT.get_or_init(|| document)))
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    #[test]
    fn a_trailing_slash_is_dropped_from_every_path_but_those_of_the_documentation() {
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
