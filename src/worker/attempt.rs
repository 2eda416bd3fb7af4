//! One attempt at a claimed job: fetch the files, run the child process, extend the lease, publish the result.

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

use super::context::{AttemptError, Shutdown, WorkerContext, retry_with_backoff};
use super::files::{pictures, result_files};
use super::prepared::PreparedChild;
use super::process::{Excess, JobProcess, explain_excess, explain_exit};
use super::scratch::sanitize;
use super::task::{ProgressLine, Task, pause_alone_at};
use crate::blobs::BlobError;
use crate::context::Stage;
use crate::jobs::{
    Artifacts, Claim, Completion, Failure, FailureKind, Job, JobProblem, JobProgress, JobReport, Lease, ProblemKind,
    Status, StoreError,
};
use crate::repair::Step;
use crate::telemetry::{self, label};

/// The least time between two writes of progress to the store.
const PROGRESS_EVERY: Duration = Duration::from_millis(250);
/// The longest progress line that the worker reads, in bytes.
const LINE_BYTES: usize = 4 << 10;

/// The work on one claim, from fetching the input files to publishing the result.
pub(super) struct Attempt<'a> {
    context: &'a WorkerContext,
    lease: Lease,
    job: Job,
    /// Cancelled when the lease is lost.
    lost: CancellationToken,
    /// Cancelled when the lease is lost or this process shuts down.
    stop: CancellationToken,
}

/// Why the child's run ended.
enum RunEnd {
    /// The child exited without being killed by this worker.
    Exited(ExitStatus),
    /// Killed at the deadline.
    Deadline,
    /// Killed because its processes exceeded a shared limit.
    Excess(Excess),
    /// Killed because the lease was lost: the job was canceled, deleted, or claimed by another worker.
    LeaseLost,
    /// Killed because this process shuts down.
    Shutdown,
}

/// The output of a child, read after all its processes have ended.
struct ChildResult {
    ended: RunEnd,
    stderr: String,
    report: io::Result<Option<Vec<u8>>>,
}

impl<'a> Attempt<'a> {
    /// Prepares an attempt at `claim` that stops when `shutdown.now` is cancelled.
    pub fn new(context: &'a WorkerContext, claim: Claim, shutdown: &Shutdown) -> Self {
        let (lost, stop) = (CancellationToken::new(), shutdown.now.child_token());
        Self { context, lease: claim.lease, job: claim.job, lost, stop }
    }

    /// Runs the attempt to its end and records the result in the store, unless the lease is lost.
    pub async fn run(self, shutdown: &Shutdown) {
        let started = Instant::now();
        let ended = tokio::select! {
            ended = self.try_run(shutdown) => ended,
            never = self.keep_lease() => match never {},
        };
        let ended = match ended {
            Err(AttemptError::Store(StoreError::LeaseLost)) => Err(StoreError::LeaseLost),
            // An attempt that a shutdown interrupts does not count.
            Err(error) if shutdown.now.is_cancelled() => {
                tracing::warn!(%error, "attempt interrupted by shutdown");
                self.context.store.release(&self.lease).await.map(|()| None)
            }
            Err(error) => self.fail_transient(&error).await.map(Some),
            Ok(ended) => Ok(ended),
        };
        let milliseconds = u64::try_from(started.elapsed().as_millis()).unwrap_or(u64::MAX);
        metrics::histogram!(telemetry::ATTEMPT).record(started.elapsed());
        match ended {
            Ok(Some(job)) => record_end(&job, milliseconds),
            Ok(None) => tracing::info!(milliseconds, "released job"),
            Err(StoreError::LeaseLost) => {
                tracing::warn!(milliseconds, "lease lost; result dropped");
                metrics::counter!(telemetry::ATTEMPTS_DROPPED).increment(1);
                self.context.drop_files(&self.lease).await;
            }
            // The lease will expire, and another worker will requeue the job.
            Err(error) => tracing::error!(%error, milliseconds, "could not record the attempt's result"),
        }
    }

    async fn try_run(&self, shutdown: &Shutdown) -> Result<Option<Job>, AttemptError> {
        pause_alone_at("worker-claimed").await;
        let PreparedChild { scratch, process } = self.context.child()?;
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
        let child = self.run_child(process, folder, shutdown).await?;
        self.settle(folder, child).await
    }

