//! Pictures of ended jobs, drawn at the first request.

use std::convert::Infallible;
use std::io;
use std::time::Duration;

use tokio::io::{copy, sink};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::context::{AttemptError, Shutdown, WorkerContext, retry_with_backoff};
use super::files::undrawn_files;
use super::prepared::PreparedChild;
use super::scratch::sanitize;
use super::task::Task;
use crate::jobs::{Artifacts, Claim, Job, Lease, StoreError};
use crate::repair::OfferedFile;

/// How many attempts at drawing a job gets before it is left without pictures.
const MAX_ATTEMPTS: u32 = 3;

/// Draws a job's pictures under a lease on its drawings, and publishes those that could be drawn.
pub(super) async fn draw(context: &WorkerContext, claim: Claim, shutdown: &Shutdown) {
    let Claim { lease, job } = claim;
    let (started, stop) = (Instant::now(), shutdown.now.child_token());
    let drawn = if lease.attempt > MAX_ATTEMPTS {
        Ok(Artifacts::new())
    } else {
        tokio::select! {
        drawn = try_draw(context, &lease, &job, &stop) => drawn,
        never = keep_hold(context, &lease, &stop) => match never {},
                }
    };
    let published = match drawn {
        Ok(drawn) => {
            retry_with_backoff(None, || context.store.finish_drawings(&lease, drawn.clone())).await.map(|_| drawn.len())
        }
        Err(error) => {
            tracing::warn!(%error, "could not draw pictures");
            context.drop_files(&lease).await;
            // Ends the hold, so that a worker can retry at once. If the store fails, the hold expires later.
            let _ = context.store.hold_drawings(&lease, Duration::ZERO).await;
            return;
        }
    };
    let milliseconds = u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
    match published {
        Ok(pictures) => tracing::info!(pictures, milliseconds, "pictures drawn"),
        Err(error) => {
            tracing::warn!(%error, milliseconds, "could not publish pictures; pictures dropped");
            context.drop_files(&lease).await;
        }
    }
}

/// Draws in a child process and stores the pictures that it left. A child that fails midway keeps the pictures drawn before.
async fn try_draw(
    context: &WorkerContext,
    held: &Lease,
    job: &Job,
    stop: &CancellationToken,
) -> Result<Artifacts, AttemptError> {
    let PreparedChild { scratch, mut process } = context.child()?;
    let folder = scratch.path();
    context.fetch_inputs(job, folder).await?;
    let model = job.artifacts.get(Task::MODEL).and_then(|model| model.file.as_ref());
    if let Some(file) = model {
        let path = folder.join(Task::MODEL);
        retry_with_backoff(Some(stop), || context.blobs.fetch(&file.key, &file.sha256, &path)).await?;
    }
    let offered_file = match model {
        Some(_) => OfferedFile::Model,
        None if job.artifacts.contains_key(Task::ORIGINAL) => OfferedFile::Original,
        None => OfferedFile::None,
    };
    process.send(&context.task(job, held.attempt, Some(offered_file))).await?;
    // The progress is not used, but the pipe must not fill up.
    if let Some(mut progress) = process.stdout() {
        tokio::spawn(async move { copy(&mut progress, &mut sink()).await });
    }
    let group = process.group();
    let result = tokio::select! {
        status = process.wait() => status.map(drop),
        excess = context.wait_for_excess(job, folder, group) => excess.map(drop),
        () = stop.cancelled() => Ok(()),
    };
    let (status, stderr) = process.end(context.may_leave_group()).await?;
    result?;
    if stop.is_cancelled() {
        return Err(StoreError::LeaseLost.into());
    }
    let scratch_path = folder.to_owned();
    tokio::task::spawn_blocking(move || sanitize(&scratch_path)).await.map_err(io::Error::from)?;
    let drawn = context.store_files(held, folder, undrawn_files(job), stop).await?;
    if !status.success() {
        tracing::warn!(%status, stderr, pictures = drawn.len(), "drawing process failed");
        if drawn.is_empty() {
            return Err(io::Error::other(format!("the drawing process ended: {status}")).into());
        }
    }
    Ok(drawn)
}

/// Extends the hold on the drawings. When the hold is lost, it cancels `stop` and never completes: the drawing ends itself.
async fn keep_hold(context: &WorkerContext, held: &Lease, stop: &CancellationToken) -> Infallible {
    let lease = context.config.lease;
    loop {
        tokio::time::sleep(lease / 3).await;
        if let Err(StoreError::LeaseLost) = context.store.hold_drawings(held, lease).await {
            stop.cancel();
            return std::future::pending().await;
        }
    }
}
