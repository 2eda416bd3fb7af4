use std::fmt::Write;
use std::io::Cursor;

use pulldown_cmark::{CowStr, Event, HeadingLevel, Parser, Tag, TagEnd, html};

use super::outline::{Heading, MARKDOWN, Outline};
use super::{PAGES, PICTURES};
use crate::web;

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
