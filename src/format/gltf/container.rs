//! The GLB container, a header and chunks (glTF 2.0, section 4), and JSON building blocks that bound memory.

use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;
use std::ops::Deref;

use serde::Deserialize;
use serde::de::{Deserializer, Error, SeqAccess, Unexpected, Visitor};

use super::super::errors::{FileLocation, ReadError, ReadErrorKind, excerpt};
use super::super::formats::GLB_SIGNATURE;

const JSON: &[u8; 4] = b"JSON";
const BINARY: &[u8; 4] = b"BIN\0";
const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;

/// The JSON and binary chunks of a GLB file, each with its byte offset.
#[derive(Debug)]
pub(super) struct Container<'a> {
    /// The JSON chunk.
    pub json: (usize, &'a [u8]),
    /// The binary chunk; `None` if there is none.
    pub binary: Option<(usize, &'a [u8])>,
}

/// Finds the chunks of a GLB file. Chunks of unknown types are skipped, as the specification requires.
pub(super) fn read_chunks<'a>(bytes: &'a [u8], warnings: &mut Vec<String>) -> Result<Container<'a>, ReadError> {
    let Some(header) = bytes.first_chunk::<HEADER_BYTES>() else {
        return Err(truncated(bytes.len(), "the file ends within the header of a GLB file"));
    };
    match u32_at(header, 4) {
        2 => {}
        1 => {
            return Err(ReadError::at_byte(
                ReadErrorKind::UnsupportedFormat,
                4,
                "the file is glTF 1.0, which is not supported; convert the model to glTF 2.0, export a GLB file and send that file",
            ));
        }
        other => {
            let detail = format!(
                "the GLB file declares version {other}, but only version 2 is supported; export the model again as version 2"
            );
            return Err(ReadError::at_byte(ReadErrorKind::Malformed, 4, detail));
        }
    }
    let length = u32_at(header, 8) as usize;
    if length < HEADER_BYTES + CHUNK_HEADER_BYTES {
        let detail = format!(
            "the GLB file declares a length of {length} bytes, too short for any content; export the model again"
        );
        return Err(ReadError::at_byte(ReadErrorKind::Malformed, 8, detail));
    }
    if length > bytes.len() {
        let detail = format!("the GLB file declares a length of {length} bytes, but has only {}", bytes.len());
        return Err(truncated(bytes.len(), &detail));
    }
    if length < bytes.len() {
        warnings.push(format!("bytes after the end of the GLB file were ignored: {}", bytes.len() - length));
    }
    chunks(&bytes[..length], warnings)
}

fn chunks<'a>(bytes: &'a [u8], warnings: &mut Vec<String>) -> Result<Container<'a>, ReadError> {
    let malformed = |at: usize, detail: String| {
        Err(ReadError::at_byte(ReadErrorKind::Malformed, at, format!("{detail}; export the model again")))
    };
    let (mut json, mut binary) = (None, None);
    let (mut at, mut number, mut unaligned) = (HEADER_BYTES, 0, false);
    while at < bytes.len() {
        let Some(header) = bytes[at..].first_chunk::<CHUNK_HEADER_BYTES>() else {
            return Err(truncated(at, "the GLB file ends within the header of a chunk"));
        };
        let begin = at + CHUNK_HEADER_BYTES;
        let length = u32_at(header, 0) as usize;
        let Some(chunk) = begin.checked_add(length).and_then(|end| bytes.get(begin..end)) else {
            let detail =
                format!("a chunk of the GLB file declares {length} bytes, but only {} follow", bytes.len() - begin);
            return Err(truncated(at, &detail));
        };
        let kind = &header[4..];
        match number {
            0 if kind == JSON => json = Some((begin, chunk)),
            0 => {
                return malformed(at, format!("the GLB file's first chunk has the type '{}', not JSON", excerpt(kind)));
            }
            1 if kind == BINARY => binary = Some((begin, chunk)),
            _ if kind == JSON => return malformed(at, "the GLB file has a second JSON chunk".to_owned()),
            _ if kind == BINARY => {
                return malformed(at, "the GLB file has a binary chunk that is not its second chunk".to_owned());
            }
            _ => {}
        }
        unaligned |= !length.is_multiple_of(4);
        number += 1;
        at = begin + length;
    }
    if unaligned {
        warnings.push(
            "the GLB file has chunks whose length is not a multiple of four, which other programs may reject"
                .to_owned(),
        );
    }
    match json {
        Some(json) => Ok(Container { json, binary }),
        None => Err(truncated(bytes.len(), "the GLB file has no JSON chunk")),
    }
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).map_or(0, |word| u32::from_le_bytes(*word))
}

fn truncated(at: usize, detail: &str) -> ReadError {
    let detail = format!("{detail}; it was probably cut off, so send it again");
    ReadError::at_byte(ReadErrorKind::Truncated, at, detail)
}

/// Builds a GLB file; `None` if it exceeds the 4 GiB that the format can count.
pub(super) fn assemble(mut json: Vec<u8>, mut binary: Vec<u8>) -> Option<Vec<u8>> {
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let chunks: &[(&[u8; 4], Vec<u8>)] = &[(JSON, json), (BINARY, binary)];
    let present = || chunks.iter().filter(|(_, chunk)| !chunk.is_empty());
    let length = HEADER_BYTES + present().map(|(_, chunk)| CHUNK_HEADER_BYTES + chunk.len()).sum::<usize>();
    let mut file = Vec::with_capacity(length);
    file.extend_from_slice(GLB_SIGNATURE);
    file.extend_from_slice(&2_u32.to_le_bytes());
    file.extend_from_slice(&u32::try_from(length).ok()?.to_le_bytes());
    for (kind, chunk) in present() {
        file.extend_from_slice(&u32::try_from(chunk.len()).ok()?.to_le_bytes());
        file.extend_from_slice(*kind);
        file.extend_from_slice(chunk);
    }
    Some(file)
}

