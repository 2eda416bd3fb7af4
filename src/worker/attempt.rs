use std::convert::Infallible;
use std::fs::File;
use std::io::{self, Read};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::ExitStatus;
use std::time::Duration;

use futures::{FutureExt, StreamExt};
use tokio::io::AsyncWriteExt;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::Instant;
use tokio_util::codec::{FramedRead, LinesCodec, LinesCodecError};
use tokio_util::sync::CancellationToken;
use tracing::{Instrument, Span};

use super::context::{AttemptError, Shutdown, WorkerContext, offered, pictures, retry_with_backoff};
use super::process::{Excess, JobProcess, explain_excess, explain_exit};
use super::scratch::sanitize;
use super::task::{JOB, ProgressLine, Task, pause_alone_at};
use crate::blobs::BlobError;
use crate::context::Stage;
use crate::jobs::{
    Artifacts, Claim, Completion, Failure, FailureKind, Job, JobProblem, JobProgress, JobReport, Lease, ProblemKind,
    Status, StoreError,
};
use crate::repair::Step;
use crate::telemetry::{self, label};

/// Progress is written to the store no more often than this.
const PROGRESS_EVERY: Duration = Duration::from_millis(250);
/// Longest line of progress that is read.
const LINE_BYTES: usize = 4 << 10;

/// One claim, from the first byte fetched to the result published.
pub(super) struct Attempt<'a> {
    context: &'a WorkerContext,
    lease: Lease,
    job: Job,
    /// Cancelled when the job is lost.
    lost: CancellationToken,
    /// Cancelled when the job is lost, and when this process stops.
    over: CancellationToken,
}

/// How the child's run ended.
enum Ended {
    /// By itself.
    Exited(ExitStatus),
    /// Killed at the deadline.
    Deadline,
    /// Killed because it took too much.
    Excess(Excess),
    /// Killed because the job is no longer ours: canceled, deleted, or given to another worker.
    LeaseLost,
    /// Killed because this process stops.
    Shutdown,
}

/// What a child left, once nothing of it lives.
struct ChildResult {
    ended: Ended,
    stderr: String,
    report: io::Result<Option<Vec<u8>>>,
}

impl<'a> Attempt<'a> {
    pub fn new(context: &'a WorkerContext, claim: Claim, shutdown: &Shutdown) -> Self {
        let (lost, over) = (CancellationToken::new(), shutdown.now.child_token());
        Self { context, lease: claim.lease, job: claim.job, lost, over }
    }

    /// Runs to the end; whatever happens is noted in the store, unless the lease is lost.
    pub async fn run(self, shutdown: &Shutdown) {
        let started = Instant::now();
        let ended = tokio::select! {
            ended = self.try_run(shutdown) => ended,
            never = self.keep_lease() => match never {},
        };
        let ended = match ended {
            Err(AttemptError::Store(StoreError::LeaseLost)) => Err(StoreError::LeaseLost),
            // What was given up because this process stops is charged to nobody.
            Err(error) if shutdown.now.is_cancelled() => {
                tracing::warn!(%error, "given up half way");
                self.context.store.release(&self.lease).await.map(|()| None)
            }
            Err(error) => self.fail_passing(&error).await.map(Some),
            Ok(ended) => Ok(ended),
        };
        let milliseconds = u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
        metrics::histogram!(telemetry::ATTEMPT).record(started.elapsed());
        match ended {
            Ok(Some(job)) => record_end(&job, milliseconds),
            Ok(None) => tracing::info!(milliseconds, "handed back"),
            Err(StoreError::LeaseLost) => {
                tracing::warn!(milliseconds, "the job is no longer ours; its result is dropped");
                metrics::counter!(telemetry::ATTEMPTS_DROPPED).increment(1);
                self.context.drop_files(&self.lease).await;
            }
            // The lease will expire, and the job be queued again.
            Err(error) => tracing::error!(%error, milliseconds, "could not note how the attempt ended"),
        }
    }

    async fn try_run(&self, shutdown: &Shutdown) -> Result<Option<Job>, AttemptError> {
        pause_alone_at("worker-claimed").await;
        let scratch = self.context.scratch.attempt()?;
        let folder = scratch.path();
        tokio::select! {
            fetched = self.context.fetch_inputs(&self.job, folder) => fetched?,
            () = self.lost.cancelled() => return Err(StoreError::LeaseLost.into()),
            () = shutdown.now.cancelled() => {
                self.context.store.release(&self.lease).await?;
                return Ok(None);
            }
        }
        pause_alone_at("worker-spawn").await;
        let child = self.run_child(folder, shutdown).await?;
        self.settle(folder, child).await
    }

