//! The same histories on the real stores. Each answer must be that of the simulated database, which shows that it is a true model.

use std::rc::Rc;
use std::sync::Arc;

use meshmend::jobs::{PostgresStore, SqliteStore};
use tokio::runtime::{Builder, Runtime};

use crate::database::{CountedIds, ManualClock};
use crate::history::run;
use crate::plan::Plan;
use crate::postgres::Postgres;
use crate::request::FleetStore;
use crate::support::{policy, report, simulated};
use crate::world::Backend;

/// How many histories `make test` runs on each store.
const HISTORIES: u64 = 12;

fn runtime() -> Rc<Runtime> {
    Rc::new(Builder::new_current_thread().enable_all().build().expect("a runtime"))
}

fn real(runtime: Rc<Runtime>, open: impl FnOnce(Arc<ManualClock>, Arc<CountedIds>) -> Arc<dyn FleetStore>) -> Backend {
    let (clock, ids) = (Arc::new(ManualClock::default()), Arc::new(CountedIds::default()));
    let store = open(Arc::clone(&clock), Arc::clone(&ids));
    let (retry, runtime) = (policy(), Some(runtime));
    Backend { store, clock, ids, retry, simulated: None, runtime, missing: None, report: report(), number: 1 }
}

/// Runs histories on a real store and on the simulated database.
fn compare(backend: &Backend) {
    let count = std::env::var("FLEET_STORE_HISTORIES").map_or(HISTORIES, |count| count.parse().expect("a number"));
    for seed in 0..count {
        let (plan, number) = (Plan::of(seed).without_crashes(), seed + 1);
        let real = run(&plan, Backend { number, ..backend.clone() }, true);
        let journal = real.journal.join("\n");
        assert!(real.violation.is_none(), "seed {seed}: {:?}\n{plan:?}\n{journal}", real.violation);
        let model = run(&plan, Backend { number, ..simulated(None) }, true);
        let differs = real.journal.iter().zip(&model.journal).position(|(real, model)| real != model);
        if let Some(line) = differs {
            let before = real.journal[..line].join("\n");
            panic!("seed {seed}: {before}\nreal:  {}\nmodel: {}", real.journal[line], model.journal[line]);
        }
        assert_eq!(real.journal.len(), model.journal.len(), "seed {seed}");
    }
}

#[test]
fn sqlite_answers_as_the_simulated_database_does() {
    let (folder, runtime) = (tempfile::tempdir().expect("a folder"), runtime());
    let path = folder.path().join("jobs.db");
    let open = |clock: Arc<ManualClock>, ids: Arc<CountedIds>| {
        let store = runtime.block_on(SqliteStore::open(&path, clock, policy())).expect("a store");
        Arc::new(store.with_ids(ids)) as Arc<dyn FleetStore>
    };
    compare(&real(Rc::clone(&runtime), open));
}

#[test]
fn postgresql_answers_as_the_simulated_database_does() {
    let (cluster, runtime) = (Postgres::start(), runtime());
    let open = |clock: Arc<ManualClock>, ids: Arc<CountedIds>| {
        let store = runtime.block_on(PostgresStore::open(&cluster.url(), 4, Some(clock), policy())).expect("a store");
        Arc::new(store.with_ids(ids)) as Arc<dyn FleetStore>
    };
    compare(&real(Rc::clone(&runtime), open));
}
