use std::fs::File;
use std::io;
use std::path::Path;
use std::process::{ExitStatus, Stdio};
use std::time::Duration;

use rustix::io::Errno;
use rustix::process::{Pid, Signal, WaitOptions, kill_process_group, waitpgid};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};

use super::task::Task;

/// A job's child process and all it starts, as one process group.
pub(super) struct JobProcess {
    child: Child,
    group: Pid,
    _lifeline: Option<ChildStdin>,
}

impl JobProcess {
    /// Starts `program job-child` in `folder` with an environment that holds no more than it needs.
    pub fn start(program: &Path, folder: &Path, first_attempt: bool) -> io::Result<Self> {
        let stderr = File::create(Task::in_folder(folder, Task::STDERR))?;
        let mut command = Command::new(program);
        command
            .arg("job-child")
            .arg(folder)
            .current_dir(folder)
            .env_clear()
            .env("PATH", std::env::var_os("PATH").unwrap_or_else(|| "/usr/local/bin:/usr/bin:/bin".into()))
            .env("HOME", folder)
            .env("TMPDIR", folder)
            .env("LANG", "C.UTF-8")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(stderr)
            .process_group(0)
            .kill_on_drop(true);
        if cfg!(feature = "failpoints") && first_attempt {
            command.envs(std::env::var_os("FAILPOINTS").map(|v| ("FAILPOINTS", v)));
        }
        let mut child = command.spawn()?;
        let id = child.id().and_then(|id| i32::try_from(id).ok()).and_then(Pid::from_raw);
        let group = id.ok_or_else(|| io::Error::other("the child process ended before it had an id"))?;
        let lifeline = child.stdin.take();
        Ok(Self { child, group, _lifeline: lifeline })
    }

    pub fn id(&self) -> i32 {
        self.group.as_raw_nonzero().get()
    }

    pub fn stdout(&mut self) -> Option<ChildStdout> {
        self.child.stdout.take()
    }

    /// Waits for the child itself; what it started may live on until [`end`](Self::end).
    pub async fn wait(&mut self) -> io::Result<ExitStatus> {
        self.child.wait().await
    }

    /// Kills whatever of the group is left and reaps it.
    pub async fn end(mut self) -> io::Result<ExitStatus> {
        match kill_process_group(self.group, Signal::KILL) {
            Ok(()) | Err(Errno::SRCH) => {}
            Err(e) => return Err(e.into()),
        }
        let status = self.child.wait().await?;
        // Grandchildren come to us because the pool made this process their reaper. A killed process ends within
        // moments, unless it hangs in the kernel, which is no reason to hold up the worker.
        for _ in 0..200 {
            match waitpgid(self.group, WaitOptions::NOHANG) {
                Ok(None) => tokio::time::sleep(Duration::from_millis(10)).await,
                Ok(Some(_)) => {}
                Err(_) => return Ok(status),
            }
        }
        tracing::error!(group = self.group.as_raw_nonzero(), "a killed process group is still there");
        Ok(status)
    }
}
