//! A job's child process: how it starts and ends, what it may take, and why it ended.

use std::collections::HashSet;
use std::fs::{read_dir, symlink_metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use rustix::io::Errno;
use rustix::process::{Pid, Signal, WaitOptions, kill_process_group, waitpgid, waitpid};
use serde::Serialize;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command};
use tokio::task::JoinHandle;
use tokio::time::Instant;

use crate::jobs::{FailureKind, JobProblem, ProblemKind};
use crate::sandbox::processes::{MARK, count_group, end_descendants, end_strays};

/// Memory in large pages, and none set apart for each thread: most of what a short-lived process waits for is memory that it touches for
/// the first time. C libraries other than glibc don't know it.
const ALLOCATOR: &str = "glibc.malloc.hugetlb=1:glibc.malloc.arena_max=1";
/// Bytes from the end of a process's standard error that are kept.
const STDERR_BYTES: usize = 16 << 10;
/// How long to wait for the end of its standard error once it has ended, in case another process holds it open.
const LAST_WORDS: Duration = Duration::from_millis(500);

/// A job's child process and all it starts, as one process group.
pub(super) struct JobProcess {
    child: Child,
    group: Pid,
    folder: PathBuf,
    stderr: JoinHandle<Vec<u8>>,
    _lifeline: JoinHandle<ChildStdin>,
}

impl JobProcess {
    /// Starts `program verb folder` with an environment that holds no more than it needs, and tells it what to do: a line of JSON on its
    /// standard input, which then stays open as its lifeline.
    pub fn start(
        program: &Path,
        verb: &str,
        folder: &Path,
        first_attempt: bool,
        task: &impl Serialize,
    ) -> io::Result<Self> {
        let mut task = serde_json::to_vec(task)?;
        task.push(b'\n');
        let mut command = Command::new(program);
        command
            .arg(verb)
            .arg(folder)
            .current_dir(folder)
            .env_clear()
            .env("PATH", std::env::var_os("PATH").unwrap_or_else(|| "/usr/local/bin:/usr/bin:/bin".into()))
            .env("HOME", folder)
            .env("TMPDIR", folder)
            .env("LANG", "C.UTF-8")
            .env("GLIBC_TUNABLES", ALLOCATOR)
            .env(MARK, folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0)
            .kill_on_drop(true);
        if cfg!(feature = "failpoints") && first_attempt {
            command.envs(std::env::var_os("FAILPOINTS").map(|v| ("FAILPOINTS", v)));
        }
        let mut child = command.spawn()?;
        let id = child.id().and_then(|id| i32::try_from(id).ok()).and_then(Pid::from_raw);
        let group = id.ok_or_else(|| io::Error::other("the child process ended before it had an id"))?;
        let (Some(stdin), Some(stderr)) = (child.stdin.take(), child.stderr.take()) else {
            return Err(io::Error::other("the child process has no standard input or error"));
        };
        let (lifeline, stderr) = (tokio::spawn(tell(stdin, task)), tokio::spawn(tail(stderr)));
        Ok(Self { child, group, folder: folder.to_owned(), stderr, _lifeline: lifeline })
    }

    pub fn group(&self) -> Pid {
        self.group
    }

    pub fn stdout(&mut self) -> Option<ChildStdout> {
        self.child.stdout.take()
    }

    /// Waits for the child itself; what it started may live on until [`end`](Self::end).
    pub async fn wait(&mut self) -> io::Result<ExitStatus> {
        self.child.wait().await
    }

    /// Kills whatever of the group is left and reaps it. Where nothing kept its processes in the group (`loose`), those that left it are
    /// looked for too. Gives how it ended, and the end of what it wrote to standard error.
    pub async fn end(mut self, loose: bool) -> io::Result<(ExitStatus, String)> {
        let mut strays = HashSet::new();
        // Before the child is gone, since its children get another parent then.
        if loose && self.child.id().is_some() {
            let child = self.group;
            strays = tokio::task::spawn_blocking(move || end_descendants(child)).await?;
        }
        match kill_process_group(self.group, Signal::KILL) {
            Ok(()) | Err(Errno::SRCH) => {}
            Err(e) => return Err(e.into()),
        }
        let status = self.child.wait().await?;
        if loose {
            let folder = self.folder;
            strays.extend(tokio::task::spawn_blocking(move || end_strays(folder.as_os_str())).await?);
        }
        // Grandchildren come to us because the pool made this process their reaper.
        let group = self.group;
        reap(group, || waitpgid(group, WaitOptions::NOHANG).map(|it| it.is_some())).await;
        for stray in strays {
            reap(stray, || waitpid(Some(stray), WaitOptions::NOHANG).map(|it| it.is_some())).await;
        }
        let stderr = tokio::time::timeout(LAST_WORDS, &mut self.stderr).await;
        self.stderr.abort();
        let stderr = stderr.ok().and_then(Result::ok).unwrap_or_default();
        Ok((status, String::from_utf8_lossy(&stderr).into_owned()))
    }
}

