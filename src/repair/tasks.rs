//! The tasks of a strategy, and the surface between two tasks.

use std::sync::Arc;

use super::change::ChangeKind;
use super::operators::sheets::{open_sheet_share, open_sheet_share_with};
use super::operators::split_non_manifold::Pairing;
use super::operators::{Counts, Failure};
use super::options::{Operator, Options, WindingRuleChoice};
use super::part_accounting::IntendedChanges;
use super::presets::{remesh_action, tier_of};
use super::red_flags::AddedSurface;
use super::report::{Action, Step, StepStatus, Strategy};
use crate::arrange::{ArrangeError, WindingRule};
use crate::inspect::SearchedMesh;
use crate::mesh::{Edges, Surface};

/// A strategy with its index in the plan.
#[derive(Debug, Clone, Copy)]
pub(super) struct IndexedStrategy<'a> {
    /// Index in the plan.
    pub index: u32,
    /// The strategy.
    pub strategy: &'a Strategy,
}

/// One operator of an action, or the remesh with Blender that the action stands for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Task {
    /// The action.
    pub action: Action,
    /// The operator; none for a remesh with Blender.
    pub operator: Option<Operator>,
}

/// The surface between two tasks, with its known properties.
#[derive(Debug, Clone)]
pub(super) struct SurfaceState {
    /// The surface. States that did not change it share it.
    pub surface: Arc<Surface>,
    /// The counts of the surface's defects; none if unknown.
    pub counts: Option<Counts>,
    /// The edges of the surface; none if unknown.
    pub edges: Option<Arc<Edges>>,
    /// Upper bound on the distance that any vertex has moved from the input, in the model's unit.
    pub moved: f64,
    /// Number of holes of solids that stay open because they exceed the options' limits.
    over_limit: u64,
    /// The changes to what is solid that were made on purpose.
    pub intended: IntendedChanges,
    /// The surface before the first change to a sound model that the options ask for, such as thicker walls; none before such a change.
    pub before_requests: Option<Arc<Surface>>,
    /// A mesh with most faces of the surface that was searched for intersecting faces.
    pub searched: Option<Arc<SearchedMesh>>,
    /// The surface added before a remesh, which the remeshed faces no longer show.
    pub added_surface: Option<AddedSurface>,
}

impl SurfaceState {
    /// Makes the state at the start of a repair.
    pub fn new(surface: Surface) -> Self {
        Self {
            surface: Arc::new(surface),
            counts: None,
            edges: None,
            moved: 0.0,
            over_limit: 0,
            intended: IntendedChanges::default(),
            before_requests: None,
            searched: None,
            added_surface: None,
        }
    }

    /// The edges of the surface.
    pub fn edges(&mut self) -> Arc<Edges> {
        Arc::clone(self.edges.get_or_insert_with(|| Arc::new(Edges::new(&self.surface.faces))))
    }

    /// The counts of the surface's defects.
    pub fn counts(&mut self) -> Counts {
        match self.counts {
            Some(counts) => counts,
            None => {
                let edges = self.edges();
                let counts = Counts::with_edges(&self.surface, &edges);
                *self.counts.insert(counts)
            }
        }
    }

    /// Completes a change of the surface by an operator: counts the defects, and restores the surface that was `kept` if a count has risen
    /// that the operator promises not to raise. Returns why it was restored.
    pub fn complete_change(&mut self, operator: Operator, before: &Counts, kept: Arc<Surface>) -> Option<String> {
        let changed = Arc::make_mut(&mut self.surface);
        changed.drop_unreferenced();
        changed.shrink_to_fit();
        // The old edges are dropped before the new ones need memory.
        self.edges = None;
        let edges = Edges::new(&changed.faces);
        let after = Counts::with_edges(changed, &edges);
        if let Some((counter, was, is)) = operator.broken_claim(before, &after) {
            self.surface = kept;
            let counter = counter.in_words();
            return Some(format!("undone because the count of {counter} would have grown from {was} to {is}"));
        }
        (self.counts, self.edges) = (Some(after), Some(Arc::new(edges)));
        self.intended.is_interior_filled |= operator == Operator::FillInterior;
        self.intended.are_islands_treated |= operator == Operator::TreatIslands;
        if operator.changes_sound_model() && self.before_requests.is_none() {
            self.before_requests = Some(kept);
        }
        None
    }

    /// Share of the area in open sheets, from 0 to 1.
    pub fn open_sheet_share(&self) -> f64 {
        match &self.edges {
            Some(edges) => open_sheet_share_with(&self.surface, edges),
            None => open_sheet_share(&self.surface),
        }
    }

