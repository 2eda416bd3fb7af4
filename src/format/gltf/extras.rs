//! Properties that glTF does not have, such as part numbers and notes. They are stored in `extras` under the key `meshmend`.

use std::fmt;

use serde::de::{Deserializer, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::document::Asset;
use crate::scene::{Note, ObjectKind};

/// The key in `extras` for meshmend's own data.
const OWN: &str = "meshmend";

/// meshmend's own data in the `extras` of the asset, a mesh or a node.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Extras {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part_number: Option<String>,
    /// One of [`KINDS`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    notes: Vec<Written>,
}

/// A note as it is stored in `extras`.
#[derive(Debug, Serialize, Deserialize)]
struct Written {
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
const KINDS: [(ObjectKind, &str); 5] = [
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
        let own = extras.filter(|extras| extras.get().contains(OWN));
        own.and_then(|extras| serde_json::from_str::<Holder>(extras.get()).ok())
            .map_or_else(Self::default, |it| it.meshmend)
    }

    /// The `extras` to write; `None` if there is nothing to store.
    pub fn written(part_number: Option<&String>, kind: ObjectKind, notes: &[Note]) -> Option<serde_json::Value> {
        let kind = (kind != ObjectKind::Model).then(|| KINDS.iter().find(|(known, _)| *known == kind)).flatten();
        let notes: Vec<Written> = notes.iter().cloned().map(Written::from).collect();
        let it = Self { part_number: part_number.cloned(), kind: kind.map(|(_, name)| (*name).to_owned()), notes };
        let empty = it.part_number.is_none() && it.kind.is_none() && it.notes.is_empty();
        (!empty).then(|| serde_json::json!({ OWN: it }))
    }

    /// The object's kind.
    pub fn kind(&self) -> ObjectKind {
        let found = KINDS.iter().find(|(_, name)| self.kind.as_deref() == Some(name));
        found.map_or(ObjectKind::Model, |(kind, _)| *kind)
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
    let copyright = asset.copyright.as_deref().map(|value| plain(COPYRIGHT, value.to_owned()));
    let texts = asset.extras.and_then(|extras| serde_json::from_str::<Texts>(extras.get()).ok());
    let own = Extras::read(asset.extras).notes();
    copyright.into_iter().chain(own).chain(texts.into_iter().flat_map(|texts| texts.0)).collect()
}

fn plain(name: &str, value: String) -> Note {
    Note { name: name.to_owned(), namespace: None, value, kind: None, preserve: false }
}

/// The string members of a JSON object, as notes.
struct Texts(Vec<Note>);

impl<'de> Deserialize<'de> for Texts {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Members;
        impl<'de> Visitor<'de> for Members {
            type Value = Texts;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<Texts, A::Error> {
                let mut notes = Vec::new();
                while let Some((name, value)) = members.next_entry::<String, &RawValue>()? {
                    if let Ok(value) = serde_json::from_str::<String>(value.get()) {
                        notes.push(plain(&name, value));
                    }
                }
                Ok(Texts(notes))
            }
        }
        deserializer.deserialize_map(Members)
    }
}

impl From<Note> for Written {
    fn from(Note { name, namespace, value, kind, preserve }: Note) -> Self {
        Self { name, value, namespace, kind, preserve }
    }
}

impl From<Written> for Note {
    fn from(Written { name, value, namespace, kind, preserve }: Written) -> Self {
        Self { name, namespace, value, kind, preserve }
    }
}
