//! Requests to a child process that is started for the answer alone: to try the sandbox, and to run Blender once.

use std::fs;
use std::io::{self, Write};
use std::net::{Ipv4Addr, Ipv6Addr, TcpListener};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use tokio::io::AsyncReadExt;
use tokio_util::sync::CancellationToken;

use super::child::{end_with_worker, enter_sandbox, read_request};
use super::context::WorkerContext;
use super::process::JobProcess;
use super::task::{Confinement, TRIAL, WARM_UP};
use crate::blender::{BlenderConfig, Warmth, warm_up};
use crate::repair::RemesherInfo;
use crate::sandbox::{Protections, SandboxMode, Trial};

/// Most of an answer that is read.
const ANSWER_BYTES: u64 = 64 << 10;
/// Most time to try the sandbox.
const TRIAL_TIME: Duration = Duration::from_secs(30);
/// Most time to run Blender once, with the waiting for other Blenders.
const WARM_UP_TIME: Duration = Duration::from_secs(180);

/// A request to a process that is started as for a job.
struct ChildRequest<'a, Q> {
    program: &'a Path,
    verb: &'a str,
    folder: &'a Path,
    question: Q,
    time_limit: Duration,
}

impl<Q: Serialize> ChildRequest<'_, Q> {
    /// Starts the process, and ends it when it has answered, after the time limit, or at `stop`.
    ///
    /// # Errors
    /// Where it can't be asked or gives no answer; then with what it said on standard error.
    async fn send<A: DeserializeOwned>(self, stop: &CancellationToken) -> io::Result<A> {
        let mut process = JobProcess::start(self.program, self.verb, self.folder, false, &self.question)?;
        let mut answer = Vec::new();
        if let Some(stdout) = process.stdout() {
            let mut stdout = stdout.take(ANSWER_BYTES);
            let reading = tokio::time::timeout(self.time_limit, stdout.read_to_end(&mut answer));
            // What is cut short is no JSON.
            tokio::select! { _ = reading => {}, () = stop.cancelled() => {} }
        }
        let (_, said) = process.end(true).await?;
        serde_json::from_slice(&answer)
            .map_err(|_| io::Error::other(if said.trim().is_empty() { "no answer" } else { said.trim() }.to_owned()))
    }
}

/// Answers the request that this process was started for.
fn answer_request<Q: DeserializeOwned, A: Serialize>(answer: impl FnOnce(Q) -> io::Result<A>) -> ExitCode {
    let answered = read_request().and_then(answer).and_then(|answer| {
        serde_json::to_writer(io::stdout(), &answer)?;
        io::stdout().flush()
    });
    match answered {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(io::stderr(), "{error}");
            ExitCode::FAILURE
        }
    }
}

/// A request to try what the sandbox must hold back.
#[derive(Debug, Serialize, Deserialize)]
struct TrialRequest {
    confinement: Confinement,
    trial: Trial,
}

/// Starts a process as for a job, with its folder in `outside`, lets it try what must fail, and says what did.
///
/// # Errors
/// Where it can't be tried, and where protections are missing that are required.
pub(super) async fn try_sandbox(program: &Path, outside: &Path, confinement: Confinement) -> io::Result<Protections> {
    // Answers nobody; a connection that gets as far as its queue is one too many.
    let listener =
        TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).or_else(|_| TcpListener::bind((Ipv6Addr::LOCALHOST, 0)))?;
    let trial = Trial { listener: listener.local_addr()?, outside: outside.to_owned() };
    fs::write(outside.join(Trial::SECRET), "not for jobs")?;
    let folder = outside.join("inside");
    fs::create_dir(&folder)?;
    let required = confinement.sandbox.mode == SandboxMode::Require;
    let question = TrialRequest { confinement, trial };
    let request = ChildRequest { program, verb: TRIAL, folder: &folder, question, time_limit: TRIAL_TIME };
    let found: Protections = request.send(&CancellationToken::new()).await?;
    let open = [&found.network, &found.files].into_iter().find(|layer| required && !layer.enforced);
    if let Some(layer) = open {
        return Err(io::Error::other(layer.detail.clone().unwrap_or_default()));
    }
    Ok(found)
}

/// The entry point of the process that tries what a sandbox holds back; `folder` is its own.
pub(super) fn run_trial(folder: &Path) -> ExitCode {
    answer_request(|TrialRequest { confinement, trial }| {
        confinement.limits.apply()?;
        trial.run(&confinement.sandbox, folder)
    })
}

/// A request to run Blender once.
#[derive(Debug, Serialize, Deserialize)]
struct WarmUpRequest {
    confinement: Confinement,
    remesher: RemesherInfo,
    blender: BlenderConfig,
}

/// Runs Blender once on a small model, in a process as for a job, and logs the result.
pub(super) async fn warm_blender_up(context: Arc<WorkerContext>, remesher: RemesherInfo, stop: CancellationToken) {
    let warmth: io::Result<Warmth> = async {
        let scratch = context.scratch.attempt()?;
        let blender = context.config.blender.clone();
        let question = WarmUpRequest { confinement: context.confinement(WARM_UP_TIME), remesher, blender };
        let (program, folder) = (context.config.program.as_path(), scratch.path());
        ChildRequest { program, verb: WARM_UP, folder, question, time_limit: WARM_UP_TIME }.send(&stop).await
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

/// The entry point of the process that runs Blender once; `folder` is its own.
pub(super) fn run_warm_up(folder: &Path) -> ExitCode {
    answer_request(|WarmUpRequest { confinement, remesher, blender }| {
        enter_sandbox(folder, &confinement, Some(&blender))?;
        end_with_worker()?;
        Ok(warm_up(remesher, BlenderConfig { scratch: Some(folder.to_owned()), ..blender }))
    })
}
