//! Words, numbers and lines of text formats, shared by the readers of STL, OBJ, MTL, PLY, OFF and Vertex/Face text.

use std::num::IntErrorKind;

use super::errors::{FileLocation, ReadError, ReadErrorKind, excerpt};

/// A word of a text file and its byte offset.
#[derive(Debug, Clone, Copy)]
pub(super) struct Word<'a> {
    /// The word's bytes.
    pub bytes: &'a [u8],
    /// Byte offset of the word in the file.
    pub at: usize,
}

impl Word<'_> {
    /// Whether the word equals `keyword` (given in lowercase), ignoring case.
    pub fn is(&self, keyword: &str) -> bool {
        self.bytes.eq_ignore_ascii_case(keyword.as_bytes())
    }
}

/// A cursor over the words of a text file whose lines end in LF, CR LF or CR.
///
/// Words are byte sequences in no particular encoding. Line numbers are computed only when an error needs one.
#[derive(Debug, Clone)]
pub(super) struct Text<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Whether `#` at the start of a word begins a comment that runs to the end of the line.
    comments: bool,
    /// Whether a backslash before a line end joins the line to the next.
    continued: bool,
}

/// The UTF-8 byte order mark, which some editors write at the start of a file.
pub(super) const UTF8_MARK: &[u8] = b"\xEF\xBB\xBF";

impl<'a> Text<'a> {
    /// A cursor at the start of the text, after a byte order mark.
    pub fn new(bytes: &'a [u8]) -> Self {
        let at = if bytes.starts_with(UTF8_MARK) { UTF8_MARK.len() } else { 0 };
        Self { bytes, at, comments: false, continued: false }
    }

    /// A cursor at a byte offset, for text after a header.
    pub fn starting_at(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at, comments: false, continued: false }
    }

    /// Enables `#` comments.
    pub fn with_comments(mut self) -> Self {
        self.comments = true;
        self
    }

    /// Enables line continuation by backslash.
    pub fn with_continued_lines(mut self) -> Self {
        self.continued = true;
        self
    }

    /// Byte offset of the next unread byte.
    pub fn at(&self) -> usize {
        self.at
    }

    /// Number of unread bytes.
    pub fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// The next word on this line; `None` at the end of the line, which stays unread.
    #[inline]
    pub fn word_on_line(&mut self) -> Option<Word<'a>> {
        let bytes = self.bytes;
        let mut at = self.at;
        loop {
            match bytes.get(at) {
                Some(b' ' | b'\t' | 0x0B | 0x0C | 0) => at += 1,
                Some(b'\\') if self.continued => match line_end(bytes, at + 1) {
                    Some(next) => at = next,
                    None => break,
                },
                Some(b'#') if self.comments => {
                    while !matches!(bytes.get(at), None | Some(b'\n' | b'\r')) {
                        at += 1;
                    }
                }
                None | Some(b'\n' | b'\r') => {
                    self.at = at;
                    return None;
                }
                Some(_) => break,
            }
        }
        let start = at;
        at += 1;
        loop {
            match bytes.get(at) {
                None | Some(b' ' | b'\n' | b'\r' | b'\t' | 0x0B | 0x0C | 0) => break,
                Some(b'\\') if self.continued && line_end(bytes, at + 1).is_some() => break,
                Some(_) => at += 1,
            }
        }
        self.at = at;
        Some(Word { bytes: &bytes[start..at], at: start })
    }

    /// The next word on this or a later line; `None` at the end of the file.
    #[inline]
    pub fn word(&mut self) -> Option<Word<'a>> {
        loop {
            if let Some(word) = self.word_on_line() {
                return Some(word);
            }
            if !self.next_line() {
                return None;
            }
        }
    }

    /// Skips one line end; `false` at the end of the file.
    fn next_line(&mut self) -> bool {
        match line_end(self.bytes, self.at) {
            Some(next) => {
                self.at = next;
                true
            }
            None => false,
        }
    }

    /// Skips to the end of this line, ignoring continuation.
    pub fn skip_line(&mut self) {
        while !matches!(self.bytes.get(self.at), None | Some(b'\n' | b'\r')) {
            self.at += 1;
        }
    }

    /// The rest of this line, ignoring continuation, without surrounding white space.
    pub fn rest_of_line(&mut self) -> &'a [u8] {
        let begin = self.at;
        self.skip_line();
        self.bytes[begin..self.at].trim_ascii()
    }

    /// Skips to the end of this line and of all lines that continue it.
    pub fn skip_statement(&mut self) {
        while self.word_on_line().is_some() {}
    }

    /// An error at the line that contains the byte offset `at`.
    pub fn error(&self, kind: ReadErrorKind, at: usize, detail: impl Into<String>) -> ReadError {
        ReadError { kind, place: Some(FileLocation::Line(line_of(self.bytes, at))), detail: detail.into() }
    }

    /// An error for a file that ends where `expected` should be.
    pub fn ended(&self, expected: &str) -> ReadError {
        self.error(
            ReadErrorKind::Truncated,
            self.bytes.len(),
            format!("the file ends where {expected} was expected; it was probably cut off, so send it again"),
        )
    }

    /// Parses a word as a number. Spellings of infinity and not-a-number count as numbers, including Microsoft's `1.#QNAN`.
    #[inline]
    pub fn number(&self, word: Word<'_>, expected: &str) -> Result<f64, ReadError> {
        number(word.bytes).ok_or_else(|| self.not_a_number(word, expected))
    }

    #[cold]
    fn not_a_number(&self, word: Word<'_>, expected: &str) -> ReadError {
        let found = excerpt(word.bytes);
        let comma = word.bytes.contains(&b',') && number(&with_replaced_byte(word.bytes, b',', b'.')).is_some();
        let detail = if comma {
            format!("'{found}' has a decimal comma where {expected} was expected; export with decimal points")
        } else {
            format!("found '{found}' where {expected} was expected; export the model again")
        };
        self.error(ReadErrorKind::Malformed, word.at, detail)
    }

    /// Parses a word as a whole number; `3.0` counts as 3.
    #[inline]
    pub fn integer(&self, word: Word<'_>, expected: &str) -> Result<i64, ReadError> {
        integer(word.bytes).ok_or_else(|| {
            self.error(
                ReadErrorKind::Malformed,
                word.at,
                format!("found '{}' where {expected} was expected; export the model again", excerpt(word.bytes)),
            )
        })
    }
}

