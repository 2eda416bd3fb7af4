//! Options that were set but not followed, or followed only in part, with the reasons.
//!
//! [`RULES`] names for each option how its effect is checked: most options act through operators, whose steps show whether they changed
//! anything.

use serde_json::Value;

use super::options::{Interior, Islands, Merge, OpenSheets, Operator, Options, Overlaps, Preset, Voids};
use super::presets::remesh_action;
use super::report::{NotAppliedCause, OptionNotApplied, SkipReason, Step, StepStatus};
use super::tasks::ExecutedStep;

/// How to check whether an option had an effect.
#[derive(Debug, Clone, Copy)]
enum Rule {
    /// The option acts through these operators. The text is the reason if they find nothing to do.
    Operators(OperatorRule, &'static [Operator], &'static str),
    /// The option acts through a remesh.
    Remesh,
    /// The option is always followed, such as a limit.
    Always,
    /// The option has a rule that no other option has.
    Special(SpecialRule),
}

/// Exceptions for options that act through operators.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum OperatorRule {
    /// No exception.
    Plain,
    /// The option refines another one, which gives the reason if nothing was done.
    Refines,
    WeldTolerance,
    StitchThreshold,
    StitchEpsilon,
    DegenerateTolerance,
    OpenSheets,
    Thickness,
    Voids,
    MinWall,
}

/// The options with their own rules.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SpecialRule {
    Preset,
    Category,
    Merge,
    With,
    OverlapAngle,
    Overlaps,
    MaxHoleSize,
    MaxHoles,
    Interior,
    Islands,
}

