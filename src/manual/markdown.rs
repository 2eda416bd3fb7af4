//! The documentation's Markdown sources, and their conversion to HTML.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::io::Cursor;

use pulldown_cmark::{CowStr, Event, HeadingLevel, Options, Parser, Tag, TagEnd, html};

use crate::web;

/// Embeds the Markdown files with these names.
macro_rules! pages {
    ($($name:literal)*) => {
        &[$(($name, include_str!(concat!("../../docs/", $name, ".md")))),*]
    };
}

/// Embeds the PNG files with these names.
macro_rules! pictures {
    ($($name:literal)*) => {
        &[$((concat!($name, ".png"), include_bytes!(concat!("../../docs/pictures/", $name, ".png")))),*]
    };
}

/// The pages' names and Markdown texts, in the order in which they are listed. The first page is served at `/docs/`.
pub const PAGES: &[(&str, &str)] = pages! {
    "README"
    "quick-start"
    "installing"
    "how-repair-works"
    "formats"
    "printing-processes"
    "print-on-demand"
    "widget"
    "using-the-api"
    "clients"
    "command-line"
    "options"
    "report"
    "problems"
    "glossary"
    "operations"
    "metrics"
    "capacity"
    "versions"
};

/// The images in the pages, rendered by the program itself (`make pictures`).
pub(super) const PICTURES: &[(&str, &[u8])] = pictures! {
    "ball-before" "ball-change"
    "cube-before" "cube-after"
    "boxes-before" "boxes-after"
    "halves-before" "halves-change"
    "sheet-before" "sheet-after"
};

/// The Markdown extensions that pages may use beyond CommonMark.
const MARKDOWN: Options = Options::ENABLE_TABLES;

/// A heading of a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Heading {
    /// The heading's level: 2 for a section, 3 for a subsection, and so on.
    pub level: u8,
    /// The heading's text.
    pub text: String,
    /// The heading's URL fragment, generated as on GitHub.
    pub anchor: String,
}

/// The title, summary and headings of a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outline {
    /// The first heading.
    pub title: String,
    /// The first paragraph, without markup.
    pub summary: String,
    /// The headings after the first.
    pub headings: Vec<Heading>,
}