    /// Records the holes that a step left open, including a step reused from an earlier strategy.
    pub fn record_holes(&mut self, step: &Step) {
        if step.operator == Some(Operator::FillHoles) {
            self.over_limit =
                step.changed.iter().find(|change| change.kind == ChangeKind::HolesOverLimit).map_or(0, |c| c.count);
        }
    }

    /// Why a remesh must not run: it would close holes that the options leave open. None if there are no such holes.
    pub fn why_no_remesh(&self) -> Option<String> {
        (self.over_limit > 0).then(|| {
            format!(
                "a remesh would close {} holes that `max_hole_edges`, `max_hole_size` or `max_holes` keeps open",
                self.over_limit
            )
        })
    }
}

impl Task {
    /// The tasks of a strategy in order, without its first `from` actions and without validation.
    pub fn of(strategy: &Strategy, from: usize) -> Vec<Self> {
        let tasks = strategy.actions.get(from..).unwrap_or_default().iter().flat_map(|planned| {
            let remesh = remesh_action(planned.action).map(|_| None);
            let operators = planned.operators.iter().map(|&o| Some(o)).chain(remesh);
            operators.map(|operator| Self { action: planned.action, operator })
        });
        tasks.collect()
    }
}

/// How a strategy pairs faces around non-manifold edges, and its winding rule.
///
/// The two main strategies of `auto` differ in both: a full repair counts inverted parts as solid, the others do not. The option
/// `winding_rule` overrides the rule.
pub(super) fn pairing_and_winding_rule(strategy: &Strategy, options: &Options) -> (Pairing, WindingRule) {
    let is_full_repair = strategy.actions.iter().any(|planned| planned.action == Action::FullRepair);
    let (pairing, winding_rule) = if is_full_repair {
        (Pairing::Angular, WindingRule::Nonzero)
    } else {
        (Pairing::FinsLast, WindingRule::Positive)
    };
    let winding_rule = match options.winding_rule {
        WindingRuleChoice::Auto => winding_rule,
        WindingRuleChoice::Positive => WindingRule::Positive,
        WindingRuleChoice::Nonzero => WindingRule::Nonzero,
        WindingRuleChoice::Odd => WindingRule::Odd,
    };
    (pairing, winding_rule)
}

/// Whether a strategy counts parts that are inside out as solid.
pub(super) fn counts_inverted_as_solid(strategy: &Strategy, options: &Options) -> bool {
    pairing_and_winding_rule(strategy, options).1 != WindingRule::Positive
}

/// Whether a strategy turns open sheets into solids.
pub(super) fn closes_sheets(strategy: &Strategy) -> bool {
    strategy.actions.iter().any(|planned| planned.action == Action::CloseSheets)
}

/// A step of a strategy, run or reused.
pub(super) struct ExecutedStep {
    /// The step for the report.
    pub step: Step,
    /// Whether the step was reused and its note says nothing else.
    pub has_reuse_note: bool,
}

/// The note of a reused step without its own note.
const REUSED: &str = "reused from an earlier strategy";

impl ExecutedStep {
    /// Makes the step of a strategy that reuses a step of an earlier strategy, as part of `action`.
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

/// The state of intersecting faces between two tasks of a strategy.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Intersections {
    /// Unknown: the surface changed since the last self-union.
    Unknown,
    /// The surface is unchanged since the last self-union, which resolved the intersections as far as possible.
    Resolved,
    /// The self-union failed, and since then only coincident vertices were moved apart.
    Unresolvable,
}

impl Intersections {
    /// The state after a step.
    pub fn after(self, step: &Step, failure: Option<&Failure>) -> Self {
        match step.operator {
            Some(Operator::SelfUnion) => {
                let failed = step.status == StepStatus::Failed;
                // An open surface may still be closed by a later task.
                let is_open = matches!(failure, Some(Failure::Arrange(ArrangeError::NotClosed(_))));
                if failed && !is_open { Self::Unresolvable } else { Self::Resolved }
            }
            Some(Operator::Perturb) if self == Self::Unresolvable => self,
            _ if step.changed.is_empty() => self,
            _ => Self::Unknown,
        }
    }

    /// Whether a task is a self-union that would change nothing.
    pub fn makes_needless(self, task: Task) -> bool {
        self != Self::Unknown && task.operator == Some(Operator::SelfUnion)
    }
}
