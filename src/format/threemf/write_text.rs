//! Text as XML can hold it.

use std::borrow::Cow;

/// What XML has no way to say is left out.
fn sayable(text: &str) -> impl Iterator<Item = char> {
    text.chars().filter(|&c| c >= ' ' && !matches!(c, '\u{FFFE}' | '\u{FFFF}') || matches!(c, '\t' | '\n' | '\r'))
}

fn escaped<'t>(text: &'t str, escape: impl Fn(char) -> Option<&'static str>) -> Cow<'t, str> {
    let plain = |c: char| (' '..'\u{FFFE}').contains(&c) && escape(c).is_none();
    if text.chars().all(plain) {
        return Cow::Borrowed(text);
    }
    let mut whole = String::with_capacity(text.len() + 16);
    for c in sayable(text) {
        match escape(c) {
            Some(reference) => whole.push_str(reference),
            None => whole.push(c),
        }
    }
    Cow::Owned(whole)
}

/// The value of an attribute, between double quotes.
pub(super) fn attribute(text: &str) -> Cow<'_, str> {
    escaped(text, |c| match c {
        '&' => Some("&amp;"),
        '<' => Some("&lt;"),
        '>' => Some("&gt;"),
        '"' => Some("&quot;"),
        '\t' => Some("&#9;"),
        '\n' => Some("&#10;"),
        '\r' => Some("&#13;"),
        _ => None,
    })
}

/// The text of an element.
pub(super) fn content(text: &str) -> Cow<'_, str> {
    escaped(text, |c| match c {
        '&' => Some("&amp;"),
        '<' => Some("&lt;"),
        '>' => Some("&gt;"),
        '\r' => Some("&#13;"),
        _ => None,
    })
}

/// The text as a name without a prefix (`NCName`), a `_` for what no name may have.
pub(super) fn name(text: &str) -> String {
    let in_name =
        |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.') || (c > '\u{FF}' && c.is_alphabetic());
    let mut name: String = text.chars().map(|c| if in_name(c) { c } else { '_' }).collect();
    if !name.starts_with(|c: char| c == '_' || c.is_alphabetic()) {
        name.insert(0, '_');
    }
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_xml_uses_itself_is_escaped_and_what_it_forbids_left_out() {
        assert_eq!(attribute("a \"b\" <c> & d\n\u{1}\u{FFFF}"), "a &quot;b&quot; &lt;c&gt; &amp; d&#10;");
        assert_eq!(content("]]>\r\n\u{8}\u{1F600}"), "]]&gt;&#13;\n\u{1F600}");
        assert!(matches!(attribute("plain"), Cow::Borrowed("plain")));
        assert_eq!(content("\u{10000}\u{FFFD}"), "\u{10000}\u{FFFD}");
    }

    #[test]
    fn any_text_becomes_a_name() {
        assert_eq!(name("Title"), "Title");
        assert_eq!(name("my note: 1"), "my_note__1");
        assert_eq!(name("3mfVersion"), "_3mfVersion");
        assert_eq!(name(""), "_");
    }
}
