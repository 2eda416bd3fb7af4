use std::sync::OnceLock;

use axum::extract::DefaultBodyLimit;
use axum::http::Uri;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::routing::get;
use axum::{Json, Router};
use utoipa_swagger_ui::SwaggerUi;

use super::admit::{admit, preflight};
use super::layers;
use super::manual;
use super::openapi;
use super::page;
use super::problem::{Problem, ProblemCode};
use super::state::ApiState;

/// The whole HTTP surface.
pub fn router(state: ApiState) -> Router {
    let admitted = openapi::guarded().route_layer(from_fn_with_state(state.clone(), admit));
    let (routes, document) = admitted.merge(openapi::open()).split_for_parts();
    let router = routes
        .merge(page::routes())
        .merge(manual::routes())
        .route("/openapi-3.0.json", get(openapi_3_0))
        .with_state(state)
        // Its scripts and styles are in the binary too: it works offline.
        .merge(SwaggerUi::new("/docs/api").url("/openapi.json", openapi::complete(document)))
        .fallback(no_route)
        .method_not_allowed_fallback(wrong_method)
        // Uploads are counted as they stream in, and other bodies by `ApiJson`.
        .layer(DefaultBodyLimit::disable())
        .layer(from_fn(preflight));
    layers::add(router)
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
