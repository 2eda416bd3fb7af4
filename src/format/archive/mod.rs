//! Files in a ZIP archive ("APPNOTE.TXT - .ZIP File Format Specification"), with limits that hold before anything is unpacked.

mod names;
mod pack;

use std::collections::HashMap;
use std::io::{Cursor, Read};

use memchr::memmem;
use zip::result::{ZipError, ZipResult};
use zip::{CompressionMethod, ZipArchive};

pub(super) use names::{key, percent_decoded, resolve};
pub(super) use pack::{compressed, stored};

use super::Limits;
use super::errors::{ReadError, ReadErrorKind, shown_up_to};

/// What each file in an archive begins with.
pub(super) const LOCAL: &[u8] = b"PK\x03\x04";
/// What each entry of a directory begins with.
const ENTRY: &[u8] = b"PK\x01\x02";

/// Most entries of an archive. Models in many parts have hundreds.
const ENTRIES: usize = 10_000;
/// How many bytes may be unpacked for each of the archive's: models in text have up to 20, the densest that deflate can do is 1032.
const RATIO: u64 = 100;
/// What may be unpacked from however small an archive.
const LEAST: u64 = 64 << 20;
/// How often the limit of a file's bytes what is unpacked from it may have.
const TIMES: u64 = 8;

/// The files of an archive.
pub(super) struct Archive<'a> {
    zip: ZipArchive<Cursor<&'a [u8]>>,
    /// The names of files in the archive's order, and the entry of each.
    files: Vec<(String, usize)>,
    /// Places in `files` by [`key`].
    places: HashMap<String, usize>,
}

/// A file that is unpacked as it is read.
pub(super) struct Packed<'z> {
    pub reader: Box<dyn Read + 'z>,
    /// How long the directory says that it is.
    pub size: u64,
}

impl<'a> Archive<'a> {
    /// Reads the archive's directory.
    pub fn open(bytes: &'a [u8], limits: &Limits) -> Result<Self, ReadError> {
        // Whichever directory is found, it can't have more entries.
        if memmem::find_iter(bytes, ENTRY).take(ENTRIES + 1).count() > ENTRIES {
            let detail = format!("the archive has more than {ENTRIES} entries; send the model and its own files only");
            return Err(ReadError::whole(ReadErrorKind::TooLarge, detail));
        }
        let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(|error| no_directory(bytes, &error))?;
        check_sizes(&zip, bytes.len() as u64, limits).map_err(|error| no_directory(bytes, &error))??;
        // Bytes that several entries unpack make a small archive large.
        if zip.has_overlapping_entries().map_err(|error| no_directory(bytes, &error))? {
            return Err(malformed("entries of the archive overlap; it was tampered with, so make it again"));
        }
        let files = files(&zip)?;
        let places: HashMap<String, usize> =
            files.iter().enumerate().map(|(place, (name, _))| (key(name), place)).collect();
        if places.len() < files.len() || zip.has_duplicate_names() {
            return Err(malformed("the archive has two entries of the same name; make it again"));
        }
        Ok(Self { zip, files, places })
    }

    /// The names of files, in the archive's order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.files.iter().map(|(name, _)| name.as_str())
    }

    /// Whether there is a file of this name.
    pub fn has(&self, name: &str) -> bool {
        self.places.contains_key(&key(name))
    }

    /// The name of a file as it is written in the archive, whatever the case in which it is asked for.
    pub fn name(&self, name: &str) -> Option<&str> {
        self.places.get(&key(name)).map(|&place| self.files[place].0.as_str())
    }

    /// How long a file is, as the directory says.
    pub fn size(&self, name: &str) -> Option<u64> {
        self.zip.by_index_data(self.index(name)?).ok().map(|entry| entry.size())
    }

    /// All bytes of a file of no more than `most`; none if there is no such file.
    pub fn bytes(&self, name: &str, most: u64) -> Result<Option<Vec<u8>>, ReadError> {
        let Some(size) = self.size(name) else { return Ok(None) };
        if size > most {
            let detail = format!("the archive's file {} has {size} bytes, over the limit of {most}", shown(name));
            return Err(ReadError::whole(ReadErrorKind::TooLarge, format!("{detail}; send a smaller one")));
        }
        let Some(bytes) = self.first(name, size + 1)? else { return Ok(None) };
        if bytes.len() as u64 != size {
            let detail = format!("the archive's file {} is not as long as its directory says", shown(name));
            return Err(malformed(format!("{detail}; send the archive again")));
        }
        Ok(Some(bytes))
    }

    /// The first bytes of a file, at most so many; none if there is no such file.
    pub fn first(&self, name: &str, most: u64) -> Result<Option<Vec<u8>>, ReadError> {
        // Only its place in the archive is copied.
        let mut zip = self.zip.clone();
        let Some(Packed { reader, .. }) = unpack(&mut zip, self.index(name), name)? else { return Ok(None) };
        let mut bytes = Vec::new();
        reader.take(most).read_to_end(&mut bytes).map_err(|error| cant_be_unpacked(name, &error))?;
        Ok(Some(bytes))
    }

    /// A file to be read; none if there is no such file.
    pub fn unpack(&mut self, name: &str) -> Result<Option<Packed<'_>>, ReadError> {
        let index = self.index(name);
        unpack(&mut self.zip, index, name)
    }

    fn index(&self, name: &str) -> Option<usize> {
        self.places.get(&key(name)).map(|&place| self.files[place].1)
    }
}

