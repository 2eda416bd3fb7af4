use std::fs;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, TcpListener};
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio_util::sync::CancellationToken;

use super::errand::{answer, ask};
use super::inside;
use super::task::Confinement;
use crate::sandbox::{SandboxMode, Trial, Walls};

/// Most time for it.
const PATIENCE: Duration = Duration::from_secs(30);

/// What the process is to do.
#[derive(Debug, Serialize, Deserialize)]
struct Question {
    confinement: Confinement,
    trial: Trial,
}

/// Starts a process as for a job, with its folder in `outside`, lets it try what must fail, and says what did.
///
/// # Errors
/// Where it can't be tried, and where walls are missing that are required.
pub(super) async fn probe(program: &Path, outside: &Path, confinement: Confinement) -> io::Result<Walls> {
    // Answers nobody; a connection that gets as far as its queue is one too many.
    let listener =
        TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).or_else(|_| TcpListener::bind((Ipv6Addr::LOCALHOST, 0)))?;
    let trial = Trial { listener: listener.local_addr()?, outside: outside.to_owned() };
    fs::write(outside.join(Trial::SECRET), "not for jobs")?;
    let folder = outside.join("inside");
    fs::create_dir(&folder)?;
    let required = confinement.sandbox.mode == SandboxMode::Require;
    let question = Question { confinement, trial };
    let never = CancellationToken::new();
    let walls: Walls = ask(program, inside::TRIAL, &folder, &question, PATIENCE, &never).await?;
    let open = [&walls.network, &walls.files].into_iter().find(|wall| required && !wall.in_force);
    if let Some(wall) = open {
        return Err(io::Error::other(wall.detail.clone().unwrap_or_default()));
    }
    Ok(walls)
}

/// The inside of the process that tries what a sandbox holds back; `folder` is its own.
pub(super) fn run_trial(folder: &Path) -> ExitCode {
    answer(|Question { confinement, trial }| {
        confinement.limits.apply()?;
        trial.run(&confinement.sandbox, folder)
    })
}
