//! The pages in docs/ and the README.

use std::path::Path;

use meshmend::manual::PAGES;
use pulldown_cmark::{CodeBlockKind, Event, Options, Parser, Tag, TagEnd};

pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A page in the repository.
pub struct Page {
    /// The path from the repository's root.
    pub path: String,
    pub text: String,
}

/// The served pages and the README.
pub fn all_pages() -> Vec<Page> {
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
    /// The info string after the opening fence.
    pub kind: String,
    pub code: String,
}

impl Page {
    /// The code blocks in order.
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
