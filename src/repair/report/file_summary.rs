//! The format and the size of a file.

use serde::{Deserialize, Serialize};

use crate::format::Format;

/// The format and size of the input file or of the returned file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct FileSummary {
    /// The file format.
    pub format: Format,
    /// The dialect of the format, such as `binary STL`.
    pub dialect: String,
    /// The size in bytes.
    pub bytes: u64,
}

impl FileSummary {
    /// The summary of written bytes.
    pub(crate) fn of(format: Format, dialect: &str, bytes: &[u8]) -> Self {
        Self { format, dialect: dialect.to_owned(), bytes: bytes.len() as u64 }
    }
}
