//! The queue: claims, heartbeats and the ends of attempts.

use std::time::Duration;

use async_trait::async_trait;
use meshmend::access::IdSource;
use meshmend::jobs::{
    Claim, ClassLoad, Completion, Failure, FailureKind, Job, JobId, JobProblem, JobProgress, Lease, QueueStore,
    QueuedCounts, Status, StoreError,
};

use super::{Guard, Row, SimDatabase, Tables, time_of};

const UNUSED: &str = "no process of the fleet calls this";
/// How far apart two claims that are not atomic may be and still find the same job.
const RACE_MS: i64 = 5;

fn millis(time: Duration) -> i64 {
    i64::try_from(time.as_millis()).expect("short")
}

/// A tenant's turn in the order of claims: running jobs, last claim, next job.
type Turn = (u32, Option<i64>, JobId);

impl SimDatabase {
    /// The job to claim next.
    fn next_job(&self, tables: &Tables, now: i64, max_running: u32) -> Option<JobId> {
        if let (false, Some((at, id))) = (self.has(Guard::ClaimIsAtomic), tables.last_claim)
            && (at..=at + RACE_MS).contains(&now)
            && tables.jobs[&id].job.status == Status::Running
        {
            return Some(id);
        }
        let is_due = |row: &&Row| {
            row.job.status == Status::Queued && (row.run_at <= now || !self.has(Guard::ClaimWaitsUntilDue))
        };
        let mut best: Option<Turn> = None;
        let mut tenants: Vec<&str> = Vec::new();
        for tenant in tables.jobs.values().filter(is_due).map(|row| row.job.tenant.as_str()) {
            if tenants.contains(&tenant) {
                continue;
            }
            tenants.push(tenant);
            let own = || tables.jobs.values().filter(|row| row.job.tenant == tenant);
            let running = u32::try_from(own().filter(|row| row.job.status == Status::Running).count()).expect("few");
            if running >= max_running && self.has(Guard::ClaimKeepsTheMaximum) {
                continue;
            }
            let next = own().filter(is_due).min_by_key(|row| (row.run_at, row.job.id)).expect("one is due").job.id;
            let turn = (running, own().filter_map(|row| row.claimed_at).max(), next);
            if best.is_none_or(|best| if self.has(Guard::ClaimTakesTurns) { turn < best } else { next < best.2 }) {
                best = Some(turn);
            }
        }
        best.map(|(_, _, id)| id)
    }

    /// Changes the row of a lease, if `fence` allows it.
    fn under_lease<T>(
        &self,
        held: &Lease,
        fence: Guard,
        change: impl FnOnce(&mut Tables, i64) -> T,
    ) -> Result<T, StoreError> {
        let (now, tables) = (self.now(), &mut *self.tables());
        let row = tables.jobs.get(&held.id).ok_or(StoreError::LeaseLost)?;
        let is_held = if self.has(fence) { self.holds(row, held) } else { row.job.status == Status::Running };
        if is_held { Ok(change(tables, now)) } else { Err(StoreError::LeaseLost) }
    }

    /// The job, if this lease's own earlier write ended the attempt.
    fn ended_by(&self, held: &Lease) -> Result<Job, StoreError> {
        let tables = self.tables();
        let row = tables.jobs.get(&held.id).filter(|row| row.ended_token.as_deref() == Some(held.token.as_str()));
        let row = row.filter(|_| self.has(Guard::RepeatIsRecognized));
        row.map(|row| row.job.clone()).ok_or(StoreError::LeaseLost)
    }

    /// Records the end of an attempt that did not succeed.
    fn end_attempt(row: &mut Row, crashes: u32, retry_in: Option<Duration>, failure: &Failure, now: i64) {
        row.job.crashes = crashes;
        if let Some(delay) = retry_in {
            row.job.status = Status::Queued;
            row.set_run_at(now + millis(delay));
        } else {
            row.job.status = Status::Failed;
            row.job.problem = Some(failure.problem.clone());
            row.job.artifacts = failure.artifacts.clone();
            row.job.finished_at = Some(time_of(now));
            row.job.outcome = failure.report.as_ref().map(meshmend::jobs::JobReport::outcome);
        }
        row.drop_lease();
    }
}

#[async_trait]
impl QueueStore for SimDatabase {
    async fn queued_counts(&self, _: &str) -> Result<QueuedCounts, StoreError> {
        unreachable!("{UNUSED}")
    }

    async fn queue_position(&self, _: &Job) -> Result<Option<u64>, StoreError> {
        unreachable!("{UNUSED}")
    }

    async fn longest_wait(&self) -> Result<Duration, StoreError> {
        unreachable!("{UNUSED}")
    }

    async fn class_loads(&self) -> Result<Vec<ClassLoad>, StoreError> {
        unreachable!("{UNUSED}")
    }