/// Writes a process's task, as fast as it reads, and gives what it is to keep as long as it is to live.
async fn tell(mut stdin: ChildStdin, task: Vec<u8>) -> ChildStdin {
    // A process that has ended before it read its task says why by its exit status.
    let _ = stdin.write_all(&task).await;
    stdin
}

/// The end of what a process writes until it ends.
async fn tail(mut stderr: ChildStderr) -> Vec<u8> {
    let mut kept = Vec::new();
    while let Ok(1..) = stderr.read_buf(&mut kept).await {
        if kept.len() > 2 * STDERR_BYTES {
            kept.drain(..kept.len() - STDERR_BYTES);
        }
    }
    kept.split_off(kept.len().saturating_sub(STDERR_BYTES))
}

/// Waits for killed processes until there are none. A killed process ends within moments, unless it hangs in the kernel, which is
/// no reason to hold up the worker.
async fn reap(id: Pid, one: impl Fn() -> Result<bool, Errno>) {
    for _ in 0..200 {
        match one() {
            Ok(false) => tokio::time::sleep(Duration::from_millis(10)).await,
            Ok(true) => {}
            Err(_) => return,
        }
    }
    tracing::error!(id = id.as_raw_nonzero(), "a killed process is still there");
}

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

/// What is said where memory ends: by the allocator, by a read into memory, by the operating system of a mapping and of a
/// thread's stack.
const OUT_OF_MEMORY: [&str; 4] =
    ["memory allocation of", "out of memory", "Cannot allocate memory", "Resource temporarily unavailable"];

/// What is said where a disk is full.
const OUT_OF_ROOM: [&str; 2] = ["No space left on device", "Disk quota exceeded"];

/// Why a job's process ended without a result and without saying so in its own words: by its exit status and what it
/// wrote to standard error. A limit would be met again, so that is final; anything else may be tried again.
pub(super) fn explain_exit(status: ExitStatus, stderr: &str, memory_bytes: u64) -> (FailureKind, JobProblem) {
    const SIGXCPU: i32 = 24;
    const SIGXFSZ: i32 = 25;
    let megabytes = memory_bytes >> 20;
    let (kind, code, detail) = if OUT_OF_MEMORY.iter().any(|words| stderr.contains(words)) {
        let detail = format!(
            "The job needs more than the {megabytes} MiB of memory that a job may have. Send the model with \
             fewer faces, or raise the service's --job-memory."
        );
        (FailureKind::Final, ProblemKind::OutOfMemory, detail)
    } else if status.signal() == Some(SIGXCPU) {
        let detail = "The job used more processor time than a job may have. Send it with fewer faces, or a smaller max_tier \
                      or level.";
        (FailureKind::Final, ProblemKind::CpuLimit, detail.to_owned())
    } else if status.signal() == Some(SIGXFSZ) {
        let detail = "The job wrote a larger file than a job may write. Ask for a coarser result, such as a \
                      smaller voxel_resolution.";
        (FailureKind::Final, ProblemKind::FileLimit, detail.to_owned())
    } else if OUT_OF_ROOM.iter().any(|words| stderr.contains(words)) {
        let detail =
            "The disk that jobs are done on is full. The operator has to make room; send the model again then.";
        (FailureKind::Passing, ProblemKind::Internal, detail.to_owned())
    } else {
        let detail = format!(
            "The job's process ended by itself ({status}). This is a fault of the service, not of the model: \
             please report it with the job's log."
        );
        (FailureKind::Crash, ProblemKind::Crashed, detail)
    };
    (kind, JobProblem::new(code, detail))
}

/// Why a job was killed that took too much of what is counted for all its processes together.
pub(super) fn explain_excess(excess: Excess, scratch_bytes: u64, processes: u64) -> JobProblem {
    let (code, detail) = match excess {
        Excess::Scratch => (
            ProblemKind::FileLimit,
            format!(
                "The job's files took more than the {} MiB of disk that a job may have. Ask for a coarser result, such as a \
                 smaller voxel_resolution, or raise the service's --job-scratch-mib.",
                scratch_bytes >> 20
            ),
        ),
        Excess::Processes => (
            ProblemKind::Crashed,
            format!(
                "The job started more than the {processes} processes that a job may have, and was stopped. This is a fault \
                 of the service, not of the model: please report it with the job's log, or raise the service's --job-processes."
            ),
        ),
    };
    JobProblem::new(code, detail)
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
