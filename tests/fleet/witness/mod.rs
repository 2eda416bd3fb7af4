//! The witness: it sees each request that the database executes, keeps its own account of every job, and notices the first violation
//! of an invariant.

mod deliveries;
mod turns;

use std::collections::BTreeMap;

use meshmend::jobs::{
    Artifact, CancelResult, Failure, FailureKind, Job, JobId, Lease, NewJob, RetryPolicy, Status, StoreError,
};
use time::OffsetDateTime;

use super::plan::LEASE;
use super::request::{Answer, Request};

/// What must hold in every history.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Invariant {
    /// A job that has ended never changes again.
    EachJobEndsOnce,
    /// Every accepted job ends, with its input until then and its files after.
    NothingAcceptedIsLost,
    /// Requests with the same idempotency key make one job.
    OneRequestMakesOneJob,
    /// Only the worker that holds the lease changes a running job.
    NoStaleWriteLands,
    /// Until a lease expires or is revoked, nobody else gets the job.
    LeasesAreExclusive,
    /// Attempts and crashes are counted, and a retry comes when it is due.
    RetriesFollowThePolicy,
    /// Tenants take turns and keep their maximum.
    TenantsAreServedFairly,
    /// Each end makes one message, which is delivered.
    EveryEndIsAnnouncedOnce,
}

/// An invariant that does not hold, and how it shows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    pub invariant: Invariant,
    pub detail: String,
}

/// A lease as the witness knows it.
#[derive(Debug, Clone)]
struct Held {
    attempt: u32,
    token: String,
    expires_at: i64,
}

impl Held {
    fn is(&self, lease: &Lease) -> bool {
        self.attempt == lease.attempt && self.token == lease.token
    }
}

/// The witness's account of a job.
#[derive(Clone)]
struct View {
    row: Job,
    held: Option<Held>,
    /// The token of the attempt that ended last.
    ended_by: Option<String>,
    claimed_at: Option<i64>,
}

/// See the module's documentation.
pub struct Witness {
    retry: RetryPolicy,
    max_running: u32,
    jobs: BTreeMap<JobId, View>,
    keys: BTreeMap<(String, String), JobId>,
    deliveries: BTreeMap<String, deliveries::DeliveryView>,
    announcements: BTreeMap<JobId, deliveries::Announcements>,
    /// Accounts before the commits that a crash of the database loses.
    unsynced: Vec<(JobId, View)>,
    /// The latest time of the database's clock.
    latest: i64,
    violation: Option<Violation>,
}

fn millis(time: OffsetDateTime) -> i64 {
    i64::try_from(time.unix_timestamp_nanos() / 1_000_000).expect("a time of this age")
}

impl Witness {
    pub fn new(retry: RetryPolicy, max_running: u32) -> Self {
        Self {
            retry,
            max_running,
            jobs: BTreeMap::new(),
            keys: BTreeMap::new(),
            deliveries: BTreeMap::new(),
            announcements: BTreeMap::new(),
            unsynced: Vec::new(),
            latest: 0,
            violation: None,
        }
    }

    pub fn violation(&self) -> Option<&Violation> {
        self.violation.as_ref()
    }

    fn violated(&mut self, invariant: Invariant, detail: String) {
        self.violation.get_or_insert(Violation { invariant, detail });
    }

    fn require(&mut self, holds: bool, invariant: Invariant, detail: impl FnOnce() -> String) {
        if !holds {
            self.violated(invariant, detail());
        }
    }

    /// The jobs that a request may have changed.
    pub fn jobs_of(request: &Request, answer: &Result<Answer, StoreError>) -> Vec<JobId> {
        match (request, answer) {
            (_, Ok(Answer::Claimed(Some(claim)))) => vec![claim.job.id],
            (_, Ok(Answer::Requeued(jobs))) => jobs.iter().map(|job| job.id).collect(),
            (Request::Submit(new), _) => vec![new.id],
            (Request::Cancel(id), _) => vec![*id],
            _ => request.lease().map(|held| held.id).into_iter().collect(),
        }
    }

