//! The archive of parts: a ZIP file, with limits that hold before anything is unpacked.

use std::collections::HashMap;
use std::io::{Cursor, Read};

use memchr::memmem;
use zip::result::{ZipError, ZipResult};
use zip::{CompressionMethod, ZipArchive};

use super::part_name;
use super::shown_name;
use super::stream::Stream;
use super::xml::Xml;
use crate::format::Limits;
use crate::format::errors::{ReadError, ReadErrorKind, shown_up_to};

/// Most entries of an archive. Models in many parts have hundreds.
const ENTRIES: usize = 10_000;
/// How many bytes may be unpacked for each of the archive's: models in XML have up to 20, the densest that deflate can do is 1032.
const RATIO: u64 = 100;
/// What may be unpacked from however small an archive.
const LEAST: u64 = 64 << 20;
/// How often the limit of a file's bytes what is unpacked from it may have.
const TIMES: u64 = 8;
/// What each entry of a directory begins with.
const ENTRY: &[u8] = b"PK\x01\x02";

/// The parts of a file.
pub(super) struct Archive<'a> {
    zip: ZipArchive<Cursor<&'a [u8]>>,
    /// The entry of each part, by [`part_name::key`].
    parts: HashMap<String, usize>,
}

impl<'a> Archive<'a> {
    /// Reads the archive's directory.
    pub fn open(bytes: &'a [u8], limits: &Limits) -> Result<Self, ReadError> {
        // Whichever directory is found, it can't have more entries.
        if memmem::find_iter(bytes, ENTRY).take(ENTRIES + 1).count() > ENTRIES {
            let detail = format!("the archive has more than {ENTRIES} entries; export the model again");
            return Err(ReadError::whole(ReadErrorKind::TooLarge, detail));
        }
        let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(|error| no_directory(bytes, &error))?;
        check_sizes(&zip, bytes.len() as u64, limits).map_err(|error| no_directory(bytes, &error))??;
        // Bytes that several entries unpack make a small archive large.
        if zip.has_overlapping_entries().map_err(|error| no_directory(bytes, &error))? {
            return Err(malformed("entries of the archive overlap; it was tampered with, so export the model again"));
        }
        let parts = parts(&zip)?;
        Ok(Self { zip, parts })
    }

    /// Whether there is a part of this name.
    pub fn has(&self, part: &str) -> bool {
        self.parts.contains_key(&part_name::key(part))
    }

    /// The names of entries, for a message.
    pub fn some_names(&self) -> String {
        let names: Vec<String> = self.zip.file_names_raw().take(3).map(|name| shown_up_to(60, name)).collect();
        names.join(", ")
    }

    /// A part's XML; none if there is no such part.
    pub fn xml(&mut self, part: &str) -> Result<Option<Xml<'_>>, ReadError> {
        let Some((reader, size)) = self.unpack(part)? else { return Ok(None) };
        Xml::new(part, Stream::new(reader, size)).map(Some)
    }

    /// All bytes of a part, if there is one and they are no more than `most`.
    pub fn bytes(&mut self, part: &str, most: u64) -> Result<Option<Vec<u8>>, ReadError> {
        let Some((reader, size)) = self.unpack(part)? else { return Ok(None) };
        if size > most {
            let detail = format!(
                "the part {} has {size} bytes, and pictures may have {most} in all; make them smaller",
                shown_name(part)
            );
            return Err(ReadError::whole(ReadErrorKind::TooLarge, detail));
        }
        let mut bytes = Vec::new();
        reader.take(size + 1).read_to_end(&mut bytes).map_err(|error| cant_be_unpacked(part, &error))?;
        if bytes.len() as u64 != size {
            return Err(malformed(format!(
                "the part {} is not as long as the archive says; send the file again",
                shown_name(part)
            )));
        }
        Ok(Some(bytes))
    }

    /// A reader of a part, and how long the directory says that it is.
    fn unpack(&mut self, part: &str) -> Result<Option<(Box<dyn Read + '_>, u64)>, ReadError> {
        let Some(&index) = self.parts.get(&part_name::key(part)) else { return Ok(None) };
        let entry = self.zip.by_index_data(index).map_err(|error| cant_be_unpacked(part, &error))?;
        if entry.encrypted() {
            let detail =
                format!("the archive's entry {} is encrypted; export the model without a password", shown_name(part));
            return Err(ReadError::whole(ReadErrorKind::UnsupportedFormat, detail));
        }
        if !matches!(entry.compression(), CompressionMethod::Stored | CompressionMethod::Deflated) {
            let detail = format!(
                "the archive's entry {} is packed by {}, where 3MF asks for deflate; export the model again",
                shown_name(part),
                entry.compression()
            );
            return Err(ReadError::whole(ReadErrorKind::UnsupportedFormat, detail));
        }
        let size = entry.size();
        let reader = self.zip.by_index(index).map_err(|error| cant_be_unpacked(part, &error))?;
        Ok(Some((Box::new(reader), size)))
    }
}

