//! Why a file can't be read or written, and where in the file the problem is.

use serde::{Deserialize, Serialize};

/// Where in a file a problem is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema), schema(as = Place))]
#[serde(rename_all = "snake_case")]
pub enum FileLocation {
    /// Offset in bytes from the start of the file.
    Byte(u64),
    /// Line number, counted from 1.
    Line(u64),
}

/// What is wrong with a file, for programs. The explanation for people is [`ReadError::detail`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ReadErrorKind {
    /// The file has no bytes.
    Empty,
    /// The bytes match no known format.
    UnknownFormat,
    /// The format is known, but meshmend does not read it.
    UnsupportedFormat,
    /// The file ends before its declared content does.
    Truncated,
    /// A word, number or header that the format does not allow.
    Malformed,
    /// A face refers to a vertex that does not exist.
    IndexOutOfRange,
    /// The file exceeds one of the [`Limits`](super::Limits).
    TooLarge,
    /// The file is well formed but holds no triangle.
    NoFaces,
}

/// An error from reading a file. Its display text is `detail` followed by the location.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{detail}{}", match place { Some(FileLocation::Byte(b)) => format!(" (at byte {b})"), Some(FileLocation::Line(l)) => format!(" (line {l})"), None => String::new() })]
pub struct ReadError {
    /// The kind of error, for programs.
    pub kind: ReadErrorKind,
    /// The byte or line of the error; `None` if it concerns the whole file.
    pub place: Option<FileLocation>,
    /// What was found, what was expected and what to do, in words.
    pub detail: String,
}

impl ReadError {
    /// An error that concerns the whole file.
    pub(super) fn for_file(kind: ReadErrorKind, detail: impl Into<String>) -> Self {
        Self { kind, place: None, detail: detail.into() }
    }

    /// An error at a byte offset.
    pub(super) fn at_byte(kind: ReadErrorKind, at: usize, detail: impl Into<String>) -> Self {
        Self { kind, place: Some(FileLocation::Byte(at as u64)), detail: detail.into() }
    }
}

/// An error from writing a mesh or a scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WriteError {
    /// More faces than the format's count field can hold.
    #[error("the model has {faces} faces, but the format can count only {max}; choose another output format")]
    TooManyFaces {
        /// Number of faces in the mesh.
        faces: u64,
        /// Largest number of faces that the format can count.
        max: u64,
    },
    /// More instances of objects than the format's readers accept.
    #[error(
        "the model has {parts} instances of objects, but the format allows only {max}; join objects or choose another output format"
    )]
    TooManyParts {
        /// Number of instances.
        parts: u64,
        /// Largest number of instances that the format allows.
        max: u64,
    },
    /// A coordinate is outside the range of the format's number type.
    #[error(
        "coordinate {value} of vertex {vertex} does not fit in the format's 32-bit numbers; scale the model or choose another output format"
    )]
    OutOfRange {
        /// Index of the vertex.
        vertex: u32,
        /// The coordinate.
        value: f64,
    },
    /// A coordinate or a transform contains infinity or not-a-number.
    #[error(
        "a coordinate is not a finite number, which the format can't store; repair the model or choose another output format"
    )]
    NotFinite,
    /// The file would be larger than the format can hold.
    #[error("the file would be larger than the format can hold; simplify the model or choose another output format")]
    TooLarge,
}

/// A word of the file for use in a message: escaped, and shortened after 32 bytes.
pub(super) fn excerpt(word: &[u8]) -> String {
    excerpt_up_to(32, word)
}

/// As [`excerpt`], shortened after `max` bytes.
pub(super) fn excerpt_up_to(max_bytes: usize, word: &[u8]) -> String {
    let mut text: String =
        String::from_utf8_lossy(&word[..word.len().min(max_bytes)]).chars().flat_map(char::escape_debug).collect();
    if word.len() > max_bytes {
        text.push_str("...");
    }
    text
}
