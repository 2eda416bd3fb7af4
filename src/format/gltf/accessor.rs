//! Accessors: typed elements in a buffer view, with sparse replacements (glTF 2.0, 3.6.2).

use std::borrow::Cow;

use super::super::errors::{FileLocation, ReadError, ReadErrorKind};
use super::container::Integer;
use super::document::{AccessorEntry, Shape, Sparse};
use super::file::{File, entry, malformed};

/// The component type of an accessor.
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
    /// The component type of a glTF code; `label` is the accessor, for the error.
    fn of(code: Integer, label: &str) -> Result<Self, ReadError> {
        Ok(match code.0 {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            other => {
                return Err(malformed(format!("{label} has the component type {other}, which glTF does not define")));
            }
        })
    }

    /// Size in bytes.
    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The largest index of this type, which would restart a primitive, and which glTF forbids.
    pub fn restart_index(self) -> u32 {
        match self {
            Self::I8 | Self::U8 => u32::from(u8::MAX),
            Self::I16 | Self::U16 => u32::from(u16::MAX),
            Self::U32 | Self::F32 => u32::MAX,
        }
    }
}

/// Elements of one type, checked against the size of their buffer view. Elements without bytes are zero.
pub(super) struct Accessor<'f> {
    /// Number of elements.
    pub count: usize,
    /// Type of the numbers.
    pub component: Component,
    /// Number of components in an element.
    pub width: usize,
    normalized: bool,
    bytes: Cow<'f, [u8]>,
    stride: usize,
    place: Option<usize>,
    sparse: Option<SparseElements<'f>>,
}

/// Sparse elements, which replace elements of the buffer view.
struct SparseElements<'f> {
    /// Indices of the replaced elements, ascending.
    indices: Vec<u32>,
    bytes: &'f [u8],
}

impl<'f> Accessor<'f> {
    /// The accessor with this index in the document.
    pub fn new(file: &'f File<'_>, number: Integer) -> Result<Self, ReadError> {
        let declared = entry(&file.document.accessors, number, "accessor")?;
        let label = format!("accessor {}", number.0);
        let component = Component::of(declared.component_type, &label)?;
        let width = match declared.shape {
            Shape::Scalar => 1,
            Shape::Vec2 => 2,
            Shape::Vec3 => 3,
            Shape::Vec4 | Shape::Mat2 => 4,
            Shape::Mat3 => 9,
            Shape::Mat4 => 16,
        };
        let count = declared.count.index();
        let mut accessor = Self {
            count,
            component,
            width,
            normalized: declared.normalized,
            bytes: Cow::Borrowed(&[]),
            stride: width * component.size(),
            place: None,
            sparse: None,
        };
        match declared.buffer_view {
            Some(view) => accessor.find_bytes(file, view, declared, &label)?,
            // Without a buffer view all elements are zero and take no bytes, so their number is bounded by the file's size.
            None if count > file.length => {
                let detail = format!(
                    "{label} declares {count} elements without data, more than the file's {} bytes",
                    file.length
                );
                return Err(ReadError::for_file(ReadErrorKind::TooLarge, format!("{detail}; export the model again")));
            }
            None => {}
        }
        if let Some(sparse) = &declared.sparse {
            accessor.sparse = Some(accessor.sparse_elements(file, sparse, &label)?);
        }
        Ok(accessor)
    }

    /// An accessor of decoded floats.
    pub fn from_floats(values: &[f32], width: usize) -> Self {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self::from_bytes(bytes, Component::F32, width)
    }

    /// An accessor of decoded indices.
    pub fn from_indices(values: impl Iterator<Item = u32>) -> Self {
        Self::from_bytes(values.flat_map(u32::to_le_bytes).collect(), Component::U32, 1)
    }

    fn from_bytes(bytes: Vec<u8>, component: Component, width: usize) -> Self {
        let stride = width * component.size();
        let count = bytes.len() / stride;
        Self { count, component, width, normalized: false, bytes: Cow::Owned(bytes), stride, place: None, sparse: None }
    }

    /// Finds the accessor's bytes in its buffer view.
    fn find_bytes(
        &mut self,
        file: &'f File<'_>,
        view: Integer,
        declared: &AccessorEntry,
        label: &str,
    ) -> Result<(), ReadError> {
        let view = file.view(view)?;
        let size = self.stride;
        let stride = view.stride.unwrap_or(size);
        if stride < size {
            return Err(malformed(format!(
                "{label} has elements of {size} bytes, but a stride of only {stride} bytes"
            )));
        }
        let begin = declared.byte_offset.index();
        // The last element needs no padding.
        let needed = self.count.checked_sub(1).map_or(0, |before| before as u64 * stride as u64 + size as u64);
        let end = begin as u64 + needed;
        if end > view.bytes.len() as u64 {
            let detail = format!(
                "{label} spans {} elements, {needed} bytes from byte {begin}, beyond its buffer view of {} bytes; the file is damaged, so export the model again",
                self.count,
                view.bytes.len()
            );
            let place = view.place.map(|at| FileLocation::Byte(at as u64));
            return Err(ReadError { place, ..ReadError::for_file(ReadErrorKind::Truncated, detail) });
        }
        self.bytes = Cow::Borrowed(view.bytes.get(begin..).unwrap_or_default());
        self.stride = stride;
        self.place = view.place.map(|place| place + begin);
        Ok(())
    }

