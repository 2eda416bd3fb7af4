//! Scratch folders: one for each worker process, with one folder for each attempt.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, flock};
use tempfile::TempDir;

/// A worker process's private folder. Each attempt gets a folder in it, which is removed when the attempt ends.
///
/// The process holds a file lock on the folder. The operating system drops the lock however the process ends. A worker that
/// starts thus recognizes the folders of killed workers by their free locks, and removes them.
#[derive(Debug)]
pub(super) struct Scratch {
    folder: PathBuf,
    _lock: File,
}

const LOCK: &str = ".lock";

impl Scratch {
    /// Creates the folder `worker` in `root`, after removing the folders of ended workers.
    ///
    /// # Errors
    /// When a folder can't be created, listed or locked.
    pub fn open(root: &Path, worker: &str) -> io::Result<Self> {
        fs::create_dir_all(root)?;
        remove_abandoned(root)?;
        let folder = root.join(worker);
        fs::DirBuilder::new().mode(0o700).create(&folder)?;
        let lock = File::create(folder.join(LOCK))?;
        flock(&lock, FlockOperation::NonBlockingLockExclusive)?;
        Ok(Self { folder, _lock: lock })
    }

    /// Creates a folder for one attempt.
    ///
    /// # Errors
    /// When the folder can't be created.
    pub fn attempt(&self) -> io::Result<TempDir> {
        tempfile::Builder::new().prefix("attempt-").tempdir_in(&self.folder)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        if let Err(error) = fs::remove_dir_all(&self.folder) {
            tracing::warn!(%error, folder = %self.folder.display(), "could not remove the scratch folder");
        }
    }
}

fn remove_abandoned(root: &Path) -> io::Result<()> {
    for entry in fs::read_dir(root)? {
        let folder = entry?.path();
        let Ok(lock) = File::open(folder.join(LOCK)) else { continue };
        if flock(&lock, FlockOperation::NonBlockingLockExclusive).is_ok() {
            tracing::info!(folder = %folder.display(), "removing scratch folder of an ended worker");
            sanitize(&folder);
            match fs::remove_dir_all(&folder) {
                // Another worker may remove the same folder.
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    tracing::warn!(%error, folder = %folder.display(), "could not remove the scratch folder of an ended worker");
                }
                _ => {}
            }
        }
    }
    Ok(())
}

/// Makes a folder safe to read after a job's processes have ended. Removes entries that are neither files nor folders, such as
/// links to other folders and pipes without end. Restores the owner's access to folders that the job closed.
pub(super) fn sanitize(folder: &Path) {
    let mut pending = vec![folder.to_owned()];
    while let Some(folder) = pending.pop() {
        let entries = fs::read_dir(&folder).into_iter().flatten().flatten();
        for path in entries.map(|entry| entry.path()) {
            // Failures are ignored here: reading the file later reports them.
            let Ok(metadata) = fs::symlink_metadata(&path) else { continue };
            if metadata.is_dir() {
                if metadata.permissions().mode() & 0o700 != 0o700 {
                    let _ = fs::set_permissions(&path, fs::Permissions::from_mode(0o700));
                }
                pending.push(path);
            } else if !metadata.is_file() {
                let _ = fs::remove_file(&path);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_starting_worker_removes_abandoned_folders_and_keeps_locked_ones() {
        let root = tempfile::tempdir().expect("a folder");
        let held = Scratch::open(root.path(), "held").expect("a scratch folder");
        fs::create_dir(root.path().join("left")).expect("a folder");
        fs::write(root.path().join("left").join(LOCK), "").expect("a file");
        let attempt = held.attempt().expect("a folder");
        drop(Scratch::open(root.path(), "next").expect("a scratch folder"));
        assert!(attempt.path().exists());
        assert!(!root.path().join("left").exists());
        assert!(!root.path().join("next").exists());
    }

    #[test]
    fn sanitize_removes_links_and_reopens_closed_folders() {
        let (outside, folder) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
        let (closed, link) = (folder.path().join("closed"), folder.path().join("closed/model"));
        fs::create_dir(&closed).expect("a folder");
        fs::write(outside.path().join("secret"), "").expect("a file");
        fs::write(closed.join("kept"), "").expect("a file");
        std::os::unix::fs::symlink(outside.path().join("secret"), &link).expect("a link");
        std::os::unix::fs::symlink(outside.path(), closed.join("folder")).expect("a link");
        fs::set_permissions(&closed, fs::Permissions::from_mode(0o000)).expect("it is ours");
        sanitize(folder.path());
        let names: Vec<_> =
            fs::read_dir(&closed).expect("it is open").flatten().map(|entry| entry.file_name()).collect();
        assert_eq!(names, ["kept"]);
        assert!(outside.path().join("secret").exists());
    }
}