    /// Runs the child to its end, and puts how it ended at the end of its log.
    async fn run_child(&self, folder: &Path, shutdown: &Shutdown) -> Result<ChildResult, AttemptError> {
        let (program, first) = (&self.context.config.program, self.lease.attempt == 1);
        let mut process = JobProcess::start(program, JOB, folder, first, &self.context.task(&self.job, None))?;
        tracing::info!(process = process.group().as_raw_nonzero(), "started");
        let ended = self.watch(&mut process, folder, &shutdown.now).instrument(tracing::info_span!("run")).await;
        let (status, stderr) = process.end(self.context.loose()).await?;
        let left = folder.to_owned();
        let left = tokio::task::spawn_blocking(move || {
            sanitize(&left);
            read(&left.join(Task::FULL_REPORT))
        });
        let report = left.await.map_err(io::Error::from)?;
        let ended = match ended? {
            Ended::Exited(status) if told_to_end(status, shutdown).await => Ended::Shutdown,
            ended => ended,
        };
        append_stderr(folder, &ended, status, &stderr).await?;
        Ok(ChildResult { ended, stderr, report })
    }

    /// Ends the attempt by what the child left; none where the job was released.
    async fn settle(&self, folder: &Path, child: ChildResult) -> Result<Option<Job>, AttemptError> {
        let ChildResult { ended, stderr, report } = child;
        match ended {
            Ended::LeaseLost => {
                count_kill("lease_lost");
                Err(StoreError::LeaseLost.into())
            }
            Ended::Shutdown => {
                count_kill("shutdown");
                self.context.store.release(&self.lease).await?;
                Ok(None)
            }
            // The result was there before the process went down.
            Ended::Exited(_) | Ended::Deadline if !matches!(report, Ok(None)) => {
                self.conclude(folder, report?).await.map(Some)
            }
            Ended::Deadline => {
                count_kill("deadline");
                let detail = format!(
                    "The job was stopped: it ran longer than the {} s that deadline_s allows. Send it again with a \
                     larger deadline_s, a smaller max_tier or level, or fewer faces.",
                    self.job.options.deadline_s()
                );
                let problem = JobProblem::new(ProblemKind::DeadlineExceeded, detail);
                self.fail(folder, FailureKind::Final, problem).await.map(Some)
            }
            Ended::Excess(excess) => {
                count_kill(excess.name());
                let config = &self.context.config;
                let problem = explain_excess(excess, config.job_scratch, config.job_processes);
                self.fail(folder, FailureKind::Final, problem).await.map(Some)
            }
            Ended::Exited(status) if status.success() => self.conclude(folder, None).await.map(Some),
            Ended::Exited(status) if status.code() == Some(i32::from(Task::EXIT_PROBLEM)) => {
                let problem = there(read(&folder.join(Task::PROBLEM))?, Task::PROBLEM)?;
                let problem = serde_json::from_slice(&problem).map_err(|e| AttemptError::Json(Task::PROBLEM, e))?;
                self.fail(folder, FailureKind::Final, problem).await.map(Some)
            }
            Ended::Exited(status) => {
                let (kind, problem) = explain_exit(status, &stderr, self.context.config.job_memory);
                metrics::counter!(telemetry::CHILD_CRASHES, "reason" => label(&problem.code)).increment(1);
                tracing::warn!(%status, code = label(&problem.code), "the repair process ended by itself");
                self.fail(folder, kind, problem).await.map(Some)
            }
        }
    }

    /// Extends the lease from the claim to the end of the attempt, whatever the attempt is doing. When the job is no
    /// longer ours it cancels `lost` and `over`, and waits for the attempt to end itself.
    async fn keep_lease(&self) -> Infallible {
        let (store, lease) = (&self.context.store, self.context.config.lease);
        let mut changed = store.notifier().listen();
        let mut beat = tokio::time::interval_at(Instant::now() + lease / 3, lease / 3);
        let mut held_until = Instant::now() + lease;
        loop {
            let ours = tokio::select! {
                _ = beat.tick() => match store.heartbeat(&self.lease, lease, None).await {
                    Ok(()) => {
                        held_until = Instant::now() + lease;
                        true
                    }
                    Err(StoreError::LeaseLost) => false,
                    Err(error) => {
                        tracing::warn!(%error, "heartbeat failed");
                        Instant::now() < held_until
                    }
                },
                ring = changed.recv() => match ring {
                    Ok(id) if id != self.lease.id => true,
                    Ok(_) | Err(RecvError::Lagged(_)) => self.still_ours().await,
                    Err(RecvError::Closed) => true,
                },
            };
            if !ours {
                self.lost.cancel();
                self.over.cancel();
                return std::future::pending().await;
            }
        }
    }