/// The offset after the line end at `at`; `None` if there is no line end at `at`.
fn line_end(bytes: &[u8], at: usize) -> Option<usize> {
    match bytes.get(at) {
        Some(b'\n') => Some(at + 1),
        Some(b'\r') if bytes.get(at + 1) == Some(&b'\n') => Some(at + 2),
        Some(b'\r') => Some(at + 1),
        _ => None,
    }
}

/// The number of the line that contains a byte offset, counted from 1.
fn line_of(bytes: &[u8], at: usize) -> u64 {
    let mut line = 1;
    let mut here = 0;
    let end = at.min(bytes.len());
    while here < end {
        match line_end(bytes, here) {
            Some(next) if next <= end => {
                line += 1;
                here = next;
            }
            _ => here += 1,
        }
    }
    line
}

/// Parses a word as a number, in any spelling that a C library's `printf` produces.
pub(super) fn number(word: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(word).ok()?;
    text.parse().ok().or_else(|| spelled_number(text))
}

/// Parses not-a-number and infinity as C libraries spell them (`1.#QNAN`, `-1.#IND00`, `1.#INF`, `-nan(ind)`), and Fortran's exponents with
/// `D`.
#[cold]
fn spelled_number(text: &str) -> Option<f64> {
    let (negative, rest) = match text.as_bytes().first()? {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    };
    let lower = rest.to_ascii_lowercase();
    let sign = if negative { -1.0 } else { 1.0 };
    if lower.starts_with("1.#inf") {
        return Some(sign * f64::INFINITY);
    }
    if lower.starts_with("1.#qnan") || lower.starts_with("1.#snan") || lower.starts_with("1.#ind") {
        return Some(f64::NAN);
    }
    if lower.starts_with("nan(") && lower.ends_with(')') {
        return Some(f64::NAN);
    }
    let plain = lower.bytes().all(|b| b.is_ascii_digit() || matches!(b, b'.' | b'd' | b'+' | b'-'));
    if plain && lower.bytes().filter(|&b| b == b'd').count() == 1 {
        return lower.replace('d', "e").parse::<f64>().ok().map(|value| sign * value);
    }
    None
}

