//! What a reader may spend on a file, and how it reads.

use serde::{Deserialize, Serialize};

use super::errors::{ReadError, ReadErrorKind};

/// How much of a file is looked at to tell its format. Longer heads are cut to this, so that a reader and a sniffer agree.
pub(super) const HEAD: usize = 4096;

/// What a reader may spend on one file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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

/// How a file is read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadOptions {
    /// What may be spent.
    pub limits: Limits,
    /// Polygons twisted by more than this many degrees are cut with the least fold, others as flat ones, which is how programs
    /// show them that draw a quad as two triangles from its first corner: 45 by default.
    pub twist_angle_deg: f64,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { limits: Limits::default(), twist_angle_deg: 45.0 }
    }
}

impl ReadOptions {
    /// The defaults within limits.
    #[must_use]
    pub fn within(limits: Limits) -> Self {
        Self { limits, ..Self::default() }
    }
}

impl Limits {
    /// None at all, for what we wrote ourselves.
    pub const NONE: Self = Self { max_bytes: u64::MAX, max_faces: u64::MAX, max_vertices: u64::MAX };

    pub(super) fn check_bytes(&self, found: u64) -> Result<(), ReadError> {
        check("bytes", found, self.max_bytes)
    }

    pub(super) fn check_faces(&self, found: u64) -> Result<(), ReadError> {
        check("faces", found, self.max_faces)
    }

    /// Vertices are also held to what a 32-bit index can name, whatever the limit says.
    pub(super) fn check_vertices(&self, found: u64) -> Result<(), ReadError> {
        check("vertices", found, self.max_vertices.min(u64::from(u32::MAX)))
    }
}

fn check(what: &str, found: u64, most: u64) -> Result<(), ReadError> {
    if found <= most {
        return Ok(());
    }
    let advice = if what == "bytes" {
        "export the model in a binary format, or simplify it first"
    } else {
        "simplify the model before you send it"
    };
    Err(ReadError::whole(
        ReadErrorKind::TooLarge,
        format!("the file has {found} {what}, which is over the limit of {most}; {advice}"),
    ))
}
