//! Text as XML can hold it, and notes, whose names have prefixes that the model declares.

use std::borrow::Cow;
use std::fmt::Write as _;

use super::schema::{OWN_NOTES, note_namespace};
use crate::scene::{Note, Scene};

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
fn content(text: &str) -> Cow<'_, str> {
    escaped(text, |c| match c {
        '&' => Some("&amp;"),
        '<' => Some("&lt;"),
        '>' => Some("&gt;"),
        '\r' => Some("&#13;"),
        _ => None,
    })
}

/// The text as a name without a prefix (`NCName`), a `_` for what no name may have.
fn name(text: &str) -> String {
    let in_name =
        |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.') || (c > '\u{FF}' && c.is_alphabetic());
    let mut name: String = text.chars().map(|c| if in_name(c) { c } else { '_' }).collect();
    if !name.starts_with(|c: char| c == '_' || c.is_alphabetic()) {
        name.insert(0, '_');
    }
    name
}

/// Prefixes that are taken by others.
const TAKEN: [&str; 3] = ["m", "xml", "xmlns"];

/// The prefixes of all notes' namespaces, and the namespaces, in the order of their first use.
pub(super) struct Prefixes<'s> {
    all: Vec<(String, &'s str)>,
}

impl<'s> Prefixes<'s> {
    pub fn of(scene: &'s Scene) -> Self {
        let mut prefixes = Self { all: Vec::new() };
        let of_objects = scene.objects.iter().flat_map(|object| &object.notes);
        let of_items = scene.items.iter().flat_map(|item| &item.notes);
        for note in scene.notes.iter().chain(of_objects).chain(of_items) {
            match note_namespace(note) {
                Some(OWN_NOTES) => prefixes.add(Some("note"), OWN_NOTES),
                Some(namespace) => prefixes.add(note.name.split_once(':').map(|(prefix, _)| prefix), namespace),
                None => {}
            }
        }
        prefixes
    }

    fn add(&mut self, wanted: Option<&str>, namespace: &'s str) {
        if self.all.iter().any(|(_, known)| *known == namespace) {
            return;
        }
        let free =
            |prefix: &String| !TAKEN.contains(&prefix.as_str()) && self.all.iter().all(|(taken, _)| taken != prefix);
        let wanted = wanted.map(name).filter(free);
        let prefix = wanted.or_else(|| (1..).map(|number| format!("n{number}")).find(free));
        self.all.extend(prefix.map(|prefix| (prefix, namespace)));
    }

    /// The declarations, as attributes of the root.
    pub fn declarations(&self) -> String {
        self.all.iter().map(|(prefix, uri)| format!(" xmlns:{prefix}=\"{}\"", attribute(uri))).collect()
    }

    /// Writes notes, the first of each name.
    pub fn write<'n>(&self, notes: impl Iterator<Item = &'n Note>, text: &mut String) {
        let mut written: Vec<String> = Vec::new();
        for note in notes {
            let local =
                note.namespace.as_ref().and(note.name.split_once(':')).map_or(note.name.as_str(), |(_, local)| local);
            let name = match note_namespace(note) {
                None => note.name.clone(),
                Some(namespace) => match self.all.iter().find(|(_, uri)| *uri == namespace) {
                    Some((prefix, _)) => format!("{prefix}:{}", qualified(local)),
                    None => continue,
                },
            };
            if written.contains(&name) {
                continue;
            }
            let preserve = if note.preserve { " preserve=\"1\"" } else { "" };
            let kind = note.kind.as_ref().map_or_else(String::new, |kind| format!(" type=\"{}\"", attribute(kind)));
            // Writing to a string can't fail.
            let _ = writeln!(text, "<metadata name=\"{name}\"{preserve}{kind}>{}</metadata>", content(&note.value));
            written.push(name);
        }
    }
}

/// A name after a prefix. That some of those in use begin with a digit harms nobody.
fn qualified(local: &str) -> String {
    let clean = name(local);
    match local.starts_with(|c: char| c.is_ascii_digit()) {
        true => clean[1..].to_owned(),
        false => clean,
    }
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
