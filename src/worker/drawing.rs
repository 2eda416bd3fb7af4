//! Pictures of ended jobs, drawn when somebody asks for them.

use std::convert::Infallible;
use std::io;
use std::path::Path;

use tokio::io::{copy, sink};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::attempt::{AttemptError, USAGE_EVERY};
use super::files::undrawn;
use super::inside;
use super::patience::patiently;
use super::pool::{Pool, Shutdown};
use super::process::JobProcess;
use super::scratch::tame;
use super::task::Task;
use crate::jobs::{Artifacts, Claim, Job, Lease, StoreError};
use crate::repair::HandedOut;

/// Times that it is tried before the job is left without pictures.
const TRIES: u32 = 3;

/// Draws the pictures of a job under a hold on them, and publishes those that could be drawn.
pub(super) async fn draw(pool: &Pool, claim: Claim, shutdown: &Shutdown) {
    let Claim { lease, job } = claim;
    let (started, over) = (Instant::now(), shutdown.now.child_token());
    let drawn = if lease.attempt > TRIES {
        Ok(Artifacts::new())
    } else {
        tokio::select! {
            drawn = try_draw(pool, &lease, &job, &over) => drawn,
            never = keep_hold(pool, &lease, &over) => match never {},
        }
    };
    let published = match drawn {
        Ok(drawn) => patiently(None, || pool.store.finish_drawings(&lease, drawn.clone())).await.map(|_| drawn.len()),
        Err(error) => {
            tracing::warn!(%error, "the pictures were not drawn");
            drop_files(pool, &lease).await;
            // For another worker, or this one, to try again; where that fails the hold runs out.
            let _ = pool.store.hold_drawings(&lease, std::time::Duration::ZERO).await;
            return;
        }
    };
    let milliseconds = u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
    match published {
        Ok(pictures) => tracing::info!(pictures, milliseconds, "drawn"),
        Err(error) => {
            tracing::warn!(%error, milliseconds, "the pictures are dropped");
            drop_files(pool, &lease).await;
        }
    }
}

/// Has a child process draw, and stores what it left. One that ends otherwise than it should leaves the pictures that it had drawn.
async fn try_draw(pool: &Pool, held: &Lease, job: &Job, over: &CancellationToken) -> Result<Artifacts, AttemptError> {
    let scratch = pool.scratch.attempt()?;
    let folder = scratch.path();
    pool.fetch_inputs(job, folder).await?;
    let model = job.artifacts.get(Task::MODEL).and_then(|model| model.file.as_ref());
    if let Some(file) = model {
        let path = folder.join(Task::MODEL);
        patiently(Some(over), || pool.blobs.fetch(&file.key, &file.sha256, &path)).await?;
    }
    let handed_out = match model {
        Some(_) => HandedOut::Model,
        None if job.artifacts.contains_key(Task::ORIGINAL) => HandedOut::Original,
        None => HandedOut::None,
    };
    let task = pool.task(job, Some(handed_out));
    let mut process = JobProcess::start(&pool.config.program, inside::JOB, folder, held.attempt == 1, &task)?;
    let ended = watch(pool, job, &mut process, folder, over).await;
    let (status, said) = process.end(pool.loose()).await?;
    ended?;
    if over.is_cancelled() {
        return Err(StoreError::LeaseLost.into());
    }
    let left = folder.to_owned();
    tokio::task::spawn_blocking(move || tame(&left)).await.map_err(io::Error::from)?;
    let drawn = pool.store_files(held, folder, undrawn(job), over).await?;
    if !status.success() {
        tracing::warn!(%status, said, pictures = drawn.len(), "drawing ended early");
        if drawn.is_empty() {
            return Err(io::Error::other(format!("the process ended: {status}")).into());
        }
    }
    Ok(drawn)
}

/// Waits until the child ends or must be killed.
async fn watch(
    pool: &Pool,
    job: &Job,
    process: &mut JobProcess,
    folder: &Path,
    over: &CancellationToken,
) -> io::Result<()> {
    // Nobody is told how far it is, but it must be able to say so.
    if let Some(mut said) = process.stdout() {
        tokio::spawn(async move { copy(&mut said, &mut sink()).await });
    }
    let deadline = tokio::time::sleep(pool.deadline(job));
    tokio::pin!(deadline);
    let given = job
        .inputs
        .iter()
        .map(|input| input.bytes)
        .chain(job.artifacts.values().filter_map(|it| Some(it.file.as_ref()?.bytes)));
    let allowance = pool.allowance(given.sum());
    let mut usage = tokio::time::interval_at(Instant::now() + USAGE_EVERY, USAGE_EVERY);
    loop {
        tokio::select! {
            status = process.wait() => return status.map(drop),
            () = &mut deadline => return Ok(()),
            () = over.cancelled() => return Ok(()),
            _ = usage.tick() => {
                let (folder, group) = (folder.to_owned(), process.group());
                if tokio::task::spawn_blocking(move || allowance.exceeded(&folder, group)).await?.is_some() {
                    return Ok(());
                }
            }
        }
    }
}

/// Extends the hold until it is lost, and then waits for the drawing to end itself.
async fn keep_hold(pool: &Pool, held: &Lease, over: &CancellationToken) -> Infallible {
    let lease = pool.config.lease;
    loop {
        tokio::time::sleep(lease / 3).await;
        if let Err(StoreError::LeaseLost) = pool.store.hold_drawings(held, lease).await {
            over.cancel();
            return std::future::pending().await;
        }
    }
}

async fn drop_files(pool: &Pool, held: &Lease) {
    if let Err(error) = pool.blobs.delete_claim(held.id, &held.token).await {
        tracing::warn!(%error, "pictures of a lost hold were left");
    }
}
