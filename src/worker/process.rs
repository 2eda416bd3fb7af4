//! A job's child process: its start and end, its shared limits, and the reason it ended.

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

use crate::allocator;
use crate::jobs::{FailureKind, JobProblem, ProblemKind};
use crate::sandbox::processes::{MARK, count_group, end_descendants, end_strays};

/// How many bytes are kept from the end of a process's standard error.
const STDERR_BYTES: usize = 16 << 10;
/// How long to read the standard error of an ended process, in case another process keeps the pipe open.
const STDERR_WAIT: Duration = Duration::from_millis(500);

/// A job's child process and all processes it starts, as one process group.
pub(super) struct JobProcess {
    child: Child,
    group: Pid,
    folder: PathBuf,
    stderr: JoinHandle<Vec<u8>>,
    lifeline: JoinHandle<ChildStdin>,
}

impl JobProcess {
    /// Starts `program verb folder` with a minimal environment. The child reads each request as one line of JSON from standard
    /// input; `request` is the first. The pipe then stays open as a lifeline: it closes when this process ends.
    ///
    /// # Errors
    /// When the request can't be serialized or the process can't be started.
    pub fn start(program: &Path, verb: &str, folder: &Path, request: &impl Serialize) -> io::Result<Self> {
        let request = json_line(request)?;
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
            .env(allocator::VARIABLE, allocator::KEEP_FREED_MEMORY)
            .env(MARK, folder)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .process_group(0)
            .kill_on_drop(true);
        if cfg!(feature = "failpoints") {
            command.envs(std::env::var_os("FAILPOINTS").map(|v| ("FAILPOINTS", v)));
        }
        let mut child = command.spawn()?;
        let id = child.id().and_then(|id| i32::try_from(id).ok()).and_then(Pid::from_raw);
        let group = id.ok_or_else(|| io::Error::other("the child process ended before it had an id"))?;
        let (Some(stdin), Some(stderr)) = (child.stdin.take(), child.stderr.take()) else {
            return Err(io::Error::other("the child process has no standard input or error"));
        };
        let (lifeline, stderr) = (tokio::spawn(write_line(stdin, request)), tokio::spawn(read_tail(stderr)));
        Ok(Self { child, group, folder: folder.to_owned(), stderr, lifeline })
    }

    /// Sends the child one more request.
    ///
    /// # Errors
    /// When the request can't be serialized.
    pub async fn send(&mut self, request: &impl Serialize) -> io::Result<()> {
        let request = json_line(request)?;
        let stdin = (&mut self.lifeline).await.map_err(io::Error::from)?;
        self.lifeline = tokio::spawn(write_line(stdin, request));
        Ok(())
    }

    /// Whether the child has not ended.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// The id of the child's process group.
    pub fn group(&self) -> Pid {
        self.group
    }

    /// The child's standard output; `None` after the first call.
    pub fn stdout(&mut self) -> Option<ChildStdout> {
        self.child.stdout.take()
    }

    /// Waits for the child itself. Processes that it started may run until [`end`](Self::end).
    pub async fn wait(&mut self) -> io::Result<ExitStatus> {
        self.child.wait().await
    }

    /// Kills the process group and reaps its processes. With `may_leave_group` it also ends processes that left the group.
    /// Returns the child's exit status and the end of its standard error.
    ///
    /// # Errors
    /// When the group can't be killed, or the child's status can't be read.
    pub async fn end(mut self, may_leave_group: bool) -> io::Result<(ExitStatus, String)> {
        let mut strays = HashSet::new();
        // The search needs a living child: its own children get another parent when it ends.
        if may_leave_group && self.child.id().is_some() {
            let child = self.group;
            strays = tokio::task::spawn_blocking(move || end_descendants(child)).await?;
        }
        match kill_process_group(self.group, Signal::KILL) {
            Ok(()) | Err(Errno::SRCH) => {}
            Err(e) => return Err(e.into()),
        }
        let status = self.child.wait().await?;
        if may_leave_group {
            let folder = self.folder;
            strays.extend(tokio::task::spawn_blocking(move || end_strays(folder.as_os_str())).await?);
        }
        // The kernel reparents grandchildren to this process: the pool made it their subreaper.
        let group = self.group;
        reap(group, || waitpgid(group, WaitOptions::NOHANG).map(|ended| ended.is_some())).await;
        for stray in strays {
            reap(stray, || waitpid(Some(stray), WaitOptions::NOHANG).map(|ended| ended.is_some())).await;
        }
        let stderr = tokio::time::timeout(STDERR_WAIT, &mut self.stderr).await;
        self.stderr.abort();
        let stderr = stderr.ok().and_then(Result::ok).unwrap_or_default();
        Ok((status, String::from_utf8_lossy(&stderr).into_owned()))
    }
}

