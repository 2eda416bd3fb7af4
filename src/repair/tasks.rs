//! What a strategy does, task by task, and the surface between two tasks.

use super::change::ChangeKind;
use super::operators::split_non_manifold::Pairing;
use super::operators::{Counts, Failure};
use super::options::{Operator, Options, WindingRuleChoice};
use super::presets::{remesh_action, tier_of};
use super::red_flags::Invented;
use super::report::{Action, Step, StepStatus, Strategy};
use crate::arrange::{ArrangeError, WindingRule};
use crate::mesh::Surface;

/// A strategy of a plan, and its index in it.
#[derive(Debug, Clone, Copy)]
pub(super) struct IndexedStrategy<'a> {
    pub index: u32,
    pub strategy: &'a Strategy,
}

/// An operator of an action, or the action's remesh.
#[derive(Debug, Clone, Copy)]
pub(super) struct Task {
    pub action: Action,
    pub operator: Option<Operator>,
}

/// An operator with what its parameters follow from, as far as that differs between strategies: on one surface, equal keys have equal
/// results.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Key {
    operator: Operator,
    pairing: Option<Pairing>,
    winding_rule: Option<WindingRule>,
    closes_sheets: Option<bool>,
}

/// The surface between two tasks, and what is known of it.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub surface: Surface,
    /// The counts of the surface, where they are known.
    pub counts: Option<Counts>,
    /// How far operators since the input may have moved a vertex, in the model's unit.
    pub moved: f64,
    /// Holes of solids that stay open, since the options close none so large or so many.
    over_limit: u64,
    /// What was invented before the surface was made anew, which leaves no trace of it.
    pub invented: Option<Invented>,
}

impl State {
    /// Where repairs start.
    pub fn new(surface: Surface) -> Self {
        Self { surface, counts: None, moved: 0.0, over_limit: 0, invented: None }
    }

    /// Notes which holes a step left open, also one that was reused from an earlier strategy.
    pub fn note_holes(&mut self, step: &Step) {
        if step.operator == Some(Operator::FillHoles) {
            self.over_limit =
                step.changed.iter().find(|it| it.kind == ChangeKind::HolesOverLimit).map_or(0, |it| it.count);
        }
    }

    /// Why nothing may close the holes that are open; none where nothing speaks against it.
    pub fn why_left_open(&self) -> Option<String> {
        (self.over_limit > 0).then(|| {
            format!(
                "it would close {} holes that max_hole_edges, max_hole_size or max_holes leaves open",
                self.over_limit
            )
        })
    }
}

impl Task {
    /// What a strategy does, but for `Validate`, in order; its first `from` actions left out.
    pub fn of(strategy: &Strategy, from: usize) -> Vec<Self> {
        let tasks = strategy.actions.get(from..).unwrap_or_default().iter().flat_map(|planned| {
            let remesh = remesh_action(planned.action).map(|_| None);
            let operators = planned.operators.iter().map(|&o| Some(o)).chain(remesh);
            operators.map(|operator| Self { action: planned.action, operator })
        });
        tasks.collect()
    }

    /// Its operator and parameters in a strategy; none for a remesh.
    pub fn key(self, strategy: &Strategy, options: &Options) -> Option<Key> {
        let operator = self.operator?;
        let (pairing, winding_rule) = ways_of(strategy, options);
        Some(Key {
            operator,
            pairing: (operator == Operator::SplitNonManifold).then_some(pairing),
            winding_rule: matches!(operator, Operator::SelfUnion | Operator::Remesh).then_some(winding_rule),
            closes_sheets: (operator == Operator::SelfUnion).then(|| closes_sheets(strategy)),
        })
    }
}

/// The two ways of `auto` differ in how faces are paired around edges, and in what is turned inside out: one keeps it, the
/// other drops it, unless the options say what is inside.
pub(super) fn ways_of(strategy: &Strategy, options: &Options) -> (Pairing, WindingRule) {
    let mends = strategy.actions.iter().any(|planned| planned.action == Action::FullRepair);
    let (pairing, winding_rule) =
        if mends { (Pairing::Angular, WindingRule::Nonzero) } else { (Pairing::FinsLast, WindingRule::Positive) };
    let winding_rule = match options.winding_rule {
        WindingRuleChoice::Auto => winding_rule,
        WindingRuleChoice::Positive => WindingRule::Positive,
        WindingRuleChoice::Nonzero => WindingRule::Nonzero,
        WindingRuleChoice::Odd => WindingRule::Odd,
    };
    (pairing, winding_rule)
}

/// Whether a strategy takes parts that are inside out for solid.
pub(super) fn takes_inverted_for_solid(strategy: &Strategy, options: &Options) -> bool {
    ways_of(strategy, options).1 != WindingRule::Positive
}

/// Whether a strategy makes open sheets solid.
pub(super) fn closes_sheets(strategy: &Strategy) -> bool {
    strategy.actions.iter().any(|planned| planned.action == Action::CloseSheets)
}

/// A step, and whether its note is its own.
pub(super) struct ExecutedStep {
    pub step: Step,
    /// Whether its result was reused, and its note says only that.
    pub has_reuse_note: bool,
}

/// The note of a step that was not run again, where it has none of its own.
const REUSED: &str = "its result was taken over from an earlier strategy";

impl ExecutedStep {
    /// A step of an earlier strategy of which the result is reused by a later one, as part of an action of that.
    pub fn reused(step: &Step, strategy: u32, action: Action) -> Self {
        let note = Some(step.note.clone().unwrap_or_else(|| REUSED.to_owned()));
        let reused = Step { strategy, action, tier: tier_of(action), milliseconds: 0.0, note, ..step.clone() };
        Self { step: reused, has_reuse_note: step.note.is_none() }
    }
}

impl From<Step> for ExecutedStep {
    fn from(step: Step) -> Self {
        Self { step, has_reuse_note: false }
    }
}

/// What is known of faces that intersect, on a strategy's way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Crossings {
    Unknown,
    /// Nothing changed since they were resolved, as far as they could be.
    Resolved,
    /// They could not be resolved, and nothing but sheets that were moved apart by a hair changed since.
    Given,
}

impl Crossings {
    pub fn after(self, step: &Step, failure: Option<&Failure>) -> Self {
        match step.operator {
            Some(Operator::SelfUnion) => {
                let failed = step.status == StepStatus::Failed;
                // Sheets that are cut apart may be closed.
                let open = matches!(failure, Some(Failure::Arrange(ArrangeError::NotClosed(_))));
                if failed && !open { Self::Given } else { Self::Resolved }
            }
            Some(Operator::Perturb) if self == Self::Given => self,
            _ if step.changed.is_empty() => self,
            _ => Self::Unknown,
        }
    }

    /// Whether a task can be left out.
    pub fn make_needless(self, task: Task) -> bool {
        self != Self::Unknown && task.operator == Some(Operator::SelfUnion)
    }
}
