//! A whole file: its document and the buffers that it names.

use std::borrow::Cow;
use std::cell::Cell;

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use super::super::archive::percent_decoded;
use super::super::beside::Beside;
use super::super::errors::{ReadError, ReadErrorKind, shown};
use super::super::limits::Limits;
use super::document::{Buffer, BufferView, Document};
use super::json::Whole;

const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// The longest path of another file, in bytes.
const LONGEST_PATH: usize = 4096;

/// A document with its buffers.
pub(super) struct File<'a> {
    pub document: Document<'a>,
    buffers: Vec<Source<'a>>,
    pub limits: Limits,
    /// The files that came with it.
    pub beside: &'a Beside<'a>,
    /// How many bytes the file has.
    pub length: usize,
    /// Work that the faces and vertices of the result do not count.
    spent: Cell<u64>,
}

/// Where the bytes of a buffer are.
enum Source<'a> {
    /// Here, and the offset in the file where they are as they stand there.
    Here(Cow<'a, [u8]>, Option<usize>),
    /// In another file.
    Elsewhere(String),
    /// Nowhere, as where an extension gives the bytes.
    Nowhere,
}

/// A part of a buffer.
#[derive(Clone, Copy)]
pub(super) struct View<'f> {
    pub bytes: &'f [u8],
    /// Its offset in the file, where it has one.
    pub place: Option<usize>,
    /// From the start of one element to that of the next, where it is told.
    pub stride: Option<usize>,
}

impl<'a> File<'a> {
    /// Finds the bytes of all buffers; `binary` is the binary chunk with its offset.
    pub fn new(
        document: Document<'a>,
        binary: Option<(usize, &'a [u8])>,
        limits: Limits,
        length: usize,
        beside: &'a Beside<'a>,
        warnings: &mut Vec<String>,
    ) -> Result<Self, ReadError> {
        let mut buffers = Vec::with_capacity(document.buffers.len());
        for (number, buffer) in document.buffers.iter().enumerate() {
            buffers.push(source(number, buffer, binary, beside, warnings)?);
        }
        Ok(Self { document, buffers, limits, beside, length, spent: Cell::new(0) })
    }

    /// Counts work on so many entries, of which a small file can ask for any amount by naming the same ones again and again.
    pub fn spend(&self, entries: usize) -> Result<(), ReadError> {
        self.spent.set(self.spent.get().saturating_add(entries as u64));
        if self.spent.get() > self.limits.max_vertices.saturating_mul(2) {
            let detail =
                "the file's compressed or sparse data and its skins are used over and over; export the model again";
            return Err(ReadError::whole(ReadErrorKind::TooLarge, detail));
        }
        Ok(())
    }

    pub fn view(&self, number: Whole) -> Result<View<'_>, ReadError> {
        let view = entry(&self.document.buffer_views, number, "buffer view")?;
        let what = format!("buffer view {}", number.0);
        let (bytes, place) = self.buffer(view)?;
        let begin = view.byte_offset.index();
        let part = begin.checked_add(view.byte_length.index()).and_then(|end| bytes.get(begin..end));
        let Some(part) = part else {
            return Err(malformed(format!(
                "{what} is {} bytes from byte {begin} of a buffer of {} bytes",
                view.byte_length.0,
                bytes.len()
            )));
        };
        let stride = view.byte_stride.map(Whole::index).filter(|&stride| stride > 0);
        Ok(View { bytes: part, place: place.map(|place| place + begin), stride })
    }

    fn buffer(&self, view: &BufferView) -> Result<(&[u8], Option<usize>), ReadError> {
        match entry(&self.buffers, view.buffer, "buffer")? {
            Source::Here(bytes, place) => Ok((bytes, *place)),
            Source::Elsewhere(name) => Err(ReadError::whole(
                ReadErrorKind::UnsupportedFormat,
                format!(
                    "the model's data is in another file, '{name}'; export a GLB file, which has all in one, or send both in a ZIP archive"
                ),
            )),
            Source::Nowhere if view.extensions.meshopt.is_some() => Err(ReadError::whole(
                ReadErrorKind::UnsupportedFormat,
                "the file is compressed with meshopt (EXT_meshopt_compression), which is not read; export without compression",
            )),
            Source::Nowhere => {
                let detail = format!("buffer {} has no bytes: the file has no chunk for it", view.buffer.0);
                Err(ReadError::whole(ReadErrorKind::Truncated, format!("{detail}; export the model again as GLB")))
            }
        }
    }
}

fn source<'a>(
    number: usize,
    buffer: &Buffer<'a>,
    binary: Option<(usize, &'a [u8])>,
    beside: &Beside<'_>,
    warnings: &mut Vec<String>,
) -> Result<Source<'a>, ReadError> {
    let told = buffer.byte_length.index();
    let short = |found: usize, place: Option<usize>| {
        let detail = format!(
            "buffer {number} is to have {told} bytes and has {found}; the file was probably cut off, so send it again"
        );
        ReadError {
            place: place.map(|at| super::super::Place::Byte(at as u64)),
            ..ReadError::whole(ReadErrorKind::Truncated, detail)
        }
    };
    match (&buffer.uri, binary) {
        (Some(uri), _) => {
            let bytes = match data(uri) {
                Some(bytes) => Some(bytes.map_err(|why| malformed(format!("the data of buffer {number} {why}")))?),
                None => path(uri).and_then(|path| beside.file(&path, u64::MAX)),
            };
            match bytes {
                Some(bytes) if bytes.len() < told => Err(short(bytes.len(), None)),
                Some(bytes) => Ok(Source::Here(Cow::Owned(bytes), None)),
                None => Ok(Source::Elsewhere(shown(uri.as_bytes()))),
            }
        }
        (None, Some((place, chunk))) if number == 0 => {
            if chunk.len() < told {
                return Err(short(chunk.len(), Some(place)));
            }
            if chunk.len() - told > 3 {
                warnings.push(format!("bytes after the end of the binary data were left out: {}", chunk.len() - told));
            }
            Ok(Source::Here(Cow::Borrowed(&chunk[..told]), Some(place)))
        }
        (None, _) => Ok(Source::Nowhere),
    }
}

/// The bytes of a `data:` address; none where it is another kind of address.
pub(super) fn data(uri: &str) -> Option<Result<Vec<u8>, &'static str>> {
    let (scheme, rest) = uri.split_at_checked(5)?;
    if !scheme.eq_ignore_ascii_case("data:") {
        return None;
    }
    Some(match rest.split_once(',') {
        Some((kind, text)) if kind.ends_with(";base64") => BASE64.decode(text).map_err(|_| "is not base64"),
        _ => Err("is not a data address with base64"),
    })
}

/// The path of an address that is relative; none for other kinds of address.
pub(super) fn path(uri: &str) -> Option<String> {
    let is_path = !uri.is_empty() && !uri.contains("://") && uri.len() <= LONGEST_PATH;
    if is_path { percent_decoded(uri) } else { None }
}

/// The entry of a list that the document names.
pub(super) fn entry<'l, T>(list: &'l [T], number: Whole, what: &str) -> Result<&'l T, ReadError> {
    list.get(number.index())
        .ok_or_else(|| malformed(format!("the document names {what} {}, and there are {}", number.0, list.len())))
}

/// An error about something that the specification forbids.
pub(super) fn malformed(detail: impl std::fmt::Display) -> ReadError {
    ReadError::whole(ReadErrorKind::Malformed, format!("{detail}; export the model again"))
}