    /// Runs the child to its end and appends its standard error and the reason of its end to the job's log.
    async fn run_child(
        &self,
        mut process: JobProcess,
        folder: &Path,
        shutdown: &Shutdown,
    ) -> Result<ChildResult, AttemptError> {
        process.send(&self.context.task(&self.job, self.lease.attempt, None)).await?;
        tracing::info!(process = process.group().as_raw_nonzero(), "started child process");
        let ended = self.watch(&mut process, folder, &shutdown.now).instrument(tracing::info_span!("run")).await;
        let (status, stderr) = process.end(self.context.may_leave_group()).await?;
        let left = folder.to_owned();
        let left = tokio::task::spawn_blocking(move || {
            sanitize(&left);
            read_if_present(&left.join(Task::FULL_REPORT))
        });
        let report = left.await.map_err(io::Error::from)?;
        let ended = match ended? {
            RunEnd::Exited(status) if was_stopped_with_service(status, shutdown).await => RunEnd::Shutdown,
            ended => ended,
        };
        append_stderr(folder, &ended, status, &stderr).await?;
        Ok(ChildResult { ended, stderr, report })
    }

    /// Records the attempt's result, by why the child ended and the files it left. Returns `None` if the job was released.
    async fn settle(&self, folder: &Path, child: ChildResult) -> Result<Option<Job>, AttemptError> {
        let ChildResult { ended, stderr, report } = child;
        match ended {
            RunEnd::LeaseLost => {
                count_kill("lease_lost");
                Err(StoreError::LeaseLost.into())
            }
            RunEnd::Shutdown => {
                count_kill("shutdown");
                self.context.store.release(&self.lease).await?;
                Ok(None)
            }
            // The child wrote its whole report before it was stopped, so the result counts.
            RunEnd::Exited(_) | RunEnd::Deadline if !matches!(report, Ok(None)) => {
                self.conclude(folder, report?).await.map(Some)
            }
            RunEnd::Deadline => {
                count_kill("deadline");
                let detail = format!(
                    "The job ran longer than its `deadline_s` of {} s allows and was stopped. Submit it again with a larger \
                     `deadline_s`, a smaller `max_tier` or `level`, or fewer faces.",
                    self.job.options.deadline_s()
                );
                let problem = JobProblem::new(ProblemKind::DeadlineExceeded, detail);
                self.fail(folder, FailureKind::Final, problem).await.map(Some)
            }
            RunEnd::Excess(excess) => {
                count_kill(excess.name());
                let config = &self.context.config;
                let problem = explain_excess(excess, config.job_scratch, config.job_processes);
                self.fail(folder, FailureKind::Final, problem).await.map(Some)
            }
            RunEnd::Exited(status) if status.success() => self.conclude(folder, None).await.map(Some),
            RunEnd::Exited(status) if status.code() == Some(i32::from(Task::EXIT_PROBLEM)) => {
                let problem = require_file(read_if_present(&folder.join(Task::PROBLEM))?, Task::PROBLEM)?;
                let problem = serde_json::from_slice(&problem).map_err(|e| AttemptError::Json(Task::PROBLEM, e))?;
                self.fail(folder, FailureKind::Final, problem).await.map(Some)
            }
            RunEnd::Exited(status) => {
                let (kind, problem) = explain_exit(status, &stderr, self.context.config.job_memory);
                metrics::counter!(telemetry::CHILD_CRASHES, "reason" => label(&problem.code)).increment(1);
                tracing::warn!(%status, code = label(&problem.code), "child process ended without a result");
                self.fail(folder, kind, problem).await.map(Some)
            }
        }
    }

