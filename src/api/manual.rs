//! The documentation, as pages and as Markdown, for people and for language models. Like the page it needs no key.

use axum::Router;
use axum::extract::Path;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{Redirect, Response};
use axum::routing::get;

use super::page::{self, ASK, For};
use super::problem::{Problem, ProblemCode, shown};
use super::state::ApiState;
use crate::manual;
use crate::web::File;

/// What a page may do: show what is of this service, and run nothing.
const POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; style-src 'self'; img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

pub(super) fn routes() -> Router<ApiState> {
    Router::new()
        .route("/docs", get(async || Redirect::permanent("/docs/")))
        .route("/docs/", get(async |headers: HeaderMap| html(manual::index(), &headers)))
        .route("/docs/{name}", get(text))
        .route("/docs/pictures/{name}", get(picture))
        .route("/llms.txt", get(async |headers: HeaderMap| answer(manual::llms(), &headers)))
        .route("/llms-full.txt", get(async |headers: HeaderMap| answer(manual::llms_full(), &headers)))
}

async fn text(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    let markdown = name.strip_suffix(".md").and_then(manual::page).map(|page| answer(&page.markdown, &headers));
    let page = || manual::page(&name).filter(|page| !page.is_index()).map(|page| html(page, &headers));
    markdown.or_else(page).ok_or_else(|| missing(&name))
}

async fn picture(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    manual::picture(&name).map(|file| answer(file, &headers)).ok_or_else(|| missing(&name))
}

fn answer(file: &'static File, headers: &HeaderMap) -> Response {
    page::answer(file, headers, ASK, For::Ourselves)
}

fn html(page: &'static manual::Page, headers: &HeaderMap) -> Response {
    let mut response = answer(&page.html, headers);
    response.headers_mut().insert(header::CONTENT_SECURITY_POLICY, POLICY);
    response
}

fn missing(name: &str) -> Problem {
    let detail = format!("The documentation has no '{}'. See /docs.", shown(name));
    Problem::new(ProblemCode::RouteNotFound, detail)
}
