//! A glTF file with its buffers and buffer views (glTF 2.0, 3.6.1).

use std::borrow::Cow;
use std::cell::Cell;

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use super::super::archive::percent_decoded;
use super::super::errors::{FileLocation, ReadError, ReadErrorKind, excerpt};
use super::super::limits::Limits;
use super::super::sidecar::Sidecars;
use super::container::Integer;
use super::document::{Buffer, BufferView, Document};

const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// Maximum length of a path to a sidecar file, in bytes.
const MAX_PATH_BYTES: usize = 4096;

/// A document with its buffers.
pub(super) struct File<'a> {
    /// The JSON document.
    pub document: Document<'a>,
    buffers: Vec<BufferData<'a>>,
    /// Limits on the result.
    pub limits: Limits,
    /// The sidecar files.
    pub sidecars: &'a Sidecars<'a>,
    /// Size of the file in bytes.
    pub length: usize,
    /// Entries processed by [`File::count_work`] so far.
    work: Cell<u64>,
}

/// Where buffers without embedded data come from.
pub(super) struct BufferSources<'a> {
    /// The binary chunk of GLB with its byte offset in the file.
    pub binary: Option<(usize, &'a [u8])>,
    /// The sidecar files.
    pub sidecars: &'a Sidecars<'a>,
}

/// The bytes of a buffer.
enum BufferData<'a> {
    /// The bytes, and their offset in the file if they are stored there unencoded.
    Bytes(Cow<'a, [u8]>, Option<usize>),
    /// A sidecar file that was not sent.
    MissingFile(String),
    /// No bytes, for example because an extension provides them.
    Absent,
}

/// The bytes of a buffer view.
#[derive(Clone, Copy)]
pub(super) struct View<'f> {
    /// The bytes.
    pub bytes: &'f [u8],
    /// Their offset in the file; `None` for encoded or sidecar data.
    pub place: Option<usize>,
    /// Distance in bytes between the starts of elements, if declared.
    pub stride: Option<usize>,
}

impl<'a> File<'a> {
    /// Resolves all buffers of a file of `length` bytes.
    ///
    /// # Errors
    /// A [`ReadError`] if a buffer is shorter than declared or its embedded data is malformed.
    pub fn new(
        document: Document<'a>,
        sources: &BufferSources<'a>,
        limits: Limits,
        length: usize,
        warnings: &mut Vec<String>,
    ) -> Result<Self, ReadError> {
        let mut buffers = Vec::with_capacity(document.buffers.len());
        for (number, buffer) in document.buffers.iter().enumerate() {
            buffers.push(buffer_data(number, buffer, sources, warnings)?);
        }
        Ok(Self { document, buffers, limits, sidecars: sources.sidecars, length, work: Cell::new(0) })
    }

    /// Counts the work on `entries` entries. Without a limit, a small file could cause any amount of work by referring to the same data
    /// often.
    pub fn count_work(&self, entries: usize) -> Result<(), ReadError> {
        self.work.set(self.work.get().saturating_add(entries as u64));
        if self.work.get() > self.limits.max_vertices.saturating_mul(2) {
            let detail =
                "the file refers to the same compressed data, sparse data or skins too often; export the model again";
            return Err(ReadError::for_file(ReadErrorKind::TooLarge, detail));
        }
        Ok(())
    }

