use std::collections::BTreeMap;

use pulldown_cmark::{Event, HeadingLevel, Options, Parser, Tag, TagEnd};

/// What Markdown may have beside CommonMark.
pub(super) const MARKDOWN: Options = Options::ENABLE_TABLES;

/// A heading within a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Heading {
    /// 2 for a section, 3 for one within it, and so on.
    pub level: u8,
    /// Its words.
    pub text: String,
    /// What links to it end with, as GitHub makes it.
    pub anchor: String,
}

/// What a page is about.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outline {
    /// Its first heading.
    pub title: String,
    /// Its first paragraph, without markup.
    pub summary: String,
    /// The headings below the first.
    pub headings: Vec<Heading>,
}

impl Outline {
    /// That of a text in Markdown.
    #[must_use]
    pub fn of(markdown: &str) -> Self {
        let mut outline = Self { title: String::new(), summary: String::new(), headings: Vec::new() };
        let mut taken = BTreeMap::new();
        let mut text = String::new();
        for event in Parser::new_ext(markdown, MARKDOWN) {
            match event {
                Event::Start(Tag::Heading { .. } | Tag::Paragraph) => text.clear(),
                Event::Text(words) | Event::Code(words) => text.push_str(&words),
                Event::SoftBreak => text.push(' '),
                Event::End(TagEnd::Heading(HeadingLevel::H1)) => outline.title = std::mem::take(&mut text),
                Event::End(TagEnd::Heading(level)) => {
                    let anchor = anchor(&text, &mut taken);
                    outline.headings.push(Heading { level: level as u8, text: std::mem::take(&mut text), anchor });
                }
                Event::End(TagEnd::Paragraph) if outline.summary.is_empty() => {
                    outline.summary = std::mem::take(&mut text);
                }
                _ => {}
            }
        }
        outline
    }
}

/// Letters, digits, hyphens and underscores in lower case, hyphens for spaces, and a number where another has the same.
fn anchor(text: &str, taken: &mut BTreeMap<String, u32>) -> String {
    let kept = text.to_lowercase().replace(' ', "-");
    let kept: String = kept.chars().filter(|c| c.is_alphanumeric() || "-_".contains(*c)).collect();
    let before = taken.entry(kept.clone()).or_default();
    *before += 1;
    if *before == 1 { kept } else { format!("{kept}-{}", *before - 1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_about_its_first_heading_and_its_first_paragraph() {
        let outline = Outline::of(
            "# The `title`\n\nWhat it *is*\nabout.\n\nMore.\n\n## A part\n\n### One's own, `x_y`\n\n## A part\n",
        );
        assert_eq!((outline.title.as_str(), outline.summary.as_str()), ("The title", "What it is about."));
        let headings: Vec<_> =
            outline.headings.iter().map(|it| (it.level, it.text.as_str(), it.anchor.as_str())).collect();
        assert_eq!(
            headings,
            [(2, "A part", "a-part"), (3, "One's own, x_y", "ones-own-x_y"), (2, "A part", "a-part-1")]
        );
    }
}