    /// Judges a request that the database executed at `now`. `rows` are the rows of [`Self::jobs_of`] afterwards.
    pub fn executed(&mut self, now: i64, request: &Request, answer: &Result<Answer, StoreError>, rows: Vec<Job>) {
        for row in &rows {
            self.check_final(row);
        }
        match (request, answer) {
            (Request::Submit(new), answer) => self.submitted(new, answer, rows),
            (Request::Cancel(_), Ok(Answer::Canceled(Some(canceled)))) => self.canceled(canceled, rows),
            (Request::Claim { .. }, Ok(Answer::Claimed(claim))) => {
                self.check_turn(now, claim.as_ref().map(|claim| &claim.job));
                if let Some(claim) = claim {
                    self.claimed(now, &claim.lease, rows);
                }
            }
            (Request::Heartbeat(held, _), answer) => self.extended(now, held, answer, rows),
            (Request::Complete(..) | Request::Fail(..), answer) => self.ended(now, request, answer, rows),
            (Request::Release(held), answer) => self.released(held, answer, rows),
            (Request::RequeueExpired, Ok(Answer::Requeued(_))) => self.requeued(now, rows),
            (Request::ClaimDelivery, Ok(Answer::Due(Some(due)))) => self.delivery_claimed(now, due),
            (Request::Settle(due, _, result), Ok(_)) => self.settled(due, *result),
            _ => {}
        }
        self.latest = self.latest.max(now);
    }

    /// Every commit so far is on the database's disk.
    pub fn synced(&mut self) {
        self.unsynced.clear();
    }

    /// The database lost the commits that did not wait for the disk.
    pub fn crashed(&mut self, find: impl Fn(JobId) -> Option<Job>) {
        while let Some((id, view)) = self.unsynced.pop() {
            self.jobs.insert(id, view);
        }
        if let Some(id) = self.jobs.keys().copied().find(|id| find(*id).is_none()) {
            self.violated(Invariant::NothingAcceptedIsLost, format!("{id} is gone"));
        }
    }

    fn check_final(&mut self, row: &Job) {
        let Some(view) = self.jobs.get(&row.id) else { return };
        let before = &view.row;
        if before.status.is_final() && row.version != before.version {
            let detail = format!("{} was {} and is now {}", row.id, before.status.as_str(), row.status.as_str());
            self.violated(Invariant::EachJobEndsOnce, detail);
        }
    }

    fn submitted(&mut self, new: &NewJob, answer: &Result<Answer, StoreError>, mut rows: Vec<Job>) {
        let (Ok(_), Some(row)) = (answer, rows.pop()) else { return };
        if let Some(request) = &new.key {
            let first = *self.keys.entry((new.tenant.clone(), request.key.clone())).or_insert(new.id);
            self.require(first == new.id, Invariant::OneRequestMakesOneJob, || {
                format!("the request {} made {first} and {}", request.key, new.id)
            });
        }
        self.jobs.insert(new.id, View { row, held: None, ended_by: None, claimed_at: None });
    }

    fn canceled(&mut self, canceled: &CancelResult, mut rows: Vec<Job>) {
        let (CancelResult::Canceled(_), Some(row)) = (canceled, rows.pop()) else { return };
        let view = self.jobs.get_mut(&row.id).expect("submitted");
        view.held = None;
        view.row = row;
    }

