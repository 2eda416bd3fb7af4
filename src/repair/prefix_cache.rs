//! The prefix cache: operators that several strategies share at their start run once.
//!
//! The cache saves time and does not affect results. With [`PrefixCache::disabled`] every strategy runs all of its operators.

use rustc_hash::FxHashMap;

use super::operators::Failure;
use super::options::Options;
use super::report::{Step, Strategy};
use super::tasks::{SurfaceState, Task, TaskKey};

/// Most surfaces that are kept, besides the one that every strategy starts from.
const MAX_KEPT: usize = 4;

/// The number of the surface that every strategy starts from.
pub(super) const START: u32 = 0;

/// The known results of sequences of operators, each with its parameters ([`TaskKey`]).
///
/// ```text
///    start --stitch--> 1 --repair--> 2 --fill holes--> 3 --self-union--> 4   the first strategy
///                      |                               +--close sheets--> 6  a later one, from the surface kept at 3
///                      +--other repair--> 5
/// ```
///
/// Surfaces have numbers. A surface that an operator does not change keeps its number; a changed surface gets a new one. So two sequences
/// that differ only in operators without effect lead to the same number. Surfaces are kept only where a later strategy branches off, and
/// of those the ones after the most tasks, which save the most time.
#[derive(Default)]
pub(super) struct PrefixCache {
    is_disabled: bool,
    known: FxHashMap<(u32, TaskKey), KnownResult>,
    /// The kept surfaces, each with its number and the number of tasks that led to it.
    kept: Vec<(u32, usize, SurfaceState)>,
    /// The last number that was given to a surface.
    last: u32,
}

/// The known result of an operator on a surface.
#[derive(Clone)]
pub(super) struct KnownResult {
    /// The number of the resulting surface.
    pub surface: u32,
    /// The operator's step.
    pub step: Step,
    /// Why the operator could not do its work.
    pub failure: Option<Failure>,
}

impl PrefixCache {
    /// Makes a cache that remembers nothing.
    pub fn disabled() -> Self {
        Self { is_disabled: true, ..Self::default() }
    }

    /// The result of an operator on a surface, if it ran on this surface before.
    pub fn known(&self, surface: u32, key: TaskKey) -> Option<&KnownResult> {
        self.known.get(&(surface, key))
    }

    /// A new number for a surface.
    pub fn new_number(&mut self) -> u32 {
        self.last += 1;
        self.last
    }

    /// Remembers the result of an operator on a surface. Returns the number of the resulting surface.
    pub fn learn(
        &mut self,
        surface: u32,
        key: TaskKey,
        has_changed: bool,
        (step, failure): (&Step, Option<&Failure>),
    ) -> u32 {
        if let Some(known) = self.known(surface, key) {
            return known.surface;
        }
        let result = if has_changed { self.new_number() } else { surface };
        if !self.is_disabled {
            let known = KnownResult { surface: result, step: step.clone(), failure: failure.cloned() };
            self.known.insert((surface, key), known);
        }
        result
    }

    /// Keeps the surface after `tasks` tasks. If there are too many surfaces, the one after the fewest tasks is dropped.
    pub fn keep(&mut self, surface: u32, tasks: usize, state: &SurfaceState) {
        if self.is_disabled || surface == START || self.kept(surface).is_some() {
            return;
        }
        self.kept.push((surface, tasks, state.clone()));
        if self.kept.len() > MAX_KEPT
            && let Some(nearest) = (0..self.kept.len()).min_by_key(|&at| self.kept[at].1)
        {
            self.kept.remove(nearest);
        }
    }

    /// The surface with this number, if it is kept.
    pub fn kept(&self, surface: u32) -> Option<&SurfaceState> {
        self.kept.iter().find(|&&(number, ..)| number == surface).map(|(.., state)| state)
    }
}

/// For each later strategy, the number of first tasks that it shares with a strategy, without the first `from` actions, which all share.
pub(super) fn shared_prefixes(strategy: &Strategy, later: &[Strategy], from: usize, options: &Options) -> Vec<usize> {
    let keys = |strategy: &Strategy| -> Vec<Option<TaskKey>> {
        Task::of(strategy, from).into_iter().map(|task| task.key(strategy, options)).collect()
    };
    let own = keys(strategy);
    let shared = |other: &Strategy| own.iter().zip(keys(other)).take_while(|(a, b)| a.is_some() && *a == b).count();
    later.iter().map(shared).collect()
}
