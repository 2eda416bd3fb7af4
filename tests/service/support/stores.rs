//! A job store of each kind, with a clock that tests advance.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::time::Duration;

use meshmend::access::SystemIds;
use meshmend::context::{Context, NoProgress};
use meshmend::format::{Format, Limits};
use meshmend::jobs::{
    Artifacts, Claim, Clock, Failure, FailureKind, Input, Job, JobId, JobOptions, JobProblem, JobReport, NewJob,
    PostgresStore, ProblemKind, RetryPolicy, SqliteStore, Store,
};
use meshmend::repair::{Options, repair};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection, PgConnection};

use crate::files;
use crate::postgres::Postgres;

const FILE: &str = "jobs.db";
pub const LEASE: Duration = Duration::from_secs(10);

/// A clock that only tests advance.
pub struct ManualClock(pub AtomicI64);

impl Clock for ManualClock {
    fn now_ms(&self) -> i64 {
        self.0.load(Ordering::SeqCst)
    }
}

/// A store under test.
pub struct Bench {
    pub store: Box<dyn Store>,
    pub clock: Arc<ManualClock>,
    pub policy: RetryPolicy,
    /// The store's database, dropped after the store.
    home: Home,
}

/// The database of a store.
enum Home {
    Sqlite(tempfile::TempDir),
    Postgres(Box<Postgres>),
}

impl Bench {
    pub async fn sqlite() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let (clock, policy) = Self::time();
        let store = SqliteStore::open(&folder.path().join(FILE), clock.clone(), policy).await.expect("a store");
        Self { store: Box::new(store), clock, policy, home: Home::Sqlite(folder) }
    }

    pub async fn postgres() -> Self {
        let cluster = Postgres::start();
        let (clock, policy) = Self::time();
        let store = PostgresStore::open(&cluster.url(), 10, Some(clock.clone()), policy).await.expect("a store");
        Self { store: Box::new(store), clock, policy, home: Home::Postgres(Box::new(cluster)) }
    }

    fn time() -> (Arc<ManualClock>, RetryPolicy) {
        (Arc::new(ManualClock(AtomicI64::new(1_800_000_000_000))), RetryPolicy::default())
    }

    /// Executes SQL on the database without going through the store.
    pub async fn execute(&self, sqlite: &'static str, postgres: &'static str) {
        match &self.home {
            Home::Sqlite(folder) => {
                let options = SqliteConnectOptions::new().filename(folder.path().join(FILE));
                let mut connection = options.connect().await.expect("the file");
                sqlx::raw_sql(sqlite).execute(&mut connection).await.expect("done");
            }
            Home::Postgres(cluster) => {
                let mut connection = PgConnection::connect(&cluster.url()).await.expect("the server");
                sqlx::raw_sql(postgres).execute(&mut connection).await.expect("done");
            }
        }
    }

    pub fn advance(&self, time: Duration) {
        self.clock.0.fetch_add(i64::try_from(time.as_millis()).expect("short"), Ordering::SeqCst);
    }

    pub async fn submit(&self) -> Job {
        self.submit_of("shop").await
    }

    pub async fn submit_of(&self, tenant: &str) -> Job {
        self.store.submit(Self::job(tenant)).await.expect("accepted")
    }

    pub fn job(tenant: &str) -> NewJob {
        let id = JobId::new(&SystemIds);
        let input = |number: usize| Input {
            key: format!("uploads/{id}/{number}"),
            name: "a.stl".into(),
            bytes: 684,
            sha256: "00".into(),
            format: Format::Stl,
        };
        NewJob::new(id, tenant, vec![input(0), input(1)], JobOptions::default())
    }

    pub async fn claim(&self) -> Option<Claim> {
        self.store.claim("worker", LEASE, u32::MAX).await.expect("a result")
    }

    pub async fn get(&self, id: JobId) -> Job {
        self.store.get(id).await.expect("a result").expect("a job")
    }

    /// The report of a repair that had nothing to do.
    pub fn report() -> JobReport {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let (options, limits) = (Options::default(), Limits::default());
        let result = repair(&files::whole_box(), &options, &limits, None, &context).expect("a result");
        JobReport::Repair(Box::new(result.report))
    }

    pub fn failure(kind: FailureKind) -> Failure {
        let problem = JobProblem { code: ProblemKind::Internal, detail: "why".into(), place: None, file: None };
        Failure { kind, problem, report: None, artifacts: Artifacts::new() }
    }
}

/// Runs each test on each store.
macro_rules! on_each_store {
    ($($name:ident),* $(,)?) => {
        mod sqlite {
            $(#[tokio::test(flavor = "multi_thread")]
            async fn $name() {
                super::$name($crate::support::stores::Bench::sqlite().await).await;
            })*
        }
        mod postgres {
            $(#[tokio::test(flavor = "multi_thread")]
            async fn $name() {
                super::$name($crate::support::stores::Bench::postgres().await).await;
            })*
        }
    };
}
pub(crate) use on_each_store;
