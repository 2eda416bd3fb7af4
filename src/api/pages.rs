//! The page that people see, the widget that shops embed, and the documentation, as pages and as Markdown. They ask the API like anybody
//! else, so nothing here needs a key.

use axum::Router;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;

use super::extract::{names_etag, text_header};
use super::problem::{Problem, ProblemCode, shown};
use super::state::ApiState;
use crate::manual;
use crate::web::{self, File};

/// For what keeps its name: a browser asks each time whether it is still this one.
const ASK: &str = "no-cache";
/// For what has a hash in its name: it never changes.
const FOREVER: &str = "public, max-age=31536000, immutable";

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
    let mut response = answer(web::document(), &headers, ASK, For::Ourselves);
    let policy = policy(bucket.as_deref());
    if let Ok(policy) = HeaderValue::from_str(&policy) {
        response.headers_mut().insert(header::CONTENT_SECURITY_POLICY, policy);
    }
    response
}

async fn widget(headers: HeaderMap) -> Response {
    answer(web::widget(), &headers, ASK, For::AllPages)
}

async fn asset(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    let file = web::asset(&name).ok_or_else(|| {
        let detail = format!("There is nothing at '/assets/{}'. Load the page again.", shown(&name));
        Problem::new(ProblemCode::RouteNotFound, detail)
    })?;
    Ok(answer(file, &headers, FOREVER, For::AllPages))
}

/// What the page may do: run and load what is of this service, and send files to and fetch them from the bucket, where there is one.
fn policy(bucket: Option<&str>) -> String {
    let bucket = bucket.map(|origin| format!(" {origin}")).unwrap_or_default();
    format!(
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:{bucket}; connect-src 'self'{bucket}; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}

/// What a page may do: show what is of this service, and run nothing.
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
    markdown.or_else(page).ok_or_else(|| missing(&name))
}

async fn picture(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    manual::picture(&name).map(|file| manual_file(file, &headers)).ok_or_else(|| missing(&name))
}

fn manual_file(file: &'static File, headers: &HeaderMap) -> Response {
    answer(file, headers, ASK, For::Ourselves)
}

fn html(page: &'static manual::Page, headers: &HeaderMap) -> Response {
    let mut response = manual_file(&page.html, headers);
    response.headers_mut().insert(header::CONTENT_SECURITY_POLICY, MANUAL_POLICY);
    response
}

fn missing(name: &str) -> Problem {
    let detail = format!("The documentation has no '{}'. See /docs.", shown(name));
    Problem::new(ProblemCode::RouteNotFound, detail)
}

/// Whose pages may load a file.
#[derive(Clone, Copy, PartialEq, Eq)]
enum For {
    /// The service's own.
    Ourselves,
    /// Those of shops too, also where they are isolated from other origins.
    AllPages,
}

/// A file, packed where that is asked for, or that it is still the one that is known.
fn answer(file: &'static File, headers: &HeaderMap, cache: &'static str, whose: For) -> Response {
    let common = [
        (header::CACHE_CONTROL, cache),
        (header::ETAG, file.etag()),
        (header::VARY, "accept-encoding"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    let reach: &[(HeaderName, &str)] = match whose {
        For::Ourselves => &[
            (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
            (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        ],
        For::AllPages => &[
            (header::ACCESS_CONTROL_ALLOW_ORIGIN, "*"),
            (HeaderName::from_static("cross-origin-resource-policy"), "cross-origin"),
        ],
    };
    let mut response =
        if text_header(headers, &header::IF_NONE_MATCH).is_some_and(|known| names_etag(known, file.etag())) {
            (StatusCode::NOT_MODIFIED, common).into_response()
        } else {
            let kind = [(header::CONTENT_TYPE, file.media_type)];
            match file.gzip().filter(|_| takes_gzip(headers)) {
                Some(packed) => (common, kind, [(header::CONTENT_ENCODING, "gzip")], packed).into_response(),
                None => (common, kind, file.plain()).into_response(),
            }
        };
    for &(ref name, value) in reach {
        response.headers_mut().insert(name.clone(), HeaderValue::from_static(value));
    }
    response
}

/// Whether gzip is among the encodings that a client takes, and not with the weight 0 (RFC 9110, 12.5.3).
fn takes_gzip(headers: &HeaderMap) -> bool {
    let Some(taken) = text_header(headers, &header::ACCEPT_ENCODING) else { return false };
    taken.split(',').any(|one| {
        let (name, weight) = one.split_once(';').unwrap_or((one, ""));
        let refused = weight.trim().strip_prefix("q=").and_then(|q| q.parse::<f32>().ok()).is_some_and(|q| q <= 0.0);
        ["gzip", "*"].contains(&name.trim()) && !refused
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gzip_is_sent_to_those_who_take_it() {
        for (given, taken) in [
            ("gzip, deflate, br", true),
            ("br;q=1.0, gzip;q=0.2", true),
            ("*", true),
            ("gzip;q=0", false),
            ("identity", false),
            ("", false),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(header::ACCEPT_ENCODING, given.parse().expect("a header"));
            assert_eq!(takes_gzip(&headers), taken, "{given}");
        }
        assert!(!takes_gzip(&HeaderMap::new()));
    }

    #[test]
    fn the_page_may_reach_the_bucket_and_nobody_else() {
        let policy = policy(Some("https://files.example"));
        assert!(policy.contains("connect-src 'self' https://files.example;"), "{policy}");
        assert!(policy.contains("script-src 'self';"), "{policy}");
        assert!(!super::policy(None).contains("http"));
    }
}
