//! Notes, whose names have prefixes that the model declares.

use std::fmt::Write as _;

use super::notes::{OWN, namespace};
use super::write_text::{attribute, content, name};
use crate::scene::{Note, Scene};

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
            match namespace(note) {
                Some(OWN) => prefixes.add(Some("note"), OWN),
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
            let name = match namespace(note) {
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
