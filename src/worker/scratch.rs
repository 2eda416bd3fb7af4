use std::fs::{self, File};
use std::io;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
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
        fs::DirBuilder::new().mode(0o700).create(&folder)?;
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
            sanitize(&folder);
            match fs::remove_dir_all(&folder) {
                // Another worker may be clearing away too.
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    tracing::warn!(%error, folder = %folder.display(), "could not remove it");
                }
                _ => {}
            }
        }
    }
    Ok(())
}

/// Makes what a job's processes left in a folder safe to go through, once they have ended: takes away what is neither a file nor a
/// folder, such as links that lead elsewhere and pipes that never end, and opens folders that they closed.
pub(super) fn sanitize(folder: &Path) {
    let mut left = vec![folder.to_owned()];
    while let Some(folder) = left.pop() {
        let entries = fs::read_dir(&folder).into_iter().flatten().flatten();
        for path in entries.map(|entry| entry.path()) {
            // What can't be done here is an error to whoever comes for the file.
            let Ok(found) = fs::symlink_metadata(&path) else { continue };
            if found.is_dir() {
                if found.permissions().mode() & 0o700 != 0o700 {
                    let _ = fs::set_permissions(&path, fs::Permissions::from_mode(0o700));
                }
                left.push(path);
            } else if !found.is_file() {
                let _ = fs::remove_file(&path);
            }
        }
    }
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

    #[test]
    fn what_leads_out_of_a_folder_is_taken_away_and_what_is_closed_is_opened() {
        let (outside, folder) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
        let (closed, link) = (folder.path().join("closed"), folder.path().join("closed/model"));
        fs::create_dir(&closed).expect("a folder");
        fs::write(outside.path().join("secret"), "").expect("a file");
        fs::write(closed.join("kept"), "").expect("a file");
        std::os::unix::fs::symlink(outside.path().join("secret"), &link).expect("a link");
        std::os::unix::fs::symlink(outside.path(), closed.join("folder")).expect("a link");
        fs::set_permissions(&closed, fs::Permissions::from_mode(0o000)).expect("it is ours");
        sanitize(folder.path());
        let left: Vec<_> =
            fs::read_dir(&closed).expect("it is open").flatten().map(|entry| entry.file_name()).collect();
        assert_eq!(left, ["kept"]);
        assert!(outside.path().join("secret").exists());
    }
}
