//! A model and its sidecar files (materials, textures, buffers) in a ZIP archive.
//!
//! This module finds the model in an archive, resolves the files that the model refers to, and packs OBJ with materials and textures.

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::io::{Cursor, Write};
use std::sync::Arc;

use zip::ZipWriter;
use zip::result::ZipResult;

use super::archive::{self, Archive, deflate_options, name_key, resolve, store_options};
use super::errors::{ReadError, ReadErrorKind, WriteError, excerpt, excerpt_up_to};
use super::formats::Format;
use super::limits::{Limits, SNIFFED_BYTES};
use super::paint::{MAX_TEXTURE_BYTES, media_type};
use super::sniff::sniff;

/// The sidecar files of a model: all files in the archive that the model came in.
pub(super) struct Sidecars<'z> {
    /// The archive and the model's name in it; `None` for a model that came without an archive.
    origin: Option<(&'z Archive<'z>, &'z str)>,
    /// The first file with each base name, by [`name_key`].
    by_base_name: HashMap<String, &'z str>,
    /// Bytes that may still be unpacked, and how many of them for textures.
    bytes_left: Cell<u64>,
    texture_bytes_left: Cell<u64>,
    /// Files that could not be found or unpacked.
    missing: RefCell<FailedNames>,
    /// Textures that are neither PNG nor JPEG.
    unsupported_images: RefCell<FailedNames>,
}

/// File names that caused a warning: their number, and the first of them.
#[derive(Default)]
struct FailedNames {
    count: u64,
    first: String,
}

impl FailedNames {
    fn add(&mut self, name: &str) {
        if self.count == 0 {
            self.first = excerpt(name.as_bytes());
        }
        self.count += 1;
    }
}

impl<'z> Sidecars<'z> {
    /// No sidecar files, for a model that came without an archive.
    pub fn none() -> Self {
        Self {
            origin: None,
            by_base_name: HashMap::new(),
            bytes_left: Cell::new(0),
            texture_bytes_left: Cell::new(0),
            missing: RefCell::default(),
            unsupported_images: RefCell::default(),
        }
    }

    /// The sidecar files of the file `model` in an archive.
    pub fn in_archive(model: &'z str, archive: &'z Archive<'z>, limits: &Limits) -> Self {
        let mut by_base_name = HashMap::new();
        for name in archive.names() {
            by_base_name.entry(name_key(base_name(name))).or_insert(name);
        }
        Self {
            origin: Some((archive, model)),
            by_base_name,
            bytes_left: Cell::new(limits.max_bytes),
            texture_bytes_left: Cell::new(MAX_TEXTURE_BYTES),
            ..Self::none()
        }
    }

    /// Whether the model came in an archive.
    pub fn has_archive(&self) -> bool {
        self.origin.is_some()
    }

    /// Whether the file that the model refers to as `name` exists.
    pub fn has(&self, name: &str) -> bool {
        self.find(name).is_some()
    }

    /// Unpacks the file that the model refers to as `name`, up to `most` bytes. `None` if the file is missing or too large, which
    /// [`Sidecars::warnings`] reports.
    pub fn read_file(&self, name: &str, most: u64) -> Option<Vec<u8>> {
        let (archive, _) = self.origin?;
        let most = most.min(self.bytes_left.get());
        let bytes = self.find(name).and_then(|found| archive.read_file(found, most).ok().flatten());
        match &bytes {
            Some(bytes) => self.bytes_left.set(self.bytes_left.get().saturating_sub(bytes.len() as u64)),
            None => self.missing.borrow_mut().add(name),
        }
        bytes
    }

    /// As [`Sidecars::read_file`], for a texture; returns its media type too. `None` also if the file is neither PNG nor JPEG.
    pub fn read_texture(&self, name: &str) -> Option<(Arc<[u8]>, &'static str)> {
        let bytes = self.read_file(name, self.texture_bytes_left.get())?;
        let Some(media_type) = media_type(&bytes) else {
            self.unsupported_images.borrow_mut().add(name);
            return None;
        };
        self.texture_bytes_left.set(self.texture_bytes_left.get().saturating_sub(bytes.len() as u64));
        Some((bytes.into(), media_type))
    }

