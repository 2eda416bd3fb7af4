//! A whole file: its document, the buffers that it names, and numbers in them (glTF 2.0, 3.6.2).

use std::borrow::Cow;
use std::cell::Cell;

use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use super::super::archive::percent_decoded;
use super::super::errors::{Place, ReadError, ReadErrorKind, shown};
use super::super::limits::Limits;
use super::super::sidecar::Sidecars;
use super::container::Whole;
use super::document::{AccessorEntry, Buffer, BufferView, Document, Shape, Sparse};

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
    pub sidecars: &'a Sidecars<'a>,
    /// How many bytes the file has.
    pub length: usize,
    /// Work that the faces and vertices of the result do not count.
    spent: Cell<u64>,
}

/// The bytes that come with a document, for its buffers.
pub(super) struct Attached<'a> {
    /// The binary chunk with its offset in the file.
    pub binary: Option<(usize, &'a [u8])>,
    /// The files that came with it.
    pub sidecars: &'a Sidecars<'a>,
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
    /// Finds the bytes of all buffers in a file of `length` bytes.
    pub fn new(
        document: Document<'a>,
        attached: &Attached<'a>,
        limits: Limits,
        length: usize,
        warnings: &mut Vec<String>,
    ) -> Result<Self, ReadError> {
        let mut buffers = Vec::with_capacity(document.buffers.len());
        for (number, buffer) in document.buffers.iter().enumerate() {
            buffers.push(source(number, buffer, attached, warnings)?);
        }
        Ok(Self { document, buffers, limits, sidecars: attached.sidecars, length, spent: Cell::new(0) })
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
    attached: &Attached<'a>,
    warnings: &mut Vec<String>,
) -> Result<Source<'a>, ReadError> {
    let told = buffer.byte_length.index();
    let short = |found: usize, place: Option<usize>| {
        let detail = format!(
            "buffer {number} is to have {told} bytes and has {found}; the file was probably cut off, so send it again"
        );
        ReadError {
            place: place.map(|at| Place::Byte(at as u64)),
            ..ReadError::whole(ReadErrorKind::Truncated, detail)
        }
    };
    match (&buffer.uri, attached.binary) {
        (Some(uri), _) => {
            let bytes = match data(uri) {
                Some(bytes) => Some(bytes.map_err(|why| malformed(format!("the data of buffer {number} {why}")))?),
                None => path(uri).and_then(|path| attached.sidecars.file(&path, u64::MAX)),
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

/// The kind of number in a buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(code: Whole, what: &str) -> Result<Self, ReadError> {
        Ok(match code.0 {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            other => return Err(malformed(format!("{what} has the component type {other}, which there is not"))),
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The largest index of this type, which would restart a primitive and is forbidden.
    pub fn restart(self) -> u32 {
        match self {
            Self::I8 | Self::U8 => u32::from(u8::MAX),
            Self::I16 | Self::U16 => u32::from(u16::MAX),
            Self::U32 | Self::F32 => u32::MAX,
        }
    }
}

/// Elements of equal shape, checked against the bytes that are there. What lies beyond the bytes is zero.
pub(super) struct Accessor<'f> {
    pub count: usize,
    pub component: Component,
    /// Numbers in an element.
    pub width: usize,
    normalized: bool,
    bytes: Cow<'f, [u8]>,
    stride: usize,
    place: Option<usize>,
    sparse: Option<Replaced<'f>>,
}

/// Elements that stand elsewhere.
struct Replaced<'f> {
    /// Which, ascending.
    which: Vec<u32>,
    bytes: &'f [u8],
}

impl<'f> Accessor<'f> {
    pub fn new(file: &'f File<'_>, number: Whole) -> Result<Self, ReadError> {
        let told = entry(&file.document.accessors, number, "accessor")?;
        let what = format!("accessor {}", number.0);
        let component = Component::of(told.component_type, &what)?;
        let width = match told.shape {
            Shape::Scalar => 1,
            Shape::Vec2 => 2,
            Shape::Vec3 => 3,
            Shape::Vec4 | Shape::Mat2 => 4,
            Shape::Mat3 => 9,
            Shape::Mat4 => 16,
        };
        let count = told.count.index();
        let mut it = Self {
            count,
            component,
            width,
            normalized: told.normalized,
            bytes: Cow::Borrowed(&[]),
            stride: width * component.size(),
            place: None,
            sparse: None,
        };
        match told.buffer_view {
            Some(view) => it.find_bytes(file, view, told, &what)?,
            // All zeros by the specification, which cost no byte: as many are believed as the file has bytes.
            None if count > file.length => {
                let detail = format!("{what} has {count} elements without data, in a file of {} bytes", file.length);
                return Err(ReadError::whole(ReadErrorKind::TooLarge, format!("{detail}; export the model again")));
            }
            None => {}
        }
        if let Some(sparse) = &told.sparse {
            it.sparse = Some(it.replaced(file, sparse, &what)?);
        }
        Ok(it)
    }

    /// Decoded numbers.
    pub fn of_floats(values: &[f32], width: usize) -> Self {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self::of_bytes(bytes, Component::F32, width)
    }

    /// Decoded indices.
    pub fn of_indices(values: impl Iterator<Item = u32>) -> Self {
        Self::of_bytes(values.flat_map(u32::to_le_bytes).collect(), Component::U32, 1)
    }

    fn of_bytes(bytes: Vec<u8>, component: Component, width: usize) -> Self {
        let stride = width * component.size();
        let count = bytes.len() / stride;
        Self { count, component, width, normalized: false, bytes: Cow::Owned(bytes), stride, place: None, sparse: None }
    }

    fn find_bytes(
        &mut self,
        file: &'f File<'_>,
        view: Whole,
        told: &AccessorEntry,
        what: &str,
    ) -> Result<(), ReadError> {
        let view = file.view(view)?;
        let size = self.stride;
        let stride = view.stride.unwrap_or(size);
        if stride < size {
            return Err(malformed(format!("{what} has elements of {size} bytes every {stride} bytes")));
        }
        let begin = told.byte_offset.index();
        // The last element has no gap after it.
        let needed = self.count.checked_sub(1).map_or(0, |before| before as u64 * stride as u64 + size as u64);
        let end = begin as u64 + needed;
        if end > view.bytes.len() as u64 {
            let detail = format!(
                "{what} has {} elements, {needed} bytes from byte {begin} of a buffer view of {} bytes; the file is damaged, so export the model again",
                self.count,
                view.bytes.len()
            );
            let place = view.place.map(|at| Place::Byte(at as u64));
            return Err(ReadError { place, ..ReadError::whole(ReadErrorKind::Truncated, detail) });
        }
        self.bytes = Cow::Borrowed(view.bytes.get(begin..).unwrap_or_default());
        self.stride = stride;
        self.place = view.place.map(|place| place + begin);
        Ok(())
    }

    fn replaced(&self, file: &'f File<'_>, sparse: &Sparse, what: &str) -> Result<Replaced<'f>, ReadError> {
        let count = sparse.count.index();
        let component = Component::of(sparse.indices.component_type, what)?;
        let part = |view: Whole, offset: Whole, size: usize| {
            let bytes = file.view(view)?.bytes;
            let end = count.checked_mul(size).and_then(|length| length.checked_add(offset.index()));
            end.and_then(|end| bytes.get(offset.index()..end)).ok_or_else(|| {
                malformed(format!("{what} replaces {count} elements, for which there are not enough bytes"))
            })
        };
        let size = self.width * self.component.size();
        let bytes = part(sparse.values.buffer_view, sparse.values.byte_offset, size)?;
        let numbers = part(sparse.indices.buffer_view, sparse.indices.byte_offset, component.size())?;
        file.spend(count)?;
        let which: Vec<u32> = numbers.chunks_exact(component.size()).map(|bytes| whole(component, bytes)).collect();
        if !which.is_sorted_by(|a, b| a < b) || which.last().is_some_and(|&last| last as usize >= self.count) {
            let detail = format!("{what} replaces elements that are not there, or not in ascending order");
            return Err(malformed(detail));
        }
        Ok(Replaced { which, bytes })
    }

    /// The bytes of an element.
    fn element(&self, number: usize) -> &[u8] {
        let size = self.width * self.component.size();
        if let Some(sparse) = &self.sparse
            && let Ok(at) = sparse.which.binary_search_by(|which| (*which as usize).cmp(&number))
        {
            return &sparse.bytes[at * size..][..size];
        }
        let begin = number.saturating_mul(self.stride);
        self.bytes.get(begin..begin.saturating_add(size)).unwrap_or_default()
    }

    /// The first numbers of an element as fractions where integers are said to be such, else as they are.
    #[inline]
    pub fn floats<const N: usize>(&self, number: usize) -> [f32; N] {
        self.read(number, self.normalized)
    }

    /// As [`Self::floats`], integers being fractions whatever is said.
    pub fn fractions<const N: usize>(&self, number: usize) -> [f32; N] {
        self.read(number, true)
    }

    #[inline]
    fn read<const N: usize>(&self, number: usize, normalized: bool) -> [f32; N] {
        let mut values = [0.0; N];
        let bytes = self.element(number).chunks_exact(self.component.size());
        for (value, bytes) in values.iter_mut().zip(bytes) {
            *value = float(self.component, bytes, normalized);
        }
        values
    }

    /// The first numbers of an element as whole numbers; fractions are cut.
    pub fn wholes<const N: usize>(&self, number: usize) -> [u32; N] {
        let mut values = [0; N];
        for (value, bytes) in values.iter_mut().zip(self.element(number).chunks_exact(self.component.size())) {
            *value = whole(self.component, bytes);
        }
        values
    }

    /// Where in the file an element is.
    pub fn place(&self, number: usize) -> Option<Place> {
        self.place.map(|place| Place::Byte((place + number * self.stride) as u64))
    }
}

/// A number; fractions after glTF 2.0, 3.6.2.2.
#[inline]
fn float(component: Component, bytes: &[u8], normalized: bool) -> f32 {
    let fraction = |value: f32, most: f32| if normalized { (value / most).max(-1.0) } else { value };
    match (component, bytes) {
        (Component::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
        (Component::I8, &[a]) => fraction(f32::from(a.cast_signed()), 127.0),
        (Component::U8, &[a]) => fraction(f32::from(a), 255.0),
        (Component::I16, &[a, b]) => fraction(f32::from(i16::from_le_bytes([a, b])), 32767.0),
        (Component::U16, &[a, b]) => fraction(f32::from(u16::from_le_bytes([a, b])), 65535.0),
        #[expect(clippy::cast_precision_loss, reason = "no attribute that is read has such numbers")]
        (Component::U32, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]) as f32,
        _ => 0.0,
    }
}

fn whole(component: Component, bytes: &[u8]) -> u32 {
    match (component, bytes) {
        (Component::U8 | Component::I8, &[a]) => u32::from(a),
        (Component::U16 | Component::I16, &[a, b]) => u32::from(u16::from_le_bytes([a, b])),
        (Component::U32, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "fractions are cut")]
        (Component::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]) as u32,
        _ => 0,
    }
}
