//! How files are packed: the same bytes on every machine and at every time.

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System};

/// Deflate's usual level: 9 takes three times as long for 2 % less.
const LEVEL: i64 = 6;

/// For what packs well; `is_long` where it may have more than 4 GiB, which a ZIP entry counts otherwise.
pub(in crate::format) fn compressed(is_long: bool) -> SimpleFileOptions {
    options().compression_method(CompressionMethod::Deflated).compression_level(Some(LEVEL)).large_file(is_long)
}

/// For what is packed already, such as pictures.
pub(in crate::format) fn stored() -> SimpleFileOptions {
    options().compression_method(CompressionMethod::Stored)
}

fn options() -> SimpleFileOptions {
    SimpleFileOptions::default().last_modified_time(DateTime::default()).system(System::Unix).unix_permissions(0o644)
}
