//! Results that were made before, for the same bytes, options and engine, of the same tenant.

use axum::http::{HeaderMap, header};
use sha2::{Digest, Sha256};

use super::extract::text_header;
use crate::blobs::{BlobError, Blobs};
use crate::jobs::{Artifacts, Input, Job, JobId, JobOptions, JobOutcome, JobStore, Mode, NewJob, Reused};

/// What stands for an attempt's token in the keys of files that no attempt made.
const COPIED: &str = "reused";

/// A hash of all that a job's result depends on. The reports of analyses name their files.
pub(super) fn fingerprint(inputs: &[Input], options: &JobOptions) -> String {
    let named = options.mode() == Mode::Analyze;
    let files: Vec<_> =
        inputs.iter().map(|input| (input.format, input.bytes, &input.sha256, named.then_some(&input.name))).collect();
    let bytes = serde_json::to_vec(&(crate::ENGINE, files, options)).unwrap_or_default();
    hex::encode(Sha256::digest(&bytes))
}

/// Whether the client wants the work done again (RFC 9111, 5.2.1.4).
pub(super) fn is_refused(headers: &HeaderMap) -> bool {
    text_header(headers, &header::CACHE_CONTROL)
        .is_some_and(|value| value.split(',').any(|word| ["no-cache", "no-store"].contains(&word.trim())))
}

/// The result of an earlier job for the new job, its files copied. None where there is none that will do; the job is then
/// done as if there were none.
pub(super) async fn find(store: &dyn JobStore, blobs: &Blobs, new: &NewJob) -> Option<Reused> {
    let NewJob { id, inputs, .. } = new;
    let earlier = match store.find_result(&new.tenant, &new.fingerprint).await {
        Ok(earlier) => earlier?,
        Err(error) => {
            tracing::warn!(%error, "earlier results could not be looked up");
            return None;
        }
    };
    let (outcome, report) = (earlier.outcome?, earlier.report.clone()?);
    if !is_final(outcome) {
        return None;
    }
    match copy(blobs, *id, &earlier, inputs).await {
        Ok(artifacts) => Some(Reused { from: earlier.id, outcome, report, artifacts }),
        Err(error) => {
            tracing::info!(%error, from = %earlier.id, "an earlier result is gone; doing the work again");
            if let Err(error) = blobs.delete_attempts(*id, None).await {
                tracing::warn!(%error, "copies of an earlier result were left");
            }
            None
        }
    }
}

/// Whether another try would give the same: less than a whole repair may have been for want of time, or of a Blender that is there now.
fn is_final(outcome: JobOutcome) -> bool {
    match outcome {
        JobOutcome::AlreadyPrintable | JobOutcome::Repaired | JobOutcome::Printable | JobOutcome::NotPrintable => true,
        JobOutcome::PartiallyRepaired | JobOutcome::Unrepairable | JobOutcome::Undecided => false,
    }
}

/// Copies the files of a job for another one, under names that fit its inputs.
async fn copy(blobs: &Blobs, id: JobId, earlier: &Job, inputs: &[Input]) -> Result<Artifacts, BlobError> {
    let (old, new) = (stem(&earlier.inputs), stem(inputs));
    let mut artifacts = Artifacts::new();
    for (name, artifact) in &earlier.artifacts {
        let mut artifact = artifact.clone();
        if let Some(file) = &mut artifact.file {
            let key = Blobs::artifact_key(id, COPIED, name);
            blobs.copy(&file.key, &key).await?;
            file.key = key;
        }
        if let Some(rest) = artifact.filename.strip_prefix(old) {
            artifact.filename = format!("{new}{rest}");
        }
        artifacts.insert(name.clone(), artifact);
    }
    Ok(artifacts)
}

/// What the names of a repair's files begin with.
fn stem(inputs: &[Input]) -> &str {
    inputs.first().map_or("model", Input::stem)
}
