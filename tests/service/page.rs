//! The web page and its assets, as a browser requests them.

use reqwest::header::HeaderMap;

use crate::s3::S3;
use crate::server::{Api, Start};

/// The URLs of the assets that a document refers to.
fn assets(document: &str) -> Vec<&str> {
    document.split('"').filter(|word| word.starts_with("/assets/")).collect()
}

fn policy(headers: &HeaderMap) -> &str {
    headers["content-security-policy"].to_str().expect("text")
}

#[tokio::test]
async fn the_page_comes_with_all_it_needs_and_may_reach_nothing_else() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let answer = api.get("/").send().await.expect("a response");
    assert_eq!(
        (answer.status().as_u16(), &answer.headers()["content-type"]),
        (200, &"text/html; charset=utf-8".parse().expect("text"))
    );
    assert_eq!(answer.headers()["cache-control"], "no-cache");
    assert_eq!(answer.headers()["x-content-type-options"], "nosniff");
    assert_eq!(answer.headers()["referrer-policy"], "no-referrer");
    let allowed = policy(answer.headers()).to_owned();
    for rule in [
        "default-src 'none'",
        "script-src 'self';",
        "style-src 'self';",
        "connect-src 'self';",
        "frame-ancestors 'none'",
    ] {
        assert!(allowed.contains(rule), "{rule} is not in {allowed}");
    }
    assert!(!allowed.contains("unsafe"), "{allowed}");
    let document = answer.text().await.expect("text");
    assert!(!document.contains("://"), "every address is of this service: {document}");
    let named = assets(&document);
    assert_eq!(named.len(), 3, "{document}");
    for path in named {
        let response = api.get(path).send().await.expect("a response");
        assert_eq!(
            (response.status().as_u16(), &response.headers()["cache-control"]),
            (200, &"public, max-age=31536000, immutable".parse().expect("text")),
            "{path}"
        );
    }
    let missing = api.get("/assets/page-00000000.js").send().await.expect("a response");
    assert_eq!(
        (missing.status().as_u16(), &missing.headers()["content-type"]),
        (404, &"application/problem+json".parse().expect("text"))
    );
}

#[tokio::test]
async fn a_browser_gets_the_page_compressed_and_only_when_it_changed() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let document = api.get("/").send().await.expect("a response").text().await.expect("text");
    for path in assets(&document).into_iter().chain(["/", "/widget.js"]) {
        let plain = api.get(path).send().await.expect("a response");
        assert!(!plain.headers().contains_key("content-encoding"), "a client that does not accept gzip gets none");
        let tag = plain.headers()["etag"].clone();
        let plain = plain.bytes().await.expect("bytes");
        let packed = api.get(path).header("accept-encoding", "gzip, br").send().await.expect("a response");
        assert_eq!(
            (&packed.headers()["content-encoding"], &packed.headers()["vary"]),
            (&"gzip".parse().expect("text"), &"accept-encoding".parse().expect("text"))
        );
        let packed = packed.bytes().await.expect("bytes");
        assert!(
            packed.starts_with(&[0x1f, 0x8b]) && packed.len() < plain.len(),
            "{path}: {} of {}",
            packed.len(),
            plain.len()
        );
        let again = api.get(path).header("if-none-match", &tag).send().await.expect("a response");
        assert_eq!((again.status().as_u16(), &again.headers()["etag"]), (304, &tag), "{path}");
        assert!(again.bytes().await.expect("bytes").is_empty());
        let head = api.http.head(format!("{}{path}", api.url)).send().await.expect("a response");
        assert_eq!((head.status().as_u16(), &head.headers()["content-length"]), (200, &plain.len().into()), "{path}");
    }
}

#[tokio::test]
async fn the_widget_and_what_it_loads_are_for_pages_of_all_origins_and_the_page_is_not() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--auth", "keys").start();
    let api = Api::new(&program);
    let get = |path: &str| api.get(path).header("origin", "https://shop.example").send();
    let widget = get("/widget.js").await.expect("a response");
    assert_eq!(
        (widget.status().as_u16(), &widget.headers()["content-type"]),
        (200, &"text/javascript; charset=utf-8".parse().expect("text"))
    );
    assert_eq!(widget.headers()["cache-control"], "no-cache", "a shop's page may load the widget");
    let script = widget.text().await.expect("text");
    let viewer = assets(&script).into_iter().next().expect("the viewer");
    for path in ["/widget.js", viewer] {
        for tag in ["\"none\"", "*"] {
            let request = api.get(path).header("origin", "https://shop.example").header("if-none-match", tag);
            let response = request.header("accept-encoding", "gzip").send().await.expect("a response");
            assert_eq!(response.status().as_u16(), if tag == "*" { 304 } else { 200 }, "{path}");
            assert_eq!(response.headers()["access-control-allow-origin"], "*", "{path}");
            assert_eq!(response.headers()["cross-origin-resource-policy"], "cross-origin", "{path}");
            assert!(response.headers().contains_key("etag"), "{path}");
            assert_eq!(response.headers().contains_key("content-encoding"), tag != "*", "{path}");
        }
    }
    let page = get("/").await.expect("a response");
    assert!(
        !page.headers().contains_key("access-control-allow-origin"),
        "no other page may read the service's own assets"
    );
    assert_eq!(page.headers()["cross-origin-resource-policy"], "same-origin");
    assert_eq!(page.headers()["cross-origin-opener-policy"], "same-origin");
}

#[tokio::test]
async fn the_page_needs_no_key_even_where_the_api_asks_for_one() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--auth", "keys").start();
    let api = Api::new(&program);
    assert_eq!(api.get("/").send().await.expect("a response").status(), 200);
    assert_eq!(api.get("/v1/capabilities").send().await.expect("a response").status(), 401);
}

#[tokio::test]
async fn the_page_may_reach_the_bucket_to_which_files_go() {
    let bucket = S3::start();
    let data = tempfile::tempdir().expect("a folder");
    let program = bucket.store_files_of(Start::serve(data.path())).start();
    let api = Api::new(&program);
    let upload: serde_json::Value =
        api.post("/v1/uploads").send().await.expect("a response").json().await.expect("JSON");
    let url = url::Url::parse(upload["put"]["url"].as_str().expect("text")).expect("an address");
    let response = api.get("/").send().await.expect("a response");
    let allowed = policy(response.headers());
    assert!(allowed.contains(&format!("connect-src 'self' {};", url.origin().ascii_serialization())), "{allowed}");
}