    fn claimed(&mut self, now: i64, lease: &Lease, mut rows: Vec<Job>) {
        let row = rows.pop().expect("the claimed job");
        let view = self.jobs.get_mut(&lease.id).expect("submitted");
        let before = std::mem::replace(view, View { row, ..view.clone() });
        view.claimed_at = Some(now);
        let expires_at = now + i64::try_from(LEASE).expect("short");
        view.held = Some(Held { attempt: lease.attempt, token: lease.token.clone(), expires_at });
        let (id, attempt) = (lease.id, lease.attempt);
        let status = before.row.status;
        self.require(status == Status::Queued, Invariant::LeasesAreExclusive, || {
            format!("{id} was claimed while it was {}", status.as_str())
        });
        self.require(attempt == before.row.attempt + 1, Invariant::RetriesFollowThePolicy, || {
            format!("attempt {attempt} of {id} follows attempt {}", before.row.attempt)
        });
        self.require(millis(before.row.run_at) <= now, Invariant::RetriesFollowThePolicy, || {
            format!("{id} was claimed before it was due")
        });
        self.unsynced.push((id, before));
    }

    /// Judges the fence of a write under a lease. Returns the job's account if the write changed the row or may have done so.
    fn fenced(&mut self, held: &Lease, answer: &Result<Answer, StoreError>, has_changed: bool) -> Option<&mut View> {
        let view = self.jobs.get(&held.id)?;
        let is_holder = view.held.as_ref().is_some_and(|current| current.is(held));
        let attempt = held.attempt;
        if answer.is_ok() && has_changed && !is_holder {
            let current = view.held.as_ref().map_or("nobody".to_owned(), |held| format!("attempt {}", held.attempt));
            let detail = format!("a write of attempt {attempt} changed {}, which {current} holds", held.id);
            self.violated(Invariant::NoStaleWriteLands, detail);
        }
        if matches!(answer, Err(StoreError::LeaseLost)) && is_holder {
            let detail = format!("attempt {attempt} holds {} and was refused", held.id);
            self.violated(Invariant::LeasesAreExclusive, detail);
        }
        let view = self.jobs.get_mut(&held.id).filter(|_| answer.is_ok() && has_changed);
        view.filter(|_| is_holder)
    }

    fn extended(&mut self, now: i64, held: &Lease, answer: &Result<Answer, StoreError>, mut rows: Vec<Job>) {
        let Some(row) = rows.pop() else { return };
        let Some(view) = self.fenced(held, answer, true) else { return };
        let before = std::mem::replace(view, View { row, ..view.clone() });
        if let Some(current) = &mut view.held {
            current.expires_at = now + i64::try_from(LEASE).expect("short");
        }
        self.unsynced.push((held.id, before));
    }

    fn ended(&mut self, now: i64, request: &Request, answer: &Result<Answer, StoreError>, mut rows: Vec<Job>) {
        let Some(held) = request.lease() else { return };
        let failure = if let Request::Fail(_, failure) = request { Some(failure.as_ref()) } else { None };
        let Some(row) = rows.pop() else { return };
        let Some(before) = self.jobs.get(&held.id).cloned() else { return };
        let has_changed = row.version != before.row.version;
        if answer.is_ok() && !has_changed {
            let is_repeat = before.ended_by.as_ref() == Some(&held.token);
            return self.require(is_repeat, Invariant::NoStaleWriteLands, || {
                format!("attempt {} did not end {} and was told so", held.attempt, held.id)
            });
        }
        let Some(view) = self.fenced(held, answer, has_changed) else { return };
        *view = View { row, held: None, ended_by: Some(held.token.clone()), ..view.clone() };
        let row = view.row.clone();
        self.check_end(now, &before.row, &row, failure);
    }

    /// Checks the row after the end of an attempt.
    fn check_end(&mut self, now: i64, before: &Job, row: &Job, failure: Option<&Failure>) {
        let crashes = before.crashes + u32::from(failure.is_some_and(|failure| failure.kind == FailureKind::Crash));
        let expected = match failure {
            None => Status::Succeeded,
            Some(failure) if self.retry.ends(failure.kind, before.attempt, crashes) => Status::Failed,
            Some(_) => Status::Queued,
        };
        let is_right = row.status == expected && row.crashes == crashes && row.attempt == before.attempt;
        let is_later = row.status != Status::Queued || millis(row.run_at) > now;
        self.require(is_right && is_later, Invariant::RetriesFollowThePolicy, || {
            format!("{} is {} and should be {}", row.id, row.status.as_str(), expected.as_str())
        });
    }

