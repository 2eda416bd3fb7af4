//! Child processes that are started before a job arrives. Each has entered its sandbox, has loaded the program, and waits on its
//! standard input for one task. A child runs at most one task, so a job can't see data of an earlier job.

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

    /// Starts one more child, unless `max` children are waiting already.
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

    /// Takes out a waiting child that is still running; `None` if there is none. Drops children that have ended, for example because an
    /// operator or the kernel killed them.
    pub fn take(&self) -> Option<PreparedChild> {
        let mut waiting = self.waiting();
        while let Some(mut child) = waiting.pop() {
            if child.process.is_running() {
                return Some(child);
            }
            tracing::warn!(
                process = child.process.group().as_raw_nonzero(),
                "a prepared child process ended before it got a job"
            );
        }
        None
    }

    /// Kills and reaps the waiting children, and removes their folders.
    pub async fn end(&self) {
        let waiting = std::mem::take(&mut *self.waiting());
        for PreparedChild { scratch, process } in waiting {
            if let Err(error) = process.end(false).await {
                tracing::warn!(%error, "could not end a prepared child process");
            }
            drop(scratch);
        }
    }
}
