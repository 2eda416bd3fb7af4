use std::fs;
use std::io::{self, Write};
use std::net::{Ipv4Addr, Ipv6Addr, TcpListener};
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::io::AsyncReadExt;

use super::ProcessLimits;
use super::process::JobProcess;
use super::task::Task;
use crate::sandbox::{Sandbox, SandboxMode, Trial, Walls};

/// Most time for it.
const PATIENCE: Duration = Duration::from_secs(30);
/// The file in the folder of the process that tries, which tells it what.
const TASK: &str = "trial.json";
/// Most of its answer that is read.
const ANSWER_BYTES: u64 = 64 << 10;

/// What the process is to do.
#[derive(Debug, Serialize, Deserialize)]
struct TrialTask {
    sandbox: Sandbox,
    process: ProcessLimits,
    trial: Trial,
}

/// Starts a process as for a job, with its folder in `outside`, lets it try what must fail, and says what did.
///
/// # Errors
/// Where it can't be tried, and where walls are missing that are required.
pub(super) async fn probe(
    program: &Path,
    outside: &Path,
    sandbox: Sandbox,
    process: ProcessLimits,
) -> io::Result<Walls> {
    // Answers nobody; a connection that gets as far as its queue is one too many.
    let listener =
        TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).or_else(|_| TcpListener::bind((Ipv6Addr::LOCALHOST, 0)))?;
    let trial = Trial { listener: listener.local_addr()?, outside: outside.to_owned() };
    fs::write(outside.join(Trial::SECRET), "not for jobs")?;
    let folder = outside.join("inside");
    fs::create_dir(&folder)?;
    let required = sandbox.mode == SandboxMode::Require;
    fs::write(folder.join(TASK), serde_json::to_vec(&TrialTask { sandbox, process, trial })?)?;
    let mut process = JobProcess::start(program, "sandbox-trial", &folder, false)?;
    let mut answer = Vec::new();
    if let Some(stdout) = process.stdout() {
        let mut stdout = stdout.take(ANSWER_BYTES);
        // Out of time or cut short, it is no JSON.
        let _ = tokio::time::timeout(PATIENCE, stdout.read_to_end(&mut answer)).await;
    }
    process.end(true).await?;
    let walls: Walls = serde_json::from_slice(&answer).map_err(|_| {
        let said = fs::read_to_string(folder.join(Task::STDERR)).unwrap_or_default();
        io::Error::other(
            if said.is_empty() { "the process that tries it gave no answer" } else { said.trim() }.to_owned(),
        )
    })?;
    let open = [&walls.network, &walls.files].into_iter().find(|wall| required && !wall.in_force);
    match open {
        Some(wall) => Err(io::Error::other(wall.detail.clone().unwrap_or_default())),
        None => Ok(walls),
    }
}

/// The inside of the process that tries.
#[must_use]
pub fn run_trial(folder: &Path) -> ExitCode {
    match try_run(folder) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(io::stderr(), "{error}");
            ExitCode::FAILURE
        }
    }
}

fn try_run(folder: &Path) -> io::Result<()> {
    let TrialTask { sandbox, process, trial } = serde_json::from_slice(&fs::read(folder.join(TASK))?)?;
    process.apply()?;
    let walls = trial.run(&sandbox, folder)?;
    serde_json::to_writer(io::stdout(), &walls)?;
    io::stdout().flush()
}
