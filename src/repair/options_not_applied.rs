//! Options that were set and that the result does not follow, or only in part, and why.

use serde_json::Value;

use super::options::{Merge, OpenSheets, Operator, Options, Overlaps, Preset};
use super::presets::remesh_action;
use super::report::{Candidate, NotAppliedCause, OptionNotApplied, Report, Step, StepStatus};
use super::tasks::ExecutedStep;
use crate::inspect::{BoundingBox, Inspection};
use crate::remesh::FINEST;

/// What an option acts through.
#[derive(Debug, Clone, Copy)]
enum Rule {
    /// Operators, with the reason where they find nothing to do.
    Operators(By, &'static [Operator], &'static str),
    /// A remesh.
    Remesh,
    /// A limit, or a choice that every path follows.
    Always,
    /// What no other option has.
    Own(Own),
}

/// How an option that acts through operators differs from others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum By {
    /// In nothing.
    Plain,
    WeldTolerance,
    StitchThreshold,
    StitchEpsilon,
    DegenerateTolerance,
    OpenSheets,
    Thickness,
}

/// The options with a rule of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Own {
    Preset,
    Category,
    Merge,
    With,
    OverlapAngle,
    Overlaps,
    MaxHoleSize,
    MaxHoles,
}

/// Every option and what it acts through.
const RULES: &[(&str, Rule)] = {
    use Operator as O;
    use Rule::{Always, Operators, Remesh};
    &[
        ("preset", Rule::Own(Own::Preset)),
        ("category", Rule::Own(Own::Category)),
        ("output", Always),
        ("merge", Rule::Own(Own::Merge)),
        ("require", Always),
        ("unit", Always),
        ("scale_to", Always),
        ("with", Rule::Own(Own::With)),
        ("without", Always),
        ("max_deviation", Always),
        ("max_faces", Always),
        ("max_error", Operators(By::Plain, &[O::Simplify], "no face could be removed within it")),
        ("max_tier", Always),
        ("deadline_s", Always),
        ("max_face_loss_pct", Always),
        ("max_vertex_loss_pct", Always),
        ("max_bounding_box_change_pct", Always),
        ("max_volume_change_pct", Always),
        ("max_surface_lost_pct", Always),
        ("max_surface_added_pct", Always),
        ("weld_tolerance", Operators(By::WeldTolerance, &[O::Weld], "no boundary vertices lie within it")),
        ("merge_distance", Operators(By::Plain, &[O::MergeVertices], "no vertices lie within it")),
        ("sew_ratio", Operators(By::Plain, &[O::Sew], "no boundary vertices lie within it")),
        ("stitch_threshold", Operators(By::StitchThreshold, &[O::Stitch], "no crack is within it")),
        ("stitch_distance", Operators(By::Plain, &[O::Stitch], "no crack is within it")),
        ("stitch_epsilon", Operators(By::StitchEpsilon, &[O::Stitch], "no crack was stitched")),
        ("stitch_position", Operators(By::Plain, &[O::Stitch], "no crack was stitched")),
        (
            "degenerate_tolerance",
            Operators(
                By::DegenerateTolerance,
                &[O::RemoveSlivers, O::UnfoldFoldovers],
                "no edge is shorter and no face lower",
            ),
        ),
        ("overlap_angle_deg", Rule::Own(Own::OverlapAngle)),
        ("twist_angle_deg", Always),
        ("max_hole_edges", Always),
        ("min_part_volume_pct", Operators(By::Plain, &[O::DropSmallParts], "no closed part is smaller")),
        ("nested", Operators(By::Plain, &[O::Orient], "no part had to be turned")),
        ("overlaps", Rule::Own(Own::Overlaps)),
        (
            "winding_rule",
            Operators(By::Plain, &[O::SelfUnion, O::Remesh], "no faces intersect, and every solid is as it says"),
        ),
        ("open_sheets", Operators(By::OpenSheets, &[O::ThickenSheets, O::AddBase], "the model has no open sheet")),
        (
            "thickness",
            Operators(By::Thickness, &[O::ThickenSheets, O::AddBase, O::SelfUnion], "nothing was given a thickness"),
        ),
        ("max_hole_size", Rule::Own(Own::MaxHoleSize)),
        ("max_holes", Rule::Own(Own::MaxHoles)),
        ("hole_filling", Operators(By::Plain, &[O::FillHoles], "no hole was closed")),
        ("refine_patches", Operators(By::Plain, &[O::FillHoles], "no hole was closed")),
        ("fair_patches", Operators(By::Plain, &[O::FillHoles], "no hole was closed")),
        ("voxel_size", Remesh),
        ("voxel_resolution", Remesh),
        ("max_remesh_faces", Remesh),
        ("pictures", Always),
    ]
};