    /// The bytes of a buffer view.
    pub fn view(&self, number: Integer) -> Result<View<'_>, ReadError> {
        let view = entry(&self.document.buffer_views, number, "buffer view")?;
        let label = format!("buffer view {}", number.0);
        let (bytes, place) = self.buffer(view)?;
        let begin = view.byte_offset.index();
        let part = begin.checked_add(view.byte_length.index()).and_then(|end| bytes.get(begin..end));
        let Some(part) = part else {
            return Err(malformed(format!(
                "{label} spans {} bytes from byte {begin}, beyond its buffer of {} bytes",
                view.byte_length.0,
                bytes.len()
            )));
        };
        let stride = view.byte_stride.map(Integer::index).filter(|&stride| stride > 0);
        Ok(View { bytes: part, place: place.map(|place| place + begin), stride })
    }

    fn buffer(&self, view: &BufferView) -> Result<(&[u8], Option<usize>), ReadError> {
        match entry(&self.buffers, view.buffer, "buffer")? {
            BufferData::Bytes(bytes, place) => Ok((bytes, *place)),
            BufferData::MissingFile(name) => Err(ReadError::for_file(
                ReadErrorKind::UnsupportedFormat,
                format!(
                    "the model's data is in another file, '{name}', which was not sent; export a self-contained GLB file, or send both files in a ZIP archive"
                ),
            )),
            BufferData::Absent if view.extensions.meshopt.is_some() => Err(ReadError::for_file(
                ReadErrorKind::UnsupportedFormat,
                "the file is compressed with meshopt (`EXT_meshopt_compression`), which is not supported; export the model without compression",
            )),
            BufferData::Absent => {
                let detail = format!("buffer {} has no data: the file has no binary chunk for it", view.buffer.0);
                Err(ReadError::for_file(ReadErrorKind::Truncated, format!("{detail}; export the model again as GLB")))
            }
        }
    }
}

fn buffer_data<'a>(
    number: usize,
    buffer: &Buffer<'a>,
    sources: &BufferSources<'a>,
    warnings: &mut Vec<String>,
) -> Result<BufferData<'a>, ReadError> {
    let declared = buffer.byte_length.index();
    let short = |found: usize, place: Option<usize>| {
        let detail = format!(
            "buffer {number} declares {declared} bytes but has {found}; the file was probably cut off, so send it again"
        );
        ReadError {
            place: place.map(|at| FileLocation::Byte(at as u64)),
            ..ReadError::for_file(ReadErrorKind::Truncated, detail)
        }
    };
    match (&buffer.uri, sources.binary) {
        (Some(uri), _) => {
            let bytes = match decode_data_uri(uri) {
                Some(bytes) => Some(bytes.map_err(|why| malformed(format!("the data of buffer {number} {why}")))?),
                None => relative_path(uri).and_then(|path| sources.sidecars.read_file(&path, u64::MAX)),
            };
            match bytes {
                Some(bytes) if bytes.len() < declared => Err(short(bytes.len(), None)),
                Some(bytes) => Ok(BufferData::Bytes(Cow::Owned(bytes), None)),
                None => Ok(BufferData::MissingFile(excerpt(uri.as_bytes()))),
            }
        }
        (None, Some((place, chunk))) if number == 0 => {
            if chunk.len() < declared {
                return Err(short(chunk.len(), Some(place)));
            }
            if chunk.len() - declared > 3 {
                warnings
                    .push(format!("bytes after the end of the binary data were ignored: {}", chunk.len() - declared));
            }
            Ok(BufferData::Bytes(Cow::Borrowed(&chunk[..declared]), Some(place)))
        }
        (None, _) => Ok(BufferData::Absent),
    }
}

/// Decodes a `data:` URI; `None` for other URIs.
pub(super) fn decode_data_uri(uri: &str) -> Option<Result<Vec<u8>, &'static str>> {
    let (scheme, rest) = uri.split_at_checked(5)?;
    if !scheme.eq_ignore_ascii_case("data:") {
        return None;
    }
    Some(match rest.split_once(',') {
        Some((kind, text)) if kind.ends_with(";base64") => BASE64.decode(text).map_err(|_| "is not valid base64"),
        _ => Err("is not a data URI in base64"),
    })
}

/// The path of a relative URI; `None` for other URIs.
pub(super) fn relative_path(uri: &str) -> Option<String> {
    let is_path = !uri.is_empty() && !uri.contains("://") && uri.len() <= MAX_PATH_BYTES;
    if is_path { percent_decoded(uri) } else { None }
}

/// The entry of a list by its index in the document. `what` is the kind of entry, for the error.
pub(super) fn entry<'l, T>(list: &'l [T], number: Integer, what: &str) -> Result<&'l T, ReadError> {
    list.get(number.index())
        .ok_or_else(|| malformed(format!("the document refers to {what} {}, but has only {}", number.0, list.len())))
}

/// An error about content that violates the specification. The advice to export the model again is added.
pub(super) fn malformed(detail: impl std::fmt::Display) -> ReadError {
    ReadError::for_file(ReadErrorKind::Malformed, format!("{detail}; export the model again"))
}
