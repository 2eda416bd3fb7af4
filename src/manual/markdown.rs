//! The sources of the pages in Markdown: what each is about, and its HTML.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::io::Cursor;

use pulldown_cmark::{CowStr, Event, HeadingLevel, Options, Parser, Tag, TagEnd, html};

use crate::web;

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
pub(super) const PICTURES: &[(&str, &[u8])] = pictures! {
    "ball-before" "ball-change"
    "cube-before" "cube-after"
    "boxes-before" "boxes-after"
    "halves-before" "halves-change"
    "sheet-before" "sheet-after"
};

/// What Markdown may have beside CommonMark.
const MARKDOWN: Options = Options::ENABLE_TABLES;

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

/// The address of a service in examples: links to it lead to this one.
const EXAMPLE: &str = "http://127.0.0.1:8080/";

/// A whole page: the frame with the list of pages, the list of its own sections, and the text.
pub(super) fn document(name: &str, markdown: &str, pages: &[(&str, Outline)]) -> String {
    let Some((_, outline)) = pages.iter().find(|(known, _)| *known == name) else { return String::new() };
    let list = pages.iter().fold(String::new(), |mut list, (other, outline)| {
        let current = if *other == name { " aria-current=\"page\"" } else { "" };
        // Writing to a string succeeds.
        let _ = write!(list, "<li><a href=\"{}\"{current}>{}</a></li>", address(other), escaped(&outline.title));
        list
    });
    let sections = outline.headings.iter().filter(|it| it.level == 2).fold(String::new(), |mut list, it| {
        let _ = write!(list, "<li><a href=\"#{}\">{}</a></li>", it.anchor, escaped(&it.text));
        list
    });
    web::manual()
        .replace("{title}", &escaped(&outline.title))
        .replace("{summary}", &escaped(&outline.summary))
        .replace("{name}", name)
        .replace("{pages}", &list)
        .replace("{sections}", &sections)
        // The last, since it may hold anything.
        .replace("{text}", &text(markdown, &outline.headings))
}

/// The text of a page. Comments are left out, and so would be any other HTML.
fn text(markdown: &str, headings: &[Heading]) -> String {
    let mut headings = headings.iter();
    let mut picture: Option<(CowStr<'_>, String)> = None;
    let mut is_linked = true;
    let mut events = Vec::new();
    for event in Parser::new_ext(markdown, MARKDOWN) {
        if let Some((address, alt)) = &mut picture {
            match event {
                Event::Text(words) | Event::Code(words) => alt.push_str(&words),
                Event::End(TagEnd::Image) => {
                    events.push(raw(image(address, alt)));
                    picture = None;
                }
                _ => {}
            }
            continue;
        }
        match event {
            Event::Start(Tag::Image { dest_url, .. }) => picture = Some((dest_url, String::new())),
            Event::Start(Tag::Heading { level, .. }) if level != HeadingLevel::H1 => {
                let anchor = headings.next().map_or("", |it| it.anchor.as_str());
                events.push(raw(format!("<{level} id=\"{anchor}\"><a href=\"#{anchor}\">")));
            }
            Event::End(TagEnd::Heading(level)) if level != HeadingLevel::H1 => {
                events.push(raw(format!("</a></{level}>\n")));
            }
            // What is wider than the screen is moved within its own frame, by keys too.
            Event::Start(Tag::CodeBlock(_)) => events.push(raw("<pre tabindex=\"0\"><code>".to_owned())),
            Event::End(TagEnd::CodeBlock) => events.push(raw("</code></pre>\n".to_owned())),
            Event::Start(Tag::Table(_)) => {
                events.push(raw("<div class=\"wide\" tabindex=\"0\" role=\"group\" aria-label=\"Table\">".to_owned()));
                events.push(event);
            }
            Event::End(TagEnd::Table) => events.extend([event, raw("</div>\n".to_owned())]),
            Event::Start(Tag::Link { link_type, dest_url, title, id }) => {
                let leads_to = linked(&dest_url);
                is_linked = leads_to.is_some();
                events.extend(leads_to.map(|to| Event::Start(Tag::Link { link_type, dest_url: to.into(), title, id })));
            }
            Event::End(TagEnd::Link) if !is_linked => {}
            Event::Html(_) | Event::InlineHtml(_) => {}
            _ => events.push(event),
        }
    }
    let mut text = String::new();
    html::push_html(&mut text, events.into_iter());
    text
}

fn raw(html: String) -> Event<'static> {
    Event::Html(html.into())
}

