//! Limits that every reader enforces, and options for reading.

use serde::{Deserialize, Serialize};

use super::errors::{ReadError, ReadErrorKind};

/// Number of bytes that determine a file's format. Readers use the same number as [`sniff`](super::sniff), so both find the same format.
pub(super) const SNIFFED_BYTES: usize = 4096;

/// Limits on one file. Readers check them before they allocate memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Maximum size of the file, in bytes.
    pub max_bytes: u64,
    /// Maximum number of triangles, counted after polygons are triangulated.
    pub max_faces: u64,
    /// Maximum number of vertices.
    pub max_vertices: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { max_bytes: 512 << 20, max_faces: 10_000_000, max_vertices: 30_000_000 }
    }
}

/// Options for reading a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadOptions {
    /// Limits on size and counts.
    pub limits: Limits,
    /// Twist in degrees above which a polygon is triangulated with the least fold; the default is 45. Other polygons are triangulated as
    /// flat ones: a quad from its first corner, as most programs display it.
    pub twist_angle_deg: f64,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { limits: Limits::default(), twist_angle_deg: 45.0 }
    }
}

impl ReadOptions {
    /// The default options with these limits.
    #[must_use]
    pub fn within(limits: Limits) -> Self {
        Self { limits, ..Self::default() }
    }
}

impl Limits {
    /// No limits, for files that meshmend wrote itself.
    pub const NONE: Self = Self { max_bytes: u64::MAX, max_faces: u64::MAX, max_vertices: u64::MAX };

    /// # Errors
    /// A [`ReadError`] of kind `TooLarge` if a file of `count` bytes is over the limit.
    pub(super) fn check_bytes(&self, count: u64) -> Result<(), ReadError> {
        check_limit(Limited::Bytes, count, self.max_bytes)
    }

    /// # Errors
    /// A [`ReadError`] of kind `TooLarge` if `count` faces are over the limit.
    pub(super) fn check_faces(&self, count: u64) -> Result<(), ReadError> {
        check_limit(Limited::Faces, count, self.max_faces)
    }

    /// The limit on vertices is never above `u32::MAX`, because indices have 32 bits.
    ///
    /// # Errors
    /// A [`ReadError`] of kind `TooLarge` if `count` vertices are over the limit.
    pub(super) fn check_vertices(&self, count: u64) -> Result<(), ReadError> {
        check_limit(Limited::Vertices, count, self.max_vertices.min(u64::from(u32::MAX)))
    }
}

/// The quantities that have a limit.
#[derive(Clone, Copy)]
enum Limited {
    Bytes,
    Faces,
    Vertices,
}

fn check_limit(quantity: Limited, count: u64, limit: u64) -> Result<(), ReadError> {
    if count <= limit {
        return Ok(());
    }
    let name = match quantity {
        Limited::Bytes => "bytes",
        Limited::Faces => "faces",
        Limited::Vertices => "vertices",
    };
    let advice = match quantity {
        Limited::Bytes => "export the model in a binary format, or simplify it first",
        Limited::Faces | Limited::Vertices => "simplify the model before you send it",
    };
    Err(ReadError::for_file(
        ReadErrorKind::TooLarge,
        format!("the file has {count} {name}, over the limit of {limit}; {advice}"),
    ))
}
