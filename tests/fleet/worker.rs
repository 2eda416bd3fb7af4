//! A worker process. It makes the calls of `src/worker/pool.rs` and `src/worker/attempt.rs` in the same order and with the same rules
//! of retries; fetching files, the child process and storing files are waits.

use std::convert::Infallible;
use std::rc::Rc;

use meshmend::context::Stage;
use meshmend::jobs::{
    Artifact, Artifacts, Claim, Completion, Failure, FailureKind, Job, JobProblem, JobProgress, Lease, ProblemKind,
    Status, StoreError, StoredFile,
};

use super::environment::kill;
use super::executor::{Millis, Signal};
use super::network::Link;
use super::plan::{Ending, LEASE};
use super::random::hash;
use super::world::World;

/// How often to look for work when no notification arrives.
const POLL: Millis = 2_000;
/// The least time between two writes of progress.
const PROGRESS_EVERY: Millis = 2_500;
/// How long to retry an operation that an attempt needs to end. Real workers retry for longer than any trouble of a history lasts.
const RETRY_TIME: Millis = 6_000;

/// Starts the tasks of a worker process.
pub fn start(world: &Rc<World>, process: usize) {
    let state = &world.processes[process];
    *state.drain.borrow_mut() = Signal::new(&world.sim);
    *state.now.borrow_mut() = Signal::new(&world.sim);
    let link = Link { world: Rc::clone(world), process };
    world.sim.spawn(process, requeue_expired(link.clone()));
    for _ in 0..world.plan.slots {
        world.sim.spawn(process, slot(link.clone()));
    }
}

/// Periodically requeues jobs whose lease expired. After this process was suspended, the leases of its own jobs have expired: their
/// heartbeats come first.
async fn requeue_expired(link: Link) {
    let (world, process) = (&link.world, link.process);
    let drain = world.processes[process].drain.borrow().clone();
    let mut overslept = false;
    while !drain.is_set() {
        if overslept {
            world.sim.sleep(process, LEASE / 3).await;
        }
        let _ = link.requeue_expired().await;
        let asleep = world.sim.local_now(process);
        tokio::select! { biased; () = world.sim.sleep(process, LEASE / 3) => {}, () = drain.wait() => {} }
        overslept = world.sim.local_now(process) - asleep > 2 * LEASE / 3;
    }
}

/// Claims and runs one job after the other.
async fn slot(link: Link) {
    let (world, process) = (&link.world, link.process);
    let state = &world.processes[process];
    let (drain, now) = (state.drain.borrow().clone(), state.now.borrow().clone());
    let name = format!("worker-{process}-{}", state.starts.get());
    while !drain.is_set() {
        if let Ok(Some(Claim { lease, job })) = link.claim(&name).await {
            let (lost, stop, changed) = (Signal::new(&world.sim), Signal::new(&world.sim), Signal::new(&world.sim));
            state.changed.borrow_mut().insert(job.id, changed.clone());
            Attempt { link: link.clone(), lease, job, lost, stop, changed, now: now.clone() }.run().await;
            continue;
        }
        tokio::select! {
            biased;
            () = state.work.take() => {}
            () = world.sim.sleep(process, POLL) => {}
            () = drain.wait() => {}
        }
    }
}

enum AttemptError {
    Internal,
    Store(StoreError),
}

impl From<StoreError> for AttemptError {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

enum RunEnd {
    Exited(Ending),
    LeaseLost,
    Shutdown,
}

/// The work on one claim.
struct Attempt {
    link: Link,
    lease: Lease,
    job: Job,
    lost: Signal,
    stop: Signal,
    /// Set when the database notifies of a change of the job.
    changed: Signal,
    now: Signal,
}

impl Attempt {
    /// Runs the attempt to its end and records the result in the store, unless the lease is lost.
    async fn run(self) {
        let world = &self.link.world;
        // `tokio::select!` polls in random order, so the seed decides.
        let ended = if hash(&[world.plan.seed, world.sim.now()]).is_multiple_of(2) {
            tokio::select! { biased; ended = self.try_run() => ended, never = self.keep_lease() => match never {} }
        } else {
            tokio::select! { biased; never = self.keep_lease() => match never {}, ended = self.try_run() => ended }
        };
        let ended = match ended {
            Err(AttemptError::Store(StoreError::LeaseLost)) => Err(StoreError::LeaseLost),
            Err(_) if self.now.is_set() => self.link.release(&self.lease).await.map(|()| None),
            Err(_) => self.fail_transient().await.map(Some),
            Ok(ended) => Ok(ended),
        };
        if matches!(ended, Err(StoreError::LeaseLost)) {
            self.drop_files();
        }
    }

    async fn try_run(&self) -> Result<Option<Job>, AttemptError> {
        let world = &self.link.world;
        tokio::select! {
            biased;
            () = self.sleep(5) => if !world.files.borrow().contains(&(self.job.id, String::new())) {
                world.witness.borrow_mut().missing_input(self.job.id);
                return Err(AttemptError::Internal);
            },
            () = self.lost.wait() => return Err(StoreError::LeaseLost.into()),
            () = self.now.wait() => {
                self.link.release(&self.lease).await?;
                return Ok(None);
            }
        }
        let (ending, ms) = world.child(self.job.id, self.lease.attempt);
        match self.watch(ending, ms).await {
            RunEnd::LeaseLost => Err(StoreError::LeaseLost.into()),
            RunEnd::Shutdown => {
                self.link.release(&self.lease).await?;
                Ok(None)
            }
            RunEnd::Exited(Ending::Success) => self.conclude(true).await.map(Some),
            RunEnd::Exited(Ending::NotPrintable) => self.conclude(false).await.map(Some),
            RunEnd::Exited(Ending::Problem) => self.fail(FailureKind::Final).await.map(Some),
            RunEnd::Exited(Ending::Crash) => self.fail(FailureKind::Crash).await.map(Some),
            RunEnd::Exited(Ending::Internal) => Err(AttemptError::Internal),
            RunEnd::Exited(Ending::WorkerDies) => {
                kill(world, self.link.process, 500);
                std::future::pending().await
            }
        }
    }

