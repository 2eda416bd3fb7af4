//! What a submission says, whatever way it comes: its files, its options, and the client's notes.

use serde::Serialize;
use serde_json::{Map, Value};
use sha2::{Digest, Sha256};

use crate::api::authenticate::Caller;
use crate::api::check::{field_schema, unknown_field, value_errors};
use crate::api::extract::UploadBudget;
use crate::api::problem::{FieldError, Problem, ProblemCode, shown};
use crate::api::state::ApiState;
use crate::blobs::{Blobs, Stored};
use crate::format::{ReadErrorKind, sniff};
use crate::jobs::{Input, JobId, JobOptions, Metadata, Mode, UploadId};
use crate::webhooks::TargetPolicy;

/// Largest notes of a client, in bytes, and most of them.
const METADATA_BYTES: usize = 8 << 10;
const METADATA_ENTRIES: usize = 50;
/// Longest file name that is kept, in characters.
const NAME_CHARS: usize = 200;

/// Whose request is read, and for which new job.
#[derive(Clone, Copy)]
pub struct Intake<'a> {
    pub state: &'a ApiState,
    pub caller: &'a Caller,
    pub id: JobId,
}

impl Intake<'_> {
    /// As many bytes as the caller may send.
    pub fn budget(&self) -> UploadBudget {
        UploadBudget::new(self.caller.max_bytes(self.state.config.limits.max_bytes))
    }
}

/// What came with a request, its files stored already.
pub struct Submission {
    /// Its files, models all of them.
    pub inputs: Vec<Input>,
    /// What to do.
    pub options: JobOptions,
    /// What else the client said.
    pub notes: Notes,
    /// The upload that was copied, where the file was sent before the request.
    pub upload: Option<UploadId>,
}

impl Submission {
    /// What tells one request from another: its files, its options, and what else it says.
    pub fn fingerprint(&self) -> String {
        let files: Vec<_> = self.inputs.iter().map(|input| (&input.name, input.bytes, &input.sha256)).collect();
        let bytes = serde_json::to_vec(&(files, &self.options, &self.notes)).unwrap_or_default();
        hex::encode(Sha256::digest(&bytes))
    }
}

/// What a client says of a job beside its options.
#[derive(Default, Serialize)]
pub struct Notes {
    /// Its own notes.
    pub metadata: Metadata,
    /// Where to tell of the job's end.
    pub callback_url: Option<String>,
}

impl Notes {
    /// The names of the parts, or fields of a query, that they come as.
    pub const NAMES: [&str; 2] = ["metadata", "callback_url"];

    /// Reads one of them.
    pub fn take(&mut self, name: &str, text: &str, reach: TargetPolicy) -> Result<(), Problem> {
        if name == "callback_url" {
            let url =
                reach.read(text).map_err(|error| Problem::invalid_field(name, format!("`callback_url` {error}.")))?;
            self.callback_url = Some(url.into());
            return Ok(());
        }
        let metadata = serde_json::from_str(text)
            .ok()
            .filter(|metadata: &Metadata| text.len() <= METADATA_BYTES && metadata.len() <= METADATA_ENTRIES);
        self.metadata = metadata.ok_or_else(|| {
            let kib = METADATA_BYTES >> 10;
            let message =
                format!("`metadata` must be a JSON object of at most {METADATA_ENTRIES} texts and {kib} KiB.");
            Problem::invalid_field(name, message)
        })?;
        Ok(())
    }
}

/// A file of a submission.
pub struct File {
    pub name: String,
    pub stored: Stored,
}

/// Sees whether every file is a model by its first bytes. Of several, each that is none is named.
pub fn inputs(id: JobId, files: Vec<File>) -> Result<Vec<Input>, Problem> {
    let of = files.len();
    let mut inputs = Vec::with_capacity(of);
    let (mut problems, mut errors): (Vec<Problem>, Vec<FieldError>) = Default::default();
    for (number, File { name, stored }) in files.into_iter().enumerate() {
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
                let which = if of > 1 { format!("file {} of {of}, '{name}': ", number + 1) } else { String::new() };
                if of > 1 {
                    errors.push(FieldError::new(&format!("file[{number}]"), format!("{which}{detail}")));
                }
                problems.push(Problem::new(code, format!("{which}{detail}")));
            }
        }
    }
    match problems.into_iter().next() {
        Some(first) => Err(Problem { errors, ..first }),
        None => Ok(inputs),
    }
}

/// Reads the options of a job. Every option that is wrong is named.
pub fn job_options(fields: Map<String, Value>) -> Result<JobOptions, Problem> {
    let mode = match fields.get("mode") {
        None => Mode::default(),
        Some(given) => match Mode::ALL.into_iter().find(|mode| given == mode.as_str()) {
            Some(mode) => mode,
            None => return Err(Problem::of_fields(ProblemCode::InvalidOptions, vec![unknown_mode(given)])),
        },
    };
    let errors: Vec<_> = fields.iter().flat_map(|(option, value)| option_errors(mode, option, value)).collect();
    if !errors.is_empty() {
        return Err(Problem::of_fields(ProblemCode::InvalidOptions, errors));
    }
    JobOptions::from_fields(fields).map_err(|error| match error.option() {
        Some(option) => Problem::invalid_field(option, error.to_string()),
        None => Problem::invalid_value(error.to_string()),
    })
}

fn unknown_mode(given: &Value) -> FieldError {
    let names = Mode::ALL.map(|mode| format!("`{}`", mode.as_str())).join(" or ");
    FieldError::new("mode", format!("`mode` must be {names}; got {}.", shown(&given.to_string())))
}

fn option_errors(mode: Mode, option: &str, value: &Value) -> Vec<FieldError> {
    let schema = match mode {
        Mode::Repair => "Options",
        Mode::Analyze => "AnalyzeOptions",
    };
    if option == "mode" {
        return Vec::new();
    }
    if let Some(schema) = field_schema(schema, option) {
        return value_errors(option, schema, value);
    }
    let other = Mode::ALL.into_iter().find(|of| of.option_names().iter().any(|name| name == option));
    vec![match other {
        Some(of) => {
            let (of, mode) = (of.as_str(), mode.as_str());
            let message = format!("`{option}` is an option of mode `{of}`; this job's mode is `{mode}`.");
            FieldError::new(option, message)
        }
        None => unknown_field(option, mode.option_names().iter().map(String::as_str), "option"),
    }]
}

/// A file name without folders and control characters; it is shown and handed back, never opened.
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
    fn a_file_name_keeps_nothing_that_could_lead_elsewhere() {
        for (given, kept) in [
            (Some("bracket.stl"), "bracket.stl"),
            (Some("../../etc/passwd"), "passwd"),
            (Some("C:\\models\\a b.obj"), "a b.obj"),
            (Some("nul\0l\r\nX: y.stl"), "nullX: y.stl"),
            (Some(".."), "model"),
            (Some(""), "model"),
            (None, "model"),
            (Some("größe 日本.ply"), "größe 日本.ply"),
        ] {
            assert_eq!(clean_name(given), kept);
        }
        assert_eq!(clean_name(Some(&"x".repeat(1000))).len(), NAME_CHARS);
    }
}
