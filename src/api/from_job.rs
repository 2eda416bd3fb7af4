//! A job made of files of an earlier one, which are still kept: to try other options, or to have the result in another format.

use super::caller::Caller;
use super::extract::{find_job, job_id};
use super::file_name::clean_name;
use super::from_upload::JobFile;
use super::incoming::{File, inputs};
use super::problem::{Problem, ProblemCode};
use super::state::ApiState;
use super::upload::Room;
use crate::access::Scope;
use crate::blobs::{BlobError, Blobs};
use crate::jobs::{Input, JobId, Mode, Status};

/// Copies the files of an earlier job for the new job `id`.
pub(super) async fn from_job(
    state: &ApiState,
    caller: &Caller,
    id: JobId,
    earlier: &str,
    file: JobFile,
    name: Option<&str>,
    mode: Mode,
) -> Result<Vec<Input>, Problem> {
    if !caller.may(Scope::JobsRead) {
        return Err(Problem::new(
            ProblemCode::Forbidden,
            "The key can't read jobs, so it can't make one of another's files.",
        ));
    }
    let job = find_job(state, caller, job_id(earlier)?).await?;
    if job.status == Status::Expired {
        return Err(gone(&job.id));
    }
    let given = |own: &str| clean_name(name.or(Some(own)));
    let files: Vec<(String, String, String)> = match file {
        JobFile::Input => {
            let one = job.inputs.len() == 1;
            job.inputs.into_iter().map(|it| (it.key, it.sha256, if one { given(&it.name) } else { it.name })).collect()
        }
        JobFile::Model => {
            let model = job.artifacts.get("model").and_then(|model| Some((model.file.as_ref()?, &model.filename)));
            let (file, filename) = model.ok_or_else(|| {
                let detail = format!("The job '{}' has no result to make a job of.", job.id);
                Problem::new(ProblemCode::ArtifactNotFound, detail)
            })?;
            vec![(file.key.clone(), file.sha256.clone(), given(filename))]
        }
    };
    if mode == Mode::Repair && files.len() > 1 {
        let detail = format!("A repair takes one file, and the job '{}' has {}.", job.id, files.len());
        return Err(Problem::new(ProblemCode::TooManyFiles, detail));
    }
    let mut room = Room::new(caller.max_bytes(state.config.limits.max_bytes));
    let mut copies = Vec::with_capacity(files.len());
    for (number, (key, sha256, name)) in files.into_iter().enumerate() {
        let bytes = state.blobs.get_whole(&key, &sha256).await.map_err(|error| match error {
            BlobError::NotFound => gone(&job.id),
            error => error.into(),
        })?;
        let stored = room.store(&state.blobs, &Blobs::input_key(id, number), bytes).await?;
        copies.push(File { name, stored });
    }
    inputs(id, copies)
}

fn gone(job: &JobId) -> Problem {
    Problem::new(ProblemCode::JobExpired, format!("The files of the job '{job}' were kept as long as they are."))
}
