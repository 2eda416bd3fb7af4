//! Reading and packing ZIP archives (PKWARE, "APPNOTE.TXT - .ZIP File Format Specification").
//!
//! An archive is hostile input: its sizes, entry count and names are checked before any entry is unpacked. 3MF packages and OBJ zips both
//! use this module.

use std::collections::HashMap;
use std::io::{self, BufRead, BufReader, Cursor, Read};

use memchr::memmem;
use zip::result::{ZipError, ZipResult};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipArchive};

use super::errors::{ReadError, ReadErrorKind, excerpt_up_to};
use super::limits::{Limits, SNIFFED_BYTES};

/// Signature of a local file header.
pub(super) const LOCAL_HEADER_SIGNATURE: &[u8] = b"PK\x03\x04";
/// Signature of a central directory header.
const ENTRY_SIGNATURE: &[u8] = b"PK\x01\x02";

/// Maximum number of entries. Models with many parts have hundreds.
const MAX_ENTRIES: usize = 10_000;
/// Maximum ratio of unpacked to packed bytes. Text models reach about 20; deflate itself can reach 1032.
const MAX_RATIO: u64 = 100;
/// Unpacked bytes that are always allowed, however small the archive is.
const ALWAYS_ALLOWED_BYTES: u64 = 64 << 20;
/// An archive may unpack to this many times [`Limits::max_bytes`].
const MAX_BYTES_MULTIPLE: u64 = 8;

/// An opened ZIP archive. File names are relative to its root and compared without regard to ASCII case.
pub(super) struct Archive<'a> {
    zip: ZipArchive<Cursor<&'a [u8]>>,
    /// Name and entry index of each file, in the archive's order.
    files: Vec<(String, usize)>,
    /// Position in `files` by [`name_key`].
    index_by_key: HashMap<String, usize>,
}

impl<'a> Archive<'a> {
    /// Opens an archive: reads and checks its central directory.
    ///
    /// # Errors
    /// A [`ReadError`] if the directory is unreadable, entries overlap or repeat a name, or a size limit is exceeded.
    pub fn open(bytes: &'a [u8], limits: &Limits) -> Result<Self, ReadError> {
        // Count signatures in the raw bytes: parsing the directory would allocate memory for every entry.
        if memmem::find_iter(bytes, ENTRY_SIGNATURE).take(MAX_ENTRIES + 1).count() > MAX_ENTRIES {
            let detail =
                format!("the archive has more than {MAX_ENTRIES} entries; send only the model and the files it uses");
            return Err(ReadError::for_file(ReadErrorKind::TooLarge, detail));
        }
        let mut zip = ZipArchive::new(Cursor::new(bytes)).map_err(|error| unreadable_directory(bytes, &error))?;
        check_sizes(&zip, bytes.len() as u64, limits).map_err(|error| unreadable_directory(bytes, &error))??;
        // Overlapping entries reuse the same packed bytes, so a small archive could unpack to a huge size.
        if zip.has_overlapping_entries().map_err(|error| unreadable_directory(bytes, &error))? {
            return Err(malformed(
                "entries of the archive overlap, which valid archives never do; create the archive again",
            ));
        }
        let files = files(&zip)?;
        let index_by_key: HashMap<String, usize> =
            files.iter().enumerate().map(|(place, (name, _))| (name_key(name), place)).collect();
        if index_by_key.len() < files.len() || zip.has_duplicate_names() {
            return Err(malformed(
                "the archive has two entries with the same name; rename one and create the archive again",
            ));
        }
        Ok(Self { zip, files, index_by_key })
    }

