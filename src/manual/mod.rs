//! The documentation: the pages of `docs/`, embedded in the program and served as HTML and Markdown at `/docs` and in `/llms.txt`.
//!
//! Each page is rendered on its first request. To add a page, add its name to [`PAGES`].

mod markdown;

use std::sync::OnceLock;

use self::markdown::document;
pub use self::markdown::{Heading, Outline, PAGES};
use crate::web::StaticFile;

/// A page of the documentation.
#[derive(Debug)]
pub struct Page {
    /// The page's name: its file name without `.md`, and the last segment of its URL path.
    pub name: &'static str,
    /// The page's title, summary and headings.
    pub outline: Outline,
    /// The page as HTML.
    pub html: StaticFile,
    /// The page as Markdown.
    pub markdown: StaticFile,
}

impl Page {
    /// Whether this is the page at `/docs/`.
    #[must_use]
    pub fn is_index(&self) -> bool {
        self.name == PAGES[0].0
    }
}

/// Returns all pages, in the order in which they are listed.
pub fn pages() -> &'static [Page] {
    static PAGE_LIST: OnceLock<Vec<Page>> = OnceLock::new();
    PAGE_LIST.get_or_init(|| {
        let outlines: Vec<_> = PAGES.iter().map(|&(name, text)| (name, Outline::of(text))).collect();
        let pages = PAGES.iter().zip(&outlines).map(|(&(name, text), (_, outline))| Page {
            name,
            outline: outline.clone(),
            html: StaticFile::new("page.html", document(name, text, &outlines).into_bytes()),
            markdown: StaticFile::new("page.md", text.as_bytes()),
        });
        pages.collect()
    })
}

/// Returns the page at `/docs/`.
#[must_use]
pub fn index() -> &'static Page {
    &pages()[0]
}

/// Returns the page with this name.
#[must_use]
pub fn page(name: &str) -> Option<&'static Page> {
    pages().iter().find(|page| page.name == name)
}

/// Returns an image of the documentation, by its file name.
#[must_use]
pub fn picture(name: &str) -> Option<&'static StaticFile> {
    static FILES: OnceLock<Vec<(&str, StaticFile)>> = OnceLock::new();
    let files = FILES
        .get_or_init(|| markdown::PICTURES.iter().map(|&(name, bytes)| (name, StaticFile::new(name, bytes))).collect());
    files.iter().find(|(file, _)| *file == name).map(|(_, file)| file)
}

/// Returns the list of all pages for language models, in the format of llmstxt.org.
pub fn llms() -> &'static StaticFile {
    static FILE: OnceLock<StaticFile> = OnceLock::new();
    FILE.get_or_init(|| StaticFile::new("llms.txt", list_of_pages(pages()).into_bytes()))
}

/// Returns all pages as one text.
pub fn llms_full() -> &'static StaticFile {
    static FILE: OnceLock<StaticFile> = OnceLock::new();
    FILE.get_or_init(|| StaticFile::new("llms-full.txt", all_pages().into_bytes()))
}

/// The beginning of `/llms.txt`.
const INTRODUCTION: &str = "# meshmend

> meshmend repairs broken 3D models over HTTP or on the command line. It verifies the exact result file for printability, and reports
> exactly what changed.

Submit a model with `POST /v1/jobs`, wait with `GET /v1/jobs/{id}?wait=20`, then download `/v1/jobs/{id}/artifacts/model` and
`report.json`. `GET /v1/capabilities` lists the supported formats, options and limits.

";

/// Lists the pages, one line each.
fn list_of_pages(pages: &[Page]) -> String {
    let line = |page: &Page| format!("- [{}](/docs/{}.md): {}\n", page.outline.title, page.name, page.outline.summary);
    let lines: String = pages.iter().filter(|page| !page.is_index()).map(line).collect();
    format!(
        "{INTRODUCTION}## Documentation\n\n{lines}\n## API\n\n- [OpenAPI 3.1](/openapi.json): every route, option and response\n\
         - [Problems](/problems): every error code with advice, as JSON\n\n## Optional\n\n\
         - [All pages in one](/llms-full.txt)\n"
    )
}

/// Concatenates all pages.
fn all_pages() -> String {
    PAGES.iter().skip(1).map(|(_, text)| text.trim()).collect::<Vec<_>>().join("\n\n") + "\n"
}