/// Every option with its rule, in the order of [`Options`].
const RULES: &[(&str, Rule)] = {
    use Operator as O;
    use Rule::{Always, Operators, Remesh};
    &[
        ("preset", Rule::Special(SpecialRule::Preset)),
        ("category", Rule::Special(SpecialRule::Category)),
        ("output", Always),
        ("merge", Rule::Special(SpecialRule::Merge)),
        ("require", Always),
        ("verify", Always),
        ("unit", Always),
        ("scale_to", Always),
        ("with", Rule::Special(SpecialRule::With)),
        ("without", Always),
        ("max_deviation", Always),
        ("max_faces", Always),
        ("max_error", Operators(OperatorRule::Plain, &[O::Simplify], "no face could be removed within this distance")),
        ("max_tier", Always),
        ("deadline_s", Always),
        ("max_face_loss_pct", Always),
        ("max_vertex_loss_pct", Always),
        ("max_bounding_box_change_pct", Always),
        ("max_volume_change_pct", Always),
        ("max_surface_lost_pct", Always),
        ("max_surface_added_pct", Always),
        ("weld_tolerance", Operators(OperatorRule::WeldTolerance, &[O::Weld], "no boundary vertices are this close")),
        ("merge_distance", Operators(OperatorRule::Plain, &[O::MergeVertices], "no vertices are this close")),
        ("sew_ratio", Operators(OperatorRule::Plain, &[O::Sew], "no boundary vertices are this close")),
        ("stitch_threshold", Operators(OperatorRule::StitchThreshold, &[O::Stitch], "no crack is this narrow")),
        ("stitch_distance", Operators(OperatorRule::Plain, &[O::Stitch], "no crack is this narrow")),
        ("stitch_epsilon", Operators(OperatorRule::StitchEpsilon, &[O::Stitch], "no crack was stitched")),
        ("stitch_position", Operators(OperatorRule::Plain, &[O::Stitch], "no crack was stitched")),
        (
            "degenerate_tolerance",
            Operators(
                OperatorRule::DegenerateTolerance,
                &[O::RemoveSlivers, O::UnfoldFoldovers],
                "no edge is shorter and no face has less height",
            ),
        ),
        ("overlap_angle_deg", Rule::Special(SpecialRule::OverlapAngle)),
        ("twist_angle_deg", Always),
        ("max_hole_edges", Always),
        ("min_part_volume_pct", Operators(OperatorRule::Plain, &[O::DropSmallParts], "no closed part is smaller")),
        ("nested", Operators(OperatorRule::Plain, &[O::Orient], "no part had to be reoriented")),
        ("overlaps", Rule::Special(SpecialRule::Overlaps)),
        (
            "winding_rule",
            Operators(
                OperatorRule::Plain,
                &[O::SelfUnion, O::Remesh],
                "no faces intersect, and every solid already follows this rule",
            ),
        ),
        (
            "open_sheets",
            Operators(OperatorRule::OpenSheets, &[O::ThickenSheets, O::AddBase], "the model has no open sheet"),
        ),
        (
            "thickness",
            Operators(
                OperatorRule::Thickness,
                &[O::ThickenSheets, O::AddBase, O::SelfUnion],
                "no surface was thickened",
            ),
        ),
        ("max_hole_size", Rule::Special(SpecialRule::MaxHoleSize)),
        ("max_holes", Rule::Special(SpecialRule::MaxHoles)),
        ("hole_filling", Operators(OperatorRule::Plain, &[O::FillHoles], "no hole was closed")),
        ("refine_patches", Operators(OperatorRule::Plain, &[O::FillHoles], "no hole was closed")),
        ("fair_patches", Operators(OperatorRule::Plain, &[O::FillHoles], "no hole was closed")),
        ("voxel_size", Remesh),
        ("voxel_resolution", Remesh),
        ("max_remesh_faces", Remesh),
        ("pictures", Always),
        ("alternatives", Always),
        ("process", Always),
        ("process_limits", Always),
        ("min_wall", Operators(OperatorRule::MinWall, &[O::ThickenWalls], "no wall is thinner than the limit")),
        (
            "thicken_to_process",
            Operators(OperatorRule::MinWall, &[O::ThickenWalls], "no wall is thinner than the limit"),
        ),
        ("wall_growth", Operators(OperatorRule::Refines, &[O::ThickenWalls], "no wall was thickened")),
        ("interior", Rule::Special(SpecialRule::Interior)),
        ("seal_mm", Operators(OperatorRule::Plain, &[O::FillInterior], "the interior was not filled")),
        ("islands", Rule::Special(SpecialRule::Islands)),
        ("voids", Operators(OperatorRule::Voids, &[O::FillVoids, O::VentVoids], "the model has no sealed cavity")),
        (
            "keep_cavities_over_mm3",
            Operators(OperatorRule::Plain, &[O::FillVoids], "no sealed cavity is small enough to be filled"),
        ),
        ("vent_diameter_mm", Operators(OperatorRule::Refines, &[O::VentVoids], "no cavity was vented")),
        ("target_height_mm", Always),
        ("target_longest_mm", Always),
    ]
};

/// The names of all options that have a rule here, in the order of [`Options`]. A test checks that no option is missing.
#[must_use]
pub fn options_accounted_for() -> Vec<&'static str> {
    RULES.iter().map(|(name, _)| *name).collect()
}

/// The ending of a repair, which decides whether its options had an effect.
pub(super) enum Ending<'a> {
    /// The input meets all that the options ask for; no strategy ran.
    Untouched,
    /// The input is returned because the best result is worse, for the reason `why`, or because there is no result.
    InputKept { best: Option<u32>, why: &'a str },
    /// The input is returned because the strategies did not change it.
    Unchanged { strategy: u32, preset: Preset },
    /// The result of a strategy is returned.
    Result { strategy: u32, preset: Preset },
}

