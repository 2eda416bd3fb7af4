//! How a job's files, options and notes come in: as a form, as one file with the rest in the query, or as JSON that names a file which is
//! here already. All ways end in a [`Submission`], whose files are stored.

mod body;
mod copy;
mod form;
mod submission;
pub mod upload;

use axum::extract::Request;
use axum::http::header;

use super::extract::text_header;
use super::idempotency::KeyUse;
use super::problem::Problem;

pub use copy::SubmitUpload;
pub use form::{FORM_BYTES, SubmitForm};
pub use submission::{Intake, Submission};

/// Reads a request's files, as many bytes as the caller may send, into the store under the job's keys.
pub async fn read(intake: Intake<'_>, request: Request, key: &KeyUse) -> Result<Submission, Problem> {
    let media_type = text_header(request.headers(), &header::CONTENT_TYPE).unwrap_or_default().trim().to_owned();
    let essence = media_type.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    match essence.as_str() {
        "multipart/form-data" => form::read(intake, request).await,
        "application/json" => copy::read(intake, request, key).await,
        _ => body::read(intake, request).await,
    }
}
