//! What a local folder needs beside object_store: it writes a file as `<name>#<number>` first, and neither lists nor
//! deletes those when a process was killed half way.

use std::collections::BTreeSet;
use std::fs::{self, DirEntry};
use std::io;
use std::path::Path;
use std::time::{Duration, SystemTime};

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

/// Removes a job's uploads, half-written ones among them. Version 0.1 had one file in the place of the folder.
pub(super) fn remove_uploads(folder: &Path, id: JobId) -> io::Result<()> {
    let uploads = folder.join("uploads").join(id.to_string());
    if uploads.is_file() {
        return gone_is_fine(fs::remove_file(uploads));
    }
    gone_is_fine(fs::remove_dir_all(uploads))
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

/// When an entry, or anything directly in it, last changed; a folder's own time tells nothing of a file that grows.
fn last_change(entry: &DirEntry) -> io::Result<SystemTime> {
    let data = entry.metadata()?;
    let inside = if data.is_dir() { entries(&entry.path())? } else { Vec::new() };
    let times = inside.iter().filter_map(|inner| inner.metadata().and_then(|data| data.modified()).ok());
    Ok(times.fold(data.modified()?, SystemTime::max))
}

/// Jobs with uploads or a folder of results that have not changed for `age`.
pub(super) fn owners(folder: &Path, age: Duration) -> io::Result<Vec<JobId>> {
    let mut found = BTreeSet::new();
    for kind in ["uploads", "jobs"] {
        for entry in entries(&folder.join(kind))? {
            let Ok(changed) = last_change(&entry) else { continue };
            if changed.elapsed().is_ok_and(|quiet| quiet >= age) {
                found.extend(owner(&entry));
            }
        }
    }
    Ok(found.into_iter().collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn old_file(path: &Path) {
        fs::write(path, "old").expect("a file");
        age(path);
    }

    fn age(path: &Path) {
        fs::File::open(path).expect("readable").set_modified(SystemTime::UNIX_EPOCH).expect("a time");
    }

    #[test]
    fn an_upload_under_way_has_no_owner_to_ask_for_however_old_its_folder_is() {
        let root = tempfile::tempdir().expect("a folder");
        let uploads = root.path().join("uploads");
        let (abandoned, growing) = (JobId::new(), JobId::new());
        for id in [abandoned, growing] {
            let folder = uploads.join(id.to_string());
            fs::create_dir_all(&folder).expect("a folder");
            old_file(&folder.join("0"));
            if id == growing {
                fs::write(folder.join("1#1"), "half").expect("a file");
            }
            age(&folder);
        }
        assert_eq!(owners(root.path(), Duration::from_secs(3600)).expect("readable"), [abandoned]);
        remove_uploads(root.path(), growing).expect("removed");
        assert!(!uploads.join(growing.to_string()).exists());
    }

    #[test]
    fn an_upload_of_the_first_version_is_found_and_removed() {
        let root = tempfile::tempdir().expect("a folder");
        let uploads = root.path().join("uploads");
        fs::create_dir_all(&uploads).expect("a folder");
        let id = JobId::new();
        old_file(&uploads.join(id.to_string()));
        assert_eq!(owners(root.path(), Duration::from_secs(3600)).expect("readable"), [id]);
        remove_uploads(root.path(), id).expect("removed");
        remove_uploads(root.path(), id).expect("gone already");
        assert_eq!(entries(&uploads).expect("readable").len(), 0);
    }
}