fn json_line(request: &impl Serialize) -> io::Result<Vec<u8>> {
    let mut line = serde_json::to_vec(request)?;
    line.push(b'\n');
    Ok(line)
}

/// Writes a line to a process's standard input, and returns the pipe, which the caller keeps as the lifeline.
async fn write_line(mut stdin: ChildStdin, line: Vec<u8>) -> ChildStdin {
    // The exit status of a process that ended before it read the line gives the reason.
    let _ = stdin.write_all(&line).await;
    stdin
}

/// Reads a process's standard error until it closes, and returns its last [`STDERR_BYTES`].
async fn read_tail(mut stderr: ChildStderr) -> Vec<u8> {
    let mut kept = Vec::new();
    while let Ok(1..) = stderr.read_buf(&mut kept).await {
        if kept.len() > 2 * STDERR_BYTES {
            kept.drain(..kept.len() - STDERR_BYTES);
        }
    }
    kept.split_off(kept.len().saturating_sub(STDERR_BYTES))
}

/// Reaps killed processes with `wait_one` until none is left. Gives up after two seconds: a process that hangs in the kernel
/// must not block the worker.
async fn reap(id: Pid, wait_one: impl Fn() -> Result<bool, Errno>) {
    for _ in 0..200 {
        match wait_one() {
            Ok(false) => tokio::time::sleep(Duration::from_millis(10)).await,
            Ok(true) => {}
            Err(_) => return,
        }
    }
    tracing::error!(id = id.as_raw_nonzero(), "killed process still exists");
}

/// Bytes charged for each file or folder, besides its content.
const ENTRY_BYTES: u64 = 4096;
/// How often to measure a job's use.
const MEASURE_EVERY: Duration = Duration::from_millis(500);
/// The unit of `st_blocks`, in bytes.
const BLOCK_BYTES: u64 = 512;

/// Limits on all of a job's processes together; the kernel counts these resources for each process alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SharedLimits {
    /// Bytes on disk.
    pub scratch_bytes: u64,
    /// Processes and threads; `None` if the kernel counts them.
    pub processes: Option<u64>,
}

/// The shared limit that a job exceeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Excess {
    /// Too many bytes on disk.
    Scratch,
    /// Too many processes and threads.
    Processes,
}

impl Excess {
    /// The name in logs and metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scratch => "scratch",
            Self::Processes => "processes",
        }
    }
}