/// A name as it can be shown in a message.
pub(super) fn shown(name: &str) -> String {
    shown_up_to(100, name.as_bytes())
}

/// The names of files as they stand in the head of an archive, as far as they can be made out there.
pub(super) fn names_in_head(head: &[u8]) -> impl Iterator<Item = &[u8]> {
    /// Where a local header has the length of the name, and where the name begins.
    const LENGTH: usize = 26;
    const NAME: usize = 30;
    memmem::find_iter(head, LOCAL).filter_map(|at| {
        let length = head.get(at + LENGTH..)?.first_chunk()?;
        head.get(at + NAME..at + NAME + usize::from(u16::from_le_bytes(*length)))
    })
}

fn unpack<'z>(
    zip: &'z mut ZipArchive<Cursor<&[u8]>>,
    index: Option<usize>,
    name: &str,
) -> Result<Option<Packed<'z>>, ReadError> {
    let Some(index) = index else { return Ok(None) };
    let entry = zip.by_index_data(index).map_err(|error| cant_be_unpacked(name, &error))?;
    let unsupported = |detail: String| Err(ReadError::whole(ReadErrorKind::UnsupportedFormat, detail));
    if entry.encrypted() {
        return unsupported(format!("the archive's file {} is encrypted; send it without a password", shown(name)));
    }
    let method = entry.compression();
    if !matches!(method, CompressionMethod::Stored | CompressionMethod::Deflated) {
        let detail = format!("the archive's file {} is packed by {method}, which is not read", shown(name));
        return unsupported(format!("{detail}; pack it with deflate, as usual"));
    }
    let size = entry.size();
    let reader = zip.by_index(index).map_err(|error| cant_be_unpacked(name, &error))?;
    Ok(Some(Packed { reader: Box::new(reader), size }))
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

/// The names of all files with their entries, in order; folders are none.
fn files(zip: &ZipArchive<Cursor<&[u8]>>) -> Result<Vec<(String, usize)>, ReadError> {
    let mut files = Vec::with_capacity(zip.len());
    for (index, (raw, name)) in zip.file_names_raw().zip(zip.file_names()).enumerate() {
        let refuse = |what: &str| {
            malformed(format!("the archive's entry '{}' has {what}; make it again", shown_up_to(100, raw)))
        };
        let name = name.map_err(|_| refuse("no readable name"))?;
        if name.ends_with(['/', '\\']) {
            continue;
        }
        let inside = names::inside(&name).ok_or_else(|| refuse("a name that leads out of it"))?;
        files.push((inside, index));
    }
    Ok(files)
}

fn cant_be_unpacked(name: &str, error: &dyn std::fmt::Display) -> ReadError {
    malformed(format!("the archive's file {} can't be unpacked ({error}); send the archive again", shown(name)))
}

fn malformed(detail: impl Into<String>) -> ReadError {
    ReadError::whole(ReadErrorKind::Malformed, detail)
}

#[cold]
fn no_directory(bytes: &[u8], error: &ZipError) -> ReadError {
    let what = if super::threemf::is_likely(bytes) { "3MF file" } else { "ZIP archive" };
    let detail = format!("the {what} has no readable directory ({error}); it was probably cut off, so send it again");
    ReadError::whole(ReadErrorKind::Truncated, detail)
}