    /// Warnings about files that were missing, too large or of an unsupported type.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        let missing = self.missing.borrow();
        if missing.count > 0 {
            warnings.push(format!(
                "files that the model refers to are not in the archive, or are too large to unpack: {}, the first '{}'",
                missing.count, missing.first
            ));
        }
        let unsupported_images = self.unsupported_images.borrow();
        if unsupported_images.count > 0 {
            warnings.push(format!(
                "textures that are neither PNG nor JPEG were dropped: {}, the first '{}'",
                unsupported_images.count, unsupported_images.first
            ));
        }
        warnings
    }

    /// Finds a file by its path from the model's folder, else by its base name, because paths often come from another computer.
    fn find(&self, name: &str) -> Option<&'z str> {
        let (archive, model) = self.origin?;
        let by_path = resolve(model, name).and_then(|path| archive.stored_name(&path));
        by_path.or_else(|| self.by_base_name.get(&name_key(base_name(name))).copied())
    }
}

/// The part of a path after the last slash or backslash.
fn base_name(name: &str) -> &str {
    name.rsplit(['/', '\\']).next().unwrap_or(name)
}

/// File name extensions of models that can be read.
const MODEL_EXTENSIONS: [&str; 8] = ["stl", "obj", "ply", "off", "mesh", "glb", "gltf", "3mf"];

/// Extensions of files that often accompany a model, and that format detection could mistake for one.
const OTHER_EXTENSIONS: [&str; 51] = [
    "txt", "md", "rtf", "doc", "docx", "odt", "xls", "xlsx", "pptx", "pdf", "htm", "html", "url", "webloc", "xml",
    "json", "csv", "log", "ini", "db", "nfo", "mtl", "bin", "png", "jpg", "jpeg", "gif", "bmp", "tif", "tiff", "tga",
    "webp", "svg", "psd", "exr", "hdr", "dds", "ktx", "ktx2", "mp4", "mov", "zip", "7z", "rar", "gz", "tar", "xz",
    "bz2", "gcode", "exe", "js",
];

/// Maximum number of file names in a message.
const MAX_SHOWN_NAMES: usize = 4;

/// Finds the only model in an archive and its format, which is detected by content. Files with a model's extension are tried first; other
/// files are tried only if none of those is a model.
///
/// # Errors
/// A [`ReadError`] of kind `UnsupportedFormat` if the archive holds no model or several.
pub(super) fn find_model<'z>(archive: &'z Archive<'_>) -> Result<(&'z str, Format), ReadError> {
    let visible = || archive.names().filter(|name| !is_hidden(name));
    let mut refused = None;
    let named = visible().filter(|name| has_extension(name, &MODEL_EXTENSIONS));
    let mut found = detect_models(archive, named, |name, error| {
        refused.get_or_insert_with(|| {
            let detail = format!("in the archive's file {}: {}", archive::name_excerpt(name), error.detail);
            ReadError { detail, ..error }
        });
    });
    if found.is_empty() && refused.is_none() {
        let others = visible().filter(|name| !has_extension(name, &OTHER_EXTENSIONS));
        found = detect_models(archive, others, |_, _| {});
        // The first bytes of an office document look like those of 3MF.
        found.retain(|(_, format)| !matches!(format, Format::ThreeMf | Format::Zip));
    }
    match (found[..].first(), found.len()) {
        (Some(only), 1) => Ok(*only),
        (Some(_), _) => {
            let names = shown_names(found.iter().map(|(name, _)| *name), found.len());
            let detail =
                format!("the ZIP archive holds {} models ({names}); send each in a request or archive of its own", found.len());
            Err(ReadError::for_file(ReadErrorKind::UnsupportedFormat, detail))
        }
        (None, _) => Err(refused.unwrap_or_else(|| {
            let names = shown_names(archive.names(), archive.names().count());
            let detail = format!(
                "the ZIP archive holds no supported model ({names}); add one STL, OBJ, PLY, OFF, 3MF, GLB or glTF file and the files it uses"
            );
            ReadError::for_file(ReadErrorKind::UnsupportedFormat, detail)
        })),
    }
}