/// The names of the options of which this account knows what they act through.
#[must_use]
pub fn options_accounted_for() -> Vec<&'static str> {
    RULES.iter().map(|(name, _)| *name).collect()
}

/// How a repair ended, for what its options came to.
pub(super) enum Ending<'a> {
    /// The input satisfies all that was asked for; nothing ran.
    Untouched,
    /// The input is handed out, since the best result is worse for this reason, or there is none.
    InputKept { best: Option<u32>, why: &'a str },
    /// The input is handed out, since the strategies left it as it is.
    Unchanged { strategy: u32, preset: Preset },
    /// The result of a strategy is handed out.
    Result { strategy: u32, preset: Preset },
}

/// The options that were set and that the result does not follow, in the order of [`Options`].
pub(super) fn options_not_applied(
    options: &Options,
    steps: &[ExecutedStep],
    ending: &Ending<'_>,
) -> Vec<OptionNotApplied> {
    let set = names_set(options);
    let account = Account { options, steps, ending };
    let is_set = |name: &str| set.iter().any(|it| it == name);
    let mut all = Vec::new();
    for &(name, rule) in RULES.iter().filter(|(name, _)| is_set(name)) {
        let found = match rule {
            Rule::Always => None,
            Rule::Operators(by, operators, nothing) if asks(options, name, by) => {
                account.of_operators(by, operators, nothing)
            }
            Rule::Operators(..) => None,
            Rule::Remesh => account.of_remesh(),
            Rule::Own(own) => account.of_own(own),
        };
        if let Some((cause, reason)) = found {
            all.push(OptionNotApplied::new(options, name, cause, reason));
        }
    }
    all.extend(account.of_with());
    // What could be followed in part is not done for want of anything to do.
    let is_limited = |it: &OptionNotApplied| {
        account.steps().flat_map(|step| &step.options_not_applied).any(|limited| limited.option == it.option)
    };
    all.retain(|it| it.cause != NotAppliedCause::NothingToDo || !is_limited(it));
    for limited in account.steps().flat_map(|step| &step.options_not_applied) {
        if !all.contains(limited) {
            all.push(limited.clone());
        }
    }
    all
}

/// What is to be said of the options that concern the file rather than its meshes.
pub(super) fn of_file(options: &Options, has_objects: bool, kept_apart: bool) -> Option<OptionNotApplied> {
    let (cause, reason) = match (options.merge, has_objects) {
        (Merge::Auto, _) => return None,
        (_, false) => (NotAppliedCause::NothingToDo, "the file has no objects"),
        (Merge::None, true) if !kept_apart => {
            (NotAppliedCause::Unavailable, "the result's format has no objects, or there are too many to keep apart")
        }
        _ => return None,
    };
    Some(OptionNotApplied::new(options, "merge", cause, reason))
}

/// The names of the options that are not at their defaults.
fn names_set(options: &Options) -> Vec<String> {
    options.to_changed_fields().into_iter().map(|(name, _)| name).collect()
}

/// Whether an option that was set asks for something to be done: zero does not, nor does a tolerance below the usual one.
fn asks(options: &Options, name: &str, by: By) -> bool {
    let usual = Options::default();
    let value = serde_json::to_value(options).ok().and_then(|all| all.get(name).cloned());
    let is_zero = value.as_ref().and_then(Value::as_f64) == Some(0.0);
    match by {
        By::StitchEpsilon => true,
        By::OpenSheets => options.open_sheets != OpenSheets::Leave,
        By::WeldTolerance => !is_zero && options.weld_tolerance >= usual.weld_tolerance,
        By::DegenerateTolerance => !is_zero && options.degenerate_tolerance >= usual.degenerate_tolerance,
        By::Plain | By::StitchThreshold | By::Thickness => !is_zero,
    }
}

type Found = Option<(NotAppliedCause, String)>;

struct Account<'a> {
    options: &'a Options,
    steps: &'a [ExecutedStep],
    ending: &'a Ending<'a>,
}