/// Refuses what would unpack to more than is allowed.
fn check_sizes(zip: &ZipArchive<Cursor<&[u8]>>, packed: u64, limits: &Limits) -> ZipResult<Result<(), ReadError>> {
    let most = packed.saturating_mul(RATIO).max(LEAST).min(limits.max_bytes.saturating_mul(TIMES));
    let mut unpacked = 0_u64;
    for index in 0..zip.len() {
        unpacked = unpacked.saturating_add(zip.by_index_data(index)?.size());
    }
    if unpacked <= most {
        return Ok(Ok(()));
    }
    let detail = format!(
        "the archive of {packed} bytes says that it unpacks to {unpacked}, which is over the limit of {most}; simplify the model before you send it"
    );
    Ok(Err(ReadError::whole(ReadErrorKind::TooLarge, detail)))
}

/// The parts' entries by [`part_name::key`].
fn parts(zip: &ZipArchive<Cursor<&[u8]>>) -> Result<HashMap<String, usize>, ReadError> {
    let mut parts = HashMap::new();
    let twice = || malformed("the archive has two entries of the same name; export the model again");
    for (index, (raw, name)) in zip.file_names_raw().zip(zip.file_names()).enumerate() {
        let raw = shown_up_to(100, raw);
        let name = name.map_err(|_| {
            malformed(format!("the archive's entry '{raw}' has no readable name; export the model again"))
        })?;
        if name.ends_with(['/', '\\']) {
            continue;
        }
        let part = part_name::of_entry(&name);
        let part = part.ok_or_else(|| {
            malformed(format!("the archive's entry '{raw}' has a name that leads out of it; export the model again"))
        })?;
        if parts.insert(part_name::key(&part), index).is_some() {
            return Err(twice());
        }
    }
    match zip.has_duplicate_names() {
        true => Err(twice()),
        false => Ok(parts),
    }
}

fn cant_be_unpacked(part: &str, error: &dyn std::fmt::Display) -> ReadError {
    malformed(format!("the part {} can't be unpacked ({error}); send the file again", shown_name(part)))
}

fn malformed(detail: impl Into<String>) -> ReadError {
    ReadError::whole(ReadErrorKind::Malformed, detail)
}

/// Whether the head of a file names what only 3MF files have.
fn looks_like_3mf(head: &[u8]) -> bool {
    let head = &head[..head.len().min(4096)];
    let names = [&b"3D/"[..], b"3D\\", b"[Content_Types].xml", b".model"];
    names.iter().any(|name| head.windows(name.len()).any(|window| window == *name))
}

#[cold]
fn no_directory(bytes: &[u8], error: &ZipError) -> ReadError {
    if looks_like_3mf(bytes) {
        let detail =
            format!("the 3MF file has no readable directory ({error}); it was probably cut off, so send it again");
        ReadError::whole(ReadErrorKind::Truncated, detail)
    } else {
        let detail = format!(
            "this is a ZIP archive without a readable directory ({error}); if it is whole, unpack it, take the STL, OBJ, PLY or OFF file inside, and send that"
        );
        ReadError::whole(ReadErrorKind::UnsupportedFormat, detail)
    }
}