impl Outline {
    /// Extracts the outline of a Markdown text.
    #[must_use]
    pub fn of(markdown: &str) -> Self {
        let mut outline = Self { title: String::new(), summary: String::new(), headings: Vec::new() };
        let mut anchor_counts = BTreeMap::new();
        let mut text = String::new();
        for event in Parser::new_ext(markdown, MARKDOWN) {
            match event {
                Event::Start(Tag::Heading { .. } | Tag::Paragraph) => text.clear(),
                Event::Text(words) | Event::Code(words) => text.push_str(&words),
                Event::SoftBreak => text.push(' '),
                Event::End(TagEnd::Heading(HeadingLevel::H1)) => outline.title = std::mem::take(&mut text),
                Event::End(TagEnd::Heading(level)) => {
                    let anchor = anchor(&text, &mut anchor_counts);
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

/// Returns the URL fragment of a heading: lower case, with hyphens for spaces, without punctuation. A repeated fragment gets a number.
fn anchor(text: &str, counts: &mut BTreeMap<String, u32>) -> String {
    let hyphenated = text.to_lowercase().replace(' ', "-");
    let anchor: String = hyphenated.chars().filter(|c| c.is_alphanumeric() || "-_".contains(*c)).collect();
    let count = counts.entry(anchor.clone()).or_default();
    *count += 1;
    if *count == 1 { anchor } else { format!("{anchor}-{}", *count - 1) }
}

/// The service's address in examples. Links to this address become links to the serving host.
const EXAMPLE_HOST: &str = "http://127.0.0.1:8080/";

/// Renders a page: the template with the list of pages, the list of the page's sections, and the text.
pub(super) fn document(name: &str, markdown: &str, pages: &[(&str, Outline)]) -> String {
    let Some((_, outline)) = pages.iter().find(|(page, _)| *page == name) else { return String::new() };
    let list = pages.iter().fold(String::new(), |mut list, (other, outline)| {
        let current = if *other == name { " aria-current=\"page\"" } else { "" };
        // Writing to a string succeeds.
        let _ = write!(list, "<li><a href=\"{}\"{current}>{}</a></li>", address(other), escaped(&outline.title));
        list
    });
    let sections =
        outline.headings.iter().filter(|heading| heading.level == 2).fold(String::new(), |mut list, heading| {
            let _ = write!(list, "<li><a href=\"#{}\">{}</a></li>", heading.anchor, escaped(&heading.text));
            list
        });
    web::manual()
        .replace("{title}", &escaped(&outline.title))
        .replace("{summary}", &escaped(&outline.summary))
        .replace("{name}", name)
        .replace("{pages}", &list)
        .replace("{sections}", &sections)
        // The text is inserted last, because it may contain placeholders.
        .replace("{text}", &text(markdown, &outline.headings))
}

/// Renders the text of a page. HTML in the source, such as comments, is omitted.
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
                let anchor = headings.next().map_or("", |heading| heading.anchor.as_str());
                events.push(raw(format!("<{level} id=\"{anchor}\"><a href=\"#{anchor}\">")));
            }
            Event::End(TagEnd::Heading(level)) if level != HeadingLevel::H1 => {
                events.push(raw(format!("</a></{level}>\n")));
            }
            // Wide code blocks and tables scroll in their own frame, also by keyboard.
            Event::Start(Tag::CodeBlock(_)) => events.push(raw("<pre tabindex=\"0\"><code>".to_owned())),
            Event::End(TagEnd::CodeBlock) => events.push(raw("</code></pre>\n".to_owned())),
            Event::Start(Tag::Table(_)) => {
                events.push(raw("<div class=\"wide\" tabindex=\"0\" role=\"group\" aria-label=\"Table\">".to_owned()));
                events.push(event);
            }
            Event::End(TagEnd::Table) => events.extend([event, raw("</div>\n".to_owned())]),
            Event::Start(Tag::Link { link_type, dest_url, title, id }) => {
                let target = linked(&dest_url);
                is_linked = target.is_some();
                events.extend(target.map(|to| Event::Start(Tag::Link { link_type, dest_url: to.into(), title, id })));
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

/// Returns the relative URL of a page from another page.
fn address(name: &str) -> &str {
    if name == PAGES[0].0 { "./" } else { name }
}

/// Returns the target of a link in the served page, or `None` for a link to a repository file outside `docs/`.
fn linked(link: &str) -> Option<String> {
    if let Some(path) = link.strip_prefix(EXAMPLE_HOST) {
        return Some(format!("/{path}"));
    }
    let (file, anchor) =
        link.split_once('#').map_or((link, String::new()), |(file, fragment)| (file, format!("#{fragment}")));
    match file.strip_suffix(".md") {
        _ if file.starts_with("../") => None,
        Some(name) => Some(address(name).to_owned() + &anchor),
        None => Some(link.to_owned()),
    }
}

/// Renders an image element with its size, so that the page layout does not shift when the image loads.
fn image(address: &str, alt: &str) -> String {
    let name = address.strip_prefix("pictures/").unwrap_or(address);
    let bytes = PICTURES.iter().find(|(file, _)| *file == name).map_or(&[][..], |(_, bytes)| bytes);
    let (width, height) =
        png::Decoder::new(Cursor::new(bytes)).read_info().map_or((0, 0), |reader| reader.info().size());
    format!("<img src=\"{address}\" alt=\"{}\" width=\"{width}\" height=\"{height}\" loading=\"lazy\">", escaped(alt))
}

/// Escapes a text for HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outline_has_the_first_heading_the_first_paragraph_and_the_other_headings() {
        let outline = Outline::of(
            "# The `title`\n\nWhat it *is*\nabout.\n\nMore.\n\n## A part\n\n### One's own, `x_y`\n\n## A part\n",
        );
        assert_eq!((outline.title.as_str(), outline.summary.as_str()), ("The title", "What it is about."));
        let headings: Vec<_> = outline
            .headings
            .iter()
            .map(|heading| (heading.level, heading.text.as_str(), heading.anchor.as_str()))
            .collect();
        assert_eq!(
            headings,
            [(2, "A part", "a-part"), (3, "One's own, x_y", "ones-own-x_y"), (2, "A part", "a-part-1")]
        );
    }

    fn rendered(markdown: &str) -> String {
        text(markdown, &Outline::of(markdown).headings)
    }

    #[test]
    fn links_between_pages_and_to_the_service_work_in_the_served_pages() {
        for (source, served) in [
            ("options.md", Some("options")),
            ("options.md#repair", Some("options#repair")),
            ("README.md", Some("./")),
            ("#repair", Some("#repair")),
            ("http://127.0.0.1:8080/docs/api/", Some("/docs/api/")),
            ("https://www.standardwebhooks.com", Some("https://www.standardwebhooks.com")),
            ("../deploy/README.md", None),
        ] {
            assert_eq!(linked(source).as_deref(), served, "{source}");
        }
        assert_eq!(rendered("[deploy/](../deploy/README.md) [x](x.md)"), "<p>deploy/ <a href=\"x\">x</a></p>\n");
    }

    #[test]
    fn sections_link_to_themselves_and_wide_content_is_reachable_by_keyboard() {
        assert_eq!(
            rendered("# A\n\n## B `c`"),
            "<h1>A</h1>\n<h2 id=\"b-c\"><a href=\"#b-c\">B <code>c</code></a></h2>\n"
        );
        assert_eq!(rendered("```sh operator\na < b\n```"), "<pre tabindex=\"0\"><code>a &lt; b\n</code></pre>\n");
        let table = rendered("| a |\n|---|\n| b |");
        assert!(
            table.starts_with("<div class=\"wide\" tabindex=\"0\"") && table.ends_with("</table>\n</div>\n"),
            "{table}"
        );
    }

    #[test]
    fn html_in_a_page_is_omitted() {
        assert_eq!(rendered("<!-- a -->\n\nb <script>c</script>"), "<p>b c</p>\n");
    }

    #[test]
    fn images_have_alternative_text_and_a_size() {
        let image = rendered("![A \"ball\"](pictures/ball-before.png)");
        assert!(image.contains("alt=\"A &quot;ball&quot;\" width=\"960\" height=\"720\""), "{image}");
    }
}
