//! Why a file can't be read or written, and where in it.

use serde::{Deserialize, Serialize};

/// Where in a file something was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Place {
    /// Offset in bytes from the file's start.
    Byte(u64),
    /// Line number, the first line being 1.
    Line(u64),
}

/// What is wrong with a file, for programs; the words for people are in [`ReadError::detail`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ReadErrorKind {
    /// The file has no bytes.
    Empty,
    /// The bytes match no known format.
    UnknownFormat,
    /// A known format that is not read by this version.
    UnsupportedFormat,
    /// The file ends before what it promised.
    Truncated,
    /// A word, number or header that is not what the format asks for.
    Malformed,
    /// A face names a vertex that is not there.
    IndexOutOfRange,
    /// Over one of the [`Limits`](super::Limits).
    TooLarge,
    /// The file is well formed and holds no triangle.
    NoFaces,
}

/// Why a file could not be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{detail}{}", match place { Some(Place::Byte(b)) => format!(" (at byte {b})"), Some(Place::Line(l)) => format!(" (line {l})"), None => String::new() })]
pub struct ReadError {
    /// The kind, for programs.
    pub kind: ReadErrorKind,
    /// Where, if it has a place.
    pub place: Option<Place>,
    /// What was found and what was expected, and what to do, in words.
    pub detail: String,
}

impl ReadError {
    /// An error about the file as a whole.
    pub(super) fn whole(kind: ReadErrorKind, detail: impl Into<String>) -> Self {
        Self { kind, place: None, detail: detail.into() }
    }

    /// An error at an offset in bytes.
    pub(super) fn at_byte(kind: ReadErrorKind, at: usize, detail: impl Into<String>) -> Self {
        Self { kind, place: Some(Place::Byte(at as u64)), detail: detail.into() }
    }
}

/// Why a mesh could not be written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WriteError {
    /// The format's count field is too small.
    #[error("{faces} faces are more than the {most} that the format can count; choose another output format")]
    TooManyFaces {
        /// Faces in the mesh.
        faces: u64,
        /// What the format can say.
        most: u64,
    },
    /// More places of objects than the format's readers take.
    #[error(
        "the objects stand in {parts} places, more than the {most} that the format takes; unite them or choose another output format"
    )]
    TooManyParts {
        /// Places of objects.
        parts: u64,
        /// How many may be.
        most: u64,
    },
    /// A coordinate does not fit the format's number type.
    #[error(
        "coordinate {value} of vertex {vertex} does not fit in the format's 32-bit numbers; scale the model or choose another output format"
    )]
    OutOfRange {
        /// Index of the vertex.
        vertex: u32,
        /// The coordinate.
        value: f64,
    },
    /// A coordinate, or a number of an object's place, is infinite or none.
    #[error(
        "a coordinate is not a finite number, which the format can't say; repair the model or choose another output format"
    )]
    NotFinite,
    /// The file would be larger than the format can hold.
    #[error("the file would be larger than the format can hold; simplify the model or choose another output format")]
    TooLarge,
}

/// A word of the file as it can be shown in a message: printable, and cut where it is long.
pub(super) fn shown(word: &[u8]) -> String {
    shown_up_to(32, word)
}

/// As [`shown`], cut where it is longer than `most` bytes.
pub(super) fn shown_up_to(most: usize, word: &[u8]) -> String {
    let mut text: String =
        String::from_utf8_lossy(&word[..word.len().min(most)]).chars().flat_map(char::escape_debug).collect();
    if word.len() > most {
        text.push_str("...");
    }
    text
}
