//! Child requests: the worker starts a child process, sends it one request, and reads one JSON response. A request tests the
//! sandbox or warms up Blender.

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

use super::child::{end_with_worker, read_request};
use super::context::WorkerContext;
use super::process::JobProcess;
use super::task::{ChildSetup, Confinement, TRIAL, WARM_UP};
use crate::blender::{BlenderConfig, WarmUpResult, warm_up};
use crate::repair::RemesherInfo;
use crate::sandbox::{Protections, SandboxMode, Trial};

/// The most bytes of a response that are read.
const RESPONSE_BYTES: u64 = 64 << 10;
/// The time limit of the sandbox trial.
const TRIAL_TIME: Duration = Duration::from_secs(30);
/// The time limit of the warm-up of Blender, with the wait for a slot.
const WARM_UP_TIME: Duration = Duration::from_secs(180);

/// A request to a child process that runs under the same confinement as a job.
struct ChildRequest<'a, Q> {
    program: &'a Path,
    /// The verb that selects the child's entry point.
    verb: &'a str,
    /// The child's scratch folder.
    folder: &'a Path,
    body: Q,
    time_limit: Duration,
}

impl<Q: Serialize> ChildRequest<'_, Q> {
    /// Starts the process, reads its response, and ends it. Ends it early after the time limit or when `stop` is cancelled.
    ///
    /// # Errors
    /// When the process can't be started or gives no complete response; the error then has its standard error.
    async fn send<A: DeserializeOwned>(self, stop: &CancellationToken) -> io::Result<A> {
        let mut process = JobProcess::start(self.program, self.verb, self.folder, &self.body)?;
        let mut response = Vec::new();
        if let Some(stdout) = process.stdout() {
            let mut stdout = stdout.take(RESPONSE_BYTES);
            let reading = tokio::time::timeout(self.time_limit, stdout.read_to_end(&mut response));
            // An interrupted response is not valid JSON, so parsing reports it.
            tokio::select! { _ = reading => {}, () = stop.cancelled() => {} }
        }
        let (_, stderr) = process.end(true).await?;
        serde_json::from_slice(&response).map_err(|_| {
            let reason = if stderr.trim().is_empty() { "the child process gave no response" } else { stderr.trim() };
            io::Error::other(reason.to_owned())
        })
    }
}

/// Reads the request that this process was started for, and writes the response to standard output.
fn answer_request<Q: DeserializeOwned, A: Serialize>(answer: impl FnOnce(Q) -> io::Result<A>) -> ExitCode {
    let answered = read_request().and_then(answer).and_then(|response| {
        serde_json::to_writer(io::stdout(), &response)?;
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

/// A request to try the actions that the sandbox must prevent.
#[derive(Debug, Serialize, Deserialize)]
struct TrialRequest {
    confinement: Confinement,
    trial: Trial,
}

/// Starts a child process with its folder in `outside`, and lets it try the actions that the sandbox must prevent. Returns the
/// protections that held.
///
/// # Errors
/// When the trial can't run, or a required protection is missing.
pub(super) async fn try_sandbox(program: &Path, outside: &Path, confinement: Confinement) -> io::Result<Protections> {
    // The listener never accepts: a connection that reaches its backlog has already left the sandbox.
    let listener =
        TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).or_else(|_| TcpListener::bind((Ipv6Addr::LOCALHOST, 0)))?;
    let trial = Trial { listener: listener.local_addr()?, outside: outside.to_owned() };
    fs::write(outside.join(Trial::SECRET), "not for jobs")?;
    let folder = outside.join("inside");
    fs::create_dir(&folder)?;
    let required = confinement.sandbox.mode == SandboxMode::Require;
    let body = TrialRequest { confinement, trial };
    let request = ChildRequest { program, verb: TRIAL, folder: &folder, body, time_limit: TRIAL_TIME };
    let protections: Protections = request.send(&CancellationToken::new()).await?;
    let essential = [&protections.network, &protections.files];
    let missing = essential.into_iter().find(|protection| required && !protection.enforced);
    if let Some(missing) = missing {
        return Err(io::Error::other(missing.detail.clone().unwrap_or_default()));
    }
    Ok(protections)
}

/// The child entry point of the sandbox trial; `folder` is the child's scratch folder.
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

/// Runs Blender once on a small model, in a child process as for a job, and logs the result.
pub(super) async fn warm_blender_up(context: Arc<WorkerContext>, remesher: RemesherInfo, stop: CancellationToken) {
    let result: io::Result<WarmUpResult> = async {
        let scratch = context.scratch.attempt()?;
        let blender = context.config.blender.clone();
        let body = WarmUpRequest { confinement: context.confinement(WARM_UP_TIME), remesher, blender };
        let (program, folder) = (context.config.program.as_path(), scratch.path());
        ChildRequest { program, verb: WARM_UP, folder, body, time_limit: WARM_UP_TIME }.send(&stop).await
    }
    .await;
    match result {
        _ if stop.is_cancelled() => {}
        Ok(WarmUpResult::Warm(time)) => tracing::info!(seconds = time.as_secs_f64(), "tier 3 is warm"),
        Ok(WarmUpResult::Failed(reason)) => tracing::warn!(
            reason,
            "tier 3 failed on a small model; if it works with --sandbox off, add the paths that Blender reads to --sandbox-read"
        ),
        Err(error) => tracing::warn!(%error, "could not warm up tier 3"),
    }
}

/// The child entry point of Blender's warm-up; `folder` is the child's scratch folder.
pub(super) fn run_warm_up(folder: &Path) -> ExitCode {
    answer_request(|WarmUpRequest { confinement, remesher, blender }| {
        ChildSetup { confinement, blender: Some(blender.clone()) }.enter(folder)?;
        end_with_worker()?;
        Ok(warm_up(remesher, BlenderConfig { scratch: Some(folder.to_owned()), ..blender }))
    })
}
