//! Reading the numbers of PLY elements in sequence: from binary of either byte order, or from text.

use super::super::errors::{ReadError, ReadErrorKind, excerpt};
use super::super::text::{Text, number};
use super::header::{Element, PropertyType, Row, Scalar};

/// A source of the elements' numbers, read in sequence.
pub(super) trait Values {
    /// Reads a number as f64. `row` is named in errors.
    fn read_number(&mut self, scalar: Scalar, row: Row<'_>) -> Result<f64, ReadError>;

    /// Reads an optional number, such as a normal's; malformed text gives not-a-number.
    fn read_optional(&mut self, scalar: Scalar, row: Row<'_>) -> Result<f64, ReadError> {
        self.read_number(scalar, row)
    }

    /// Reads a whole number.
    fn read_integer(&mut self, scalar: Scalar, row: Row<'_>) -> Result<i64, ReadError>;

    /// Skips `count` numbers.
    fn skip(&mut self, scalar: Scalar, count: u64, row: Row<'_>) -> Result<(), ReadError>;

    /// Skips all rows of an element.
    fn skip_element(&mut self, element: &Element) -> Result<(), ReadError>;

    /// An upper bound of the numbers left in the file.
    fn max_left(&self, scalar: Scalar) -> u64;

    /// An error at the number that was read last.
    fn error(&self, kind: ReadErrorKind, detail: String) -> ReadError;

    /// A warning about bytes after the last element; `None` if there are none.
    fn trailing_warning(&mut self) -> Option<String>;
}

/// Skips the rows of an element number by number, for elements with lists and for text.
fn skip_rows<V: Values>(values: &mut V, element: &Element) -> Result<(), ReadError> {
    if element.properties.is_empty() {
        return Ok(());
    }
    for row in element.rows() {
        for property in &element.properties {
            match property.value_type {
                PropertyType::Scalar(scalar) => values.skip(scalar, 1, row)?,
                PropertyType::List { count, item } => {
                    let length = list_length(values, count, row)?;
                    values.skip(item, length, row)?;
                }
            }
        }
    }
    Ok(())
}

/// Reads the length of a list.
pub(super) fn list_length<V: Values>(values: &mut V, count: Scalar, row: Row<'_>) -> Result<u64, ReadError> {
    let length = values.read_integer(count, row)?;
    u64::try_from(length).map_err(|_| {
        values.error(
            ReadErrorKind::Malformed,
            format!(
                "a list in {row_name} has the length {length}; a length can't be below zero, so export the model again",
                row_name = row_name(row)
            ),
        )
    })
}

/// A row for an error message, such as `'vertex' 7 of 100`.
fn row_name(row: Row<'_>) -> String {
    let Row { element, number } = row;
    format!("'{}' {number} of {}", excerpt(element.name.as_bytes()), element.count)
}

/// Binary numbers; little-endian if `LITTLE` is true.
pub(super) struct BinaryValues<'a, const LITTLE: bool> {
    bytes: &'a [u8],
    /// Offset of the next number.
    at: usize,
    /// Offset of the number that was read last.
    last: usize,
}

impl<'a, const LITTLE: bool> BinaryValues<'a, LITTLE> {
    /// Starts at the byte offset `at`.
    pub fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at, last: at }
    }

    #[inline]
    fn take<const N: usize>(&mut self, row: Row<'_>) -> Result<[u8; N], ReadError> {
        match self.bytes.get(self.at..).and_then(|rest| rest.first_chunk::<N>()) {
            Some(&chunk) => {
                self.last = self.at;
                self.at += N;
                Ok(chunk)
            }
            None => Err(self.ended(row)),
        }
    }

    #[cold]
    fn ended(&self, row: Row<'_>) -> ReadError {
        ReadError::at_byte(
            ReadErrorKind::Truncated,
            self.bytes.len(),
            format!("the file ends within {}; it was cut off or its counts are wrong, so send it again", row_name(row)),
        )
    }
}

/// Reads one number of type `$t`.
macro_rules! number {
    ($self:ident, $t:ty, $row:ident) => {{
        let bytes = $self.take::<{ size_of::<$t>() }>($row)?;
        if LITTLE { <$t>::from_le_bytes(bytes) } else { <$t>::from_be_bytes(bytes) }
    }};
}

