use std::io;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio_util::sync::CancellationToken;

use super::child::{end_with_the_worker, shut_in};
use super::errand::{answer, ask};
use super::inside;
use super::pool::Pool;
use super::task::Confinement;
use crate::blender::{BlenderConfig, Warmth, warm_up};
use crate::repair::RemesherInfo;

/// Most time for it, with the waiting for other Blenders.
const PATIENCE: Duration = Duration::from_secs(180);

/// What the process is to do.
#[derive(Debug, Serialize, Deserialize)]
struct Question {
    confinement: Confinement,
    remesher: RemesherInfo,
    blender: BlenderConfig,
}

/// Runs Blender once on a small model, in a process as for a job, and logs what came of it.
pub(super) async fn warm_blender_up(pool: Arc<Pool>, remesher: RemesherInfo, stop: CancellationToken) {
    let warmth: io::Result<Warmth> = async {
        let scratch = pool.scratch.attempt()?;
        let blender = pool.config.blender.clone();
        let question = Question { confinement: pool.confinement(PATIENCE), remesher, blender };
        ask(&pool.config.program, inside::WARM_UP, scratch.path(), &question, PATIENCE, &stop).await
    }
    .await;
    match warmth {
        _ if stop.is_cancelled() => {}
        Ok(Warmth::Warm(time)) => tracing::info!(seconds = time.as_secs_f64(), "tier 3 is warm"),
        Ok(Warmth::Failed(reason)) => tracing::warn!(
            reason,
            "tier 3 was found but failed on a small model; if it works with --sandbox off, name what it reads in --sandbox-read"
        ),
        Err(error) => tracing::warn!(%error, "tier 3 could not be tried on a small model"),
    }
}

/// The inside of the process that runs Blender once; `folder` is its own.
pub(super) fn run_warm_up(folder: &Path) -> ExitCode {
    answer(|Question { confinement, remesher, blender }| {
        shut_in(folder, &confinement, Some(&blender))?;
        end_with_the_worker()?;
        Ok(warm_up(remesher, BlenderConfig { scratch: Some(folder.to_owned()), ..blender }))
    })
}
