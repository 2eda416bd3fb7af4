//! Reads a job's files, options, metadata and callback URL from a request: a form, one file with the rest in the query, or JSON that names
//! a stored file. All three ways end in a [`Submission`], whose files are stored.

mod form;
mod options;
mod raw_body;
mod stored_file;
mod submission;
pub mod upload;

use axum::extract::Request;
use axum::http::header;

use super::extract::text_header;
use super::idempotency::IdempotencyState;
use super::problem::Problem;

pub use form::{FORM_BYTES, SubmitForm};
pub use stored_file::SubmitUpload;
pub use submission::{Submission, SubmissionContext};

/// Reads a submission, and stores its files under the new job's keys.
///
/// # Errors
/// A problem if a field or file is invalid, if the files exceed the caller's size limit, or if the upload is interrupted.
pub async fn read(
    context: SubmissionContext<'_>,
    request: Request,
    key: &IdempotencyState,
) -> Result<Submission, Problem> {
    let media_type = text_header(request.headers(), &header::CONTENT_TYPE).unwrap_or_default().trim().to_owned();
    let essence = media_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    match essence.as_str() {
        "multipart/form-data" => form::read(context, request).await,
        "application/json" => stored_file::read(context, request, key).await,
        _ => raw_body::read(context, request).await,
    }
}
