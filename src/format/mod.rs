//! Bytes to [`Soup`] and back: one file a format, found by content and never by name.
//!
//! Every input is hostile: readers check counts against [`Limits`] and against the bytes that are there before they
//! allocate, and answer a [`ReadError`] that names the byte or line and what was expected there.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::mesh::Soup;

/// A file format that is both read and written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Stereolithography, binary or ASCII; written as binary. Coordinates are f32 and there are no indices.
    Stl,
    /// Wavefront OBJ.
    Obj,
    /// Stanford PLY, ASCII or binary of either byte order; written as little-endian binary.
    Ply,
    /// Object File Format with its variants.
    Off,
}

/// What a reader may spend on one file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Largest file, in bytes.
    pub max_bytes: u64,
    /// Most triangles after polygons are cut.
    pub max_faces: u64,
    /// Most vertices.
    pub max_vertices: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { max_bytes: 512 << 20, max_faces: 10_000_000, max_vertices: 30_000_000 }
    }
}

/// Where in a file something was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Place {
    /// Offset in bytes from the file's start.
    Byte(u64),
    /// Line number, the first line being 1.
    Line(u64),
}

/// A mesh read from bytes, with what a reader should tell.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadMesh {
    /// The triangles.
    pub soup: Soup,
    /// The format that was found.
    pub format: Format,
    /// The dialect in words: `binary STL`, `ASCII PLY`, `COFF`.
    pub dialect: String,
    /// Oddities that were read past, each a sentence for the person who sent the file.
    pub warnings: Vec<String>,
}

/// Names the format of a file from its first bytes (a few thousand are enough) and its length where it is known.
///
/// # Errors
/// [`ReadErrorKind::UnknownFormat`] or [`ReadErrorKind::UnsupportedFormat`], with what was found.
pub fn sniff(_head: &[u8], _length: Option<u64>) -> Result<Format, ReadError> {
    Err(ReadError { kind: ReadErrorKind::UnknownFormat, place: None, detail: String::new() })
}

/// Reads a whole file of any known format.
///
/// # Errors
/// A [`ReadError`] that names the place and what was expected.
pub fn read(_bytes: &[u8], _limits: &Limits) -> Result<ReadMesh, ReadError> {
    Err(ReadError { kind: ReadErrorKind::UnknownFormat, place: None, detail: String::new() })
}

/// Writes a mesh in a format. The same mesh gives the same bytes.
///
/// # Errors
/// [`WriteError`] when the mesh can't be said in the format.
pub fn write(_soup: &Soup, _format: Format) -> Result<Vec<u8>, WriteError> {
    Err(WriteError::TooManyFaces { faces: 0, most: 0 })
}

/// What is wrong with a file, for programs; the words for people are in [`ReadError::detail`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
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
    /// Over one of the [`Limits`].
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
}
