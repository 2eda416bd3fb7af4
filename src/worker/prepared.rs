//! Child processes that are started before a job arrives. Each has entered its sandbox, has loaded the program, and waits on its
//! standard input for one task. A child runs one task at most, so no job finds anything of an earlier job.

use std::io;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::TempDir;

use super::process::JobProcess;

/// A child process that waits for its task, with the scratch folder that it may write to.
pub(super) struct PreparedChild {
    /// The scratch folder, which is removed when this value is dropped.
    pub scratch: TempDir,
    /// The process.
    pub process: JobProcess,
}

/// The children of one worker process that wait for a task: at most one for each slot.
#[derive(Default)]
pub(super) struct PreparedChildren {
    waiting: Mutex<Vec<PreparedChild>>,
}

impl PreparedChildren {
    fn waiting(&self) -> MutexGuard<'_, Vec<PreparedChild>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts one more child, unless `max` children wait.
    ///
    /// # Errors
    /// The error of `start`.
    pub fn refill(&self, max: usize, start: impl FnOnce() -> io::Result<PreparedChild>) -> io::Result<()> {
        let mut waiting = self.waiting();
        if waiting.len() < max {
            waiting.push(start()?);
        }
        Ok(())
    }

    /// Removes a waiting child that still runs. Others are dropped: an operator or the kernel may have killed them.
    pub fn take(&self) -> Option<PreparedChild> {
        let mut waiting = self.waiting();
        while let Some(mut child) = waiting.pop() {
            if child.process.is_running() {
                return Some(child);
            }
            tracing::warn!(process = child.process.group().as_raw_nonzero(), "a waiting child process has ended");
        }
        None
    }

    /// Kills and reaps the waiting children, and removes their folders.
    pub async fn end(&self) {
        let waiting = std::mem::take(&mut *self.waiting());
        for PreparedChild { scratch, process } in waiting {
            if let Err(error) = process.end(false).await {
                tracing::warn!(%error, "could not end a waiting child process");
            }
            drop(scratch);
        }
    }
}
