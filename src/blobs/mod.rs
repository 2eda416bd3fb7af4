//! The file store: uploads and artifacts over object_store, in a local folder or in a bucket of an S3-compatible store.
//!
//! A job's first uploaded file has the key `uploads/<job id>`, and each further one `more/<job id>/<number>`. Most jobs have a
//! single file, which thus needs no folder of its own and no extra sync to disk. An attempt's files have keys
//! `jobs/<job id>/<claim>/<name>`, so that the files of a lost attempt are never mistaken for the result. A file that was uploaded
//! before its job has the key `incoming/<upload id>`.

mod bucket;
mod cleanup;
mod local;
mod store;
mod stored;

pub use bucket::S3Config;
pub use store::{Blobs, free_bytes};
pub use stored::{BlobError, Owner, Stored, UploadError};
