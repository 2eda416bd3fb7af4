//! The prefix cache: operators that several strategies share at their start run once.
//!
//! The cache saves time and does not affect results. With [`PrefixCache::disabled`] every strategy runs all of its operators, and every
//! result is judged.

use rustc_hash::FxHashMap;

use super::operators::Failure;
use super::operators::split_non_manifold::Pairing;
use super::options::{Operator, Options};
use super::report::{Step, Strategy};
use super::tasks::{SurfaceState, Task, closes_sheets, pairing_and_winding_rule};
use crate::arrange::WindingRule;

/// Most surfaces that are kept, besides the one that every strategy starts from.
const MAX_KEPT: usize = 4;

/// The number of the surface that every strategy starts from.
pub(super) const START: u32 = 0;

/// An operator with those of its parameters that differ between strategies. On the same surface, equal keys give equal results.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct TaskKey {
    operator: Operator,
    pairing: Option<Pairing>,
    winding_rule: Option<WindingRule>,
    closes_sheets: Option<bool>,
}

impl TaskKey {
    /// The operator of a task with its parameters in a strategy; none for a remesh with Blender.
    pub fn of(task: Task, strategy: &Strategy, options: &Options) -> Option<Self> {
        let operator = task.operator?;
        let (pairing, winding_rule) = pairing_and_winding_rule(strategy, options);
        Some(Self {
            operator,
            pairing: (operator == Operator::SplitNonManifold).then_some(pairing),
            winding_rule: matches!(operator, Operator::SelfUnion | Operator::Remesh).then_some(winding_rule),
            closes_sheets: (operator == Operator::SelfUnion).then(|| closes_sheets(strategy)),
        })
    }
}

/// The known results of sequences of operators, each with its parameters ([`TaskKey`]).
///
/// ```text
///    start --stitch--> 1 --repair--> 2 --fill holes--> 3 --self-union--> 4   the first strategy
///                      |                               +--close sheets--> 6  a later one, from the surface kept at 3
///                      +--other repair--> 5
/// ```
///
/// Surfaces have numbers. A surface that an operator does not change keeps its number; a changed surface gets a new one. So two sequences
/// that differ only in operators without effect lead to the same number. A surface is kept as long as a later strategy starts from it: each
/// starts from the surface after the most tasks that it shares with an earlier one.
#[derive(Default)]
pub(super) struct PrefixCache {
    is_disabled: bool,
    known: FxHashMap<(u32, TaskKey), KnownResult>,
    kept: Vec<KeptSurface>,
    /// The last number that was given to a surface.
    last: u32,
}

/// A surface from which later strategies start.
struct KeptSurface {
    number: u32,
    /// The number of tasks that led to the surface.
    tasks: usize,
    state: SurfaceState,
    /// The indices of the strategies that start from the surface.
    strategies: Vec<usize>,
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

    /// Whether the cache remembers nothing.
    pub fn is_disabled(&self) -> bool {
        self.is_disabled
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

    /// Keeps the surface after `tasks` tasks for the strategies with these indices. Drops the surfaces that no strategy needs any more,
    /// and if there are still too many, the one after the fewest tasks.
    pub fn keep(&mut self, number: u32, tasks: usize, state: &SurfaceState, strategies: Vec<usize>) {
        if self.is_disabled || number == START {
            return;
        }
        for kept in self.kept.iter_mut().filter(|kept| kept.tasks <= tasks) {
            kept.strategies.retain(|strategy| kept.number == number || !strategies.contains(strategy));
        }
        match self.kept.iter_mut().find(|kept| kept.number == number) {
            Some(kept) => kept.strategies.extend(strategies),
            None => {
                let mut state = state.clone();
                state.edges = None;
                self.kept.push(KeptSurface { number, tasks, state, strategies });
            }
        }
        self.kept.retain(|kept| !kept.strategies.is_empty());
        if self.kept.len() > MAX_KEPT
            && let Some(nearest) = (0..self.kept.len()).min_by_key(|&at| self.kept[at].tasks)
        {
            self.kept.remove(nearest);
        }
    }

    /// Drops the surfaces from which no strategy after this one starts.
    pub fn drop_before(&mut self, strategy: usize) {
        for kept in &mut self.kept {
            kept.strategies.retain(|&later| later > strategy);
        }
        self.kept.retain(|kept| !kept.strategies.is_empty());
    }

    /// The surface with this number, if it is kept.
    pub fn kept(&self, number: u32) -> Option<&SurfaceState> {
        self.kept.iter().find(|kept| kept.number == number).map(|kept| &kept.state)
    }
}

/// For each later strategy, the number of first tasks that it shares with a strategy, without the first `from` actions, which all share.
pub(super) fn shared_prefixes(strategy: &Strategy, later: &[Strategy], from: usize, options: &Options) -> Vec<usize> {
    let keys = |strategy: &Strategy| -> Vec<Option<TaskKey>> {
        Task::of(strategy, from).into_iter().map(|task| TaskKey::of(task, strategy, options)).collect()
    };
    let own = keys(strategy);
    let shared = |other: &Strategy| own.iter().zip(keys(other)).take_while(|(a, b)| a.is_some() && *a == b).count();
    later.iter().map(shared).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Surface;

    fn kept(cache: &PrefixCache) -> Vec<u32> {
        cache.kept.iter().map(|kept| kept.number).collect()
    }

    #[test]
    fn a_surface_is_kept_until_no_strategy_starts_from_it() {
        let state = SurfaceState::new(Surface::default());
        let mut cache = PrefixCache::default();
        cache.keep(1, 5, &state, vec![1, 3]);
        cache.keep(2, 14, &state, vec![2, 4]);
        assert_eq!(kept(&cache), [1, 2]);
        cache.keep(3, 13, &state, vec![3]);
        cache.drop_before(1);
        assert_eq!(kept(&cache), [2, 3], "strategy 3 starts from the surface after more tasks");
        cache.drop_before(3);
        assert_eq!(kept(&cache), [2]);
    }

    #[test]
    fn of_too_many_surfaces_the_one_after_the_fewest_tasks_is_dropped() {
        let state = SurfaceState::new(Surface::default());
        let mut cache = PrefixCache::default();
        for (number, tasks) in [(1, 9), (2, 7), (3, 12), (4, 8), (5, 10)] {
            cache.keep(number, tasks, &state, vec![number as usize]);
        }
        assert_eq!(kept(&cache), [1, 3, 4, 5]);
    }
}
