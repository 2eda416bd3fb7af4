//! The documentation, as pages in the program: what is in `docs/` is read there, served at `/docs`, and told to programs in
//! `/llms.txt`.
//!
//! Everything is made once, when it is first asked for. A page is added by its name in the list below.

mod html;
mod llms;
mod outline;

use std::sync::OnceLock;

use crate::web::File;
pub use outline::{Heading, Outline};

macro_rules! pages {
    ($($name:literal)*) => {
        &[$(($name, include_str!(concat!("../../docs/", $name, ".md")))),*]
    };
}

macro_rules! pictures {
    ($($name:literal)*) => {
        &[$((concat!($name, ".png"), include_bytes!(concat!("../../docs/pictures/", $name, ".png")))),*]
    };
}

/// The pages by name, in the order in which they are listed. The first is the one at `/docs/`.
pub const PAGES: &[(&str, &str)] = pages! {
    "README"
    "quick-start"
    "how-repair-works"
    "formats"
    "print-on-demand"
    "widget"
    "using-the-api"
    "clients"
    "command-line"
    "options"
    "report"
    "problems"
    "operations"
    "metrics"
};

/// The pictures that pages show, drawn by the program itself (`make pictures`).
const PICTURES: &[(&str, &[u8])] = pictures! {
    "ball-before" "ball-change"
    "cube-before" "cube-after"
    "boxes-before" "boxes-after"
    "halves-before" "halves-change"
    "sheet-before" "sheet-after"
};

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
            html: File::new("page.html", html::document(name, text, &outlines).into_bytes()),
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
    let made = MADE.get_or_init(|| PICTURES.iter().map(|&(name, bytes)| (name, File::new(name, bytes))).collect());
    made.iter().find(|(known, _)| *known == name).map(|(_, file)| file)
}

/// What there is to read, for language models, in the form of llmstxt.org.
pub fn llms() -> &'static File {
    static MADE: OnceLock<File> = OnceLock::new();
    MADE.get_or_init(|| File::new("llms.txt", llms::list(pages()).into_bytes()))
}

/// All pages as one text.
pub fn llms_full() -> &'static File {
    static MADE: OnceLock<File> = OnceLock::new();
    MADE.get_or_init(|| File::new("llms-full.txt", llms::all().into_bytes()))
}