    /// The file names, in the archive's order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.files.iter().map(|(name, _)| name.as_str())
    }

    /// Whether the archive has a file with this name, ignoring case.
    pub fn contains(&self, name: &str) -> bool {
        self.index_by_key.contains_key(&name_key(name))
    }

    /// The file's name as stored in the archive; `None` if there is no such file.
    pub fn stored_name(&self, name: &str) -> Option<&str> {
        self.index_by_key.get(&name_key(name)).map(|&place| self.files[place].0.as_str())
    }

    /// The unpacked size of a file in bytes, as the directory declares it.
    pub fn size(&self, name: &str) -> Option<u64> {
        self.zip.by_index_data(self.index(name)?).ok().map(|entry| entry.size())
    }

    /// Unpacks a whole file of at most `max_bytes` bytes; `None` if there is no such file.
    pub fn read_file(&self, name: &str, max_bytes: u64) -> Result<Option<Vec<u8>>, ReadError> {
        let Some(size) = self.size(name) else { return Ok(None) };
        if size > max_bytes {
            let detail =
                format!("the archive's file {} has {size} bytes, over the limit of {max_bytes}", name_excerpt(name));
            return Err(ReadError::for_file(ReadErrorKind::TooLarge, format!("{detail}; send a smaller file")));
        }
        let Some(bytes) = self.read_prefix(name, size + 1)? else { return Ok(None) };
        if bytes.len() as u64 != size {
            let detail =
                format!("the archive's file {} does not have the size that its directory declares", name_excerpt(name));
            return Err(malformed(format!("{detail}; send the archive again")));
        }
        Ok(Some(bytes))
    }

    /// Unpacks at most the first `max_bytes` bytes of a file; `None` if there is no such file.
    pub fn read_prefix(&self, name: &str, max_bytes: u64) -> Result<Option<Vec<u8>>, ReadError> {
        // The clone shares the archive's bytes.
        let mut zip = self.zip.clone();
        let Some((reader, _)) = unpack(&mut zip, self.index(name), name)? else { return Ok(None) };
        let mut bytes = Vec::new();
        reader.take(max_bytes).read_to_end(&mut bytes).map_err(|error| unpacking_failed(name, &error))?;
        Ok(Some(bytes))
    }

    /// Opens a file as a stream that unpacks while it is read; `None` if there is no such file.
    pub fn unpack(&mut self, name: &str) -> Result<Option<Stream<'_>>, ReadError> {
        let index = self.index(name);
        Ok(unpack(&mut self.zip, index, name)?.map(|(reader, size)| Stream::new(reader, size)))
    }

    fn index(&self, name: &str) -> Option<usize> {
        self.index_by_key.get(&name_key(name)).map(|&place| self.files[place].1)
    }
}

/// A file name, shortened and escaped for a message.
pub(super) fn name_excerpt(name: &str) -> String {
    excerpt_up_to(100, name.as_bytes())
}

/// The file names in the local headers within the first bytes of an archive.
pub(super) fn names_in_head(head: &[u8]) -> impl Iterator<Item = &[u8]> {
    /// Offsets of the name's length and of the name within a local file header.
    const LENGTH: usize = 26;
    const NAME: usize = 30;
    memmem::find_iter(head, LOCAL_HEADER_SIGNATURE).filter_map(|at| {
        let length = head.get(at + LENGTH..)?.first_chunk()?;
        head.get(at + NAME..at + NAME + usize::from(u16::from_le_bytes(*length)))
    })
}

/// Lowercase names, or prefixes of names, that 3MF packages begin with.
const PART_PREFIXES: [&str; 4] = ["[content_types].xml", "_rels/", "3d/", "metadata/"];

/// Whether the first bytes of an archive name a part that 3MF packages begin with.
pub(super) fn is_likely_3mf(head: &[u8]) -> bool {
    let starts_with = |name: &[u8], part: &str| {
        name.get(..part.len()).is_some_and(|start| start.eq_ignore_ascii_case(part.as_bytes()))
    };
    let head = &head[..head.len().min(SNIFFED_BYTES)];
    names_in_head(head)
        .any(|name| PART_PREFIXES.iter().any(|part| starts_with(name.strip_prefix(b"/").unwrap_or(name), part)))
}

/// A reader of an entry's unpacked bytes, and the size in bytes that the directory declares.
type PackedFile<'z> = (Box<dyn Read + 'z>, u64);

fn unpack<'z>(
    zip: &'z mut ZipArchive<Cursor<&[u8]>>,
    index: Option<usize>,
    name: &str,
) -> Result<Option<PackedFile<'z>>, ReadError> {
    let Some(index) = index else { return Ok(None) };
    let entry = zip.by_index_data(index).map_err(|error| unpacking_failed(name, &error))?;
    let unsupported = |detail: String| Err(ReadError::for_file(ReadErrorKind::UnsupportedFormat, detail));
    if entry.encrypted() {
        return unsupported(format!(
            "the archive's file {} is encrypted; create the archive without a password",
            name_excerpt(name)
        ));
    }
    let method = entry.compression();
    if !matches!(method, CompressionMethod::Stored | CompressionMethod::Deflated) {
        let detail =
            format!("the archive's file {} is compressed with {method}, which is not supported", name_excerpt(name));
        return unsupported(format!("{detail}; create the archive with the usual deflate compression"));
    }
    let size = entry.size();
    let reader = zip.by_index(index).map_err(|error| unpacking_failed(name, &error))?;
    Ok(Some((Box::new(reader), size)))
}

