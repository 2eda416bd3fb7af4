//! Files in a ZIP archive ("APPNOTE.TXT - .ZIP File Format Specification"), with limits that hold before anything is unpacked.

use std::collections::HashMap;
use std::io::{self, BufRead, BufReader, Cursor, Read};

use memchr::memmem;
use zip::result::{ZipError, ZipResult};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipArchive};

use super::errors::{ReadError, ReadErrorKind, shown_up_to};
use super::limits::{HEAD, Limits};

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
        let Some((reader, _)) = unpack(&mut zip, self.index(name), name)? else { return Ok(None) };
        let mut bytes = Vec::new();
        reader.take(most).read_to_end(&mut bytes).map_err(|error| cant_be_unpacked(name, &error))?;
        Ok(Some(bytes))
    }

    /// A file that is unpacked as it is read; none if there is no such file.
    pub fn unpack(&mut self, name: &str) -> Result<Option<Stream<'_>>, ReadError> {
        let index = self.index(name);
        Ok(unpack(&mut self.zip, index, name)?.map(|(reader, size)| Stream::new(reader, size)))
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

/// Names of parts that only 3MF packages have, in lowercase.
const PARTS: [&str; 4] = ["[content_types].xml", "_rels/", "3d/", "metadata/"];

/// Whether the head of an archive names what 3MF files begin with.
pub(super) fn is_likely_3mf(head: &[u8]) -> bool {
    let begins =
        |name: &[u8], part: &str| name.get(..part.len()).is_some_and(|it| it.eq_ignore_ascii_case(part.as_bytes()));
    let head = &head[..head.len().min(HEAD)];
    names_in_head(head).any(|name| PARTS.iter().any(|part| begins(name.strip_prefix(b"/").unwrap_or(name), part)))
}

/// A reader of a file's bytes, and how long the directory says that it is.
type Packed<'z> = (Box<dyn Read + 'z>, u64);

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
    Ok(Some((Box::new(reader), size)))
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
        let inside = inside(&name).ok_or_else(|| refuse("a name that leads out of it"))?;
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
    let what = if is_likely_3mf(bytes) { "3MF file" } else { "ZIP archive" };
    let detail = format!("the {what} has no readable directory ({error}); it was probably cut off, so send it again");
    ReadError::whole(ReadErrorKind::Truncated, detail)
}

/// Longest element, comment or piece of text, in bytes.
const EVENT: u64 = 4 << 20;
/// How much is unpacked at a time.
const BUFFER: usize = 64 << 10;

/// Why a stream goes on no longer.
#[derive(Debug, thiserror::Error)]
pub(super) enum Stop {
    #[error("an element or a text is longer than {} bytes", EVENT)]
    LongEvent,
    #[error("more is packed in the archive than its directory says")]
    MoreThanSaid,
}

/// The bytes of a file as they are unpacked: no more than the directory said, and no more at a time than an element of XML may have.
pub(super) struct Stream<'a> {
    inner: BufReader<Box<dyn Read + 'a>>,
    /// What is left of the size that the archive's directory tells.
    left: u64,
    /// What the element at hand may still have.
    event: u64,
}

impl<'a> Stream<'a> {
    /// A stream of no more than `size` bytes.
    fn new(inner: Box<dyn Read + 'a>, size: u64) -> Self {
        Self { inner: BufReader::with_capacity(BUFFER, inner), left: size, event: EVENT }
    }

    /// Begins to count from zero again.
    pub fn begin_event(&mut self) {
        self.event = EVENT;
    }
}

impl Read for Stream<'_> {
    fn read(&mut self, target: &mut [u8]) -> io::Result<usize> {
        let ready = self.fill_buf()?;
        let count = ready.len().min(target.len());
        target[..count].copy_from_slice(&ready[..count]);
        self.consume(count);
        Ok(count)
    }
}

impl BufRead for Stream<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.event == 0 {
            return Err(io::Error::other(Stop::LongEvent));
        }
        let ready = self.inner.fill_buf()?;
        if ready.len() as u64 > self.left {
            return Err(io::Error::other(Stop::MoreThanSaid));
        }
        Ok(ready)
    }

    fn consume(&mut self, count: usize) {
        self.left = self.left.saturating_sub(count as u64);
        self.event = self.event.saturating_sub(count as u64);
        self.inner.consume(count);
    }
}