    /// Reads the sparse elements.
    fn sparse_elements(
        &self,
        file: &'f File<'_>,
        sparse: &Sparse,
        label: &str,
    ) -> Result<SparseElements<'f>, ReadError> {
        let count = sparse.count.index();
        let component = Component::of(sparse.indices.component_type, label)?;
        let part = |view: Integer, offset: Integer, size: usize| {
            let bytes = file.view(view)?.bytes;
            let end = count.checked_mul(size).and_then(|length| length.checked_add(offset.index()));
            end.and_then(|end| bytes.get(offset.index()..end)).ok_or_else(|| {
                malformed(format!("{label} declares {count} sparse elements, but their buffer views are too short"))
            })
        };
        let size = self.width * self.component.size();
        let bytes = part(sparse.values.buffer_view, sparse.values.byte_offset, size)?;
        let numbers = part(sparse.indices.buffer_view, sparse.indices.byte_offset, component.size())?;
        file.count_work(count)?;
        let indices: Vec<u32> = numbers.chunks_exact(component.size()).map(|bytes| integer(component, bytes)).collect();
        if !indices.is_sorted_by(|a, b| a < b) || indices.last().is_some_and(|&last| last as usize >= self.count) {
            let detail = format!("{label} has sparse indices that are out of range or not in ascending order");
            return Err(malformed(detail));
        }
        Ok(SparseElements { indices, bytes })
    }

    /// The bytes of an element; empty if it has none.
    fn element(&self, number: usize) -> &[u8] {
        let size = self.width * self.component.size();
        if let Some(sparse) = &self.sparse
            && let Ok(at) = sparse.indices.binary_search_by(|index| (*index as usize).cmp(&number))
        {
            return &sparse.bytes[at * size..][..size];
        }
        let begin = number.saturating_mul(self.stride);
        self.bytes.get(begin..begin.saturating_add(size)).unwrap_or_default()
    }

    /// The first N components of an element. Normalized integers become fractions.
    #[inline]
    pub fn floats<const N: usize>(&self, number: usize) -> [f32; N] {
        self.read(number, self.normalized)
    }

    /// As [`Self::floats`], but all integers become fractions, normalized or not.
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

    /// The first N components of an element as whole numbers; fractions are truncated.
    pub fn integers<const N: usize>(&self, number: usize) -> [u32; N] {
        let mut values = [0; N];
        for (value, bytes) in values.iter_mut().zip(self.element(number).chunks_exact(self.component.size())) {
            *value = integer(self.component, bytes);
        }
        values
    }

    /// The location of an element in the file; `None` for encoded or sidecar data.
    pub fn location(&self, number: usize) -> Option<FileLocation> {
        self.place.map(|place| FileLocation::Byte((place + number * self.stride) as u64))
    }
}

/// A component as f32; normalized integers become fractions (glTF 2.0, 3.6.2.2).
#[inline]
fn float(component: Component, bytes: &[u8], normalized: bool) -> f32 {
    let fraction = |value: f32, most: f32| if normalized { (value / most).max(-1.0) } else { value };
    match (component, bytes) {
        (Component::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
        (Component::I8, &[a]) => fraction(f32::from(a.cast_signed()), 127.0),
        (Component::U8, &[a]) => fraction(f32::from(a), 255.0),
        (Component::I16, &[a, b]) => fraction(f32::from(i16::from_le_bytes([a, b])), 32767.0),
        (Component::U16, &[a, b]) => fraction(f32::from(u16::from_le_bytes([a, b])), 65535.0),
        #[expect(clippy::cast_precision_loss, reason = "no attribute that is read has u32 components")]
        (Component::U32, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]) as f32,
        _ => 0.0,
    }
}

/// A component as a whole number.
fn integer(component: Component, bytes: &[u8]) -> u32 {
    match (component, bytes) {
        (Component::U8 | Component::I8, &[a]) => u32::from(a),
        (Component::U16 | Component::I16, &[a, b]) => u32::from(u16::from_le_bytes([a, b])),
        (Component::U32, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "fractions are truncated")]
        (Component::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]) as u32,
        _ => 0,
    }
}