/// Maximum number of entries in a list.
pub(super) const MAX_ENTRIES: usize = 1 << 20;
/// Start of the error about a longer list.
const TOO_MANY_ENTRIES: &str = "there are more than";
/// Maximum size in bytes of a document, not counting strings, which may hold whole buffers. Parsed, it takes a few times as much memory.
const MAX_DOCUMENT_BYTES: usize = 32 << 20;

/// Parses a JSON document. Errors give a byte of the file if `offset` is the document's byte offset, else a line.
pub(super) fn parse<'a, T: Deserialize<'a>>(text: &'a [u8], offset: Option<usize>) -> Result<T, ReadError> {
    if text.len() > MAX_DOCUMENT_BYTES && bytes_outside_strings(text) > MAX_DOCUMENT_BYTES {
        let detail =
            format!("the glTF document is longer than {MAX_DOCUMENT_BYTES} bytes; split the model into several files");
        return Err(ReadError::for_file(ReadErrorKind::TooLarge, detail));
    }
    serde_json::from_slice(text).map_err(|error| {
        let place = match offset {
            Some(offset) => FileLocation::Byte((offset + byte_offset(text, error.line(), error.column())) as u64),
            None => FileLocation::Line(error.line() as u64),
        };
        let words = error.to_string();
        // The location is reported in `place` instead.
        let words = words.split(" at line ").next().unwrap_or(&words);
        let kind = if words.starts_with(TOO_MANY_ENTRIES) {
            ReadErrorKind::TooLarge
        } else if error.is_eof() {
            ReadErrorKind::Truncated
        } else {
            ReadErrorKind::Malformed
        };
        let words: String = words.chars().take(200).collect();
        ReadError {
            kind,
            place: Some(place),
            detail: format!("the glTF document can't be read: {words}; export the model again"),
        }
    })
}

/// Number of bytes of a document outside strings.
fn bytes_outside_strings(text: &[u8]) -> usize {
    let (mut count, mut inside, mut escaped) = (0, false, false);
    for &byte in text {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if inside => escaped = true,
            b'"' => inside = !inside,
            _ if !inside => count += 1,
            _ => {}
        }
    }
    count
}

/// The byte offset of a line and column, both counted from 1.
fn byte_offset(text: &[u8], line: usize, column: usize) -> usize {
    let before: usize = text.split_inclusive(|&b| b == b'\n').take(line.saturating_sub(1)).map(<[u8]>::len).sum();
    (before + column.saturating_sub(1)).min(text.len())
}

/// A count or an index of the document. `3.0` is accepted as 3, because JSON has only one number type.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct Integer(pub u32);

impl Integer {
    /// The number as a list index.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

impl<'de> Deserialize<'de> for Integer {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Number;
        impl Visitor<'_> for Number {
            type Value = Integer;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a whole number from 0 to 4294967295")
            }

            fn visit_u64<E: Error>(self, number: u64) -> Result<Integer, E> {
                u32::try_from(number).map(Integer).map_err(|_| E::invalid_value(Unexpected::Unsigned(number), &self))
            }

            fn visit_f64<E: Error>(self, number: f64) -> Result<Integer, E> {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "tests whether the cast is exact"
                )]
                let whole = number as u32;
                if f64::from(whole) == number {
                    Ok(Integer(whole))
                } else {
                    Err(E::invalid_value(Unexpected::Float(number), &self))
                }
            }
        }
        deserializer.deserialize_u64(Number)
    }
}

/// A string that borrows from the document unless it has escapes.
pub(super) struct Text<'a>(Cow<'a, str>);

impl Deref for Text<'_> {
    type Target = str;

    fn deref(&self) -> &str {
        &self.0
    }
}

impl<'de: 'a, 'a> Deserialize<'de> for Text<'a> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Words;
        impl<'de> Visitor<'de> for Words {
            type Value = Cow<'de, str>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a string")
            }

            fn visit_borrowed_str<E: Error>(self, text: &'de str) -> Result<Self::Value, E> {
                Ok(Cow::Borrowed(text))
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Self::Value, E> {
                Ok(Cow::Owned(text.to_owned()))
            }
        }
        deserializer.deserialize_str(Words).map(Text)
    }
}

/// A list with at most [`MAX_ENTRIES`] entries.
pub(super) struct List<T>(Vec<T>);

impl<T> Default for List<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> Deref for List<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Entries<T> {
            type Value = Vec<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<Vec<T>, A::Error> {
                let mut list = Vec::new();
                while let Some(entry) = entries.next_element()? {
                    if list.len() == MAX_ENTRIES {
                        return Err(A::Error::custom(format!("{TOO_MANY_ENTRIES} {MAX_ENTRIES} entries in a list")));
                    }
                    list.push(entry);
                }
                Ok(list)
            }
        }
        deserializer.deserialize_seq(Entries(PhantomData)).map(List)
    }
}