// Names of files in an archive: from its root, parted by slashes, without `.` and `..`.

/// The name of an entry as the name of a file, without what some programs put before it; none where it leads out of the archive.
fn inside(name: &str) -> Option<String> {
    let name = name.replace('\\', "/");
    let name = name.strip_prefix('/').unwrap_or(&name);
    let name = name.strip_prefix("./").unwrap_or(name);
    let leads_out = |segment: &str| matches!(segment, "" | "." | "..") || is_drive(segment);
    (!name.split('/').any(leads_out) && !name.contains('\0')).then(|| name.to_owned())
}

/// The file that `source` means by a path: absolute from the archive's root, else from its own folder. None where it leads out.
pub(super) fn resolve(source: &str, path: &str) -> Option<String> {
    let path = path.replace('\\', "/");
    let folder = if path.starts_with('/') { None } else { source.rsplit_once('/') };
    let mut segments: Vec<&str> = folder.map_or_else(Vec::new, |(folder, _)| folder.split('/').collect());
    for segment in path.split('/') {
        match segment {
            "" | "." => {}
            ".." => {
                segments.pop()?;
            }
            _ => segments.push(segment),
        }
    }
    inside(&segments.join("/"))
}

/// What names are compared by.
pub(super) fn key(name: &str) -> String {
    name.to_ascii_lowercase()
}

/// A reference as a path, where `%20` stands for a blank and so on.
pub(super) fn percent_decoded(reference: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(reference.len());
    let mut rest = reference.bytes();
    while let Some(byte) = rest.next() {
        if byte == b'%' {
            let digit = |b: Option<u8>| char::from(b?).to_digit(16);
            bytes.push(u8::try_from(digit(rest.next())? * 16 + digit(rest.next())?).ok()?);
        } else {
            bytes.push(byte);
        }
    }
    String::from_utf8(bytes).ok()
}

/// `C:`, as paths of Windows begin.
fn is_drive(segment: &str) -> bool {
    matches!(segment.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic())
}

// How files are packed: the same bytes on every machine and at every time.

/// Deflate's usual level: 9 takes three times as long for 2 % less.
const LEVEL: i64 = 6;

/// For what packs well; `is_long` where it may have more than 4 GiB, which a ZIP entry counts otherwise.
pub(super) fn compressed(is_long: bool) -> SimpleFileOptions {
    options().compression_method(CompressionMethod::Deflated).compression_level(Some(LEVEL)).large_file(is_long)
}

/// For what is packed already, such as pictures.
pub(super) fn stored() -> SimpleFileOptions {
    options().compression_method(CompressionMethod::Stored)
}

fn options() -> SimpleFileOptions {
    SimpleFileOptions::default().last_modified_time(DateTime::default()).system(System::Unix).unix_permissions(0o644)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_absolute_or_from_the_folder_of_its_source() {
        let resolve = |path| resolve("a/b.obj", path);
        assert_eq!(resolve("/c.mtl").as_deref(), Some("c.mtl"));
        assert_eq!(resolve("d\\.\\c 1.mtl").as_deref(), Some("a/d/c 1.mtl"));
        assert_eq!(resolve("../e/c.png").as_deref(), Some("e/c.png"));
        for out in ["../../f", "/../f", "C:\\f"] {
            assert_eq!(resolve(out), None, "{out}");
        }
    }

    #[test]
    fn an_entry_that_leads_out_is_no_file() {
        assert_eq!(inside("3D\\a.model").as_deref(), Some("3D/a.model"));
        assert_eq!(inside("/3D/a.model").as_deref(), Some("3D/a.model"));
        assert_eq!(inside("./a 12:30.obj").as_deref(), Some("a 12:30.obj"));
        for out in ["../a", "3D/../../a", "//a", "C:/a", "c:a", "", "a/./b", "..\\a", "a\0"] {
            assert_eq!(inside(out), None, "{out}");
        }
    }

    #[test]
    fn escapes_are_read_and_bad_ones_are_none() {
        assert_eq!(percent_decoded("c%20d%C3%A9.png").as_deref(), Some("c dé.png"));
        for bad in ["%", "%4", "%zz", "%ff"] {
            assert_eq!(percent_decoded(bad), None, "{bad}");
        }
    }
}
