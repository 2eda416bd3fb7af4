//! Properties that glTF does not have, such as part numbers and notes. They are stored in `extras` under the key `meshmend`.

use std::fmt;

use serde::de::{Deserializer, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::document::Asset;
use crate::scene::{Note, ObjectKind};

/// The key in `extras` for meshmend's own data.
const EXTRAS_KEY: &str = "meshmend";

/// meshmend's own data in the `extras` of the asset, a mesh or a node.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Extras {
    /// The part number of a 3MF object or item.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part_number: Option<String>,
    /// The object's kind, one of [`OBJECT_KINDS`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    notes: Vec<StoredNote>,
}

/// A note as it is stored in `extras`.
#[derive(Debug, Serialize, Deserialize)]
struct StoredNote {
    name: String,
    value: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    namespace: Option<String>,
    #[serde(default, rename = "type", skip_serializing_if = "Option::is_none")]
    kind: Option<String>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    preserve: bool,
}

/// The stored names of object kinds.
const OBJECT_KINDS: [(ObjectKind, &str); 5] = [
    (ObjectKind::Model, "model"),
    (ObjectKind::SolidSupport, "solidsupport"),
    (ObjectKind::Support, "support"),
    (ObjectKind::Surface, "surface"),
    (ObjectKind::Other, "other"),
];

impl Extras {
    /// Reads meshmend's data from `extras`; empty if there is none.
    pub fn read(extras: Option<&RawValue>) -> Self {
        #[derive(Deserialize)]
        struct Holder {
            meshmend: Extras,
        }
        // Most extras have none; this check avoids parsing them.
        let own = extras.filter(|extras| extras.get().contains(EXTRAS_KEY));
        own.and_then(|extras| serde_json::from_str::<Holder>(extras.get()).ok())
            .map_or_else(Self::default, |holder| holder.meshmend)
    }

    /// The `extras` to write; `None` if there is nothing to store.
    pub fn to_json(part_number: Option<&String>, kind: ObjectKind, notes: &[Note]) -> Option<serde_json::Value> {
        let kind = (kind != ObjectKind::Model).then(|| OBJECT_KINDS.iter().find(|(known, _)| *known == kind)).flatten();
        let notes: Vec<StoredNote> = notes.iter().cloned().map(StoredNote::from).collect();
        let extras = Self { part_number: part_number.cloned(), kind: kind.map(|(_, name)| (*name).to_owned()), notes };
        let empty = extras.part_number.is_none() && extras.kind.is_none() && extras.notes.is_empty();
        (!empty).then(|| serde_json::json!({ EXTRAS_KEY: extras }))
    }

    /// The object's kind.
    pub fn kind(&self) -> ObjectKind {
        let known = OBJECT_KINDS.iter().find(|(_, name)| self.kind.as_deref() == Some(name));
        known.map_or(ObjectKind::Model, |(kind, _)| *kind)
    }

    /// The stored notes.
    pub fn notes(self) -> Vec<Note> {
        self.notes.into_iter().map(Note::from).collect()
    }
}

/// The name of the note that glTF stores as `asset.copyright`.
pub(super) const COPYRIGHT: &str = "Copyright";

/// The notes of a file: the copyright, meshmend's own notes, and text members of `extras` that other programs wrote.
pub(super) fn notes_of(asset: &Asset<'_>) -> Vec<Note> {
    let copyright = asset.copyright.as_deref().map(|value| plain_note(COPYRIGHT, value.to_owned()));
    let texts = asset.extras.and_then(|extras| serde_json::from_str::<TextMembers>(extras.get()).ok());
    let own = Extras::read(asset.extras).notes();
    copyright.into_iter().chain(own).chain(texts.into_iter().flat_map(|texts| texts.0)).collect()
}

fn plain_note(name: &str, value: String) -> Note {
    Note { name: name.to_owned(), namespace: None, value, kind: None, preserve: false }
}

/// The string members of a JSON object, as notes.
struct TextMembers(Vec<Note>);

impl<'de> Deserialize<'de> for TextMembers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Members;
        impl<'de> Visitor<'de> for Members {
            type Value = TextMembers;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<TextMembers, A::Error> {
                let mut notes = Vec::new();
                while let Some((name, value)) = members.next_entry::<String, &RawValue>()? {
                    if let Ok(value) = serde_json::from_str::<String>(value.get()) {
                        notes.push(plain_note(&name, value));
                    }
                }
                Ok(TextMembers(notes))
            }
        }
        deserializer.deserialize_map(Members)
    }
}

impl From<Note> for StoredNote {
    fn from(Note { name, namespace, value, kind, preserve }: Note) -> Self {
        Self { name, value, namespace, kind, preserve }
    }
}

impl From<StoredNote> for Note {
    fn from(StoredNote { name, value, namespace, kind, preserve }: StoredNote) -> Self {
        Self { name, namespace, value, kind, preserve }
    }
}
