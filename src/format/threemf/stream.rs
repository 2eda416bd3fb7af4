//! The bytes of a part as they are unpacked, no more of them than the archive said and no more at a time than an element may have.

use std::io::{self, BufRead, BufReader, Read};

/// Longest element, comment or piece of text, in bytes.
const EVENT: u64 = 4 << 20;
const BUFFER: usize = 64 << 10;

/// Why a stream goes on no longer.
#[derive(Debug, thiserror::Error)]
pub(super) enum Stop {
    #[error("an element or a text is longer than {} bytes", EVENT)]
    LongEvent,
    #[error("more is packed in the archive than its directory says")]
    MoreThanSaid,
}

/// A part's bytes.
pub(super) struct Stream<'a> {
    inner: BufReader<Box<dyn Read + 'a>>,
    /// What is left of the size that the archive's directory tells.
    left: u64,
    /// What the element at hand may still have.
    event: u64,
}

impl<'a> Stream<'a> {
    /// A stream of no more than `size` bytes.
    pub fn new(inner: Box<dyn Read + 'a>, size: u64) -> Self {
        Self { inner: BufReader::with_capacity(BUFFER, inner), left: size, event: EVENT }
    }

    /// Begins to count anew.
    pub fn begin_event(&mut self) {
        self.event = EVENT;
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
            return Err(io::Error::other(Stop::LongEvent));
        }
        let ready = self.inner.fill_buf()?;
        if ready.len() as u64 > self.left {
            return Err(io::Error::other(Stop::MoreThanSaid));
        }
        Ok(ready)
    }

    fn consume(&mut self, count: usize) {
        self.left = self.left.saturating_sub(count as u64);
        self.event = self.event.saturating_sub(count as u64);
        self.inner.consume(count);
    }
}