    async fn claim(&self, _: &str, lease: Duration, max_running: u32) -> Result<Option<Claim>, StoreError> {
        let token = self.new_token();
        let (now, tables) = (self.now(), &mut *self.tables());
        let Some(id) = self.next_job(tables, now, max_running) else { return Ok(None) };
        let row = tables.jobs.get_mut(&id).expect("found above");
        tables.unsynced.push((id, Some(row.clone())));
        tables.last_claim = Some((now, id));
        row.job.status = Status::Running;
        row.job.attempt += u32::from(self.has(Guard::ClaimRaisesTheAttempt));
        row.job.started_at = row.job.started_at.or(Some(time_of(now)));
        row.claimed_at = Some(now);
        row.drop_lease();
        row.token = Some(token.clone());
        row.lease_expires_at = now + millis(lease);
        let job = row.job.clone();
        Ok(Some(Claim { lease: Lease { id, attempt: job.attempt, token }, job }))
    }

    async fn heartbeat(&self, held: &Lease, lease: Duration, progress: Option<JobProgress>) -> Result<(), StoreError> {
        let extends = self.has(Guard::HeartbeatExtendsTheLease);
        self.under_lease(held, Guard::HeartbeatIsFenced, |tables, now| {
            let row = tables.jobs.get_mut(&held.id).expect("fenced");
            tables.unsynced.push((held.id, Some(row.clone())));
            if extends {
                row.lease_expires_at = now + millis(lease);
            }
            if progress.is_some() && progress != row.job.progress {
                row.job.progress = progress;
                row.job.version += 1;
            }
        })
    }

    async fn complete(&self, held: &Lease, completion: Completion) -> Result<Job, StoreError> {
        let ended = self.under_lease(held, Guard::CompletionIsFenced, |tables, now| {
            let row = tables.jobs.get_mut(&held.id).expect("fenced");
            row.job.status = Status::Succeeded;
            row.job.outcome = Some(completion.report.outcome());
            row.job.artifacts = completion.artifacts;
            row.job.problem = None;
            row.job.finished_at = Some(time_of(now));
            row.drop_lease();
            row.ended_token = Some(held.token.clone());
            let job = row.job.clone();
            self.end(tables, &job, now);
            job
        });
        ended.or_else(|_| self.ended_by(held))
    }

    async fn fail(&self, held: &Lease, failure: Failure) -> Result<Job, StoreError> {
        let ended = self.under_lease(held, Guard::FailureIsFenced, |tables, now| {
            let row = tables.jobs.get_mut(&held.id).expect("fenced");
            let crashes = row.job.crashes + u32::from(failure.kind == FailureKind::Crash);
            let is_final = self.retry.ends(failure.kind, row.job.attempt, crashes);
            let delay = || self.retry.delay(row.job.attempt, self.ids.random().as_u64_pair().0);
            let retry_in = (!is_final).then(delay);
            Self::end_attempt(row, crashes, retry_in, &failure, now);
            row.ended_token = Some(held.token.clone());
            let job = row.job.clone();
            self.end(tables, &job, now);
            job
        });
        ended.or_else(|_| self.ended_by(held))
    }

    async fn release(&self, held: &Lease) -> Result<(), StoreError> {
        let released = self.under_lease(held, Guard::ReleaseIsFenced, |tables, _| {
            let row = tables.jobs.get_mut(&held.id).expect("fenced");
            row.job.status = Status::Queued;
            row.job.attempt -= 1;
            row.drop_lease();
            tables.sync();
        });
        let recognizes = self.has(Guard::ReleaseRecognizesAnEarlierEnd);
        released.or_else(|error| if recognizes { self.ended_by(held).map(drop) } else { Err(error) })
    }

    async fn requeue_expired(&self) -> Result<Vec<Job>, StoreError> {
        let (now, tables) = (self.now(), &mut *self.tables());
        let is_expired = |row: &&Row| {
            row.job.status == Status::Running
                && (row.lease_expires_at <= now || !self.has(Guard::RequeueChecksTheLease))
        };
        let expired: Vec<JobId> = tables.jobs.values().filter(is_expired).map(|row| row.job.id).collect();
        let mut requeued = Vec::new();
        for id in expired {
            let row = tables.jobs.get_mut(&id).expect("found above");
            let crashes = row.job.crashes + u32::from(self.has(Guard::RequeueCountsTheCrash));
            let problem = JobProblem::worker_lost(crashes);
            let artifacts = row.job.artifacts.clone();
            let failure = Failure { kind: FailureKind::Crash, problem, report: None, artifacts };
            let retry_in = (crashes < self.retry.max_crashes).then_some(Duration::ZERO);
            Self::end_attempt(row, crashes, retry_in, &failure, now);
            let job = row.job.clone();
            self.end(tables, &job, now);
            requeued.push(job);
        }
        Ok(requeued)
    }
}
