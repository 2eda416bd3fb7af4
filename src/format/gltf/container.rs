//! The container of binary glTF: a header and chunks (glTF 2.0, 4).

use super::super::errors::{ReadError, ReadErrorKind, shown};

pub(in crate::format) const MAGIC: &[u8; 4] = b"glTF";
const JSON: &[u8; 4] = b"JSON";
const BINARY: &[u8; 4] = b"BIN\0";
const HEADER: usize = 12;
const CHUNK_HEADER: usize = 8;

/// The chunks that mean something, each with its offset in the file.
#[derive(Debug)]
pub(super) struct Container<'a> {
    pub json: (usize, &'a [u8]),
    pub binary: Option<(usize, &'a [u8])>,
}

/// Takes a file apart. Chunks of unknown types are passed over, as the specification asks.
pub(super) fn open<'a>(bytes: &'a [u8], warnings: &mut Vec<String>) -> Result<Container<'a>, ReadError> {
    let Some(header) = bytes.first_chunk::<HEADER>() else {
        return Err(truncated(bytes.len(), "the file ends within the header of a GLB file"));
    };
    match word(header, 4) {
        2 => {}
        1 => {
            return Err(ReadError::at_byte(
                ReadErrorKind::UnsupportedFormat,
                4,
                "this is glTF 1.0, which is not read; convert it to glTF 2.0, export a GLB file, and send that",
            ));
        }
        other => {
            let detail =
                format!("the GLB file says that it is of version {other}; only version 2 is known, so export it again");
            return Err(ReadError::at_byte(ReadErrorKind::Malformed, 4, detail));
        }
    }
    let length = word(header, 8) as usize;
    if length < HEADER + CHUNK_HEADER {
        let detail =
            format!("the GLB file says that it is {length} bytes long, too short for any content; export it again");
        return Err(ReadError::at_byte(ReadErrorKind::Malformed, 8, detail));
    }
    if length > bytes.len() {
        let detail = format!("the GLB file says that it is {length} bytes long and {} are there", bytes.len());
        return Err(truncated(bytes.len(), &detail));
    }
    if length < bytes.len() {
        warnings.push(format!("bytes after the end of the GLB file were left out: {}", bytes.len() - length));
    }
    chunks(&bytes[..length], warnings)
}

fn chunks<'a>(bytes: &'a [u8], warnings: &mut Vec<String>) -> Result<Container<'a>, ReadError> {
    let malformed = |at: usize, detail: String| {
        Err(ReadError::at_byte(ReadErrorKind::Malformed, at, format!("{detail}; export the model again")))
    };
    let (mut json, mut binary) = (None, None);
    let (mut at, mut number, mut unaligned) = (HEADER, 0, false);
    while at < bytes.len() {
        let Some(header) = bytes[at..].first_chunk::<CHUNK_HEADER>() else {
            return Err(truncated(at, "the GLB file ends within the header of a chunk"));
        };
        let begin = at + CHUNK_HEADER;
        let length = word(header, 0) as usize;
        let Some(chunk) = begin.checked_add(length).and_then(|end| bytes.get(begin..end)) else {
            let detail =
                format!("a chunk of the GLB file is {length} bytes long and {} are there", bytes.len() - begin);
            return Err(truncated(at, &detail));
        };
        let kind = &header[4..];
        match number {
            0 if kind == JSON => json = Some((begin, chunk)),
            0 => return malformed(at, format!("the GLB file's first chunk is '{}', not JSON", shown(kind))),
            1 if kind == BINARY => binary = Some((begin, chunk)),
            _ if kind == JSON => return malformed(at, "the GLB file has a second chunk of JSON".to_owned()),
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
            "the GLB file's chunks are not multiples of four bytes long, which other programs may refuse".to_owned(),
        );
    }
    match json {
        Some(json) => Ok(Container { json, binary }),
        None => Err(truncated(bytes.len(), "the GLB file has no chunk of JSON")),
    }
}

fn word(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..).and_then(|rest| rest.first_chunk()).map_or(0, |word| u32::from_le_bytes(*word))
}

fn truncated(at: usize, detail: &str) -> ReadError {
    let detail = format!("{detail}; it was probably cut off, so send it again");
    ReadError::at_byte(ReadErrorKind::Truncated, at, detail)
}

/// Puts a file together; none where it is over the 4 GiB that the format can count.
pub(super) fn assemble(mut json: Vec<u8>, mut binary: Vec<u8>) -> Option<Vec<u8>> {
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let chunks: &[(&[u8; 4], Vec<u8>)] = &[(JSON, json), (BINARY, binary)];
    let present = || chunks.iter().filter(|(_, chunk)| !chunk.is_empty());
    let length = HEADER + present().map(|(_, chunk)| CHUNK_HEADER + chunk.len()).sum::<usize>();
    let mut file = Vec::with_capacity(length);
    file.extend_from_slice(MAGIC);
    file.extend_from_slice(&2_u32.to_le_bytes());
    file.extend_from_slice(&u32::try_from(length).ok()?.to_le_bytes());
    for (kind, chunk) in present() {
        file.extend_from_slice(&u32::try_from(chunk.len()).ok()?.to_le_bytes());
        file.extend_from_slice(*kind);
        file.extend_from_slice(chunk);
    }
    Some(file)
}
