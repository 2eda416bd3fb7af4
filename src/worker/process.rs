use std::collections::HashSet;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use rustix::io::Errno;
use rustix::process::{Pid, Signal, WaitOptions, kill_process_group, waitpgid, waitpid};
use serde::Serialize;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command};
use tokio::task::JoinHandle;

use crate::sandbox::processes::{MARK, end_descendants, end_strays};

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
