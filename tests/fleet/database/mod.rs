//! The simulated database: the store's traits over tables in memory, statement by statement like `src/jobs/sql`. Each of its guards can
//! be taken out, so that a test can show that the simulation notices.

mod jobs;
mod outbox;
mod queue;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use meshmend::access::IdSource;
use meshmend::jobs::{Clock, Job, JobId, Lease, RetryPolicy, Status};
use time::OffsetDateTime;
use uuid::Uuid;

/// A clock that only the simulation advances.
#[derive(Default)]
pub struct ManualClock(AtomicI64);

impl ManualClock {
    pub fn set(&self, ms: i64) {
        self.0.store(ms, Ordering::Relaxed);
    }
}

impl Clock for ManualClock {
    fn now_ms(&self) -> i64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// Ids in a fixed order: a prefix for each history, and a counter.
#[derive(Default)]
pub struct CountedIds {
    prefix: AtomicU64,
    count: AtomicU64,
}

impl CountedIds {
    /// Starts the ids of a new history.
    pub fn restart(&self, prefix: u64) {
        self.prefix.store(prefix, Ordering::Relaxed);
        self.count.store(0, Ordering::Relaxed);
    }

    fn next(&self) -> Uuid {
        let (prefix, count) = (self.prefix.load(Ordering::Relaxed), self.count.fetch_add(1, Ordering::Relaxed));
        Uuid::from_u64_pair(prefix, count)
    }
}

impl IdSource for CountedIds {
    fn sortable(&self) -> Uuid {
        self.next()
    }

    fn random(&self) -> Uuid {
        self.next()
    }
}

/// A rule of the protocol. The database enforces all but the last one, which the API does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Guard {
    /// Finding a job and claiming it is one statement.
    ClaimIsAtomic,
    /// A claim raises the attempt.
    ClaimRaisesTheAttempt,
    /// A job is not claimed before it is due.
    ClaimWaitsUntilDue,
    /// Tenants take turns.
    ClaimTakesTurns,
    /// A tenant has a maximum of running jobs.
    ClaimKeepsTheMaximum,
    HeartbeatIsFenced,
    HeartbeatExtendsTheLease,
    CompletionIsFenced,
    /// The fence compares the token, not only the attempt.
    FenceHasTheToken,
    /// A repeated completion gets the answer of the first.
    RepeatIsRecognized,
    FailureIsFenced,
    ReleaseIsFenced,
    /// A worker that releases a job after its own lost write ended the attempt is not told that it lost the lease.
    ReleaseRecognizesAnEarlierEnd,
    RequeueChecksTheLease,
    RequeueCountsTheCrash,
    CancellationRevokesTheLease,
    /// The transaction that ends a job writes its message.
    MessageIsWrittenWithTheEnd,
    DeliveryIsLeased,
    SettlementIsFenced,
    SubmissionWaitsForTheDisk,
    /// The transaction that accepts a job records its idempotency key.
    KeyIsRecordedWithTheJob,
    /// The files of a submission are kept while nobody knows whether the database will execute it.
    UnknownSubmissionKeepsItsFiles,
}

/// A row of the table of jobs.
#[derive(Clone)]
struct Row {
    job: Job,
    /// Of the job's `run_at`, in milliseconds.
    run_at: i64,
    claimed_at: Option<i64>,
    token: Option<String>,
    lease_expires_at: i64,
    ended_token: Option<String>,
}

struct KeyRow {
    job: JobId,
    fingerprint: Option<String>,
    expires_at: i64,
}

#[derive(Default)]
struct Tables {
    jobs: BTreeMap<JobId, Row>,
    keys: BTreeMap<(String, String), KeyRow>,
    deliveries: Vec<outbox::DeliveryRow>,
    /// The rows before the commits that did not wait for the disk, since the last one that did.
    unsynced: Vec<(JobId, Option<Row>)>,
    /// The last claim, for a claim that is not atomic.
    last_claim: Option<(i64, JobId)>,
    /// Jobs that ended without their message, where it is not written in the same transaction.
    unannounced: Vec<Job>,
}

/// The simulated database.
pub struct SimDatabase {
    tables: Mutex<Tables>,
    clock: Arc<ManualClock>,
    ids: Arc<CountedIds>,
    retry: RetryPolicy,
    missing: Option<Guard>,
}

impl SimDatabase {
    /// A database without the guard `missing`.
    pub fn new(clock: Arc<ManualClock>, ids: Arc<CountedIds>, retry: RetryPolicy, missing: Option<Guard>) -> Self {
        Self { tables: Mutex::default(), clock, ids, retry, missing }
    }

    /// Loses the commits that did not wait for the disk.
    pub fn crash(&self) {
        let mut tables = self.tables();
        tables.unannounced.clear();
        while let Some((id, row)) = tables.unsynced.pop() {
            match row {
                Some(row) => drop(tables.jobs.insert(id, row)),
                None => drop(tables.jobs.remove(&id)),
            }
        }
    }

    /// Whether every commit is on the disk.
    pub fn is_synced(&self) -> bool {
        self.tables().unsynced.is_empty()
    }

    fn has(&self, guard: Guard) -> bool {
        self.missing != Some(guard)
    }

    fn tables(&self) -> MutexGuard<'_, Tables> {
        self.tables.lock().expect("no panic while locked")
    }

    fn now(&self) -> i64 {
        self.clock.now_ms()
    }

    fn new_token(&self) -> String {
        self.ids.random().simple().to_string()
    }

    fn new_id(&self, prefix: &str) -> String {
        format!("{prefix}_{}", self.ids.sortable().simple())
    }

    /// Whether the row is held under this lease.
    fn holds(&self, row: &Row, held: &Lease) -> bool {
        let token = !self.has(Guard::FenceHasTheToken) || row.token.as_deref() == Some(held.token.as_str());
        let status = row.job.status == Status::Running || !self.has(Guard::CancellationRevokesTheLease);
        row.job.attempt == held.attempt && status && token
    }
}

impl Tables {
    /// Records a commit that waits for the disk, and with it all before.
    fn sync(&mut self) {
        self.unsynced.clear();
    }
}

impl Row {
    fn set_run_at(&mut self, ms: i64) {
        self.run_at = ms;
        self.job.run_at = time_of(ms);
    }

    fn drop_lease(&mut self) {
        self.job.progress = None;
        self.token = None;
        self.job.version += 1;
    }
}

/// The time of milliseconds since the Unix epoch.
fn time_of(ms: i64) -> OffsetDateTime {
    OffsetDateTime::from_unix_timestamp_nanos(i128::from(ms) * 1_000_000).expect("a time of this age")
}
