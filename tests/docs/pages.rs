//! The files that people read: those in docs/, and the README.

use std::path::{Path, PathBuf};

use meshmend::manual::PAGES;
use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};

pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A page in the repository.
pub struct Page {
    /// Its path from the repository's root.
    pub path: String,
    pub text: String,
}

/// The files of the pages that are served, and the README.
pub fn written() -> Vec<Page> {
    let paths = PAGES.iter().map(|(name, _)| format!("docs/{name}.md"));
    paths
        .chain(["README.md".to_owned()])
        .map(|path| {
            let text = std::fs::read_to_string(root().join(&path)).unwrap_or_else(|error| panic!("{path}: {error}"));
            Page { path, text }
        })
        .collect()
}

/// A block of code.
#[derive(Debug, Clone)]
pub struct Block {
    /// The words behind the fence.
    pub kind: String,
    pub code: String,
}

impl Page {
    /// Its blocks of code, in order.
    pub fn blocks(&self) -> Vec<Block> {
        let mut blocks: Vec<Block> = Vec::new();
        let mut inside = false;
        for event in self.events() {
            match event {
                Event::Start(Tag::CodeBlock(kind)) => {
                    let CodeBlockKind::Fenced(kind) = kind else {
                        panic!("{}: a block of code without a fence", self.path)
                    };
                    blocks.push(Block { kind: kind.to_string(), code: String::new() });
                    inside = true;
                }
                Event::End(TagEnd::CodeBlock) => inside = false,
                Event::Text(text) if inside => blocks.last_mut().expect("a block").code.push_str(&text),
                _ => {}
            }
        }
        blocks
    }

    pub fn events(&self) -> Parser<'_> {
        Parser::new_ext(&self.text, Options::ENABLE_TABLES)
    }
}

#[test]
fn every_file_in_docs_is_a_page_that_is_served() {
    let mut there: Vec<PathBuf> =
        std::fs::read_dir(root().join("docs")).unwrap().map(|it| it.unwrap().path()).collect();
    there.retain(|path| path.extension().is_some_and(|it| it == "md"));
    let mut names: Vec<_> = there.iter().map(|path| path.file_stem().unwrap().to_str().unwrap()).collect();
    let mut listed: Vec<_> = PAGES.iter().map(|(name, _)| *name).collect();
    names.sort_unstable();
    listed.sort_unstable();
    assert_eq!(listed, names);
}

#[test]
fn every_page_has_one_title_and_says_what_it_is_about() {
    for page in meshmend::manual::pages() {
        let text = std::str::from_utf8(page.markdown.plain()).unwrap();
        assert!(text.starts_with(&format!("# {}\n", page.outline.title)), "{}", page.name);
        assert!(!page.outline.summary.is_empty() && page.outline.summary.ends_with('.'), "{}", page.name);
        let levels: Vec<_> = page.outline.headings.iter().map(|it| it.level).collect();
        assert!(levels.windows(2).all(|two| two[1] <= two[0] + 1), "{} leaves a level out: {levels:?}", page.name);
    }
}
