//! Which file of an archive is the model.

use super::super::archive::{self, Archive};
use super::super::errors::{ReadError, ReadErrorKind};
use super::super::sniff::HEAD;
use super::super::{Format, sniff};

/// Endings of models that are read.
const MODELS: [&str; 8] = ["stl", "obj", "ply", "off", "mesh", "glb", "gltf", "3mf"];

/// Endings of what is often sent along, some of which a careless eye could take for a model.
const NO_MODELS: [&str; 51] = [
    "txt", "md", "rtf", "doc", "docx", "odt", "xls", "xlsx", "pptx", "pdf", "htm", "html", "url", "webloc", "xml",
    "json", "csv", "log", "ini", "db", "nfo", "mtl", "bin", "png", "jpg", "jpeg", "gif", "bmp", "tif", "tiff", "tga",
    "webp", "svg", "psd", "exr", "hdr", "dds", "ktx", "ktx2", "mp4", "mov", "zip", "7z", "rar", "gz", "tar", "xz",
    "bz2", "gcode", "exe", "js",
];

/// How many names are shown.
const SHOWN: usize = 4;

/// The only model of an archive, and its format, told by its content. The ending of a name only says which files are looked at first: where
/// one that is named as a model is one, others are not looked at.
pub(super) fn model<'z>(archive: &'z Archive<'_>) -> Result<(&'z str, Format), ReadError> {
    let visible = || archive.names().filter(|name| !is_hidden(name));
    let mut refused = None;
    let named = visible().filter(|name| has_ending(name, &MODELS));
    let mut found = models(archive, named, |name, error| {
        refused.get_or_insert_with(|| {
            let detail = format!("in the archive's file {}: {}", archive::shown(name), error.detail);
            ReadError { detail, ..error }
        });
    });
    if found.is_empty() && refused.is_none() {
        let others = visible().filter(|name| !has_ending(name, &NO_MODELS));
        found = models(archive, others, |_, _| {});
        // A package of office programs looks like 3MF from its head.
        found.retain(|(_, format)| !matches!(format, Format::ThreeMf | Format::Zip));
    }
    match (found[..].first(), found.len()) {
        (Some(only), 1) => Ok(*only),
        (Some(_), _) => {
            let names = shown(found.iter().map(|(name, _)| *name), found.len());
            let detail =
                format!("the ZIP archive holds {} models ({names}); send each for itself, or in an archive of its own", found.len());
            Err(ReadError::whole(ReadErrorKind::UnsupportedFormat, detail))
        }
        (None, _) => Err(refused.unwrap_or_else(|| {
            let names = shown(archive.names(), archive.names().count());
            let detail = format!(
                "the ZIP archive holds no model that is read here ({names}); put one STL, OBJ, PLY, OFF, 3MF, GLB or glTF file into it, with the files that it needs"
            );
            ReadError::whole(ReadErrorKind::UnsupportedFormat, detail)
        })),
    }
}

/// Those of the files that are models.
fn models<'z>(
    archive: &Archive<'_>,
    names: impl Iterator<Item = &'z str>,
    mut refuse: impl FnMut(&str, ReadError),
) -> Vec<(&'z str, Format)> {
    let mut found = Vec::new();
    for name in names {
        match format(archive, name) {
            Ok(format) => found.push((name, format)),
            Err(error) => refuse(name, error),
        }
    }
    found
}

fn format(archive: &Archive<'_>, name: &str) -> Result<Format, ReadError> {
    let head = archive.first(name, HEAD as u64)?.unwrap_or_default();
    match sniff(&head, archive.size(name))? {
        // Only by its end is it told from 3MF, and by its name.
        Format::Zip if !has_ending(name, &["3mf"]) => {
            let detail = "it is a ZIP archive within the ZIP archive, and is not opened; send it for itself";
            Err(ReadError::whole(ReadErrorKind::UnsupportedFormat, detail))
        }
        Format::Zip => Ok(Format::ThreeMf),
        format => Ok(format),
    }
}

/// What programs leave for themselves, such as `__MACOSX/._a.obj` and `.DS_Store`.
fn is_hidden(name: &str) -> bool {
    name.split('/').any(|segment| segment.starts_with('.') || segment == "__MACOSX")
}

fn has_ending(name: &str, endings: &[&str]) -> bool {
    let file = name.rsplit('/').next().unwrap_or(name);
    file.rsplit_once('.').is_some_and(|(_, ending)| endings.iter().any(|it| ending.eq_ignore_ascii_case(it)))
}

fn shown<'n>(names: impl Iterator<Item = &'n str>, count: usize) -> String {
    let some: Vec<String> =
        names.take(SHOWN).map(|name| super::super::errors::shown_up_to(60, name.as_bytes())).collect();
    let more = if count > SHOWN { format!(" and {} more", count - SHOWN) } else { String::new() };
    if some.is_empty() { "it is empty".to_owned() } else { some.join(", ") + &more }
}
