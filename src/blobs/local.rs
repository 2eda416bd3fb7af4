//! Operations on a local folder that object_store lacks. object_store first writes a file as `<name>#<number>`, and neither lists
//! nor deletes such files after a killed process. It also syncs each of several files separately.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, DirEntry, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::stored::{CHUNK, Owner, Stored, Summary};
use crate::jobs::JobId;

/// The folders whose entries are named by job ids.
pub(super) const KINDS: [&str; 3] = ["uploads", "more", "jobs"];

/// Copies local files into the folder, each to its key. The result has `None` for a missing file. On return, the files are on disk.
///
/// The files are written to their final paths, so a killed process may leave a part of one; the keys must not be published yet.
/// All files are written before the first sync, because the disk has by then written most of the others.
pub(super) fn copy_in(folder: &Path, files: &[(String, PathBuf)]) -> io::Result<Vec<Option<Stored>>> {
    let copied = try_copy_in(folder, files);
    if copied.is_err() {
        // Files that can't be removed here are removed with their attempt.
        files.iter().for_each(|(key, _)| drop(fs::remove_file(folder.join(key))));
    }
    copied
}

fn try_copy_in(folder: &Path, files: &[(String, PathBuf)]) -> io::Result<Vec<Option<Stored>>> {
    let (mut stored, mut written, mut changed) = (Vec::new(), Vec::new(), BTreeSet::new());
    for (key, path) in files {
        let source = match File::open(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                stored.push(None);
                continue;
            }
            source => source?,
        };
        let target = folder.join(key);
        if let Some(parent) = target.parent() {
            create_folder(parent, &mut changed)?;
            changed.insert(parent.to_owned());
        }
        let mut target = File::create(target)?;
        stored.push(Some(copy(source, &mut target)?));
        written.push(target);
    }
    written.iter().try_for_each(File::sync_all)?;
    changed.iter().try_for_each(|folder| File::open(folder)?.sync_all())?;
    Ok(stored)
}

/// Creates a folder and its missing parents. Adds each folder that got a new entry to `changed`.
fn create_folder(path: &Path, changed: &mut BTreeSet<PathBuf>) -> io::Result<()> {
    match (fs::create_dir(path), path.parent()) {
        (Ok(()), parent) => changed.extend(parent.map(Path::to_owned)),
        (Err(error), _) if error.kind() == io::ErrorKind::AlreadyExists => {}
        (Err(error), Some(parent)) if error.kind() == io::ErrorKind::NotFound => {
            create_folder(parent, changed)?;
            create_folder(path, changed)?;
        }
        (Err(error), _) => return Err(error),
    }
    Ok(())
}

/// Copies a file's bytes, and returns their summary.
pub(super) fn copy(mut source: File, target: &mut File) -> io::Result<Stored> {
    let mut summary = Summary::default();
    let size = usize::try_from(source.metadata()?.len()).unwrap_or(CHUNK);
    let mut chunk = vec![0; size.clamp(1, CHUNK)];
    loop {
        match source.read(&mut chunk)? {
            0 => return Ok(summary.finish()),
            read => {
                summary.add(&chunk[..read]);
                target.write_all(&chunk[..read])?;
            }
        }
    }
}

