//! What strategies have in common is run once: the cache of what sequences of operators make of the shared opening's surface.
//!
//! Nothing but time depends on it. [`PrefixCache::disabled`] remembers nothing, and every strategy then runs all of its operators.

use rustc_hash::FxHashMap;

use super::operators::Failure;
use super::options::Options;
use super::report::{Step, Strategy};
use super::tasks::{Key, State, Task};

/// Surfaces that are kept, beside the one that every strategy starts from.
const MOST_KEPT: usize = 4;

/// The surface that every strategy starts from, as a number.
pub(super) const START: u32 = 0;

/// What sequences of operators, each with its parameters ([`Key`]), made so far.
///
/// ```text
///    start --stitch--> 1 --mend--> 2 --fill holes--> 3 --resolve--> 4      the first strategy
///                      |                             +--close sheets--> 6  a later one, from the surface that is kept at 3
///                      +--mend otherwise--> 5
/// ```
///
/// Surfaces have numbers: what an operator leaves as it is keeps its number, and what it changes gets a new one. So two sequences that
/// differ only in operators without effect come to the same number. The surfaces themselves are kept only where later strategies turn off,
/// and of those the ones farthest on, which saves most.
#[derive(Default)]
pub(super) struct PrefixCache {
    is_disabled: bool,
    known: FxHashMap<(u32, Key), Known>,
    /// With the number of each, and how many tasks led there.
    kept: Vec<(u32, usize, State)>,
    last: u32,
}

/// What an operator made of a surface.
#[derive(Clone)]
pub(super) struct Known {
    /// The number of what it made.
    pub surface: u32,
    pub step: Step,
    /// Why it did nothing, where it should have.
    pub failure: Option<Failure>,
}

impl PrefixCache {
    /// A cache that remembers nothing.
    pub fn disabled() -> Self {
        Self { is_disabled: true, ..Self::default() }
    }

    /// What an operator makes of a surface, if it ran on it before.
    pub fn known(&self, surface: u32, key: Key) -> Option<&Known> {
        self.known.get(&(surface, key))
    }

    /// A number for a surface of which nothing else is known.
    pub fn new_number(&mut self) -> u32 {
        self.last += 1;
        self.last
    }

    /// Remembers what an operator made of a surface. Answers the number of what it made.
    pub fn learn(
        &mut self,
        surface: u32,
        key: Key,
        has_changed: bool,
        (step, failure): (&Step, Option<&Failure>),
    ) -> u32 {
        if let Some(known) = self.known(surface, key) {
            return known.surface;
        }
        let made = if has_changed { self.new_number() } else { surface };
        if !self.is_disabled {
            let known = Known { surface: made, step: step.clone(), failure: failure.cloned() };
            self.known.insert((surface, key), known);
        }
        made
    }

    /// Keeps a surface, to which so many tasks led.
    pub fn keep(&mut self, surface: u32, tasks: usize, state: &State) {
        if self.is_disabled || surface == START || self.kept(surface).is_some() {
            return;
        }
        self.kept.push((surface, tasks, state.clone()));
        if self.kept.len() > MOST_KEPT
            && let Some(nearest) = (0..self.kept.len()).min_by_key(|&at| self.kept[at].1)
        {
            self.kept.remove(nearest);
        }
    }

    /// A surface, where it is kept.
    pub fn kept(&self, surface: u32) -> Option<&State> {
        self.kept.iter().find(|&&(number, ..)| number == surface).map(|(.., state)| state)
    }
}

/// How many of a strategy's first tasks each later strategy has in common with it; the first `from` actions, which all share, left out.
pub(super) fn shared_prefixes(strategy: &Strategy, later: &[Strategy], from: usize, options: &Options) -> Vec<usize> {
    let keys = |strategy: &Strategy| -> Vec<Option<Key>> {
        Task::of(strategy, from).into_iter().map(|task| task.key(strategy, options)).collect()
    };
    let own = keys(strategy);
    let shared = |other: &Strategy| own.iter().zip(keys(other)).take_while(|(a, b)| a.is_some() && *a == b).count();
    later.iter().map(shared).collect()
}