    /// Extends the lease from the claim to the end of the attempt. When the lease is lost, this future never completes.
    async fn keep_lease(&self) -> Infallible {
        let local_now = || self.link.world.sim.local_now(self.link.process);
        let (mut next, mut held_until) = (local_now() + LEASE / 3, local_now() + LEASE);
        loop {
            let is_held = tokio::select! {
                biased;
                () = self.sleep(next.saturating_sub(local_now())) => {
                    next += LEASE / 3;
                    match self.link.heartbeat(&self.lease, None).await {
                        Ok(()) => {
                            held_until = local_now() + LEASE;
                            true
                        }
                        Err(StoreError::LeaseLost) => false,
                        Err(_) => local_now() < held_until,
                    }
                }
                () = self.changed.take() => self.holds_lease().await,
            };
            if !is_held {
                self.lost.set();
                self.stop.set();
                return std::future::pending().await;
            }
        }
    }

    /// Waits until the child ends or must be killed, and records progress.
    async fn watch(&self, ending: Ending, ms: Millis) -> RunEnd {
        let exit = self.sleep(ms);
        tokio::pin!(exit);
        let mut percent = 0;
        loop {
            tokio::select! {
                biased;
                () = &mut exit => return RunEnd::Exited(ending),
                () = self.now.wait() => return RunEnd::Shutdown,
                () = self.lost.wait() => return RunEnd::LeaseLost,
                () = self.sleep(PROGRESS_EVERY) => {
                    percent += 5;
                    let progress = JobProgress { stage: Stage::Inspect, tier: None, percent, estimate: None };
                    if let Err(StoreError::LeaseLost) = self.link.heartbeat(&self.lease, Some(progress)).await {
                        return RunEnd::LeaseLost;
                    }
                }
            }
        }
    }

    /// Whether the job still runs as this attempt; `true` if the store does not answer.
    async fn holds_lease(&self) -> bool {
        match self.link.get(self.lease.id).await {
            Ok(Some(job)) => job.status == Status::Running && job.attempt == self.lease.attempt,
            Ok(None) => false,
            Err(_) => true,
        }
    }

    async fn conclude(&self, is_printable: bool) -> Result<Job, AttemptError> {
        let artifacts = self.publish().await;
        let report = self.link.world.backend.report.clone();
        let job = if is_printable {
            let completion = Completion { report, artifacts };
            retry_with_backoff(&self.link, || self.link.complete(&self.lease, completion.clone())).await?
        } else {
            let problem = JobProblem::new(ProblemKind::NotPrintable, String::new());
            let failure = Failure { kind: FailureKind::Final, problem, report: Some(report), artifacts };
            self.record_failure(failure).await?
        };
        if self.lease.attempt > 1 {
            let keeps =
                |(id, token): &(_, String)| *id != self.lease.id || token.is_empty() || *token == self.lease.token;
            self.link.world.files.borrow_mut().retain(keeps);
        }
        Ok(job)
    }

    /// Stores the files under the attempt's token.
    async fn publish(&self) -> Artifacts {
        self.sleep(20).await;
        self.link.world.files.borrow_mut().insert((self.lease.id, self.lease.token.clone()));
        let file = StoredFile { key: self.lease.token.clone(), bytes: 1, sha256: String::new() };
        let artifact = Artifact { filename: String::new(), media_type: String::new(), file: Some(file) };
        Artifacts::from([("model".to_owned(), artifact)])
    }

    async fn fail(&self, kind: FailureKind) -> Result<Job, AttemptError> {
        let artifacts = self.publish().await;
        let problem = JobProblem::new(ProblemKind::Crashed, String::new());
        Ok(self.record_failure(Failure { kind, problem, report: None, artifacts }).await?)
    }

    async fn record_failure(&self, failure: Failure) -> Result<Job, StoreError> {
        retry_with_backoff(&self.link, || self.link.fail(&self.lease, failure.clone())).await
    }

    /// Records a failure that the job did not cause, as transient.
    async fn fail_transient(&self) -> Result<Job, StoreError> {
        let problem = JobProblem::new(ProblemKind::Internal, String::new());
        let (kind, artifacts) = (FailureKind::Transient, Artifacts::new());
        self.record_failure(Failure { kind, problem, report: None, artifacts }).await
    }

    fn drop_files(&self) {
        self.link.world.files.borrow_mut().remove(&(self.lease.id, self.lease.token.clone()));
    }

    fn sleep(&self, time: Millis) -> super::executor::Sleep {
        self.link.world.sim.sleep(self.link.process, time)
    }
}

/// Runs `work`, and retries with backoff while its error is transient.
async fn retry_with_backoff<T, F>(link: &Link, work: impl Fn() -> F) -> Result<T, StoreError>
where
    F: Future<Output = Result<T, StoreError>>,
{
    let (sim, process) = (&link.world.sim, link.process);
    let until = sim.local_now(process) + RETRY_TIME;
    let mut pause = 100;
    loop {
        match work().await {
            Err(error) if error.is_transient() && sim.local_now(process) < until => {
                sim.sleep(process, pause).await;
                pause = (pause * 2).min(5_000);
            }
            result => return result,
        }
    }
}