/// The options that were set but that the result does not follow, in the order of [`Options`].
pub(super) fn options_not_applied(
    options: &Options,
    steps: &[ExecutedStep],
    ending: &Ending<'_>,
) -> Vec<OptionNotApplied> {
    let set = names_of_set_options(options);
    let check = OptionCheck { options, steps, ending };
    let is_set = |name: &str| set.iter().any(|set| set == name);
    let mut all = Vec::new();
    for &(name, rule) in RULES.iter().filter(|(name, _)| is_set(name)) {
        let not_applied = match rule {
            Rule::Always => None,
            Rule::Operators(by, operators, nothing) if asks_for_change(options, name, by) => {
                check.of_operators(by, operators, nothing)
            }
            Rule::Operators(..) => None,
            Rule::Remesh => check.of_remesh(),
            Rule::Special(own) => check.of_own(own),
        };
        if let Some((cause, reason)) = not_applied {
            all.push(OptionNotApplied::new(options, name, cause, reason));
        }
    }
    all.extend(check.of_with());
    // An option that a step could follow only in part did have something to do.
    let is_limited = |entry: &OptionNotApplied| {
        check.steps().flat_map(|step| &step.options_not_applied).any(|limited| limited.option == entry.option)
    };
    all.retain(|entry| entry.cause != NotAppliedCause::NothingToDo || !is_limited(entry));
    for limited in check.steps().flat_map(|step| &step.options_not_applied) {
        if !all.contains(limited) {
            all.push(limited.clone());
        }
    }
    all
}

/// Checks the options that concern the file rather than its meshes: `merge`.
pub(super) fn merge_not_applied(options: &Options, has_objects: bool, keeps_objects: bool) -> Option<OptionNotApplied> {
    let (cause, reason) = match (options.merge, has_objects) {
        (Merge::Auto, _) => return None,
        (_, false) => (NotAppliedCause::NothingToDo, "the file has no objects"),
        (Merge::None, true) if !keeps_objects => (
            NotAppliedCause::Unavailable,
            "the result's format has no objects, or the file has too many objects to keep separate",
        ),
        _ => return None,
    };
    Some(OptionNotApplied::new(options, "merge", cause, reason))
}

/// The names of the options that differ from their defaults.
fn names_of_set_options(options: &Options) -> Vec<String> {
    options.to_changed_fields().into_iter().map(|(name, _)| name).collect()
}

/// Whether an option that was set asks for a change. Zero does not, nor does a tolerance below the default.
fn asks_for_change(options: &Options, name: &str, by: OperatorRule) -> bool {
    let defaults = Options::default();
    let value = serde_json::to_value(options).ok().and_then(|all| all.get(name).cloned());
    let is_zero = value.as_ref().and_then(Value::as_f64) == Some(0.0);
    match by {
        OperatorRule::StitchEpsilon => true,
        OperatorRule::OpenSheets => options.open_sheets != OpenSheets::Leave,
        OperatorRule::Voids => options.print.voids != Voids::Keep,
        OperatorRule::WeldTolerance => !is_zero && options.weld_tolerance >= defaults.weld_tolerance,
        OperatorRule::DegenerateTolerance => !is_zero && options.degenerate_tolerance >= defaults.degenerate_tolerance,
        _ => !is_zero,
    }
}

/// The cause and the reason why an option was not applied; none if it was applied.
type NotApplied = Option<(NotAppliedCause, String)>;

/// The check of a repair's options against its steps and its ending.
struct OptionCheck<'a> {
    options: &'a Options,
    steps: &'a [ExecutedStep],
    ending: &'a Ending<'a>,
}

