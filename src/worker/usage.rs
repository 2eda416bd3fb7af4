use std::fs::{read_dir, symlink_metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::Duration;

use rustix::process::Pid;
use tokio::time::Instant;

use crate::sandbox::processes::count_group;

/// What a file or folder takes beside its content.
const ENTRY_BYTES: u64 = 4096;
/// How often to look at what a job has taken.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// `st_blocks` counts in these.
const BLOCK_BYTES: u64 = 512;

/// What a job's processes may take together, of what the kernel counts for each alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Allowance {
    /// Bytes on disk.
    pub scratch_bytes: u64,
    /// Processes and threads, where the kernel does not count them.
    pub processes: Option<u64>,
}

/// What a job took too much of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Excess {
    Scratch,
    Processes,
}

impl Excess {
    /// What it is called in logs and metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scratch => "scratch",
            Self::Processes => "processes",
        }
    }
}

impl Allowance {
    /// Waits until a job's processes are beyond it, and answers what they took too much of; none once `longest` has passed.
    ///
    /// # Errors
    /// When the look at them crashed.
    pub async fn overrun(self, longest: Duration, folder: &Path, group: Pid) -> io::Result<Option<Excess>> {
        let watch = async {
            let mut looks = tokio::time::interval_at(Instant::now() + LOOK_EVERY, LOOK_EVERY);
            loop {
                looks.tick().await;
                let folder = folder.to_owned();
                if let Some(excess) = tokio::task::spawn_blocking(move || self.exceeded(&folder, group)).await? {
                    return Ok(excess);
                }
            }
        };
        match tokio::time::timeout(longest, watch).await {
            Ok(excess) => excess.map(Some),
            Err(_) => Ok(None),
        }
    }

    /// Whether the job with this folder and process group is beyond it.
    pub fn exceeded(&self, folder: &Path, group: Pid) -> Option<Excess> {
        if taken(folder, self.scratch_bytes).is_none_or(|bytes| bytes > self.scratch_bytes) {
            return Some(Excess::Scratch);
        }
        self.processes.is_some_and(|most| count_group(group) > most).then_some(Excess::Processes)
    }
}

/// Bytes on disk of a folder with all in it, counted no further than just above `most`; none where it hides something, since a folder
/// can be too deep to be named, or closed to its own owner.
fn taken(folder: &Path, most: u64) -> Option<u64> {
    let mut bytes = 0;
    let mut left = vec![folder.to_owned()];
    while let Some(folder) = left.pop() {
        let entries = match read_dir(&folder) {
            Ok(entries) => entries,
            // It went meanwhile.
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            Err(_) => return None,
        };
        for path in entries.flatten().map(|entry| entry.path()) {
            let found = match symlink_metadata(&path) {
                Ok(found) => found,
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                Err(_) => return None,
            };
            bytes += ENTRY_BYTES + found.blocks() * BLOCK_BYTES;
            if bytes > most {
                return Some(bytes);
            }
            if found.is_dir() {
                left.push(path);
            }
        }
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use rustix::fs::{Mode, OFlags, mkdirat, openat};

    use super::*;

    #[test]
    fn all_files_count_and_no_more_are_looked_at_than_is_needed() {
        let folder = tempfile::tempdir().expect("a folder");
        fs::create_dir_all(folder.path().join("a/b")).expect("a folder");
        fs::write(folder.path().join("a/b/file"), vec![1; 100_000]).expect("a file");
        let all = taken(folder.path(), u64::MAX).expect("nothing is hidden");
        assert!((100_000..200_000).contains(&all), "{all}");
        for number in 0..100 {
            fs::write(folder.path().join(number.to_string()), "").expect("a file");
        }
        let some = taken(folder.path(), 150_000).expect("nothing is hidden");
        assert!((150_001..400_000).contains(&some), "{some}");
    }

    #[test]
    fn a_folder_too_deep_to_be_named_is_not_passed_over() {
        let folder = tempfile::tempdir().expect("a folder");
        let name = "n".repeat(200);
        // As a process does that goes down as it makes them.
        let mut here = fs::File::open(folder.path()).expect("a folder");
        for _ in 0..30 {
            mkdirat(&here, &name, Mode::RWXU).expect("a folder");
            here = openat(&here, &name, OFlags::RDONLY, Mode::empty()).expect("a folder").into();
        }
        assert_eq!(taken(folder.path(), u64::MAX), None);
    }
}