/// The models among the files, with their formats. `refuse` receives the errors of the others.
fn detect_models<'z>(
    archive: &Archive<'_>,
    names: impl Iterator<Item = &'z str>,
    mut refuse: impl FnMut(&str, ReadError),
) -> Vec<(&'z str, Format)> {
    let mut found = Vec::new();
    for name in names {
        match detect_format(archive, name) {
            Ok(format) => found.push((name, format)),
            Err(error) => refuse(name, error),
        }
    }
    found
}

/// Detects a file's format. Nested archives are rejected unless their name ends in `.3mf`.
fn detect_format(archive: &Archive<'_>, name: &str) -> Result<Format, ReadError> {
    let head = archive.read_prefix(name, SNIFFED_BYTES as u64)?.unwrap_or_default();
    match sniff(&head, archive.size(name))? {
        // The first bytes of a 3MF package can look like those of any ZIP archive, so the name decides.
        Format::Zip if !has_extension(name, &["3mf"]) => {
            let detail =
                "the ZIP archive holds another ZIP archive, which is not opened; send the inner archive by itself";
            Err(ReadError::for_file(ReadErrorKind::UnsupportedFormat, detail))
        }
        Format::Zip => Ok(Format::ThreeMf),
        format => Ok(format),
    }
}

/// Whether a file is metadata of an operating system, such as `__MACOSX/._a.obj` or `.DS_Store`.
fn is_hidden(name: &str) -> bool {
    name.split('/').any(|segment| segment.starts_with('.') || segment == "__MACOSX")
}

fn has_extension(name: &str, extensions: &[&str]) -> bool {
    let file = name.rsplit('/').next().unwrap_or(name);
    file.rsplit_once('.')
        .is_some_and(|(_, extension)| extensions.iter().any(|known| extension.eq_ignore_ascii_case(known)))
}

/// Up to [`MAX_SHOWN_NAMES`] file names as a list for a message.
fn shown_names<'n>(names: impl Iterator<Item = &'n str>, count: usize) -> String {
    let some: Vec<String> = names.take(MAX_SHOWN_NAMES).map(|name| excerpt_up_to(60, name.as_bytes())).collect();
    let more = if count > MAX_SHOWN_NAMES { format!(" and {} more", count - MAX_SHOWN_NAMES) } else { String::new() };
    if some.is_empty() { "the archive is empty".to_owned() } else { some.join(", ") + &more }
}

/// The files of an OBJ zip.
pub(super) struct ObjZipFiles {
    /// The OBJ file.
    pub obj: Vec<u8>,
    /// The MTL file; `None` if the model has no materials.
    pub mtl: Option<Vec<u8>>,
    /// The textures that materials refer to, each with its file name.
    pub textures: Vec<(String, Arc<[u8]>)>,
}

/// File name of the OBJ file in an OBJ zip that meshmend writes.
const OBJ_NAME: &str = "model.obj";
/// File name of the MTL file in an OBJ zip that meshmend writes.
pub(super) const MTL_NAME: &str = "model.mtl";

/// Packs an OBJ zip. The same files always give the same bytes.
///
/// # Errors
/// [`WriteError::TooLarge`] if a file is larger than ZIP allows.
pub(super) fn pack(files: &ObjZipFiles) -> Result<Vec<u8>, WriteError> {
    // Writing to memory fails only if a size is too large.
    packed(files).map_err(|_| WriteError::TooLarge)
}

fn packed(files: &ObjZipFiles) -> ZipResult<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let texts = [(OBJ_NAME, Some(&files.obj)), (MTL_NAME, files.mtl.as_ref())];
    for (name, text) in texts {
        if let Some(text) = text {
            zip.start_file(name, deflate_options(text.len() as u64 > u64::from(u32::MAX) / 2))?;
            zip.write_all(text)?;
        }
    }
    for (name, bytes) in &files.textures {
        zip.start_file(name.as_str(), store_options())?;
        zip.write_all(bytes)?;
    }
    Ok(zip.finish()?.into_inner())
}
