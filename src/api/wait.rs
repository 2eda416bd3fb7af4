use std::time::Duration;

use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;

use super::state::ApiState;
use crate::jobs::{Job, JobId, StoreError};

/// Sees every change of one job: rung by the bell, and looking by itself now and then in case another process made it.
pub(super) struct Watch {
    state: ApiState,
    id: JobId,
    bell: Receiver<JobId>,
}

impl Watch {
    /// Begins to listen. Read the job after this, so that no change falls between.
    pub fn new(state: &ApiState, id: JobId) -> Self {
        Self { state: state.clone(), id, bell: state.store.bell().listen() }
    }

    /// The job once its version is past `version`; none when the service stops or the job is gone.
    pub async fn past(&mut self, version: i64) -> Result<Option<Job>, StoreError> {
        loop {
            match self.state.store.get(self.id).await? {
                None => return Ok(None),
                Some(job) if job.version > version => return Ok(Some(job)),
                Some(_) => {}
            }
            tokio::select! {
                () = rung(&mut self.bell, self.id) => {}
                () = tokio::time::sleep(self.state.config.poll) => {}
                () = self.state.stopping.cancelled() => return Ok(None),
            }
        }
    }

    /// The job once its status is another than that of `job`, or as it is when `longest` has passed.
    pub async fn status_change(&mut self, job: Job, longest: Duration) -> Result<Job, StoreError> {
        let status = job.status;
        self.until(job, longest, |job| job.status != status || status.is_final()).await
    }

    /// The job once `is_done` says so of it, or as it is when `longest` has passed, the service stops or the job is gone.
    pub async fn until(
        &mut self,
        mut job: Job,
        longest: Duration,
        is_done: impl Fn(&Job) -> bool,
    ) -> Result<Job, StoreError> {
        let waiting = async {
            while !is_done(&job) {
                match self.past(job.version).await? {
                    Some(newer) => job = newer,
                    None => break,
                }
            }
            Ok::<(), StoreError>(())
        };
        match tokio::time::timeout(longest, waiting).await {
            Ok(Err(error)) => Err(error),
            Ok(Ok(())) | Err(_) => Ok(job),
        }
    }
}

/// Waits until the bell rings for the job.
async fn rung(bell: &mut Receiver<JobId>, id: JobId) {
    loop {
        match bell.recv().await {
            Ok(other) if other != id => {}
            Ok(_) | Err(RecvError::Lagged(_)) => return,
            Err(RecvError::Closed) => std::future::pending().await,
        }
    }
}
