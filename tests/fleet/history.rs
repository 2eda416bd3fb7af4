//! Runs histories, and shortens those that violate an invariant.

use std::fmt;
use std::rc::Rc;

use super::environment;
use super::plan::{Event, Plan};
use super::witness::Violation;
use super::world::{Backend, World};

/// How long after the last trouble every job must have ended, in simulated milliseconds.
const PATIENCE: u64 = 1_200_000;
/// How many lines of the journal a failure shows.
const SHOWN_LINES: usize = 120;

/// What a history led to.
pub struct Outcome {
    pub violation: Option<Violation>,
    pub journal: Vec<String>,
}

/// Runs a plan on a store.
pub fn run(plan: &Plan, backend: Backend, is_shown: bool) -> Outcome {
    let world = World::new(plan, backend, is_shown);
    environment::start(&world);
    let healed_at = plan.healed_at();
    let is_done = || {
        let witness = world.witness.borrow();
        let is_over = || world.sim.now() >= healed_at && world.busy_clients.get() == 0 && witness.is_quiet();
        witness.violation().is_some() || is_over()
    };
    world.sim.run_until(healed_at + 2 * plan.set_back() + PATIENCE, is_done);
    let find = |id| world.backend.wait(world.backend.store.get(id)).expect("an answer");
    let has_file = |id, token: &str| world.files.borrow().contains(&(id, token.to_owned()));
    if world.witness.borrow().violation().is_none() {
        world.witness.borrow_mut().close(find, has_file);
    }
    let violation = world.witness.borrow().violation().cloned();
    let journal = world.journal_lines();
    world.sim.clear();
    debug_assert_eq!(Rc::strong_count(&world), 1);
    Outcome { violation, journal }
}

/// A history that violates an invariant, shortened.
pub struct Failed {
    pub plan: Plan,
    pub violation: Violation,
    /// How many events the plan of the seed has.
    pub planned: usize,
    journal: Vec<String>,
}

impl fmt::Display for Failed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { plan, violation, planned, journal } = self;
        writeln!(f, "seed {}: {:?} does not hold: {}", plan.seed, violation.invariant, violation.detail)?;
        writeln!(f, "{} of {planned} events are enough, with {} slots per worker:", plan.events.len(), plan.slots)?;
        for event in &plan.events {
            writeln!(f, "  {event:?}")?;
        }
        let skipped = journal.len().saturating_sub(SHOWN_LINES);
        writeln!(f, "what happened ({skipped} earlier lines left out):")?;
        journal.iter().skip(skipped).try_for_each(|line| writeln!(f, "  {line}"))
    }
}

/// Removes events from a failing plan while the same invariant is still violated (Zeller and Hildebrandt, "Simplifying and Isolating
/// Failure-Inducing Input", 2002).
pub fn shorten(plan: &Plan, violation: &Violation, backend: impl Fn() -> Backend) -> Failed {
    let still_fails = |events: &[Event]| {
        let found = run(&plan.with(events.to_vec()), backend(), false).violation;
        found.is_some_and(|found| found.invariant == violation.invariant)
    };
    let mut events = plan.events.clone();
    let mut chunk = events.len().div_ceil(2);
    while chunk > 0 {
        let mut at = 0;
        while at < events.len() {
            let mut fewer = events.clone();
            fewer.drain(at..(at + chunk).min(events.len()));
            if still_fails(&fewer) {
                events = fewer;
            } else {
                at += chunk;
            }
        }
        chunk /= 2;
    }
    let (shortened, planned) = (plan.with(events), plan.events.len());
    let Outcome { violation: found, journal } = run(&shortened, backend(), true);
    Failed { plan: shortened, violation: found.unwrap_or_else(|| violation.clone()), planned, journal }
}