impl SharedLimits {
    /// Waits until a job's processes exceed a limit, and returns which one; `None` once `longest` has passed.
    ///
    /// # Errors
    /// When a measurement panicked.
    pub async fn wait_for_excess(self, longest: Duration, folder: &Path, group: Pid) -> io::Result<Option<Excess>> {
        let watch = async {
            let mut tick = tokio::time::interval_at(Instant::now() + MEASURE_EVERY, MEASURE_EVERY);
            loop {
                tick.tick().await;
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

    /// The limit that the job with this scratch folder and process group exceeds, if any.
    pub fn exceeded(&self, folder: &Path, group: Pid) -> Option<Excess> {
        if disk_use(folder, self.scratch_bytes).is_none_or(|bytes| bytes > self.scratch_bytes) {
            return Some(Excess::Scratch);
        }
        self.processes.is_some_and(|max| count_group(group) > max).then_some(Excess::Processes)
    }
}

/// The bytes on disk of a folder and its content. Counting stops just above `max`. Returns `None` if a part can't be read: a
/// process can nest folders deeper than a path can name, or remove its own access.
fn disk_use(folder: &Path, max: u64) -> Option<u64> {
    let mut bytes = 0;
    let mut pending = vec![folder.to_owned()];
    while let Some(folder) = pending.pop() {
        let entries = match read_dir(&folder) {
            Ok(entries) => entries,
            // A running process may remove the folder during the walk.
            Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
            Err(_) => return None,
        };
        for path in entries.flatten().map(|entry| entry.path()) {
            let metadata = match symlink_metadata(&path) {
                Ok(metadata) => metadata,
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                Err(_) => return None,
            };
            bytes += ENTRY_BYTES + metadata.blocks() * BLOCK_BYTES;
            if bytes > max {
                return Some(bytes);
            }
            if metadata.is_dir() {
                pending.push(path);
            }
        }
    }
    Some(bytes)
}

/// Messages that mean that memory ran out: from the allocator, from a read into memory, and from the operating system for a
/// mapping and for a thread's stack.
const OUT_OF_MEMORY: [&str; 4] =
    ["memory allocation of", "out of memory", "Cannot allocate memory", "Resource temporarily unavailable"];

/// Messages that mean that the disk is full.
const DISK_FULL: [&str; 2] = ["No space left on device", "Disk quota exceeded"];

/// Explains a child process that ended without a result and without a problem file, by its exit status and standard error.
/// A retry would reach the same limit, so an exceeded limit is final. Other failures may be retried.
pub(super) fn explain_exit(status: ExitStatus, stderr: &str, memory_bytes: u64) -> (FailureKind, JobProblem) {
    const SIGXCPU: i32 = 24;
    const SIGXFSZ: i32 = 25;
    let megabytes = memory_bytes >> 20;
    let (kind, code, detail) = if OUT_OF_MEMORY.iter().any(|words| stderr.contains(words)) {
        let detail = format!(
            "The job needs more memory than a job may use ({megabytes} MiB). Submit a model with fewer faces, or ask the operator to \
             raise `--job-memory-mib`."
        );
        (FailureKind::Final, ProblemKind::OutOfMemory, detail)
    } else if status.signal() == Some(SIGXCPU) {
        let detail = "The job used more CPU time than a job may use. Submit a model with fewer faces, or set a smaller \
              `max_tier` or `level`.";
        (FailureKind::Final, ProblemKind::CpuLimit, detail.to_owned())
    } else if status.signal() == Some(SIGXFSZ) {
        let detail = "The job wrote a larger file than a job may write. Request a coarser result, such as a smaller \
              `voxel_resolution`.";
        (FailureKind::Final, ProblemKind::FileLimit, detail.to_owned())
    } else if DISK_FULL.iter().any(|words| stderr.contains(words)) {
        let detail =
            "The service's disk for running jobs is full. Submit the model again after the operator has freed space.";
        (FailureKind::Transient, ProblemKind::Internal, detail.to_owned())
    } else {
        let detail = format!(
            "The job's process ended unexpectedly ({status}). The fault lies with the service, not with the model: please \
             report it with the job's log."
        );
        (FailureKind::Crash, ProblemKind::Crashed, detail)
    };
    (kind, JobProblem::new(code, detail))
}

/// Explains a job that was killed because its processes together exceeded a limit.
pub(super) fn explain_excess(excess: Excess, scratch_bytes: u64, processes: u64) -> JobProblem {
    let (code, detail) = match excess {
        Excess::Scratch => (
            ProblemKind::FileLimit,
            format!(
                "The job's files used more disk space than a job may use ({} MiB). Request a coarser result, such as a smaller \
                 `voxel_resolution`, or ask the operator to raise `--job-scratch-mib`.",
                scratch_bytes >> 20
            ),
        ),
        Excess::Processes => (
            ProblemKind::Crashed,
            format!(
                "The job started more processes than a job may have ({processes}) and was stopped. The fault lies with the service, \
                 not with the model: please report it with the job's log, or ask the operator to raise `--job-processes`."
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
    fn disk_use_counts_all_files_and_stops_above_the_maximum() {
        let folder = tempfile::tempdir().expect("a folder");
        fs::create_dir_all(folder.path().join("a/b")).expect("a folder");
        fs::write(folder.path().join("a/b/file"), vec![1; 100_000]).expect("a file");
        let all = disk_use(folder.path(), u64::MAX).expect("readable folders");
        assert!((100_000..200_000).contains(&all), "{all}");
        for number in 0..100 {
            fs::write(folder.path().join(number.to_string()), "").expect("a file");
        }
        let some = disk_use(folder.path(), 150_000).expect("readable folders");
        assert!((150_001..400_000).contains(&some), "{some}");
    }

    #[test]
    fn disk_use_is_unknown_for_a_folder_too_deep_for_a_path() {
        let folder = tempfile::tempdir().expect("a folder");
        let name = "n".repeat(200);
        // Like a process that descends while it creates folders.
        let mut current = fs::File::open(folder.path()).expect("a folder");
        for _ in 0..30 {
            mkdirat(&current, &name, Mode::RWXU).expect("a folder");
            current = openat(&current, &name, OFlags::RDONLY, Mode::empty()).expect("a folder").into();
        }
        assert_eq!(disk_use(folder.path(), u64::MAX), None);
    }
}