impl Account<'_> {
    /// The strategy of which the steps count.
    fn strategy(&self) -> Option<u32> {
        match *self.ending {
            Ending::Untouched => None,
            Ending::InputKept { best, .. } => best,
            Ending::Unchanged { strategy, .. } | Ending::Result { strategy, .. } => Some(strategy),
        }
    }

    fn executed(&self) -> impl Iterator<Item = &ExecutedStep> {
        let strategy = self.strategy();
        self.steps.iter().filter(move |it| Some(it.step.strategy) == strategy)
    }

    fn steps(&self) -> impl Iterator<Item = &Step> {
        self.executed().map(|it| &it.step)
    }

    /// What an option that acts through operators came to.
    fn of_operators(&self, by: By, operators: &[Operator], nothing: &str) -> Found {
        let without = &self.options.without;
        if operators.iter().all(|operator| without.contains(operator)) {
            let names: Vec<&str> = operators.iter().map(|operator| operator.as_str()).collect();
            return Some((NotAppliedCause::Excluded, format!("`without` leaves out {}", names.join(", "))));
        }
        if by == By::StitchThreshold && self.options.stitch_distance.is_some() {
            return Some((NotAppliedCause::Excluded, "`stitch_distance` takes its place".to_owned()));
        }
        let is_own = |step: &Step| step.operator.is_some_and(|it| operators.contains(&it));
        let own = || self.steps().filter(|step| is_own(step));
        let acted = own().any(|step| step.status == StepStatus::Done && has_acted(step, by));
        let with_own_note = self.executed().filter(|it| is_own(&it.step) && !it.has_reuse_note);
        let left = with_own_note.filter_map(|it| it.step.note.as_deref()).last();
        if acted {
            let some_left = left.filter(|_| by == By::DegenerateTolerance).map(str::to_owned);
            return self.kept_input().or_else(|| some_left.map(|left| (NotAppliedCause::Limited, left)));
        }
        if let Ending::InputKept { best: None, why } = self.ending {
            return Some((NotAppliedCause::Unavailable, (*why).to_owned()));
        }
        let broken = own().filter(|step| matches!(step.status, StepStatus::Reverted | StepStatus::Failed)).last();
        if let Some(step) = broken {
            let why = step.note.clone().unwrap_or_else(|| "it failed".to_owned());
            return Some((NotAppliedCause::Unavailable, why));
        }
        if let Some(left) = left {
            return Some((NotAppliedCause::Unavailable, left.to_owned()));
        }
        let needs_tier_2 = own().next().is_none() && self.strategy().is_some() && self.options.max_tier < 2;
        if needs_tier_2 {
            return Some((NotAppliedCause::Excluded, "`max_tier=1` leaves out what it acts through".to_owned()));
        }
        Some((NotAppliedCause::NothingToDo, nothing.to_owned()))
    }

    /// The reason where the input is handed out all the same.
    fn kept_input(&self) -> Found {
        match self.ending {
            Ending::InputKept { why, .. } => {
                Some((NotAppliedCause::MadeWorse, format!("the input is handed out, since the result is worse: {why}")))
            }
            _ => None,
        }
    }

    fn remeshed(&self) -> bool {
        let is_remesh = |step: &Step| step.operator == Some(Operator::Remesh) || remesh_action(step.action).is_some();
        self.steps().any(|step| step.status == StepStatus::Done && is_remesh(step))
    }

    fn of_remesh(&self) -> Found {
        if self.remeshed() {
            return self.kept_input();
        }
        Some((NotAppliedCause::NothingToDo, "the surface was not made anew".to_owned()))
    }

    fn of_own(&self, own: Own) -> Found {
        match own {
            Own::Preset => self.of_preset(),
            Own::Category if self.options.preset != Preset::Auto => {
                Some((NotAppliedCause::Excluded, "`preset` chooses the plan".to_owned()))
            }
            Own::Category => self.of_plan(),
            Own::OverlapAngle if !self.options.with.contains(&Operator::RemoveOverlappingNeighbours) => {
                Some((NotAppliedCause::Excluded, "set `with=remove_overlapping_neighbours` too".to_owned()))
            }
            Own::Overlaps if self.options.overlaps == Overlaps::Keep && self.remeshed() => {
                Some((NotAppliedCause::Excluded, "the surface was made anew, which unites what overlaps".to_owned()))
            }
            Own::MaxHoleSize | Own::MaxHoles if self.remeshed() => {
                Some((NotAppliedCause::Limited, "the surface was made anew, which closes every hole".to_owned()))
            }
            Own::MaxHoles if self.patched() => {
                Some((NotAppliedCause::Limited, "`clean_and_patch` closes the holes around what it removes".to_owned()))
            }
            _ => None,
        }
    }

    /// Whether bad places were removed and closed again.
    fn patched(&self) -> bool {
        self.steps().any(|step| step.operator == Some(Operator::CleanAndPatch) && !step.changed.is_empty())
    }

    fn of_preset(&self) -> Found {
        match *self.ending {
            Ending::Result { preset, .. } | Ending::Unchanged { preset, .. } if preset != self.options.preset => {
                if self.options.preset == Preset::BlenderRemesh && self.options.max_tier < 3 {
                    let reason = format!("`max_tier={}` leaves out Blender", self.options.max_tier);
                    return Some((NotAppliedCause::Excluded, reason));
                }
                let steps = self.steps.iter().map(|it| &it.step);
                let skipped = steps.filter(|step| step.strategy == 0).find(|step| step.status == StepStatus::Skipped);
                let why = skipped.and_then(|step| step.note.clone());
                let cause = if why.is_some() { NotAppliedCause::Unavailable } else { NotAppliedCause::Limited };
                let why = why.unwrap_or_else(|| "its result was not good".to_owned());
                Some((cause, format!("{why}; the result is that of the preset {}", preset.as_str())))
            }
            _ => self.of_plan(),
        }
    }

    /// What a plan that was asked for came to.
    fn of_plan(&self) -> Found {
        match self.ending {
            Ending::Untouched | Ending::Unchanged { .. } => {
                Some((NotAppliedCause::NothingToDo, "the plan left the model as it was".to_owned()))
            }
            Ending::InputKept { .. } => self.kept_input(),
            Ending::Result { .. } => None,
        }
    }

    /// The operators of `with` that changed nothing.
    fn of_with(&self) -> Vec<OptionNotApplied> {
        let one = |&operator: &Operator| {
            let nothing = format!("{} found nothing to change", operator.as_str());
            let (cause, reason) = self.of_operators(By::Plain, &[operator], &nothing)?;
            let with = OptionNotApplied::new(self.options, "with", cause, reason);
            Some(OptionNotApplied { value: operator.as_str().to_owned(), ..with })
        };
        self.options.with.iter().filter_map(one).collect()
    }
}