    /// Extends the lease until the attempt ends. When the lease is lost, cancels `lost` and `stop`, and never completes.
    async fn keep_lease(&self) -> Infallible {
        let (store, lease) = (&self.context.store, self.context.config.lease);
        let mut changed = store.notifier().listen();
        let mut heartbeat = tokio::time::interval_at(Instant::now() + lease / 3, lease / 3);
        let mut held_until = Instant::now() + lease;
        loop {
            let is_held = tokio::select! {
                _ = heartbeat.tick() => match store.heartbeat(&self.lease, lease, None).await {
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
                change = changed.recv() => match change {
                    Ok(id) if id != self.lease.id => true,
                    Ok(_) | Err(RecvError::Lagged(_)) => self.holds_lease().await,
                    Err(RecvError::Closed) => true,
                },
            };
            if !is_held {
                self.lost.cancel();
                self.stop.cancel();
                return std::future::pending().await;
            }
        }
    }

    /// Reads the child's progress until the child ends or must be killed.
    async fn watch(
        &self,
        process: &mut JobProcess,
        folder: &Path,
        stop: &CancellationToken,
    ) -> Result<RunEnd, AttemptError> {
        let stdout = process.stdout().ok_or_else(|| io::Error::other("the child process has no standard output"))?;
        let mut lines = FramedRead::new(stdout, LinesCodec::new_with_max_length(LINE_BYTES)).fuse();
        let excess = self.context.wait_for_excess(&self.job, folder, process.group());
        tokio::pin!(excess);
        let mut progress: Option<JobProgress> = None;
        let mut written: Option<JobProgress> = None;
        let mut stages = Stages::default();
        let mut read_progress = |line: Result<String, LinesCodecError>| {
            let line = line.ok().and_then(|line| serde_json::from_str::<ProgressLine>(&line).ok());
            line.inspect(|&line| stages.enter(line))
        };
        let mut write_tick = tokio::time::interval_at(Instant::now() + PROGRESS_EVERY, PROGRESS_EVERY);
        loop {
            tokio::select! {
                status = process.wait() => {
                    while let Some(Some(line)) = lines.next().now_or_never() {
                        read_progress(line);
                    }
                    return Ok(RunEnd::Exited(status?));
                }
                found = &mut excess => return Ok(found?.map_or(RunEnd::Deadline, RunEnd::Excess)),
                () = stop.cancelled() => return Ok(RunEnd::Shutdown),
                () = self.lost.cancelled() => return Ok(RunEnd::LeaseLost),
                Some(line) = lines.next() => progress = read_progress(line).or(progress),
                _ = write_tick.tick(), if progress != written => {
                    match self.context.store.heartbeat(&self.lease, self.context.config.lease, progress).await {
                        Ok(()) => written = progress,
                        Err(StoreError::LeaseLost) => return Ok(RunEnd::LeaseLost),
                        Err(error) => tracing::warn!(%error, "could not record progress"),
                    }
                }
            }
        }
    }

    /// Whether the job still runs as this attempt; `true` if the store does not answer.
    async fn holds_lease(&self) -> bool {
        match self.context.store.get(self.lease.id).await {
            Ok(Some(job)) => job.status == Status::Running && job.attempt == self.lease.attempt,
            Ok(None) => false,
            Err(_) => true,
        }
    }

    /// Ends the job with its report. The job fails if the report says that the result lacks a required property.
    async fn conclude(&self, folder: &Path, report: Option<Vec<u8>>) -> Result<Job, AttemptError> {
        pause_alone_at("worker-publish").await;
        // A lost lease must not abort the upload here: files in flight would land after the files were deleted.
        let completion = self.publish(folder, report).instrument(tracing::info_span!("publish")).await?;
        pause_alone_at("worker-complete").await;
        let job = self.complete(completion).instrument(tracing::info_span!("complete")).await?;
        if self.lease.attempt > 1
            && let Err(error) = self.context.blobs.delete_attempts(self.lease.id, Some(&self.lease.token)).await
        {
            tracing::warn!(%error, "could not delete files of an earlier attempt");
        }
        Ok(job)
    }

    async fn complete(&self, completion: Completion) -> Result<Job, StoreError> {
        let Some(problem) = completion.report.refusal() else {
            return retry_with_backoff(None, || self.context.store.complete(&self.lease, completion.clone())).await;
        };
        let Completion { report, artifacts } = completion;
        let failure = Failure { kind: FailureKind::Final, problem, report: Some(report), artifacts };
        self.record_failure(failure).await
    }

    async fn publish(&self, folder: &Path, report: Option<Vec<u8>>) -> Result<Completion, AttemptError> {
        let report = JobReport::from_json(&require_file(report, Task::FULL_REPORT)?)
            .map_err(|e| AttemptError::Json(Task::FULL_REPORT, e))?;
        record_steps(report.steps());
        let report = report.abridged();
        let json = serde_json::to_vec(&report).map_err(|e| AttemptError::Json(Task::REPORT, e))?;
        tokio::fs::write(folder.join(Task::REPORT), json).await?;
        let mut artifacts = self
            .context
            .store_files(&self.lease, folder, result_files(&self.job.inputs, Some(&report)), &self.stop)
            .await?;
        if self.job.options.pictures() {
            artifacts.extend(pictures(&self.job.inputs, &report));
        }
        Ok(Completion { report, artifacts })
    }

    async fn fail(&self, folder: &Path, kind: FailureKind, problem: JobProblem) -> Result<Job, AttemptError> {
        let artifacts =
            self.context.store_files(&self.lease, folder, result_files(&self.job.inputs, None), &self.stop).await?;
        let failure = Failure { kind, problem, report: None, artifacts };
        Ok(self.record_failure(failure).await?)
    }

    async fn record_failure(&self, failure: Failure) -> Result<Job, StoreError> {
        let job = retry_with_backoff(None, || self.context.store.fail(&self.lease, failure.clone())).await?;
        // The store keeps no problem for a job that it queued for a retry.
        if job.problem.is_none() {
            tracing::warn!(code = label(&failure.problem.code), "attempt failed; job queued for a retry");
        }
        Ok(job)
    }

    /// Records a failure that the job did not cause, as transient.
    async fn fail_transient(&self, error: &AttemptError) -> Result<Job, StoreError> {
        tracing::error!(%error, "attempt failed");
        let detail = match error {
            AttemptError::Blob(BlobError::Damaged { .. }) => {
                "A stored file of this job is damaged: its bytes differ from the uploaded bytes. Upload the file again."
            }
            _ => {
                "The service could not run this job because of an internal error. Try again later; the service's log has the cause."
            }
        };
        let problem = JobProblem::new(ProblemKind::Internal, detail.to_owned());
        let failure = Failure { kind: FailureKind::Transient, problem, report: None, artifacts: Artifacts::new() };
        self.record_failure(failure).await
    }
}

fn count_kill(reason: &'static str) {
    metrics::counter!(telemetry::KILLS, "reason" => reason).increment(1);
}

/// Whether the child was ended by the signal that also tells this process to stop. Some service managers send SIGTERM to
/// every process of a service, and the child may get it first.
async fn was_stopped_with_service(status: ExitStatus, shutdown: &Shutdown) -> bool {
    const SIGTERM: i32 = 15;
    status.signal() == Some(SIGTERM)
        && tokio::time::timeout(Duration::from_millis(500), shutdown.drain.cancelled()).await.is_ok()
}

/// Appends the child's standard error and the reason of its end to the job's log.
async fn append_stderr(folder: &Path, ended: &RunEnd, status: ExitStatus, stderr: &str) -> Result<(), AttemptError> {
    let reason = match ended {
        RunEnd::Exited(status) if status.success() && stderr.is_empty() => return Ok(()),
        RunEnd::Exited(_) => format!("the repair process ended: {status}"),
        RunEnd::Deadline => "the repair process was killed at its deadline".to_owned(),
        RunEnd::Excess(excess) => {
            format!("the repair process was killed: it exceeded the {} limit", excess.name())
        }
        RunEnd::LeaseLost | RunEnd::Shutdown => "the repair process was killed".to_owned(),
    };
    let mut log = tokio::fs::OpenOptions::new().append(true).create(true).open(folder.join(Task::LOG)).await?;
    log.write_all(
        format!("{stderr}{}{reason}\n", if stderr.is_empty() || stderr.ends_with('\n') { "" } else { "\n" }).as_bytes(),
    )
    .await?;
    log.flush().await?;
    Ok(())
}

/// Reads a small file that the child may have left; `None` if there is none.
fn read_if_present(path: &Path) -> io::Result<Option<Vec<u8>>> {
    let mut bytes = Vec::new();
    match File::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        file => file?.take(Task::REPORT_BYTES as u64).read_to_end(&mut bytes)?,
    };
    Ok(Some(bytes))
}