/// Where a page is, as seen from another one.
fn address(name: &str) -> &str {
    if name == PAGES[0].0 { "./" } else { name }
}

/// Where a link of a page leads when the page is served; none where that is a file of the repository, beside the pages.
fn linked(link: &str) -> Option<String> {
    if let Some(path) = link.strip_prefix(EXAMPLE) {
        return Some(format!("/{path}"));
    }
    let (file, anchor) = link.split_once('#').map_or((link, String::new()), |(file, it)| (file, format!("#{it}")));
    match file.strip_suffix(".md") {
        _ if file.starts_with("../") => None,
        Some(name) => Some(address(name).to_owned() + &anchor),
        None => Some(link.to_owned()),
    }
}

/// A picture with its size, so that nothing moves when it has come.
fn image(address: &str, alt: &str) -> String {
    let name = address.strip_prefix("pictures/").unwrap_or(address);
    let bytes = PICTURES.iter().find(|(known, _)| *known == name).map_or(&[][..], |(_, bytes)| bytes);
    let (width, height) = png::Decoder::new(Cursor::new(bytes)).read_info().map_or((0, 0), |it| it.info().size());
    format!("<img src=\"{address}\" alt=\"{}\" width=\"{width}\" height=\"{height}\" loading=\"lazy\">", escaped(alt))
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
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

    fn made(markdown: &str) -> String {
        text(markdown, &Outline::of(markdown).headings)
    }

    #[test]
    fn links_between_pages_and_to_a_service_work_where_the_pages_are_served() {
        for (written, served) in [
            ("options.md", Some("options")),
            ("options.md#repair", Some("options#repair")),
            ("README.md", Some("./")),
            ("#repair", Some("#repair")),
            ("http://127.0.0.1:8080/docs/api/", Some("/docs/api/")),
            ("https://www.standardwebhooks.com", Some("https://www.standardwebhooks.com")),
            ("../deploy/README.md", None),
        ] {
            assert_eq!(linked(written).as_deref(), served, "{written}");
        }
        assert_eq!(made("[deploy/](../deploy/README.md) [x](x.md)"), "<p>deploy/ <a href=\"x\">x</a></p>\n");
    }

    #[test]
    fn sections_are_links_to_themselves_and_wide_things_can_be_reached_by_keys() {
        assert_eq!(made("# A\n\n## B `c`"), "<h1>A</h1>\n<h2 id=\"b-c\"><a href=\"#b-c\">B <code>c</code></a></h2>\n");
        assert_eq!(made("```sh operator\na < b\n```"), "<pre tabindex=\"0\"><code>a &lt; b\n</code></pre>\n");
        let table = made("| a |\n|---|\n| b |");
        assert!(
            table.starts_with("<div class=\"wide\" tabindex=\"0\"") && table.ends_with("</table>\n</div>\n"),
            "{table}"
        );
    }

    #[test]
    fn no_html_of_a_page_is_handed_on() {
        assert_eq!(made("<!-- a -->\n\nb <script>c</script>"), "<p>b c</p>\n");
    }

    #[test]
    fn pictures_have_words_and_a_size() {
        let image = made("![A \"ball\"](pictures/ball-before.png)");
        assert!(image.contains("alt=\"A &quot;ball&quot;\" width=\"960\" height=\"720\""), "{image}");
    }
}