    fn released(&mut self, held: &Lease, answer: &Result<Answer, StoreError>, mut rows: Vec<Job>) {
        let Some(row) = rows.pop() else { return };
        let has_changed = self.jobs.get(&held.id).is_some_and(|view| view.row.version != row.version);
        let Some(view) = self.fenced(held, answer, has_changed) else { return };
        let attempt = row.attempt;
        *view = View { row, held: None, ..view.clone() };
        self.require(attempt + 1 == held.attempt, Invariant::RetriesFollowThePolicy, || {
            format!("{} was released in attempt {} and has {attempt} attempts", held.id, held.attempt)
        });
    }

    fn requeued(&mut self, now: i64, rows: Vec<Job>) {
        for row in rows {
            let Some(view) = self.jobs.get_mut(&row.id) else { continue };
            let before = std::mem::replace(view, View { row: row.clone(), held: None, ..view.clone() });
            let is_expired = before.held.is_some_and(|held| held.expires_at <= now);
            self.require(is_expired, Invariant::LeasesAreExclusive, || {
                format!("{} was requeued before its lease expired", row.id)
            });
            let crashes = before.row.crashes + 1;
            let ends = crashes >= self.retry.max_crashes;
            let is_right = row.crashes == crashes && (row.status == Status::Failed) == ends;
            self.require(is_right, Invariant::RetriesFollowThePolicy, || {
                format!("{} is {} after crash {crashes}", row.id, row.status.as_str())
            });
        }
        let is_left = |view: &&View| view.held.as_ref().is_some_and(|held| held.expires_at <= now);
        if let Some(id) = self.jobs.values().find(is_left).map(|view| view.row.id) {
            self.violated(
                Invariant::NothingAcceptedIsLost,
                format!("the lease on {id} expired, and it was not requeued"),
            );
        }
    }

    /// A worker does not find the input of a job.
    pub fn missing_input(&mut self, id: JobId) {
        self.violated(Invariant::NothingAcceptedIsLost, format!("the input of {id} was deleted"));
    }

    /// A client got the answer that its job is accepted.
    pub fn acknowledged(&mut self, id: JobId) {
        let is_known = self.jobs.contains_key(&id);
        self.require(is_known, Invariant::NothingAcceptedIsLost, || format!("{id} was accepted and is not stored"));
    }

    /// Whether every job has ended and every end is announced.
    pub fn is_quiet(&self) -> bool {
        self.jobs.values().all(|view| view.row.status.is_final() && self.is_announced(&view.row))
    }

    /// Judges the end of a history. `find` reads a row, and `has_file` asks whether an attempt's files exist.
    pub fn close(&mut self, find: impl Fn(JobId) -> Option<Job>, has_file: impl Fn(JobId, &str) -> bool) {
        for View { row, .. } in self.jobs.values().cloned().collect::<Vec<_>>() {
            let (id, status) = (row.id, row.status);
            let stored = find(id);
            self.require(status.is_final(), Invariant::NothingAcceptedIsLost, || {
                format!("{id} is still {}", status.as_str())
            });
            let is_same = stored.is_none_or(|stored| stored.version == row.version && stored.status == status);
            self.require(is_same, Invariant::NoStaleWriteLands, || format!("{id} changed unseen"));
            let file = |artifact: &Artifact| artifact.file.as_ref().is_none_or(|file| has_file(id, &file.key));
            let has_files = row.artifacts.values().all(file);
            self.require(has_files, Invariant::NothingAcceptedIsLost, || format!("the files of {id} were deleted"));
            let announced = self.is_announced(&row);
            self.require(announced, Invariant::EveryEndIsAnnouncedOnce, || {
                format!("the end of {id} was not announced")
            });
        }
    }
}