impl<const LITTLE: bool> Values for BinaryValues<'_, LITTLE> {
    #[inline]
    fn read_number(&mut self, scalar: Scalar, row: Row<'_>) -> Result<f64, ReadError> {
        Ok(match scalar {
            Scalar::F32 => f64::from(number!(self, f32, row)),
            Scalar::F64 => number!(self, f64, row),
            Scalar::I8 => f64::from(number!(self, i8, row)),
            Scalar::U8 => f64::from(number!(self, u8, row)),
            Scalar::I16 => f64::from(number!(self, i16, row)),
            Scalar::U16 => f64::from(number!(self, u16, row)),
            Scalar::I32 => f64::from(number!(self, i32, row)),
            Scalar::U32 => f64::from(number!(self, u32, row)),
        })
    }

    #[inline]
    fn read_integer(&mut self, scalar: Scalar, row: Row<'_>) -> Result<i64, ReadError> {
        Ok(match scalar {
            Scalar::U8 => i64::from(number!(self, u8, row)),
            Scalar::I32 => i64::from(number!(self, i32, row)),
            Scalar::U32 => i64::from(number!(self, u32, row)),
            Scalar::I8 => i64::from(number!(self, i8, row)),
            Scalar::I16 => i64::from(number!(self, i16, row)),
            Scalar::U16 => i64::from(number!(self, u16, row)),
            // Not reachable: the header allows only integer types here.
            Scalar::F32 | Scalar::F64 => -1,
        })
    }

    fn skip(&mut self, scalar: Scalar, count: u64, row: Row<'_>) -> Result<(), ReadError> {
        let left = self.bytes.len() - self.at;
        let size = usize::try_from(count).ok().and_then(|count| count.checked_mul(scalar.size()));
        match size.filter(|&size| size <= left) {
            Some(size) => {
                self.at += size;
                Ok(())
            }
            None => Err(self.ended(row)),
        }
    }

    fn skip_element(&mut self, element: &Element) -> Result<(), ReadError> {
        match element.fixed_size() {
            // `Header::check_counts` has checked the total size.
            Some(size) => self.skip(Scalar::U8, element.count.saturating_mul(size as u64), Row { element, number: 0 }),
            None => skip_rows(self, element),
        }
    }

    fn max_left(&self, scalar: Scalar) -> u64 {
        ((self.bytes.len() - self.at) / scalar.size()) as u64
    }

    fn error(&self, kind: ReadErrorKind, detail: String) -> ReadError {
        ReadError::at_byte(kind, self.last, detail)
    }

    fn trailing_warning(&mut self) -> Option<String> {
        let rest = &self.bytes[self.at..];
        // Editors may add a line end after the last element.
        let is_line_end = rest.trim_ascii().is_empty() && rest.len() <= 2;
        (!is_line_end).then(|| format!("{} bytes after the last element were ignored", rest.len()))
    }
}

/// Numbers as text.
pub(super) struct AsciiValues<'a> {
    text: Text<'a>,
    /// Offset of the word that was read last.
    last: usize,
}

impl<'a> AsciiValues<'a> {
    /// Starts at the byte offset `at`.
    pub fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { text: Text::starting_at(bytes, at), last: at }
    }

    #[cold]
    fn ended(&self, row: Row<'_>) -> ReadError {
        self.text.ended(&row_name(row))
    }
}

impl Values for AsciiValues<'_> {
    #[inline]
    fn read_number(&mut self, scalar: Scalar, row: Row<'_>) -> Result<f64, ReadError> {
        let Some(word) = self.text.word() else { return Err(self.ended(row)) };
        self.last = word.at;
        let value = self.text.number(word, "a number")?;
        // A property declared as float is rounded to f32, as other readers do, however many digits the text has.
        #[expect(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
        let narrow = value as f32;
        Ok(if scalar == Scalar::F32 && narrow.is_finite() { f64::from(narrow) } else { value })
    }

    #[inline]
    fn read_optional(&mut self, _: Scalar, row: Row<'_>) -> Result<f64, ReadError> {
        let Some(word) = self.text.word() else { return Err(self.ended(row)) };
        Ok(number(word.bytes).unwrap_or(f64::NAN))
    }

    #[inline]
    fn read_integer(&mut self, _: Scalar, row: Row<'_>) -> Result<i64, ReadError> {
        let Some(word) = self.text.word() else { return Err(self.ended(row)) };
        self.last = word.at;
        self.text.integer(word, "a whole number")
    }

    fn skip(&mut self, _: Scalar, count: u64, row: Row<'_>) -> Result<(), ReadError> {
        for _ in 0..count {
            if self.text.word().is_none() {
                return Err(self.ended(row));
            }
        }
        Ok(())
    }

    fn skip_element(&mut self, element: &Element) -> Result<(), ReadError> {
        skip_rows(self, element)
    }

    fn max_left(&self, _: Scalar) -> u64 {
        self.text.remaining() as u64 / 2 + 1
    }

    fn error(&self, kind: ReadErrorKind, detail: String) -> ReadError {
        self.text.error(kind, self.last, detail)
    }

    fn trailing_warning(&mut self) -> Option<String> {
        self.text.word().map(|_| "text after the last element was ignored".to_owned())
    }
}
