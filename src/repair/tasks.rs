//! What a strategy does, task by task, and the surface between two tasks.

use super::change::ChangeKind;
use super::operators::split_non_manifold::Pairing;
use super::operators::{Counts, Failure};
use super::options::{InsideRule, Operator, Options};
use super::presets::{remesh_action, tier_of};
use super::red_flags::Invented;
use super::report::{Action, Rung, Step, StepStatus};
use crate::arrange::{ArrangeError, Inside};
use crate::mesh::Surface;

/// A strategy of a plan, and its index in it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Strategy<'a> {
    pub index: u32,
    pub rung: &'a Rung,
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
    inside: Option<Inside>,
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
                step.changed.iter().find(|it| it.what == ChangeKind::HolesOverLimit).map_or(0, |it| it.count);
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
    pub fn of(rung: &Rung, from: usize) -> Vec<Self> {
        let tasks = rung.actions.get(from..).unwrap_or_default().iter().flat_map(|planned| {
            let remesh = remesh_action(planned.action).map(|_| None);
            let operators = planned.operators.iter().map(|&o| Some(o)).chain(remesh);
            operators.map(|operator| Self { action: planned.action, operator })
        });
        tasks.collect()
    }

    /// Its operator and parameters in a strategy; none for a remesh.
    pub fn key(self, rung: &Rung, options: &Options) -> Option<Key> {
        let operator = self.operator?;
        let (pairing, inside) = ways_of(rung, options);
        Some(Key {
            operator,
            pairing: (operator == Operator::CutApart).then_some(pairing),
            inside: matches!(operator, Operator::Resolve | Operator::Remesh).then_some(inside),
            closes_sheets: (operator == Operator::Resolve).then(|| closes_sheets(rung)),
        })
    }
}

/// The two ways of `auto` differ in how faces are paired around edges, and in what is turned inside out: one keeps it, the
/// other drops it, unless the options say what is inside.
pub(super) fn ways_of(rung: &Rung, options: &Options) -> (Pairing, Inside) {
    let mends = rung.actions.iter().any(|planned| planned.action == Action::Mend);
    let (pairing, inside) =
        if mends { (Pairing::Angular, Inside::Nonzero) } else { (Pairing::FinsLast, Inside::Positive) };
    let inside = match options.inside {
        InsideRule::Auto => inside,
        InsideRule::Positive => Inside::Positive,
        InsideRule::Nonzero => Inside::Nonzero,
        InsideRule::Odd => Inside::Odd,
    };
    (pairing, inside)
}

/// Whether a strategy takes parts that are inside out for solid.
pub(super) fn takes_inverted_for_solid(rung: &Rung, options: &Options) -> bool {
    ways_of(rung, options).1 != Inside::Positive
}

/// Whether a strategy makes open sheets solid.
pub(super) fn closes_sheets(rung: &Rung) -> bool {
    rung.actions.iter().any(|planned| planned.action == Action::CloseSheets)
}

/// A step, and whether its note is its own.
pub(super) struct ExecutedStep {
    pub step: Step,
    /// Whether its result was reused, and its note says only that.
    pub has_reuse_note: bool,
}

/// The note of a step that was not run again, where it has none of its own.
const REUSED: &str = "its result was taken over from an earlier rung";

impl ExecutedStep {
    /// A step of an earlier strategy of which the result is reused by a later one, as part of an action of that.
    pub fn reused(step: &Step, rung: u32, action: Action) -> Self {
        let note = Some(step.note.clone().unwrap_or_else(|| REUSED.to_owned()));
        let reused = Step { rung, action, tier: tier_of(action), milliseconds: 0.0, note, ..step.clone() };
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
            Some(Operator::Resolve) => {
                let failed = step.status == StepStatus::Failed;
                // Sheets that are cut apart may be closed.
                let open = matches!(failure, Some(Failure::Arrange(ArrangeError::NotClosed(_))));
                if failed && !open { Self::Given } else { Self::Resolved }
            }
            Some(Operator::Separate) if self == Self::Given => self,
            _ if step.changed.is_empty() => self,
            _ => Self::Unknown,
        }
    }

    /// Whether a task can be left out.
    pub fn make_needless(self, task: Task) -> bool {
        self != Self::Unknown && task.operator == Some(Operator::Resolve)
    }
}
