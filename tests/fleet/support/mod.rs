//! Histories on the simulated database.

use std::cell::OnceCell;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use meshmend::context::{Context, NoProgress};
use meshmend::format::Limits;
use meshmend::jobs::{JobReport, RetryPolicy};
use meshmend::repair::{Options, repair};

use crate::database::{CountedIds, Guard, ManualClock, SimDatabase};
use crate::history::{Failed, run, shorten};
use crate::plan::Plan;
use crate::world::Backend;

/// When the fleet's jobs are retried.
pub fn policy() -> RetryPolicy {
    RetryPolicy { longest_delay: Duration::from_secs(20), ..RetryPolicy::default() }
}

/// The report of a repair that had nothing to do.
pub fn report() -> JobReport {
    thread_local!(static REPORT: OnceCell<JobReport> = const { OnceCell::new() });
    REPORT.with(|report| report.get_or_init(new_report).clone())
}

fn new_report() -> JobReport {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let tetrahedron = b"solid t
facet normal 0 0 0 outer loop vertex 0 0 0 vertex 0 1 0 vertex 1 0 0 endloop endfacet
facet normal 0 0 0 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 0 1 endloop endfacet
facet normal 0 0 0 outer loop vertex 0 0 0 vertex 0 0 1 vertex 0 1 0 endloop endfacet
facet normal 0 0 0 outer loop vertex 1 0 0 vertex 0 1 0 vertex 0 0 1 endloop endfacet
endsolid t
";
    let result = repair(tetrahedron, &Options::default(), &Limits::default(), None, &context).expect("a result");
    JobReport::Repair(Box::new(result.report))
}

/// A new simulated database without the guard `missing`.
pub fn simulated(missing: Option<Guard>) -> Backend {
    let (clock, ids) = (Arc::new(ManualClock::default()), Arc::new(CountedIds::default()));
    let database = Arc::new(SimDatabase::new(Arc::clone(&clock), Arc::clone(&ids), policy(), missing));
    let store = Arc::clone(&database);
    let (retry, simulated) = (policy(), Some(database));
    Backend { store, clock, ids, retry, simulated, runtime: None, missing, report: report(), number: 1 }
}

/// Runs the histories of `seeds` without the guard `missing`. Returns the first failure, shortened.
pub fn first_failure(seeds: impl Iterator<Item = u64>, missing: Option<Guard>) -> Option<Failed> {
    for seed in seeds {
        let plan = Plan::of(seed);
        if let Some(violation) = run(&plan, simulated(missing), false).violation {
            return Some(shorten(&plan, &violation, || simulated(missing)));
        }
    }
    None
}