/// Whether a step changed something for an option.
fn has_acted(step: &Step, by: By) -> bool {
    step.changed.iter().any(|change| match by {
        By::Thickness => change.kind.gives_thickness(),
        _ => !change.kind.is_only_counted(),
    })
}

/// How much larger than asked for a voxel may be before it counts as another size.
const SAME_SIZE: f64 = 1.0 + 1e-6;

/// What the report says of `max_faces` and `voxel_size` where the result does not keep to them, each with the reason.
pub(super) fn limited_options(report: &Report) -> Vec<OptionNotApplied> {
    let mut all: Vec<OptionNotApplied> = too_many_faces(report).into_iter().collect();
    let mut larger = larger_voxels(report, &report.steps, &report.candidates, &report.before);
    for object in &report.objects {
        larger = larger.or_else(|| larger_voxels(report, &object.steps, &object.candidates, &object.before));
    }
    all.extend(larger);
    all
}

/// Says why the result has more faces than `max_faces`.
fn too_many_faces(report: &Report) -> Option<OptionNotApplied> {
    let most = report.options.max_faces?;
    let faces = report.after.as_ref()?.measures.faces;
    if faces <= most {
        return None;
    }
    let of_objects = report.objects.iter().flat_map(|object| &object.steps);
    let mut steps = report.steps.iter().chain(of_objects).filter(|step| step.operator == Some(Operator::Simplify));
    let why = match steps.next_back() {
        None => "no result with fewer faces was made".to_owned(),
        Some(step) => step.note.clone().unwrap_or_else(|| "no more faces could be removed".to_owned()),
    };
    let hint = match report.options.max_error {
        None => "; without `max_error` faces go only within 0.5 % of the bounding box's diagonal, so set a larger one",
        Some(_) => "; a larger `max_error` lets more faces go",
    };
    Some(limited(report, "max_faces", format!("the result has {faces} faces ({why}){hint}")))
}

/// Says why the voxels of the result are not of `voxel_size`.
fn larger_voxels(
    report: &Report,
    steps: &[Step],
    candidates: &[Candidate],
    before: &Inspection,
) -> Option<OptionNotApplied> {
    let asked = report.options.voxel_size?;
    let strategy = candidates.iter().find(|candidate| candidate.chosen)?.strategy?;
    let step = steps.iter().rev().find(|step| step.strategy == strategy && step.voxel_size.is_some())?;
    let used = step.voxel_size?;
    if used <= asked * SAME_SIZE && asked <= used * SAME_SIZE {
        return None;
    }
    let diagonal = before.measures.bounding_box.as_ref().map_or(0.0, BoundingBox::diagonal);
    let is_native = step.operator == Some(Operator::Remesh);
    let why = if used < asked {
        "larger ones would leave nothing of the model to see".to_owned()
    } else if is_native && used <= diagonal / FINEST * SAME_SIZE {
        format!("no finer ones than 1/{FINEST} of the bounding box's diagonal are made")
    } else {
        let most = report.options.max_remesh_faces;
        format!("smaller ones would take more than the {most} faces of `max_remesh_faces`, or too much memory")
    };
    Some(limited(report, "voxel_size", format!("the result was made with voxels of {used:.6}, since {why}")))
}

fn limited(report: &Report, option: &str, reason: String) -> OptionNotApplied {
    OptionNotApplied::new(&report.options, option, NotAppliedCause::Limited, reason)
}
