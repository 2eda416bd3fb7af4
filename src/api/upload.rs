//! What comes in from a client, byte by byte: bounded in size, in silence and in memory, and removed when it is refused.

use std::error::Error;
use std::io::{self, ErrorKind};
use std::task::Poll;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::multipart::MultipartError;
use axum::http::header;
use futures::{Stream, StreamExt};
use tracing::Instrument;

use super::problem::{Problem, ProblemCode};
use crate::blobs::{BlobError, Blobs, Stored, UploadError};
use crate::jobs::JobId;

/// The files of a job that does not exist yet; removed unless it comes to be.
pub(super) struct Unclaimed {
    blobs: Option<Blobs>,
    id: JobId,
}

impl Unclaimed {
    pub fn new(blobs: &Blobs, id: JobId) -> Self {
        Self { blobs: Some(blobs.clone()), id }
    }

    /// Lets the job have its files, or removes them.
    pub async fn settle(mut self, accepted: bool) {
        if let Some(blobs) = self.blobs.take().filter(|_| !accepted) {
            remove(blobs, self.id).await;
        }
    }
}

/// A client that hangs up drops the request, wherever it is.
impl Drop for Unclaimed {
    fn drop(&mut self) {
        if let Some(blobs) = self.blobs.take() {
            tokio::spawn(remove(blobs, self.id).in_current_span());
        }
    }
}

async fn remove(blobs: Blobs, id: JobId) {
    if let Err(error) = blobs.delete_job(id).await {
        tracing::warn!(%error, "a refused upload was left");
    }
}

/// The room that one upload has for its files.
pub(super) struct Room {
    most: u64,
    left: u64,
}

impl Room {
    pub fn new(most: u64) -> Self {
        Self { most, left: most }
    }

    /// Stores a file in what room is left.
    pub async fn store<E: Error + 'static>(
        &mut self,
        blobs: &Blobs,
        key: &str,
        source: impl Stream<Item = Result<Bytes, E>>,
    ) -> Result<Stored, Problem> {
        let stored = blobs.put_stream(key, source, self.left).await.map_err(|error| match error {
            UploadError::TooLarge(_) => too_large(self.most),
            UploadError::Source(error) => source_problem(&error),
            UploadError::Store(error) => error.into(),
        })?;
        self.left -= stored.bytes;
        Ok(stored)
    }
}

pub(super) fn too_large(limit: u64) -> Problem {
    let detail = format!("The upload is larger than the {} MiB that this service takes.", limit >> 20);
    // The rest of the body is not read, so the connection can't be used again.
    Problem::new(ProblemCode::PayloadTooLarge, detail).with_header(header::CONNECTION, "close")
}

/// What can go wrong while bytes come in.
#[derive(Debug, thiserror::Error)]
pub(super) enum SourceError {
    #[error("no bytes came for too long")]
    Idle,
    #[error("the form's headers are too long")]
    Form,
    #[error(transparent)]
    Body(#[from] axum::Error),
}

/// The stream, but ended by an error when nothing comes for `longest`.
pub(super) fn with_patience(
    source: impl Stream<Item = Result<Bytes, axum::Error>> + Send + 'static,
    longest: Duration,
) -> impl Stream<Item = Result<Bytes, SourceError>> + Send + 'static {
    futures::stream::unfold(Some(Box::pin(source)), move |source| async move {
        let mut source = source?;
        match tokio::time::timeout(longest, source.next()).await {
            Err(_) => Some((Err(SourceError::Idle), None)),
            Ok(None) => None,
            Ok(Some(Err(error))) => Some((Err(error.into()), None)),
            Ok(Some(Ok(chunk))) => Some((Ok(chunk), Some(source))),
        }
    })
}

/// The stream, but never two chunks without a pause between: a reader of forms takes in all that is ready before it
/// looks at any of it, which from a fast sender would be the whole file.
pub(super) fn one_at_a_time<T>(
    source: impl Stream<Item = T> + Send + 'static,
) -> impl Stream<Item = T> + Send + 'static {
    let mut source = Box::pin(source);
    let mut pause = false;
    futures::stream::poll_fn(move |context| {
        if std::mem::take(&mut pause) {
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        let next = source.as_mut().poll_next(context);
        pause = next.is_ready();
        next
    })
}

/// The problem behind an error of the incoming bytes, however deep libraries wrapped it.
pub(super) fn source_problem(error: &(dyn Error + 'static)) -> Problem {
    let mut cause = Some(error);
    let mut is_form = false;
    while let Some(e) = cause {
        match e.downcast_ref() {
            Some(SourceError::Idle) => {
                let detail = "No bytes came for too long, so the upload was given up.";
                return Problem::new(ProblemCode::UploadTimeout, detail).with_header(header::CONNECTION, "close");
            }
            Some(SourceError::Form) => {
                return Problem::invalid_request("The form's headers are too long.")
                    .with_header(header::CONNECTION, "close");
            }
            _ => {}
        }
        if let Some(error) = e.downcast_ref::<BlobError>() {
            return error.into();
        }
        if e.downcast_ref::<io::Error>()
            .is_some_and(|e| matches!(e.kind(), ErrorKind::InvalidData | ErrorKind::InvalidInput | ErrorKind::Other))
        {
            return Problem::invalid_request(
                "The body can't be decoded as its `Content-Encoding` says. Send it again.",
            )
            .with_header(header::CONNECTION, "close");
        }
        if e.is::<MultipartError>() {
            is_form = true;
        }
        cause = e.source();
    }
    if is_form {
        let detail = "The form can't be read: it ends too early, or a part is not formed as RFC 7578 says.";
        return Problem::invalid_request(detail);
    }
    Problem::new(ProblemCode::UploadInterrupted, "The upload broke off before its end. Send it again.")
}
