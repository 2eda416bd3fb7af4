//! The contents of a submission, however it was sent: files, options, metadata and callback URL, with their validation.

use serde::Serialize;
use sha2::{Digest, Sha256};

use super::options::SubmittedOptions;
use crate::api::authenticate::Caller;
use crate::api::extract::UploadBudget;
use crate::api::problem::{FieldError, Problem, ProblemCode};
use crate::api::state::ApiState;
use crate::blobs::{Blobs, Stored};
use crate::format::{ReadErrorKind, sniff};
use crate::jobs::{Input, JobId, Metadata, UploadId};
use crate::webhooks::TargetPolicy;

/// Largest `metadata` as JSON, in bytes.
const METADATA_BYTES: usize = 8 << 10;
/// Most entries of `metadata`.
const METADATA_ENTRIES: usize = 50;
/// Longest file name that is kept, in characters.
const NAME_CHARS: usize = 200;

/// The context in which a submission is read.
#[derive(Clone, Copy)]
pub struct SubmissionContext<'a> {
    /// The API's state.
    pub state: &'a ApiState,
    /// The caller who submits the job.
    pub caller: &'a Caller,
    /// The id of the new job.
    pub id: JobId,
}

impl SubmissionContext<'_> {
    /// Returns the size budget of the caller's upload.
    pub fn budget(&self) -> UploadBudget {
        UploadBudget::new(self.caller.max_bytes(self.state.config.limits.max_bytes))
    }
}

/// A validated submission with its files stored.
pub struct Submission {
    /// The submitted model files.
    pub inputs: Vec<Input>,
    /// The job's options.
    pub options: SubmittedOptions,
    /// The job's metadata and callback URL.
    pub extras: Extras,
    /// The upload that was copied, if the file was uploaded before this request.
    pub upload: Option<UploadId>,
}

impl Submission {
    /// Returns a hash that identifies the request: its files, options, metadata and callback URL.
    pub fn fingerprint(&self) -> String {
        let files: Vec<_> = self.inputs.iter().map(|input| (&input.name, input.bytes, &input.sha256)).collect();
        let bytes = serde_json::to_vec(&(files, self.options.as_requested(), &self.extras)).unwrap_or_default();
        hex::encode(Sha256::digest(&bytes))
    }
}

/// The fields of a submission besides files and options.
#[derive(Default, Serialize)]
pub struct Extras {
    /// The client's own metadata.
    pub metadata: Metadata,
    /// The URL to notify when the job ends.
    pub callback_url: Option<String>,
}

impl Extras {
    /// The names of these fields, as form parts and as query parameters.
    pub const NAMES: [&str; 2] = ["metadata", "callback_url"];

    /// Validates one field and sets its value.
    pub fn set(&mut self, name: &str, text: &str, targets: TargetPolicy) -> Result<(), Problem> {
        if name == "callback_url" {
            let url =
                targets.read(text).map_err(|error| Problem::invalid_field(name, format!("`callback_url` {error}.")))?;
            self.callback_url = Some(url.into());
            return Ok(());
        }
        let metadata = serde_json::from_str(text)
            .ok()
            .filter(|metadata: &Metadata| text.len() <= METADATA_BYTES && metadata.len() <= METADATA_ENTRIES);
        self.metadata = metadata.ok_or_else(|| {
            let kib = METADATA_BYTES >> 10;
            let message =
                format!("`metadata` must be a JSON object of at most {METADATA_ENTRIES} text values and {kib} KiB.");
            Problem::invalid_field(name, message)
        })?;
        Ok(())
    }
}

/// A stored file of a submission.
pub struct ReceivedFile {
    /// The cleaned file name.
    pub name: String,
    /// Where and how the file is stored.
    pub stored: Stored,
}

/// Detects each file's format by its first bytes. With several files, the error names every unrecognised file.
pub fn inputs(id: JobId, files: Vec<ReceivedFile>) -> Result<Vec<Input>, Problem> {
    let count = files.len();
    let mut inputs = Vec::with_capacity(count);
    let (mut problems, mut errors): (Vec<Problem>, Vec<FieldError>) = Default::default();
    for (number, ReceivedFile { name, stored }) in files.into_iter().enumerate() {
        match sniff(&stored.head, Some(stored.bytes)) {
            Ok(format) => {
                let Stored { bytes, sha256, .. } = stored;
                inputs.push(Input { key: Blobs::input_key(id, number), name, bytes, sha256, format });
            }
            Err(error) => {
                let (code, detail) = match error.kind {
                    _ if stored.bytes == 0 => {
                        (ProblemCode::MissingFile, "The file is empty. Send a model with at least one face.".to_owned())
                    }
                    ReadErrorKind::Empty => (ProblemCode::MissingFile, error.to_string()),
                    _ => (ProblemCode::UnsupportedModel, error.to_string()),
                };
                let subject =
                    if count > 1 { format!("File {} of {count}, '{name}': ", number + 1) } else { String::new() };
                if count > 1 {
                    errors.push(FieldError::new(&format!("file[{number}]"), format!("{subject}{detail}")));
                }
                problems.push(Problem::new(code, format!("{subject}{detail}")));
            }
        }
    }
    match problems.into_iter().next() {
        Some(first) => Err(Problem { errors, ..first }),
        None => Ok(inputs),
    }
}

/// Removes folders and control characters from a file name. The name is only displayed, never opened.
pub fn clean_name(name: Option<&str>) -> String {
    let name = name.unwrap_or_default();
    let name = name.rsplit(['/', '\\']).next().unwrap_or_default();
    let name: String = name.chars().filter(|c| !c.is_control()).take(NAME_CHARS).collect();
    let name = name.trim();
    if name.is_empty() || name.chars().all(|c| c == '.') { "model".to_owned() } else { name.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_name_loses_folders_and_control_characters() {
        for (name, cleaned) in [
            (Some("bracket.stl"), "bracket.stl"),
            (Some("../../etc/passwd"), "passwd"),
            (Some("C:\\models\\a b.obj"), "a b.obj"),
            (Some("nul\0l\r\nX: y.stl"), "nullX: y.stl"),
            (Some(".."), "model"),
            (Some(""), "model"),
            (None, "model"),
            (Some("größe 日本.ply"), "größe 日本.ply"),
        ] {
            assert_eq!(clean_name(name), cleaned);
        }
        assert_eq!(clean_name(Some(&"x".repeat(1000))).len(), NAME_CHARS);
    }
}