/// Rejects an archive that declares more unpacked bytes than the limits allow.
fn check_sizes(zip: &ZipArchive<Cursor<&[u8]>>, packed: u64, limits: &Limits) -> ZipResult<Result<(), ReadError>> {
    let max_bytes = packed
        .saturating_mul(MAX_RATIO)
        .max(ALWAYS_ALLOWED_BYTES)
        .min(limits.max_bytes.saturating_mul(MAX_BYTES_MULTIPLE));
    let mut unpacked = 0_u64;
    for index in 0..zip.len() {
        unpacked = unpacked.saturating_add(zip.by_index_data(index)?.size());
    }
    if unpacked <= max_bytes {
        return Ok(Ok(()));
    }
    let detail = format!(
        "the archive of {packed} bytes would unpack to {unpacked} bytes, over the limit of {max_bytes}; simplify the model before you send it"
    );
    Ok(Err(ReadError::for_file(ReadErrorKind::TooLarge, detail)))
}

/// Name and entry index of each file, in the archive's order, without folders.
fn files(zip: &ZipArchive<Cursor<&[u8]>>) -> Result<Vec<(String, usize)>, ReadError> {
    let mut files = Vec::with_capacity(zip.len());
    for (index, (raw, name)) in zip.file_names_raw().zip(zip.file_names()).enumerate() {
        let refuse = |problem: &str| {
            malformed(format!(
                "the archive's entry '{}' has {problem}; rename the file and create the archive again",
                excerpt_up_to(100, raw)
            ))
        };
        let name = name.map_err(|_| refuse("a name that is not valid text"))?;
        if name.ends_with(['/', '\\']) {
            continue;
        }
        let normalized_name = normalized_name(&name).ok_or_else(|| refuse("a name that points outside the archive"))?;
        files.push((normalized_name, index));
    }
    Ok(files)
}

fn unpacking_failed(name: &str, error: &dyn std::fmt::Display) -> ReadError {
    malformed(format!("the archive's file {} can't be unpacked ({error}); send the archive again", name_excerpt(name)))
}

fn malformed(detail: impl Into<String>) -> ReadError {
    ReadError::for_file(ReadErrorKind::Malformed, detail)
}

#[cold]
fn unreadable_directory(bytes: &[u8], error: &ZipError) -> ReadError {
    let kind = if is_likely_3mf(bytes) { "3MF file" } else { "ZIP archive" };
    let detail = format!("the {kind} has no readable directory ({error}); it was probably cut off, so send it again");
    ReadError::for_file(ReadErrorKind::Truncated, detail)
}

/// Maximum size in bytes of one XML element, comment or text.
const MAX_EVENT_BYTES: u64 = 4 << 20;
/// Size in bytes of the unpacking buffer.
const BUFFER_BYTES: usize = 64 << 10;

/// Why a [`Stream`] stopped before the end of its file.
#[derive(Debug, thiserror::Error)]
pub(super) enum StreamError {
    #[error("an XML element or text is longer than {} bytes", MAX_EVENT_BYTES)]
    EventTooLong,
    #[error("the file in the archive is longer than its directory declares")]
    LongerThanDeclared,
}

/// Unpacks a file of an archive while it is read. Reading stops at the declared size, and at [`MAX_EVENT_BYTES`] bytes for each XML event.
pub(super) struct Stream<'a> {
    inner: BufReader<Box<dyn Read + 'a>>,
    /// Bytes left of the size that the directory declares.
    left: u64,
    /// Bytes left for the current XML event.
    event: u64,
}

impl<'a> Stream<'a> {
    /// A stream of no more than `size` bytes.
    fn new(inner: Box<dyn Read + 'a>, size: u64) -> Self {
        Self { inner: BufReader::with_capacity(BUFFER_BYTES, inner), left: size, event: MAX_EVENT_BYTES }
    }

