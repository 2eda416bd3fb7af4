//! The names of notes.

use crate::scene::Note;

/// Names that need no namespace (core specification, 3.4.1).
const NAMES: [&str; 9] = [
    "Title",
    "Designer",
    "Description",
    "Copyright",
    "LicenseTerms",
    "Rating",
    "CreationDate",
    "ModificationDate",
    "Application",
];

/// The namespace in which notes are written that have none and need one.
pub(super) const OWN: &str = "urn:meshmend:notes";

/// Whether a name needs no namespace.
pub(super) fn is_known(name: &str) -> bool {
    NAMES.contains(&name)
}

/// Namespaces that may not be bound to any prefix but their own.
const UNBOUND: [&str; 2] = ["http://www.w3.org/XML/1998/namespace", "http://www.w3.org/2000/xmlns/"];

/// The namespace that a note is written with, if it needs one.
pub(super) fn namespace(note: &Note) -> Option<&str> {
    match note.namespace.as_deref().filter(|uri| !uri.is_empty() && !UNBOUND.contains(uri)) {
        None if is_known(&note.name) => None,
        None => Some(OWN),
        uri => uri,
    }
}