impl OptionCheck<'_> {
    /// The strategy whose steps count; none if no strategy made a result.
    fn strategy(&self) -> Option<u32> {
        match *self.ending {
            Ending::Untouched => None,
            Ending::InputKept { best, .. } => best,
            Ending::Unchanged { strategy, .. } | Ending::Result { strategy, .. } => Some(strategy),
        }
    }

    fn executed(&self) -> impl Iterator<Item = &ExecutedStep> {
        let strategy = self.strategy();
        self.steps.iter().filter(move |executed| Some(executed.step.strategy) == strategy)
    }

    fn steps(&self) -> impl Iterator<Item = &Step> {
        self.executed().map(|executed| &executed.step)
    }

    /// Checks an option that acts through operators. `nothing` is the reason if they found nothing to do.
    fn of_operators(&self, by: OperatorRule, operators: &[Operator], nothing: &str) -> NotApplied {
        let without = &self.options.without;
        if operators.iter().all(|operator| without.contains(operator)) {
            let names: Vec<&str> = operators.iter().map(|operator| operator.as_str()).collect();
            return Some((NotAppliedCause::Excluded, format!("`without` leaves out {}", names.join(", "))));
        }
        if by == OperatorRule::StitchThreshold && self.options.stitch_distance.is_some() {
            return Some((NotAppliedCause::Excluded, "`stitch_distance` replaces this option".to_owned()));
        }
        let is_own = |step: &Step| step.operator.is_some_and(|operator| operators.contains(&operator));
        let own = || self.steps().filter(|step| is_own(step));
        let acted = own().any(|step| step.status == StepStatus::Done && has_effect(step, by));
        let with_own_note = self.executed().filter(|executed| is_own(&executed.step) && !executed.has_reuse_note);
        let left = with_own_note.filter_map(|executed| executed.step.note.as_deref()).last();
        if acted {
            let some_left = left
                .filter(|_| {
                    matches!(by, OperatorRule::DegenerateTolerance | OperatorRule::MinWall | OperatorRule::Voids)
                })
                .map(str::to_owned);
            return self.kept_input().or_else(|| some_left.map(|left| (NotAppliedCause::Limited, left)));
        }
        if let Ending::InputKept { best: None, why } = self.ending {
            return Some((NotAppliedCause::Unavailable, (*why).to_owned()));
        }
        let broken = own().filter(|step| matches!(step.status, StepStatus::Reverted | StepStatus::Failed)).last();
        if let Some(step) = broken {
            let why = step.note.clone().unwrap_or_else(|| "the step failed".to_owned());
            return Some((NotAppliedCause::Unavailable, why));
        }
        if let Some(left) = left {
            let reason = if by == OperatorRule::Refines { nothing } else { left };
            return Some((NotAppliedCause::Unavailable, reason.to_owned()));
        }
        let needs_tier_2 = own().next().is_none() && self.strategy().is_some() && self.options.max_tier < 2;
        if needs_tier_2 {
            return Some((
                NotAppliedCause::Excluded,
                "`max_tier=1` leaves out the operators that this option controls".to_owned(),
            ));
        }
        if own().next().is_none()
            && let Some(step) = self.steps.iter().map(|executed| &executed.step).rfind(|step| is_own(step))
        {
            let rejected = || "the result of the strategy that applied it was not accepted".to_owned();
            let note = step.note.clone().filter(|_| step.changed.is_empty());
            return Some((NotAppliedCause::Unavailable, note.unwrap_or_else(rejected)));
        }
        Some((NotAppliedCause::NothingToDo, nothing.to_owned()))
    }

    /// The reason why the option has no effect if the input is returned; none if it is not.
    fn kept_input(&self) -> NotApplied {
        match self.ending {
            Ending::InputKept { why, .. } => {
                Some((NotAppliedCause::MadeWorse, format!("the input is returned because the result is worse: {why}")))
            }
            _ => None,
        }
    }

    fn is_remeshed(&self) -> bool {
        self.steps().any(is_remesh)
    }

    fn of_remesh(&self) -> NotApplied {
        if self.is_remeshed() {
            return self.kept_input();
        }
        if self.steps.iter().any(|executed| is_remesh(&executed.step)) {
            let reason = "the remeshed result is not printable, has a red flag, or is worse than another result";
            return Some((NotAppliedCause::MadeWorse, reason.to_owned()));
        }
        Some((NotAppliedCause::NothingToDo, "no remesh was needed".to_owned()))
    }

    fn of_own(&self, own: SpecialRule) -> NotApplied {
        match own {
            SpecialRule::Preset => self.of_preset(),
            SpecialRule::Category if self.options.preset != Preset::Auto => {
                Some((NotAppliedCause::Excluded, "`preset` chooses the plan".to_owned()))
            }
            SpecialRule::Category => self.of_plan(),
            SpecialRule::OverlapAngle if !self.options.with.contains(&Operator::RemoveOverlappingNeighbours) => {
                Some((NotAppliedCause::Excluded, "also set `with=remove_overlapping_neighbours`".to_owned()))
            }
            SpecialRule::Overlaps if self.options.overlaps == Overlaps::Keep && self.is_remeshed() => {
                Some((NotAppliedCause::Excluded, "the surface was remeshed, which unites overlapping parts".to_owned()))
            }
            SpecialRule::MaxHoleSize | SpecialRule::MaxHoles if self.is_remeshed() => {
                Some((NotAppliedCause::Limited, "the surface was remeshed, which closes every hole".to_owned()))
            }
            SpecialRule::Interior if self.options.print.interior == Interior::Fill => {
                self.of_operators(OperatorRule::Plain, &[Operator::FillInterior], "the model has no space to fill")
            }
            SpecialRule::Islands if matches!(self.options.print.islands, Islands::Drop | Islands::Attach) => self
                .of_operators(
                    OperatorRule::Plain,
                    &[Operator::TreatIslands, Operator::FillInterior],
                    "no separate solid is this small",
                ),
            SpecialRule::MaxHoles if self.has_patched_regions() => {
                Some((NotAppliedCause::Limited, "`clean_and_patch` closes the holes that it opens".to_owned()))
            }
            _ => None,
        }
    }

    /// Whether `clean_and_patch` changed anything.
    fn has_patched_regions(&self) -> bool {
        self.steps().any(|step| step.operator == Some(Operator::CleanAndPatch) && !step.changed.is_empty())
    }

    fn of_preset(&self) -> NotApplied {
        match *self.ending {
            Ending::Result { preset, .. } | Ending::Unchanged { preset, .. } if preset != self.options.preset => {
                if self.options.preset == Preset::BlenderRemesh && self.options.max_tier < 3 {
                    let reason = format!("`max_tier={}` leaves out Blender", self.options.max_tier);
                    return Some((NotAppliedCause::Excluded, reason));
                }
                let steps = self.steps.iter().map(|executed| &executed.step);
                let skipped = steps.filter(|step| step.strategy == 0).find(|step| step.status == StepStatus::Skipped);
                let cause = match skipped.and_then(|step| step.skip_reason) {
                    Some(SkipReason::OutOfTime | SkipReason::Unavailable) => NotAppliedCause::Unavailable,
                    _ => NotAppliedCause::Limited,
                };
                let why = skipped.and_then(|step| step.note.clone());
                let why =
                    why.unwrap_or_else(|| "the result of the preset is not printable or has a red flag".to_owned());
                Some((cause, format!("{why}; the result comes from the preset `{}`", preset.as_str())))
            }
            _ => self.of_plan(),
        }
    }

    /// Checks an option that chooses the plan.
    fn of_plan(&self) -> NotApplied {
        match self.ending {
            Ending::Untouched | Ending::Unchanged { .. } => {
                Some((NotAppliedCause::NothingToDo, "the plan did not change the model".to_owned()))
            }
            Ending::InputKept { .. } => self.kept_input(),
            Ending::Result { .. } => None,
        }
    }

    /// Checks the operators of `with`.
    fn of_with(&self) -> Vec<OptionNotApplied> {
        let one = |&operator: &Operator| {
            let nothing = format!("`{}` found nothing to change", operator.as_str());
            let (cause, reason) = self.of_operators(OperatorRule::Plain, &[operator], &nothing)?;
            let with = OptionNotApplied::new(self.options, "with", cause, reason);
            Some(OptionNotApplied { value: operator.as_str().to_owned(), ..with })
        };
        self.options.with.iter().filter_map(one).collect()
    }
}

/// Whether a step remeshed the model.
fn is_remesh(step: &Step) -> bool {
    let can_remesh = step.operator == Some(Operator::Remesh) || remesh_action(step.action).is_some();
    can_remesh && step.status == StepStatus::Done
}

/// Whether a step made a change that the option controls.
fn has_effect(step: &Step, by: OperatorRule) -> bool {
    step.changed.iter().any(|change| match by {
        OperatorRule::Thickness => change.kind.gives_thickness(),
        _ => !change.kind.is_only_counted(),
    })
}