    /// Starts a new XML event and resets its byte count.
    pub fn begin_event(&mut self) {
        self.event = MAX_EVENT_BYTES;
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
            return Err(io::Error::other(StreamError::EventTooLong));
        }
        let ready = self.inner.fill_buf()?;
        if ready.len() as u64 > self.left {
            return Err(io::Error::other(StreamError::LongerThanDeclared));
        }
        Ok(ready)
    }

    fn consume(&mut self, count: usize) {
        self.left = self.left.saturating_sub(count as u64);
        self.event = self.event.saturating_sub(count as u64);
        self.inner.consume(count);
    }
}

// File names in an archive: relative to its root, separated by slashes, without `.` and `..`.

/// Normalizes an entry's name: slashes as separators, no leading `/` or `./`. `None` if the name points outside the archive.
fn normalized_name(name: &str) -> Option<String> {
    let name = name.replace('\\', "/");
    let name = name.strip_prefix('/').unwrap_or(&name);
    let name = name.strip_prefix("./").unwrap_or(name);
    let leads_out = |segment: &str| matches!(segment, "" | "." | "..") || is_drive(segment);
    (!name.split('/').any(leads_out) && !name.contains('\0')).then(|| name.to_owned())
}

/// Resolves a path that the file `source` refers to: from the root if absolute, else from `source`'s folder. `None` if it points outside.
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
    normalized_name(&segments.join("/"))
}

/// The form in which names are compared: ASCII lowercase.
pub(super) fn name_key(name: &str) -> String {
    name.to_ascii_lowercase()
}

/// Decodes percent escapes such as `%20`; `None` if an escape is malformed or the result is not UTF-8.
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

/// Whether a path segment is a Windows drive, such as `C:`.
fn is_drive(segment: &str) -> bool {
    matches!(segment.as_bytes(), [letter, b':', ..] if letter.is_ascii_alphabetic())
}

// Packing options. They contain no time or platform, so the same files always give the same bytes.

/// Deflate's default level. Level 9 takes three times as long and saves 2 %.
const COMPRESSION_LEVEL: i64 = 6;

/// Options for files that compress well. `is_long` enables ZIP64, which files over 4 GiB need.
pub(super) fn deflate_options(is_long: bool) -> SimpleFileOptions {
    base_options()
        .compression_method(CompressionMethod::Deflated)
        .compression_level(Some(COMPRESSION_LEVEL))
        .large_file(is_long)
}

/// Options for files that are compressed already, such as images.
pub(super) fn store_options() -> SimpleFileOptions {
    base_options().compression_method(CompressionMethod::Stored)
}

fn base_options() -> SimpleFileOptions {
    SimpleFileOptions::default().last_modified_time(DateTime::default()).system(System::Unix).unix_permissions(0o644)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_resolves_from_the_root_or_from_its_source_folder() {
        let resolve = |path| resolve("a/b.obj", path);
        assert_eq!(resolve("/c.mtl").as_deref(), Some("c.mtl"));
        assert_eq!(resolve("d\\.\\c 1.mtl").as_deref(), Some("a/d/c 1.mtl"));
        assert_eq!(resolve("../e/c.png").as_deref(), Some("e/c.png"));
        for out in ["../../f", "/../f", "C:\\f"] {
            assert_eq!(resolve(out), None, "{out}");
        }
    }

    #[test]
    fn an_entry_that_points_outside_has_no_name() {
        assert_eq!(normalized_name("3D\\a.model").as_deref(), Some("3D/a.model"));
        assert_eq!(normalized_name("/3D/a.model").as_deref(), Some("3D/a.model"));
        assert_eq!(normalized_name("./a 12:30.obj").as_deref(), Some("a 12:30.obj"));
        for out in ["../a", "3D/../../a", "//a", "C:/a", "c:a", "", "a/./b", "..\\a", "a\0"] {
            assert_eq!(normalized_name(out), None, "{out}");
        }
    }

    #[test]
    fn percent_escapes_are_decoded_and_malformed_ones_rejected() {
        assert_eq!(percent_decoded("c%20d%C3%A9.png").as_deref(), Some("c dé.png"));
        for bad in ["%", "%4", "%zz", "%ff"] {
            assert_eq!(percent_decoded(bad), None, "{bad}");
        }
    }
}
