//! A model with its side files in a ZIP archive: OBJ with its materials and pictures is read and written, any other format read.

mod choose;
mod write;

pub(super) use write::{pack, write};

use super::archive::{self, Archive};
use super::beside::Beside;
use super::content::Content;
use super::errors::ReadError;
use super::{Format, ReadOptions, threemf};

/// Reads an archive: 3MF, which is one too, or one that holds a model.
pub(super) fn read(bytes: &[u8], options: &ReadOptions, painted: bool) -> Result<Content, ReadError> {
    let mut archive = Archive::open(bytes, &options.limits)?;
    if let Some(scene) = threemf::read(&mut archive, options)? {
        return Ok(Content::Scene(scene));
    }
    let (name, format) = choose::model(&archive)?;
    let model = archive.bytes(name, options.limits.max_bytes)?.unwrap_or_default();
    let beside = Beside::of(name, &archive, &options.limits);
    let within = |error: ReadError| {
        let detail = format!("in the archive's file {}: {}", archive::shown(name), error.detail);
        ReadError { detail, ..error }
    };
    let mut content = Content::of_file(format, &model, options, painted, &beside).map_err(within)?;
    let (format, dialect, warnings) = content.account();
    if *format == Format::Obj {
        *format = Format::Zip;
    }
    dialect.push_str(" in a ZIP archive");
    warnings.extend(beside.warnings());
    Ok(content)
}
