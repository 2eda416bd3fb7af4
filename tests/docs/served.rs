//! The documentation over HTTP: HTML for browsers, Markdown for curl and language models.

use meshmend::manual::{self, PAGES};
use quick_xml::Reader;
use quick_xml::events::Event;

use crate::server::{Api, Start};
use crate::support::pictures::picture_names;

/// Elements without a closing tag.
const VOID: [&str; 4] = ["meta", "link", "img", "br"];

/// The names of a document's elements in order; panics unless the document is well-formed.
fn elements(html: &str) -> Vec<String> {
    let mut reader = Reader::from_str(html);
    reader.config_mut().check_end_names = false;
    let (mut open, mut seen) = (Vec::new(), Vec::new());
    loop {
        match reader.read_event().unwrap_or_else(|error| panic!("{error} at {}", reader.error_position())) {
            Event::Start(start) => {
                let name = String::from_utf8(start.name().as_ref().to_vec()).unwrap();
                start
                    .html_attributes()
                    .for_each(|attribute| drop(attribute.unwrap_or_else(|error| panic!("{name}: {error}"))));
                if !VOID.contains(&name.as_str()) {
                    open.push(name.clone());
                }
                seen.push(name);
            }
            Event::Empty(empty) => seen.push(String::from_utf8(empty.name().as_ref().to_vec()).unwrap()),
            Event::End(end) => {
                let name = String::from_utf8(end.name().as_ref().to_vec()).unwrap();
                assert_eq!(open.pop().as_deref(), Some(name.as_str()));
            }
            Event::Eof => break,
            _ => {}
        }
    }
    assert!(open.is_empty(), "{open:?} are not closed");
    seen
}

#[test]
fn every_page_is_one_well_formed_document_with_one_title() {
    for page in manual::pages() {
        let html = std::str::from_utf8(page.html.plain()).unwrap();
        let elements = elements(html);
        let count = |name: &str| elements.iter().filter(|element| *element == name).count();
        assert_eq!((count("h1"), count("main"), count("title")), (1, 1, 1), "{}", page.name);
        assert_eq!((count("script"), count("style")), (0, 0), "{}", page.name);
        assert_eq!(
            count("h2"),
            page.outline.headings.iter().filter(|heading| heading.level == 2).count(),
            "{}",
            page.name
        );
        assert!(!html.contains("style=\""), "the policy forbids it: {}", page.name);
        let frame = html.split("<article>").next().unwrap();
        assert!(!frame.contains(['{', '}']), "something was not put in its place: {frame}");
    }
}

#[tokio::test]
async fn every_page_comes_without_a_key_and_may_run_nothing() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--auth", "keys").start();
    let api = Api::new(&program);
    for page in manual::pages() {
        let path = if page.is_index() { "/docs/".to_owned() } else { format!("/docs/{}", page.name) };
        let response = api.get(&path).send().await.expect("a response");
        assert_eq!(response.status(), 200, "{path}");
        let header = |name: &str| response.headers()[name].to_str().expect("text").to_owned();
        assert_eq!(header("content-type"), "text/html; charset=utf-8", "{path}");
        assert_eq!(header("x-content-type-options"), "nosniff");
        let policy = header("content-security-policy");
        assert!(policy.starts_with("default-src 'none'; style-src 'self'; img-src 'self';"), "{policy}");
        assert!(!policy.contains("script") && !policy.contains("unsafe"), "{policy}");
        let tag = header("etag");
        let again = api.get(&path).header("if-none-match", &tag).send().await.expect("a response");
        assert_eq!(again.status(), 304, "{path}");
        let packed = api.get(&path).header("accept-encoding", "gzip").send().await.expect("a response");
        assert_eq!(packed.headers()["content-encoding"], "gzip", "{path}");
        let markdown = api.get(&format!("/docs/{}.md", page.name)).send().await.expect("a response");
        assert_eq!(markdown.headers()["content-type"], "text/markdown; charset=utf-8");
        assert_eq!(markdown.bytes().await.expect("bytes"), page.markdown.plain());
    }
    for name in picture_names() {
        let response = api.get(&format!("/docs/pictures/{name}")).header("accept-encoding", "gzip").send().await;
        let response = response.expect("a response");
        assert_eq!(
            (response.status().as_u16(), &response.headers()["content-type"]),
            (200, &"image/png".parse().unwrap())
        );
        assert!(!response.headers().contains_key("content-encoding"), "a PNG is compressed already");
    }
}

#[tokio::test]
async fn links_of_a_page_to_the_service_exist() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let mut seen = 0;
    for page in manual::pages() {
        let html = std::str::from_utf8(page.html.plain()).unwrap();
        let words = html.split('"').collect::<Vec<_>>();
        let links =
            words.windows(2).filter(|two| two[0].ends_with("href=") || two[0].ends_with("src=")).map(|two| two[1]);
        for link in links.filter(|link| !link.starts_with('#') && !link.starts_with("https://")) {
            let address = url::Url::parse(&format!("{}/docs/", api.url)).unwrap().join(link).unwrap();
            let response = api.http.get(address.clone()).send().await.expect("a response");
            assert_eq!(response.status(), 200, "{}: {link}", page.name);
            seen += 1;
        }
    }
    assert!(seen > 100, "{seen}");
    let index = api.get("/docs").send().await.expect("a response");
    assert_eq!(index.url().path(), "/docs/", "the address without a slash redirects");
    for path in ["/docs/nothing", "/docs/nothing.md", "/docs/pictures/nothing.png", "/docs/README"] {
        let missing = api.get(path).send().await.expect("a response");
        assert_eq!(
            (missing.status().as_u16(), &missing.headers()["content-type"]),
            (404, &"application/problem+json".parse().unwrap()),
            "{path}"
        );
    }
}

#[tokio::test]
async fn llms_txt_lists_every_page() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--auth", "keys").start();
    let api = Api::new(&program);
    let response = api.get("/llms.txt").send().await.expect("a response");
    assert_eq!(response.headers()["content-type"], "text/plain; charset=utf-8");
    let list = response.text().await.expect("text");
    assert!(list.starts_with("# meshmend\n\n> "), "{list}");
    for (name, _) in &PAGES[1..] {
        assert!(list.contains(&format!("](/docs/{name}.md): ")), "{name} is not in {list}");
    }
    assert!(list.contains("](/openapi.json)"), "{list}");
    for link in list.split("](").skip(1).map(|rest| rest.split(')').next().unwrap()) {
        assert_eq!(api.get(link).send().await.expect("a response").status(), 200, "{link}");
    }
    let whole = api.get("/llms-full.txt").send().await.expect("a response").text().await.expect("text");
    for (name, text) in &PAGES[1..] {
        assert!(whole.contains(text.trim()), "{name}");
    }
}