/// The entries of a folder; none if it is missing.
fn entries(folder: &Path) -> io::Result<Vec<DirEntry>> {
    match fs::read_dir(folder) {
        Ok(entries) => entries.collect(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

fn ignore_missing(result: io::Result<()>) -> io::Result<()> {
    match result {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// The job to which an entry of `uploads`, `more` or `jobs` belongs.
fn owner(entry: &DirEntry) -> Option<JobId> {
    entry.file_name().to_str()?.split('#').next()?.parse().ok()
}

/// Removes partly written uploads of a job, and the folder of its further files.
pub(super) fn remove_uploads(folder: &Path, id: JobId) -> io::Result<()> {
    for number in 1..100 {
        match fs::remove_file(folder.join("uploads").join(format!("{id}#{number}"))) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => break,
            result => result?,
        }
    }
    ignore_missing(fs::remove_dir_all(folder.join("more").join(id.to_string())))
}

/// Removes the folders of a job's attempts, except the one named `keep`.
pub(super) fn remove_attempts(folder: &Path, id: JobId, keep: Option<&str>) -> io::Result<()> {
    let job = folder.join("jobs").join(id.to_string());
    for entry in entries(&job)? {
        if keep.is_none_or(|keep| entry.file_name() != keep) {
            ignore_missing(fs::remove_dir_all(entry.path()))?;
        }
    }
    if keep.is_none() { ignore_missing(fs::remove_dir_all(job)) } else { Ok(()) }
}

/// Removes the folder of one claim of a job.
pub(super) fn remove_claim(folder: &Path, id: JobId, claim: &str) -> io::Result<()> {
    ignore_missing(fs::remove_dir_all(folder.join("jobs").join(id.to_string()).join(claim)))
}

/// Removes partly written files that were uploaded before their job, and have not changed since a time.
pub(super) fn remove_stale_incoming(folder: &Path, since: SystemTime) -> io::Result<()> {
    for entry in entries(&folder.join("incoming"))? {
        if last_change(&entry).is_ok_and(|change| change <= since) {
            ignore_missing(fs::remove_file(entry.path()))?;
        }
    }
    Ok(())
}

/// When an entry, or anything directly in it, last changed. A folder's own time does not change while a file in it grows.
fn last_change(entry: &DirEntry) -> io::Result<SystemTime> {
    let data = entry.metadata()?;
    let children = if data.is_dir() { entries(&entry.path())? } else { Vec::new() };
    let times = children.iter().filter_map(|child| child.metadata().and_then(|data| data.modified()).ok());
    Ok(times.fold(data.modified()?, SystemTime::max))
}

/// The owners of uploads and of result folders, of jobs none of whose files has changed since a time.
pub(super) fn owners(folder: &Path, since: SystemTime) -> io::Result<Vec<Owner>> {
    let mut changes: BTreeMap<JobId, SystemTime> = BTreeMap::new();
    let mut owners = Vec::new();
    for kind in KINDS {
        for entry in entries(&folder.join(kind))? {
            let (Some(job), Ok(change)) = (owner(&entry), last_change(&entry)) else { continue };
            let latest = changes.entry(job).or_insert(change);
            *latest = change.max(*latest);
            owners.push(Owner { job, claim: None });
            if kind == "jobs" {
                let claims =
                    entries(&entry.path())?.into_iter().filter_map(|claim| claim.file_name().into_string().ok());
                owners.extend(claims.map(|claim| Owner { job, claim: Some(claim) }));
            }
        }
    }
    changes.retain(|_, change| *change <= since);
    owners.retain(|owner| changes.contains_key(&owner.job));
    owners.sort();
    owners.dedup();
    Ok(owners)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::SystemIds;

    fn write(path: &Path, old: bool) {
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::write(path, "x").expect("a file");
        if old {
            set_old(path);
        }
    }

    fn set_old(path: &Path) {
        fs::File::open(path).expect("readable").set_modified(SystemTime::UNIX_EPOCH).expect("a time");
    }

    #[test]
    fn an_upload_with_a_growing_file_is_not_abandoned() {
        let root = tempfile::tempdir().expect("a folder");
        let (abandoned, growing) = (JobId::new(&SystemIds), JobId::new(&SystemIds));
        for id in [abandoned, growing] {
            write(&root.path().join("uploads").join(id.to_string()), true);
            let more = root.path().join("more").join(id.to_string());
            write(&more.join("1"), true);
            write(&more.join("2#1"), id == abandoned);
            set_old(&more);
        }
        let found = owners(root.path(), SystemTime::UNIX_EPOCH).expect("readable");
        assert_eq!(found, [Owner { job: abandoned, claim: None }]);
    }

    #[test]
    fn removing_uploads_removes_partly_written_files() {
        let root = tempfile::tempdir().expect("a folder");
        let (id, other) = (JobId::new(&SystemIds), JobId::new(&SystemIds));
        for id in [id, other] {
            write(&root.path().join("uploads").join(format!("{id}#1")), false);
            write(&root.path().join("more").join(id.to_string()).join("1#1"), false);
        }
        remove_uploads(root.path(), id).expect("removed");
        remove_uploads(root.path(), id).expect("gone already");
        for kind in ["uploads", "more"] {
            let owners: Vec<_> = entries(&root.path().join(kind)).expect("readable").iter().filter_map(owner).collect();
            assert_eq!(owners, [other], "{kind}");
        }
    }
}
