use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::io::AsyncReadExt;
use tokio_util::sync::CancellationToken;

use super::child::told;
use super::process::JobProcess;

/// Most of an answer that is read.
const ANSWER_BYTES: u64 = 64 << 10;

/// Starts a process as for a job, asks it one thing, and ends it when it has answered, after `patience`, or at `stop`.
///
/// # Errors
/// Where it can't be asked or gives no answer; then with what it said on standard error.
pub(super) async fn ask<A: DeserializeOwned>(
    program: &Path,
    verb: &str,
    folder: &Path,
    question: &impl Serialize,
    patience: Duration,
    stop: &CancellationToken,
) -> io::Result<A> {
    let mut process = JobProcess::start(program, verb, folder, false, question)?;
    let mut answer = Vec::new();
    if let Some(stdout) = process.stdout() {
        let mut stdout = stdout.take(ANSWER_BYTES);
        let reading = tokio::time::timeout(patience, stdout.read_to_end(&mut answer));
        // What is cut short is no JSON.
        tokio::select! { _ = reading => {}, () = stop.cancelled() => {} }
    }
    let (_, said) = process.end(true).await?;
    serde_json::from_slice(&answer)
        .map_err(|_| io::Error::other(if said.trim().is_empty() { "no answer" } else { said.trim() }.to_owned()))
}

/// The inside of the process that is asked.
pub(super) fn answer<Q: DeserializeOwned, A: Serialize>(answer: impl FnOnce(Q) -> io::Result<A>) -> ExitCode {
    let answered = told().and_then(answer).and_then(|answer| {
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
