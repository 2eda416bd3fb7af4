//! Pieces of JSON that hold no more memory than they must.

use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;
use std::ops::Deref;

use serde::Deserialize;
use serde::de::{Deserializer, Error, SeqAccess, Unexpected, Visitor};

use super::super::errors::{Place, ReadError, ReadErrorKind};

/// Most entries of any list.
pub(super) const MOST_ENTRIES: usize = 1 << 20;
/// How the error about more entries begins.
const TOO_MANY: &str = "there are more than";
/// Most bytes of a document beside its texts, which may be whole buffers. What one becomes in memory is a few times this.
const MOST_BYTES: usize = 32 << 20;

/// Reads a document; `offset` is its place in a file where bytes are counted, none where lines are.
pub(super) fn parse<'a, T: Deserialize<'a>>(text: &'a [u8], offset: Option<usize>) -> Result<T, ReadError> {
    if text.len() > MOST_BYTES && outside_texts(text) > MOST_BYTES {
        let detail = format!("the glTF document is longer than {MOST_BYTES} bytes; split the model before you send it");
        return Err(ReadError::whole(ReadErrorKind::TooLarge, detail));
    }
    serde_json::from_slice(text).map_err(|error| {
        let place = match offset {
            Some(offset) => Place::Byte((offset + byte_of(text, error.line(), error.column())) as u64),
            None => Place::Line(error.line() as u64),
        };
        let words = error.to_string();
        // The place is told in the reader's own way.
        let words = words.split(" at line ").next().unwrap_or(&words);
        let kind = if words.starts_with(TOO_MANY) {
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

/// The bytes of a document that are not within quotation marks.
fn outside_texts(text: &[u8]) -> usize {
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

/// The offset of a line and column, both counted from 1.
fn byte_of(text: &[u8], line: usize, column: usize) -> usize {
    let before: usize = text.split_inclusive(|&b| b == b'\n').take(line.saturating_sub(1)).map(<[u8]>::len).sum();
    (before + column.saturating_sub(1)).min(text.len())
}

/// A number that counts or names something; `3.0` is taken for 3, as JSON has one kind of numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct Whole(pub u32);

impl Whole {
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

impl<'de> Deserialize<'de> for Whole {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Number;
        impl Visitor<'_> for Number {
            type Value = Whole;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a whole number from 0 to 4294967295")
            }

            fn visit_u64<E: Error>(self, number: u64) -> Result<Whole, E> {
                u32::try_from(number).map(Whole).map_err(|_| E::invalid_value(Unexpected::Unsigned(number), &self))
            }

            fn visit_f64<E: Error>(self, number: f64) -> Result<Whole, E> {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the very question")]
                let whole = number as u32;
                if f64::from(whole) == number {
                    Ok(Whole(whole))
                } else {
                    Err(E::invalid_value(Unexpected::Float(number), &self))
                }
            }
        }
        deserializer.deserialize_u64(Number)
    }
}

/// A text, copied only where it has escapes.
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
                f.write_str("a text")
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

/// A list of at most [`MOST_ENTRIES`].
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
                    if list.len() == MOST_ENTRIES {
                        return Err(A::Error::custom(format!("{TOO_MANY} {MOST_ENTRIES} entries in a list")));
                    }
                    list.push(entry);
                }
                Ok(list)
            }
        }
        deserializer.deserialize_seq(Entries(PhantomData)).map(List)
    }
}
