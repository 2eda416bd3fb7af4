//! Routes of the web page, of the widget that shops embed, and of the documentation as HTML and Markdown. These files need no key; the
//! pages call the API like any other client.

use axum::Router;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;

use super::extract::{contains_etag, text_header};
use super::problem::{Problem, ProblemCode, truncated};
use super::state::ApiState;
use crate::manual;
use crate::web::{self, StaticFile};

/// Cache-Control for files with a fixed name: the browser revalidates them each time.
const REVALIDATE: &str = "no-cache";
/// Cache-Control for files with a content hash in their name, which never change.
const IMMUTABLE: &str = "public, max-age=31536000, immutable";

/// The routes of all pages and their assets.
pub(super) fn routes() -> Router<ApiState> {
    Router::new()
        .route("/", get(document))
        .route("/widget.js", get(widget))
        .route("/assets/{name}", get(asset))
        .merge(manual_routes())
}

async fn document(State(state): State<ApiState>, headers: HeaderMap) -> Response {
    let to_bucket = state.config.presigned_uploads || state.config.presigned_downloads;
    let bucket = if to_bucket { state.blobs.public_origin().await } else { None };
    let mut response = respond(web::document(), &headers, REVALIDATE, Embedding::SameOrigin);
    let policy = policy(bucket.as_deref());
    if let Ok(policy) = HeaderValue::from_str(&policy) {
        response.headers_mut().insert(header::CONTENT_SECURITY_POLICY, policy);
    }
    response
}

async fn widget(headers: HeaderMap) -> Response {
    respond(web::widget(), &headers, REVALIDATE, Embedding::AnyOrigin)
}

async fn asset(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    let file = web::asset(&name).ok_or_else(|| {
        let detail = format!("There is no file '/assets/{}'. Reload the page.", truncated(&name));
        Problem::new(ProblemCode::RouteNotFound, detail)
    })?;
    Ok(respond(file, &headers, IMMUTABLE, Embedding::AnyOrigin))
}

/// The page's Content-Security-Policy: only resources of this service, and uploads to and downloads from the bucket, if there is one.
fn policy(bucket: Option<&str>) -> String {
    let bucket = bucket.map(|origin| format!(" {origin}")).unwrap_or_default();
    format!(
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:{bucket}; connect-src 'self'{bucket}; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}

/// The documentation's Content-Security-Policy: only styles and images of this service, no scripts.
const MANUAL_POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; style-src 'self'; img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
);

fn manual_routes() -> Router<ApiState> {
    Router::new()
        .route("/docs", get(async || Redirect::permanent("/docs/")))
        .route("/docs/", get(async |headers: HeaderMap| html(manual::index(), &headers)))
        .route("/docs/{name}", get(text))
        .route("/docs/pictures/{name}", get(picture))
        .route("/llms.txt", get(async |headers: HeaderMap| manual_file(manual::llms(), &headers)))
        .route("/llms-full.txt", get(async |headers: HeaderMap| manual_file(manual::llms_full(), &headers)))
}

async fn text(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    let markdown = name.strip_suffix(".md").and_then(manual::page).map(|page| manual_file(&page.markdown, &headers));
    let page = || manual::page(&name).filter(|page| !page.is_index()).map(|page| html(page, &headers));
    markdown.or_else(page).ok_or_else(|| page_not_found(&name))
}

async fn picture(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    manual::picture(&name).map(|file| manual_file(file, &headers)).ok_or_else(|| page_not_found(&name))
}

fn manual_file(file: &'static StaticFile, headers: &HeaderMap) -> Response {
    respond(file, headers, REVALIDATE, Embedding::SameOrigin)
}

fn html(page: &'static manual::Page, headers: &HeaderMap) -> Response {
    let mut response = manual_file(&page.html, headers);
    response.headers_mut().insert(header::CONTENT_SECURITY_POLICY, MANUAL_POLICY);
    response
}

fn page_not_found(name: &str) -> Problem {
    let detail = format!("The documentation has no page '{}'. See /docs for its pages.", truncated(name));
    Problem::new(ProblemCode::RouteNotFound, detail)
}

/// Which pages may load a file.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Embedding {
    /// Only pages of this service.
    SameOrigin,
    /// Pages of any origin, including cross-origin isolated ones.
    AnyOrigin,
}

/// Responds with a file, compressed if the client accepts gzip, or with 304 if the client has the current version.
fn respond(file: &'static StaticFile, headers: &HeaderMap, cache: &'static str, embedding: Embedding) -> Response {
    let common = [
        (header::CACHE_CONTROL, cache),
        (header::ETAG, file.etag()),
        (header::VARY, "accept-encoding"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    let origin_headers: &[(HeaderName, &str)] = match embedding {
        Embedding::SameOrigin => &[
            (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
            (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        ],
        Embedding::AnyOrigin => &[
            (header::ACCESS_CONTROL_ALLOW_ORIGIN, "*"),
            (HeaderName::from_static("cross-origin-resource-policy"), "cross-origin"),
        ],
    };
    let mut response =
        if text_header(headers, &header::IF_NONE_MATCH).is_some_and(|list| contains_etag(list, file.etag())) {
            (StatusCode::NOT_MODIFIED, common).into_response()
        } else {
            let media_type = [(header::CONTENT_TYPE, file.media_type)];
            match file.gzip().filter(|_| accepts_gzip(headers)) {
                Some(packed) => (common, media_type, [(header::CONTENT_ENCODING, "gzip")], packed).into_response(),
                None => (common, media_type, file.plain()).into_response(),
            }
        };
    for &(ref name, value) in origin_headers {
        response.headers_mut().insert(name.clone(), HeaderValue::from_static(value));
    }
    response
}

/// Whether Accept-Encoding allows gzip, with a weight above 0 (RFC 9110, 12.5.3).
fn accepts_gzip(headers: &HeaderMap) -> bool {
    let Some(encodings) = text_header(headers, &header::ACCEPT_ENCODING) else { return false };
    encodings.split(',').any(|encoding| {
        let (name, weight) = encoding.split_once(';').unwrap_or((encoding, ""));
        let refused = weight.trim().strip_prefix("q=").and_then(|q| q.parse::<f32>().ok()).is_some_and(|q| q <= 0.0);
        ["gzip", "*"].contains(&name.trim()) && !refused
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_sent_only_to_clients_that_accept_it() {
        for (encodings, is_accepted) in [
            ("gzip, deflate, br", true),
            ("br;q=1.0, gzip;q=0.2", true),
            ("*", true),
            ("gzip;q=0", false),
            ("identity", false),
            ("", false),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT_ENCODING, encodings.parse().expect("a header"));
            assert_eq!(accepts_gzip(&headers), is_accepted, "{encodings}");
        }
        assert!(!accepts_gzip(&HeaderMap::new()));
    }

    #[test]
    fn the_page_may_connect_to_the_bucket_and_to_no_other_origin() {
        let policy = policy(Some("https://files.example"));
        assert!(policy.contains("connect-src 'self' https://files.example;"), "{policy}");
        assert!(policy.contains("script-src 'self';"), "{policy}");
        assert!(!super::policy(None).contains("http"));
    }
}
