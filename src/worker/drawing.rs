//! Pictures of ended jobs, drawn when somebody asks for them.

use std::convert::Infallible;
use std::io;
use std::time::Duration;

use tokio::io::{copy, sink};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::context::{AttemptError, Shutdown, WorkerContext, retry_with_backoff, undrawn};
use super::process::JobProcess;
use super::scratch::sanitize;
use super::task::{JOB, Task};
use crate::jobs::{Artifacts, Claim, Job, Lease, StoreError};
use crate::repair::OfferedFile;

/// Times that it is tried before the job is left without pictures.
const TRIES: u32 = 3;

/// Draws the pictures of a job under a hold on them, and publishes those that could be drawn.
pub(super) async fn draw(context: &WorkerContext, claim: Claim, shutdown: &Shutdown) {
    let Claim { lease, job } = claim;
    let (started, over) = (Instant::now(), shutdown.now.child_token());
    let drawn = if lease.attempt > TRIES {
        Ok(Artifacts::new())
    } else {
        tokio::select! {
            drawn = try_draw(context, &lease, &job, &over) => drawn,
            never = keep_hold(context, &lease, &over) => match never {},
        }
    };
    let published = match drawn {
        Ok(drawn) => {
            retry_with_backoff(None, || context.store.finish_drawings(&lease, drawn.clone())).await.map(|_| drawn.len())
        }
        Err(error) => {
            tracing::warn!(%error, "the pictures were not drawn");
            context.drop_files(&lease).await;
            // For another worker, or this one, to try again; where that fails the hold runs out.
            let _ = context.store.hold_drawings(&lease, Duration::ZERO).await;
            return;
        }
    };
    let milliseconds = u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
    match published {
        Ok(pictures) => tracing::info!(pictures, milliseconds, "drawn"),
        Err(error) => {
            tracing::warn!(%error, milliseconds, "the pictures are dropped");
            context.drop_files(&lease).await;
        }
    }
}

/// Has a child process draw, and stores what it left. One that ends otherwise than it should leaves the pictures that it had drawn.
async fn try_draw(
    context: &WorkerContext,
    held: &Lease,
    job: &Job,
    over: &CancellationToken,
) -> Result<Artifacts, AttemptError> {
    let scratch = context.scratch.attempt()?;
    let folder = scratch.path();
    context.fetch_inputs(job, folder).await?;
    let model = job.artifacts.get(Task::MODEL).and_then(|model| model.file.as_ref());
    if let Some(file) = model {
        let path = folder.join(Task::MODEL);
        retry_with_backoff(Some(over), || context.blobs.fetch(&file.key, &file.sha256, &path)).await?;
    }
    let offered_file = match model {
        Some(_) => OfferedFile::Model,
        None if job.artifacts.contains_key(Task::ORIGINAL) => OfferedFile::Original,
        None => OfferedFile::None,
    };
    let task = context.task(job, Some(offered_file));
    let mut process = JobProcess::start(&context.config.program, JOB, folder, held.attempt == 1, &task)?;
    // Nobody hears how far it is, but it must be able to say so.
    if let Some(mut progress) = process.stdout() {
        tokio::spawn(async move { copy(&mut progress, &mut sink()).await });
    }
    let group = process.group();
    let ended = tokio::select! {
        status = process.wait() => status.map(drop),
        excess = context.overrun(job, folder, group) => excess.map(drop),
        () = over.cancelled() => Ok(()),
    };
    let (status, said) = process.end(context.loose()).await?;
    ended?;
    if over.is_cancelled() {
        return Err(StoreError::LeaseLost.into());
    }
    let left = folder.to_owned();
    tokio::task::spawn_blocking(move || sanitize(&left)).await.map_err(io::Error::from)?;
    let drawn = context.store_files(held, folder, undrawn(job), over).await?;
    if !status.success() {
        tracing::warn!(%status, said, pictures = drawn.len(), "drawing ended early");
        if drawn.is_empty() {
            return Err(io::Error::other(format!("the process ended: {status}")).into());
        }
    }
    Ok(drawn)
}

/// Extends the hold until it is lost, and then waits for the drawing to end itself.
async fn keep_hold(context: &WorkerContext, held: &Lease, over: &CancellationToken) -> Infallible {
    let lease = context.config.lease;
    loop {
        tokio::time::sleep(lease / 3).await;
        if let Err(StoreError::LeaseLost) = context.store.hold_drawings(held, lease).await {
            over.cancel();
            return std::future::pending().await;
        }
    }
}
