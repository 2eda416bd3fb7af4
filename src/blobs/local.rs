//! What a local folder needs beside object_store: it writes a file as `<name>#<number>` first, and neither lists nor
//! deletes those when a process was killed half way.

use std::collections::BTreeSet;
use std::fs::{self, DirEntry};
use std::io;
use std::path::Path;
use std::time::Duration;

use crate::jobs::JobId;

/// Entries of a folder; none if it is not there.
fn entries(folder: &Path) -> io::Result<Vec<DirEntry>> {
    match fs::read_dir(folder) {
        Ok(entries) => entries.collect(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

fn gone_is_fine(result: io::Result<()>) -> io::Result<()> {
    match result {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// The job that an entry of `uploads` or `jobs` belongs to.
fn owner(entry: &DirEntry) -> Option<JobId> {
    entry.file_name().to_str()?.split('#').next()?.parse().ok()
}

/// Removes the half-written uploads of a job.
pub(super) fn remove_half_uploads(folder: &Path, id: JobId) -> io::Result<()> {
    for number in 1..100 {
        match fs::remove_file(folder.join("uploads").join(format!("{id}#{number}"))) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => break,
            result => result?,
        }
    }
    Ok(())
}

/// Removes the folders of a job's attempts, but for the one named `keep`.
pub(super) fn remove_attempts(folder: &Path, id: JobId, keep: Option<&str>) -> io::Result<()> {
    let job = folder.join("jobs").join(id.to_string());
    for entry in entries(&job)? {
        if keep.is_none_or(|keep| entry.file_name() != keep) {
            gone_is_fine(fs::remove_dir_all(entry.path()))?;
        }
    }
    if keep.is_none() { gone_is_fine(fs::remove_dir_all(job)) } else { Ok(()) }
}

/// Jobs with an upload or a folder of results that has not changed for `age`.
pub(super) fn owners(folder: &Path, age: Duration) -> io::Result<Vec<JobId>> {
    let mut found = BTreeSet::new();
    for kind in ["uploads", "jobs"] {
        for entry in entries(&folder.join(kind))? {
            let Ok(changed) = entry.metadata().and_then(|data| data.modified()) else { continue };
            if changed.elapsed().is_ok_and(|quiet| quiet >= age) {
                found.extend(owner(&entry));
            }
        }
    }
    Ok(found.into_iter().collect())
}
