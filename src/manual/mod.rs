//! The documentation, as pages in the program: what is in `docs/` is read there, served at `/docs`, and told to programs in
//! `/llms.txt`.
//!
//! Everything is made once, when it is first asked for. A page is added by its name in [`PAGES`].

mod markdown;

use std::sync::OnceLock;

use self::markdown::document;
pub use self::markdown::{Heading, Outline, PAGES};
use crate::web::File;

/// A page of the documentation.
#[derive(Debug)]
pub struct Page {
    /// Its name: that of its file, and the last part of its address.
    pub name: &'static str,
    /// Its title and headings.
    pub outline: Outline,
    /// For people.
    pub html: File,
    /// For programs, and for people who read Markdown.
    pub markdown: File,
}

impl Page {
    /// Whether it is the one at `/docs/`.
    #[must_use]
    pub fn is_index(&self) -> bool {
        self.name == PAGES[0].0
    }
}

/// All pages, in the order of the list.
pub fn pages() -> &'static [Page] {
    static MADE: OnceLock<Vec<Page>> = OnceLock::new();
    MADE.get_or_init(|| {
        let outlines: Vec<_> = PAGES.iter().map(|&(name, text)| (name, Outline::of(text))).collect();
        let made = PAGES.iter().zip(&outlines).map(|(&(name, text), (_, outline))| Page {
            name,
            outline: outline.clone(),
            html: File::new("page.html", document(name, text, &outlines).into_bytes()),
            markdown: File::new("page.md", text.as_bytes()),
        });
        made.collect()
    })
}

/// The page at `/docs/`.
#[must_use]
pub fn index() -> &'static Page {
    &pages()[0]
}

/// The page of that name.
#[must_use]
pub fn page(name: &str) -> Option<&'static Page> {
    pages().iter().find(|page| page.name == name)
}

/// A picture that pages show, by its file's name.
#[must_use]
pub fn picture(name: &str) -> Option<&'static File> {
    static MADE: OnceLock<Vec<(&str, File)>> = OnceLock::new();
    let made =
        MADE.get_or_init(|| markdown::PICTURES.iter().map(|&(name, bytes)| (name, File::new(name, bytes))).collect());
    made.iter().find(|(known, _)| *known == name).map(|(_, file)| file)
}

/// What there is to read, for language models, in the form of llmstxt.org.
pub fn llms() -> &'static File {
    static MADE: OnceLock<File> = OnceLock::new();
    MADE.get_or_init(|| File::new("llms.txt", list_of_pages(pages()).into_bytes()))
}

/// All pages as one text.
pub fn llms_full() -> &'static File {
    static MADE: OnceLock<File> = OnceLock::new();
    MADE.get_or_init(|| File::new("llms-full.txt", all_pages().into_bytes()))
}

const INTRODUCTION: &str = "# meshmend

> meshmend repairs broken 3D models over HTTP or on the command line, proves on the result's own bytes that it is printable, and gives an
> honest account of what changed.

Send a model to `POST /v1/jobs`, wait with `GET /v1/jobs/{id}?wait=20`, download `/v1/jobs/{id}/artifacts/model` and `report.json`.
`GET /v1/capabilities` says what this service takes and may do.

";

/// The pages with a line on each.
fn list_of_pages(pages: &[Page]) -> String {
    let line = |page: &Page| format!("- [{}](/docs/{}.md): {}\n", page.outline.title, page.name, page.outline.summary);
    let lines: String = pages.iter().filter(|page| !page.is_index()).map(line).collect();
    format!(
        "{INTRODUCTION}## Documentation\n\n{lines}\n## API\n\n- [OpenAPI 3.1](/openapi.json): every address, option and answer\n\
         - [Problems](/problems): every code of an error with what to do, as JSON\n\n## Optional\n\n\
         - [All pages in one](/llms-full.txt)\n"
    )
}

/// The pages one after the other.
fn all_pages() -> String {
    PAGES.iter().skip(1).map(|(_, text)| text.trim()).collect::<Vec<_>>().join("\n\n") + "\n"
}
