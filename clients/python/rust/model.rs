//! A model that a call gets: a file's path, or the bytes of a file.

use std::borrow::Cow;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use meshmend::format::Limits;
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;

use crate::errors::{Failure, model_error};

/// Where a model is.
#[derive(FromPyObject)]
pub enum Source {
    /// The bytes of a file.
    Bytes(PyBackedBytes),
    /// The path of a file.
    File(PathBuf),
}

/// A model with its name for messages.
#[derive(FromPyObject)]
pub struct Model(pub String, pub Source);

impl Model {
    /// The bytes of the model. A file over the limit is not read.
    pub fn read(&self, limits: &Limits) -> Result<Cow<'_, [u8]>, Failure> {
        let Self(name, source) = self;
        let path = match source {
            Source::Bytes(bytes) => return Ok(Cow::Borrowed(bytes)),
            Source::File(path) => path,
        };
        let bytes = read_up_to(path, limits.max_bytes).map_err(|error| Failure::Python(os_error(path, &error)))?;
        let bytes = bytes.ok_or_else(|| {
            let message = format!("the file has more than {} bytes; raise `max_file_mib`", limits.max_bytes);
            Failure::Python(model_error(name, &message, "too_large".to_owned(), None, None))
        })?;
        Ok(Cow::Owned(bytes))
    }
}

/// The bytes of a file; none if there are more than `max_bytes`.
fn read_up_to(path: &Path, max_bytes: u64) -> io::Result<Option<Vec<u8>>> {
    let file = File::open(path)?;
    let size = file.metadata()?.len();
    if size > max_bytes {
        return Ok(None);
    }
    let mut bytes = Vec::with_capacity(usize::try_from(size).unwrap_or_default());
    // A file may grow, and a device has no size.
    file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    Ok(Some(bytes).filter(|bytes| bytes.len() as u64 <= max_bytes))
}

/// The exception that Python's own `open` raises.
fn os_error(path: &Path, error: &io::Error) -> PyErr {
    match error.raw_os_error() {
        Some(number) => {
            let text = error.to_string();
            let text = text.split(" (os error").next().unwrap_or_default().to_owned();
            PyOSError::new_err((number, text, path.as_os_str().to_owned()))
        }
        None => PyOSError::new_err(format!("{}: {error}", path.display())),
    }
}