fn require_file(bytes: Option<Vec<u8>>, name: &'static str) -> io::Result<Vec<u8>> {
    bytes.ok_or_else(|| io::Error::other(format!("the repair process left no {name}")))
}

/// Turns the child's progress lines into trace spans: one span for each stage, which lasts until the next stage.
#[derive(Default)]
struct Stages {
    current: Option<(Stage, Option<u8>)>,
    span: Option<Span>,
}

impl Stages {
    fn enter(&mut self, progress: JobProgress) {
        let JobProgress { stage, tier, .. } = progress;
        if self.current != Some((stage, tier)) {
            let name = tier.map_or_else(|| label(&stage), |tier| format!("{} tier {tier}", label(&stage)));
            self.span = None;
            self.span = Some(tracing::info_span!("stage", otel.name = name, stage = ?stage, tier));
            self.current = Some((stage, tier));
        }
    }
}

/// Records the metrics of a repair's steps.
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

/// Logs and counts the result of an attempt, in the attempt's span.
fn record_end(job: &Job, milliseconds: u64) {
    let status = job.status.as_str();
    let outcome = job.outcome.map(|outcome| label(&outcome));
    let code = job.problem.as_ref().map(|problem| label(&problem.code));
    // The log line omits fields without a value.
    tracing::info!(status, outcome = outcome.as_deref(), code = code.as_deref(), milliseconds, "attempt ended");
    if let Some(code) = code {
        telemetry::failed(&Span::current(), code);
    }
    let outcome = outcome.unwrap_or_default();
    metrics::counter!(telemetry::ATTEMPTS, "status" => status, "outcome" => outcome).increment(1);
}
