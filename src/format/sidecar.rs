//! A model and its side files in a ZIP archive: which file is the model, what it names beside it, and how OBJ is packed with its materials
//! and pictures.

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::io::{Cursor, Write};
use std::sync::Arc;

use zip::ZipWriter;
use zip::result::ZipResult;

use super::archive::{self, Archive, compressed, key, resolve, stored};
use super::errors::{ReadError, ReadErrorKind, WriteError, shown, shown_up_to};
use super::formats::Format;
use super::limits::{HEAD, Limits};
use super::paint::{MOST_PICTURE_BYTES, media_type};
use super::sniff::sniff;

/// What is beside a model.
pub(super) struct Sidecars<'z> {
    /// The archive and the model's name in it; none for a model that came alone.
    within: Option<(&'z Archive<'z>, &'z str)>,
    /// The first file of each bare name, by [`key`].
    bare: HashMap<String, &'z str>,
    /// How many bytes may still be unpacked, and how many of pictures.
    left: Cell<u64>,
    left_for_pictures: Cell<u64>,
    missing: RefCell<Names>,
    strange: RefCell<Names>,
}

/// Names that could not be followed: how many, and the first.
#[derive(Default)]
struct Names {
    count: u64,
    first: String,
}

impl Names {
    fn add(&mut self, name: &str) {
        if self.count == 0 {
            self.first = shown(name.as_bytes());
        }
        self.count += 1;
    }
}

impl<'z> Sidecars<'z> {
    /// Nothing, for a model that came alone.
    pub fn nothing() -> Self {
        Self {
            within: None,
            bare: HashMap::new(),
            left: Cell::new(0),
            left_for_pictures: Cell::new(0),
            missing: RefCell::default(),
            strange: RefCell::default(),
        }
    }

    /// What is in the archive of a model.
    pub fn of(model: &'z str, archive: &'z Archive<'z>, limits: &Limits) -> Self {
        let mut bare = HashMap::new();
        for name in archive.names() {
            bare.entry(key(bare_name(name))).or_insert(name);
        }
        Self {
            within: Some((archive, model)),
            bare,
            left: Cell::new(limits.max_bytes),
            left_for_pictures: Cell::new(MOST_PICTURE_BYTES),
            ..Self::nothing()
        }
    }

    /// Whether there may be any.
    pub fn is_something(&self) -> bool {
        self.within.is_some()
    }

    /// Whether there is a file that the model means by this name.
    pub fn has(&self, name: &str) -> bool {
        self.find(name).is_some()
    }

    /// The bytes, no more than `most`, of the file that the model means by a name; none if they can't be had, which [`Sidecars::warnings`]
    /// tells.
    pub fn file(&self, name: &str, most: u64) -> Option<Vec<u8>> {
        let (archive, _) = self.within?;
        let most = most.min(self.left.get());
        let bytes = self.find(name).and_then(|found| archive.bytes(found, most).ok().flatten());
        match &bytes {
            Some(bytes) => self.left.set(self.left.get().saturating_sub(bytes.len() as u64)),
            None => self.missing.borrow_mut().add(name),
        }
        bytes
    }

    /// As [`Sidecars::file`], for a picture, with its media type; none too if it is not of a kind that is kept.
    pub fn picture(&self, name: &str) -> Option<(Arc<[u8]>, &'static str)> {
        let bytes = self.file(name, self.left_for_pictures.get())?;
        let Some(media_type) = media_type(&bytes) else {
            self.strange.borrow_mut().add(name);
            return None;
        };
        self.left_for_pictures.set(self.left_for_pictures.get().saturating_sub(bytes.len() as u64));
        Some((bytes.into(), media_type))
    }

    /// What could not be had.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        let missing = self.missing.borrow();
        if missing.count > 0 {
            warnings.push(format!(
                "files that the model names are not in the archive, or can't be unpacked within the limits: {}, the first '{}'",
                missing.count, missing.first
            ));
        }
        let strange = self.strange.borrow();
        if strange.count > 0 {
            warnings.push(format!(
                "pictures that are neither PNG nor JPEG were left out: {}, the first '{}'",
                strange.count, strange.first
            ));
        }
        warnings
    }

    /// By its path from the model's folder, else by its bare name, as paths are often those of another machine.
    fn find(&self, name: &str) -> Option<&'z str> {
        let (archive, model) = self.within?;
        let there = resolve(model, name).and_then(|path| archive.name(&path));
        there.or_else(|| self.bare.get(&key(bare_name(name))).copied())
    }
}

fn bare_name(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

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
const SHOWN_NAMES: usize = 4;

/// The only model of an archive, and its format, told by its content. The ending of a name only says which files are looked at first: where
/// one that is named as a model is one, others are not looked at.
pub(super) fn model_of<'z>(archive: &'z Archive<'_>) -> Result<(&'z str, Format), ReadError> {
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
            let names = shown_names(found.iter().map(|(name, _)| *name), found.len());
            let detail =
                format!("the ZIP archive holds {} models ({names}); send each for itself, or in an archive of its own", found.len());
            Err(ReadError::whole(ReadErrorKind::UnsupportedFormat, detail))
        }
        (None, _) => Err(refused.unwrap_or_else(|| {
            let names = shown_names(archive.names(), archive.names().count());
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

fn shown_names<'n>(names: impl Iterator<Item = &'n str>, count: usize) -> String {
    let some: Vec<String> = names.take(SHOWN_NAMES).map(|name| shown_up_to(60, name.as_bytes())).collect();
    let more = if count > SHOWN_NAMES { format!(" and {} more", count - SHOWN_NAMES) } else { String::new() };
    if some.is_empty() { "it is empty".to_owned() } else { some.join(", ") + &more }
}

/// What a model is written as.
pub(super) struct Files {
    pub obj: Vec<u8>,
    /// Its materials, where it has some.
    pub mtl: Option<Vec<u8>>,
    /// The pictures that materials name.
    pub pictures: Vec<(String, Arc<[u8]>)>,
}

/// The name of the model that is written, and that of its materials.
const MODEL: &str = "model.obj";
pub(super) const MATERIALS: &str = "model.mtl";

/// Packs a model with its side files. The same files give the same bytes.
pub(super) fn pack(files: &Files) -> Result<Vec<u8>, WriteError> {
    // To memory nothing can fail but a size.
    packed(files).map_err(|_| WriteError::TooLarge)
}

fn packed(files: &Files) -> ZipResult<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let texts = [(MODEL, Some(&files.obj)), (MATERIALS, files.mtl.as_ref())];
    for (name, text) in texts {
        if let Some(text) = text {
            zip.start_file(name, compressed(text.len() as u64 > u64::from(u32::MAX) / 2))?;
            zip.write_all(text)?;
        }
    }
    for (name, bytes) in &files.pictures {
        zip.start_file(name.as_str(), stored())?;
        zip.write_all(bytes)?;
    }
    Ok(zip.finish()?.into_inner())
}
