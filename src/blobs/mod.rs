//! Files: uploads and artifacts over object_store, in a local folder or in a bucket of an S3-compatible store.
//!
//! Keys: `uploads/<job id>` for the uploaded file, `more/<job id>/<number>` for each further one of a job that has several
//! (a folder for the one that most have would cost another sync to disk), and `jobs/<job id>/<claim>/<name>` for what an attempt made, so that the files
//! of a lost attempt are never mistaken for the result. `incoming/<upload id>` is a file that was sent before its job.

mod bucket;
mod cleanup;
mod local;
mod store;
mod stored;

pub use bucket::S3Config;
pub use store::{Blobs, free_bytes};
pub use stored::{BlobError, Owner, Stored, UploadError};