    /// Reads progress until the child ends or must be killed.
    async fn watch(
        &self,
        process: &mut JobProcess,
        folder: &Path,
        stop: &CancellationToken,
    ) -> Result<Ended, AttemptError> {
        let stdout = process.stdout().ok_or_else(|| io::Error::other("the child process has no standard output"))?;
        let mut lines = FramedRead::new(stdout, LinesCodec::new_with_max_length(LINE_BYTES)).fuse();
        let overrun = self.context.overrun(&self.job, folder, process.group());
        tokio::pin!(overrun);
        let mut progress: Option<JobProgress> = None;
        let mut written: Option<JobProgress> = None;
        let mut stages = Stages::default();
        let mut read = |line: Result<String, LinesCodecError>| {
            let line = line.ok().and_then(|line| serde_json::from_str::<ProgressLine>(&line).ok());
            line.inspect(|&line| stages.at(line))
        };
        let mut news = tokio::time::interval_at(Instant::now() + PROGRESS_EVERY, PROGRESS_EVERY);
        loop {
            tokio::select! {
                status = process.wait() => {
                    while let Some(Some(line)) = lines.next().now_or_never() {
                        read(line);
                    }
                    return Ok(Ended::Exited(status?));
                }
                excess = &mut overrun => return Ok(excess?.map_or(Ended::Deadline, Ended::Excess)),
                () = stop.cancelled() => return Ok(Ended::Shutdown),
                () = self.lost.cancelled() => return Ok(Ended::LeaseLost),
                Some(line) = lines.next() => {
                    progress = read(line).or(progress);
                }
                _ = news.tick(), if progress != written => {
                    match self.context.store.heartbeat(&self.lease, self.context.config.lease, progress).await {
                        Ok(()) => written = progress,
                        Err(StoreError::LeaseLost) => return Ok(Ended::LeaseLost),
                        Err(error) => tracing::warn!(%error, "progress was not noted"),
                    }
                }
            }
        }
    }

    async fn still_ours(&self) -> bool {
        match self.context.store.get(self.lease.id).await {
            Ok(Some(job)) => job.status == Status::Running && job.attempt == self.lease.attempt,
            Ok(None) => false,
            Err(_) => true,
        }
    }

    /// Ends the job by its report: with the result, or failed where the result is not what was required.
    async fn conclude(&self, folder: &Path, report: Option<Vec<u8>>) -> Result<Job, AttemptError> {
        pause_alone_at("worker-publish").await;
        // Not given up half way when the job is lost: what is in flight would land after the clearing away.
        let completion = self.publish(folder, report).instrument(tracing::info_span!("publish")).await?;
        pause_alone_at("worker-complete").await;
        let job = self.complete(completion).instrument(tracing::info_span!("complete")).await?;
        if self.lease.attempt > 1
            && let Err(error) = self.context.blobs.delete_attempts(self.lease.id, Some(&self.lease.token)).await
        {
            tracing::warn!(%error, "files of an earlier attempt were left");
        }
        Ok(job)
    }

    async fn complete(&self, completion: Completion) -> Result<Job, StoreError> {
        let Some(problem) = completion.report.refusal() else {
            return retry_with_backoff(None, || self.context.store.complete(&self.lease, completion.clone())).await;
        };
        let Completion { report, artifacts } = completion;
        let failure = Failure { kind: FailureKind::Final, problem, report: Some(report), artifacts };
        self.note_failure(failure).await
    }

    async fn publish(&self, folder: &Path, report: Option<Vec<u8>>) -> Result<Completion, AttemptError> {
        let report = JobReport::from_json(&there(report, Task::FULL_REPORT)?)
            .map_err(|e| AttemptError::Json(Task::FULL_REPORT, e))?;
        record_steps(report.steps());
        let report = report.abridged();
        let json = serde_json::to_vec(&report).map_err(|e| AttemptError::Json(Task::REPORT, e))?;
        tokio::fs::write(folder.join(Task::REPORT), json).await?;
        let mut artifacts =
            self.context.store_files(&self.lease, folder, offered(&self.job.inputs, Some(&report)), &self.over).await?;
        if self.job.options.pictures() {
            artifacts.extend(pictures(&self.job.inputs, &report));
        }
        Ok(Completion { report, artifacts })
    }

    async fn fail(&self, folder: &Path, kind: FailureKind, problem: JobProblem) -> Result<Job, AttemptError> {
        let artifacts =
            self.context.store_files(&self.lease, folder, offered(&self.job.inputs, None), &self.over).await?;
        let failure = Failure { kind, problem, report: None, artifacts };
        Ok(self.note_failure(failure).await?)
    }

    async fn note_failure(&self, failure: Failure) -> Result<Job, StoreError> {
        let job = retry_with_backoff(None, || self.context.store.fail(&self.lease, failure.clone())).await?;
        // A job that is tried again does not keep the problem.
        if job.problem.is_none() {
            tracing::warn!(code = label(&failure.problem.code), "attempt failed; the job is tried again");
        }
        Ok(job)
    }