/// Parses a word as a whole number, clamped to the range of i64.
pub(super) fn integer(word: &[u8]) -> Option<i64> {
    // Fast path: ten digits can't overflow.
    if !word.is_empty() && word.len() <= 10 && word.iter().all(u8::is_ascii_digit) {
        return Some(word.iter().fold(0, |value, digit| value * 10 + i64::from(digit - b'0')));
    }
    let text = std::str::from_utf8(word).ok()?;
    match text.parse::<i64>().map_err(|error| *error.kind()) {
        Ok(value) => return Some(value),
        Err(IntErrorKind::PosOverflow) => return Some(i64::MAX),
        Err(IntErrorKind::NegOverflow) => return Some(i64::MIN),
        Err(_) => {}
    }
    let value: f64 = text.parse().ok()?;
    #[expect(clippy::cast_possible_truncation, reason = "whole and below 2^53")]
    (value.fract() == 0.0 && value.abs() < 9_007_199_254_740_992.0).then_some(value as i64)
}

fn with_replaced_byte(word: &[u8], from: u8, to: u8) -> Vec<u8> {
    // Longer words can't be numbers.
    word.iter().take(64).map(|&b| if b == from { to } else { b }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: Text<'_>) -> Vec<String> {
        let mut text = text;
        std::iter::from_fn(|| text.word()).map(|w| String::from_utf8_lossy(w.bytes).into_owned()).collect()
    }

    #[test]
    fn lines_end_in_lf_cr_lf_or_cr() {
        assert_eq!(line_of(b"a\nb\r\nc\rd", 0), 1);
        assert_eq!(line_of(b"a\nb\r\nc\rd", 2), 2);
        assert_eq!(line_of(b"a\nb\r\nc\rd", 5), 3);
        assert_eq!(line_of(b"a\nb\r\nc\rd", 7), 4);
        assert_eq!(line_of(b"a\n", 99), 2);
    }

    #[test]
    fn a_byte_order_mark_is_not_part_of_the_first_word() {
        assert_eq!(words(Text::new(b"\xEF\xBB\xBFOFF 1")), ["OFF", "1"]);
    }

    #[test]
    fn a_backslash_joins_lines_only_when_enabled() {
        assert_eq!(words(Text::new(b"f 1\\\n2").with_continued_lines()), ["f", "1", "2"]);
        assert_eq!(words(Text::new(b"f 1\\\r\n2 \\x").with_continued_lines()), ["f", "1", "2", "\\x"]);
        assert_eq!(words(Text::new(b"f 1\\\n2")), ["f", "1\\", "2"]);
    }

    #[test]
    fn a_hash_begins_a_comment_only_when_enabled() {
        assert_eq!(words(Text::new(b"1 # 2\n3#4").with_comments()), ["1", "3#4"]);
        assert_eq!(words(Text::new(b"1 # 2")), ["1", "#", "2"]);
    }

    #[test]
    fn numbers_are_read_as_c_libraries_print_them() {
        assert_eq!(number(b"+.5e1"), Some(5.0));
        assert_eq!(number(b"1.5D-01"), Some(0.15));
        assert_eq!(number(b"-1.#INF"), Some(f64::NEG_INFINITY));
        assert!(number(b"1.#QNAN0").is_some_and(f64::is_nan));
        assert!(number(b"-nan(ind)").is_some_and(f64::is_nan));
        assert_eq!(number(b"1,5"), None);
        assert_eq!(number(b"0x10"), None);
        assert_eq!(number(b""), None);
        assert_eq!(number(b"--1"), None);
    }

    #[test]
    fn whole_numbers_may_be_spelled_with_a_point() {
        assert_eq!(integer(b"3.0"), Some(3));
        assert_eq!(integer(b"-12"), Some(-12));
        assert_eq!(integer(b"3.5"), None);
        assert_eq!(integer(b"99999999999999999999"), Some(i64::MAX));
    }
}
