//! Histories on the simulated database.

use crate::database::Guard;
use crate::history::run;
use crate::plan::Plan;
use crate::support::{first_failure, simulated};

/// How many histories `make test` runs; `make simulate` runs 100,000.
const HISTORIES: u64 = 1_000;

#[test]
fn the_protocol_keeps_its_invariants_in_every_simulated_history() {
    let count = std::env::var("FLEET_HISTORIES").map_or(HISTORIES, |count| count.parse().expect("a number"));
    let first = std::env::var("FLEET_SEED").map_or(0, |seed| seed.parse().expect("a number"));
    let failed = first_failure(first..first + count, None);
    assert!(failed.is_none(), "{}", failed.expect("a failure"));
}

#[test]
fn a_seed_gives_the_same_history_each_time() {
    for seed in 0..20 {
        let plan = Plan::of(seed);
        let [first, second] = [0, 1].map(|_| run(&plan, simulated(None), true).journal);
        assert!(first.len() > 5, "seed {seed}: {first:?}");
        assert_eq!(first, second, "seed {seed}");
    }
}

#[test]
fn a_failure_prints_its_seed_and_fewer_events_than_its_plan_has() {
    let failed = first_failure(0..1_000, Some(Guard::CompletionIsFenced)).expect("a failure");
    let text = failed.to_string();
    assert!(text.contains(&format!("seed {}: NoStaleWriteLands", failed.plan.seed)), "{text}");
    assert!(failed.plan.events.len() < failed.planned, "{text}");
    let again = run(&failed.plan, simulated(Some(Guard::CompletionIsFenced)), false).violation;
    assert_eq!(again, Some(failed.violation), "{text}");
}