    /// Notes a failure of something around the job.
    async fn fail_passing(&self, error: &AttemptError) -> Result<Job, StoreError> {
        tracing::error!(%error, "attempt failed");
        let detail = match error {
            AttemptError::Blob(BlobError::Damaged { .. }) => {
                "A file of this job is not what was uploaded any more: it was damaged where the service keeps it. Please send it again."
            }
            _ => "The service could not run this job. Please try again later; its log has the reason.",
        };
        let problem = JobProblem::new(ProblemKind::Internal, detail.to_owned());
        let failure = Failure { kind: FailureKind::Passing, problem, report: None, artifacts: Artifacts::new() };
        self.note_failure(failure).await
    }
}

fn count_kill(reason: &'static str) {
    metrics::counter!(telemetry::KILLS, "reason" => reason).increment(1);
}

/// Whether the child was ended by the same signal that tells this process to stop, as some service managers send it to
/// every process of a service. The two may come in either order.
async fn told_to_end(status: ExitStatus, shutdown: &Shutdown) -> bool {
    const SIGTERM: i32 = 15;
    status.signal() == Some(SIGTERM)
        && tokio::time::timeout(Duration::from_millis(500), shutdown.drain.cancelled()).await.is_ok()
}

/// Puts what the child wrote to standard error, and how it ended, at the end of its log.
async fn append_stderr(folder: &Path, ended: &Ended, status: ExitStatus, stderr: &str) -> Result<(), AttemptError> {
    let how = match ended {
        Ended::Exited(status) if status.success() && stderr.is_empty() => return Ok(()),
        Ended::Exited(_) => format!("the repair process ended: {status}"),
        Ended::Deadline => "the repair process was killed at its deadline".to_owned(),
        Ended::Excess(excess) => format!("the repair process was killed: too much {}", excess.name()),
        Ended::LeaseLost | Ended::Shutdown => "the repair process was killed".to_owned(),
    };
    let mut log = tokio::fs::OpenOptions::new().append(true).create(true).open(folder.join(Task::LOG)).await?;
    log.write_all(
        format!("{stderr}{}{how}\n", if stderr.is_empty() || stderr.ends_with('\n') { "" } else { "\n" }).as_bytes(),
    )
    .await?;
    log.flush().await?;
    Ok(())
}

/// A small file that the child may have left.
fn read(path: &Path) -> io::Result<Option<Vec<u8>>> {
    let mut bytes = Vec::new();
    match File::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        file => file?.take(Task::REPORT_BYTES as u64).read_to_end(&mut bytes)?,
    };
    Ok(Some(bytes))
}

fn there(bytes: Option<Vec<u8>>, name: &'static str) -> io::Result<Vec<u8>> {
    bytes.ok_or_else(|| io::Error::other(format!("the repair process left no {name}")))
}

/// The stages of a child's work as spans of a trace, by its lines of progress: each lasts until the next.
#[derive(Default)]
struct Stages {
    now: Option<(Stage, Option<u8>)>,
    span: Option<Span>,
}

impl Stages {
    fn at(&mut self, progress: JobProgress) {
        let JobProgress { stage, tier, .. } = progress;
        if self.now != Some((stage, tier)) {
            let name = tier.map_or_else(|| label(&stage), |tier| format!("{} tier {tier}", label(&stage)));
            self.span = None;
            self.span = Some(tracing::info_span!("stage", otel.name = name, stage = ?stage, tier));
            self.now = Some((stage, tier));
        }
    }
}

/// Counts and times what a repair did, by its report.
fn record_steps(steps: &[Step]) {
    for step in steps {
        let (tier, action) = (step.tier.to_string(), label(&step.action));
        metrics::histogram!(telemetry::STEP, "tier" => tier.clone(), "action" => action.clone())
            .record(step.milliseconds / 1000.0);
        metrics::counter!(telemetry::STEPS, "tier" => tier, "action" => action, "status" => label(&step.status))
            .increment(1);
        metrics::counter!(telemetry::BLENDER_RUNS).increment(step.runs.into());
        metrics::counter!(telemetry::BLENDER_RESTARTS).increment(step.runs.saturating_sub(1).into());
    }
}

/// Logs and counts how an attempt ended, in the span of the attempt.
fn record_end(job: &Job, milliseconds: u64) {
    let status = job.status.as_str();
    let outcome = job.outcome.map(|outcome| label(&outcome));
    let code = job.problem.as_ref().map(|problem| label(&problem.code));
    // A field without a value is left out of the line.
    tracing::info!(status, outcome = outcome.as_deref(), code = code.as_deref(), milliseconds, "attempt ended");
    if let Some(code) = code {
        telemetry::failed(&Span::current(), code);
    }
    let outcome = outcome.unwrap_or_default();
    metrics::counter!(telemetry::ATTEMPTS, "status" => status, "outcome" => outcome).increment(1);
}
