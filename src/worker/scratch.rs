use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, flock};
use tempfile::TempDir;

/// A worker process's private folder. Each attempt gets a folder in it, removed when the attempt ends.
///
/// The folder is held by a file lock, which the operating system drops however the process ends; so the folders that
/// killed workers left behind are told from those in use, and are removed when the next worker starts.
#[derive(Debug)]
pub(super) struct Scratch {
    folder: PathBuf,
    _lock: File,
}

const LOCK: &str = ".lock";

impl Scratch {
    pub fn open(root: &Path, worker: &str) -> io::Result<Self> {
        fs::create_dir_all(root)?;
        remove_abandoned(root)?;
        let folder = root.join(worker);
        fs::create_dir(&folder)?;
        let lock = File::create(folder.join(LOCK))?;
        flock(&lock, FlockOperation::NonBlockingLockExclusive)?;
        Ok(Self { folder, _lock: lock })
    }

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
            tracing::info!(folder = %folder.display(), "removing the scratch folder of a worker that is gone");
            match fs::remove_dir_all(&folder) {
                // Another worker may be clearing away too.
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_in_use_stays_and_one_left_behind_is_removed() {
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
}
