//! Options that were set and that the result does not follow, and why.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::climb::TAKEN_OVER;
use super::presets::remesh_action;
use super::{Operator, Options, Overlaps, Preset, Step, StepStatus};

/// An option that was set and that the result does not follow, or only in part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct OptionNotApplied {
    /// The option's name.
    pub option: String,
    /// Its value as text.
    pub value: String,
    /// What kind of reason it is.
    pub cause: NotAppliedCause,
    /// The reason as a sentence.
    pub reason: String,
}

/// The kinds of reason why an option was not applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum NotAppliedCause {
    /// The model has nothing that the option is about.
    NothingToDo,
    /// It was applied in part.
    Limited,
    /// Another option rules it out.
    Excluded,
    /// What it needs failed or is not available.
    Unavailable,
    /// The result with it would be worse than the input, which is handed out.
    MadeWorse,
}

impl OptionNotApplied {
    /// An option with its value, the cause and the reason.
    #[must_use]
    pub fn new(options: &Options, option: &str, cause: NotAppliedCause, reason: impl Into<String>) -> Self {
        let value = serde_json::to_value(options).ok().and_then(|all| all.get(option).cloned());
        let value = value.map_or_else(String::new, |value| as_text(&value));
        Self { option: option.to_owned(), value, cause, reason: reason.into() }
    }

    /// As one line for a person.
    #[must_use]
    pub fn in_words(&self) -> String {
        let verdict = match self.cause {
            NotAppliedCause::NothingToDo => "had nothing to do",
            NotAppliedCause::Limited => "was applied in part",
            _ => "was not applied",
        };
        format!("`{}={}` {verdict}: {}", self.option, self.value, self.reason)
    }
}

fn as_text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(as_text).collect::<Vec<_>>().join(","),
        other => other.to_string(),
    }
}

/// What an option acts through.
#[derive(Debug, Clone, Copy)]
enum Rule {
    /// Operators, with the reason where they find nothing to do.
    Operators(&'static [Operator], &'static str),
    /// Surface that is made anew.
    Remesh,
    /// A limit, or a choice that every path follows.
    Always,
    /// One of those that are looked at by themselves.
    Own,
}

/// Every option and what it acts through.
const RULES: &[(&str, Rule)] = {
    use Operator as O;
    use Rule::{Always, Operators, Own, Remesh};
    &[
        ("preset", Own),
        ("category", Own),
        ("output", Always),
        ("merge", Own),
        ("require", Always),
        ("unit", Always),
        ("scale_to", Always),
        ("with", Own),
        ("without", Always),
        ("max_deviation", Always),
        ("max_faces", Always),
        ("max_error", Operators(&[O::Simplify], "no face could be removed within it")),
        ("max_tier", Always),
        ("deadline_s", Always),
        ("max_face_loss_pct", Always),
        ("max_vertex_loss_pct", Always),
        ("max_box_change_pct", Always),
        ("max_volume_change_pct", Always),
        ("max_surface_lost_pct", Always),
        ("max_surface_added_pct", Always),
        ("weld_tolerance", Operators(&[O::Weld], "no boundary vertices lie within it")),
        ("merge_distance", Operators(&[O::MergeVertices], "no vertices lie within it")),
        ("sew_ratio", Operators(&[O::Sew], "no boundary vertices lie within it")),
        ("stitch_threshold", Operators(&[O::Stitch], "no crack is within it")),
        ("stitch_distance", Operators(&[O::Stitch], "no crack is within it")),
        ("stitch_epsilon", Operators(&[O::Stitch], "no crack was stitched")),
        ("stitch_position", Operators(&[O::Stitch], "no crack was stitched")),
        (
            "degenerate_tolerance",
            Operators(&[O::RemoveSlivers, O::UnfoldFoldovers], "no edge is shorter and no face lower"),
        ),
        ("overlap_angle_deg", Own),
        ("twist_angle_deg", Always),
        ("max_hole_edges", Always),
        ("min_part_volume_pct", Operators(&[O::DropSmallParts], "no closed part is smaller")),
        ("nested", Operators(&[O::Orient], "no part had to be turned")),
        ("overlaps", Own),
        ("inside", Operators(&[O::Resolve, O::Remesh], "no faces intersect, and every solid is as it says")),
        ("open_sheets", Operators(&[O::ThickenSheets, O::AddBase], "the model has no open sheet")),
        ("thickness", Operators(&[O::ThickenSheets, O::AddBase, O::Resolve], "nothing was given a thickness")),
        ("max_hole_size", Own),
        ("max_holes", Own),
        ("hole_filling", Operators(&[O::FillHoles], "no hole was closed")),
        ("refine_patches", Operators(&[O::FillHoles], "no hole was closed")),
        ("fair_patches", Operators(&[O::FillHoles], "no hole was closed")),
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
    Unchanged { rung: u32, preset: Preset },
    /// The result of a strategy is handed out.
    Result { rung: u32, preset: Preset },
}

/// The options that were set and that the result does not follow, in the order of [`Options`].
pub(super) fn options_not_applied(options: &Options, steps: &[Step], ending: &Ending<'_>) -> Vec<OptionNotApplied> {
    let set = names_set(options);
    let account = Account { options, steps, ending };
    let is_set = |name: &str| set.iter().any(|it| it == name);
    let mut all = Vec::new();
    for &(name, rule) in RULES.iter().filter(|(name, _)| is_set(name)) {
        let found = match rule {
            Rule::Always => None,
            Rule::Operators(operators, nothing) if asks(options, name) => {
                account.of_operators(name, operators, nothing)
            }
            Rule::Operators(..) => None,
            Rule::Remesh => account.of_remesh(),
            Rule::Own => account.of_own(name),
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

/// Adds what must be told of the options that concern the file rather than its mesh.
pub(super) fn of_file(options: &Options, has_objects: bool, kept_apart: bool) -> Option<OptionNotApplied> {
    use super::Merge;
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
fn asks(options: &Options, name: &str) -> bool {
    let value = serde_json::to_value(options).ok().and_then(|all| all.get(name).cloned());
    let usual = Options::default();
    let is_tighter = match name {
        "weld_tolerance" => options.weld_tolerance < usual.weld_tolerance,
        "degenerate_tolerance" => options.degenerate_tolerance < usual.degenerate_tolerance,
        _ => false,
    };
    let is_zero = value.as_ref().and_then(Value::as_f64) == Some(0.0);
    let leaves = value.as_ref().and_then(Value::as_str).is_some_and(|it| it == "leave" || it == "kept");
    !((is_zero && name != "stitch_epsilon") || leaves || is_tighter)
}

type Found = Option<(NotAppliedCause, String)>;

struct Account<'a> {
    options: &'a Options,
    steps: &'a [Step],
    ending: &'a Ending<'a>,
}

impl Account<'_> {
    /// The strategy of which the steps count.
    fn rung(&self) -> Option<u32> {
        match *self.ending {
            Ending::Untouched => None,
            Ending::InputKept { best, .. } => best,
            Ending::Unchanged { rung, .. } | Ending::Result { rung, .. } => Some(rung),
        }
    }

    fn steps(&self) -> impl Iterator<Item = &Step> {
        let rung = self.rung();
        self.steps.iter().filter(move |step| Some(step.rung) == rung)
    }

    /// What an option that acts through operators came to.
    fn of_operators(&self, name: &str, operators: &[Operator], nothing: &str) -> Found {
        let without = &self.options.without;
        if operators.iter().all(|operator| without.contains(operator)) {
            let names: Vec<&str> = operators.iter().map(|operator| operator.as_str()).collect();
            return Some((NotAppliedCause::Excluded, format!("`without` leaves out {}", names.join(", "))));
        }
        if name == "stitch_threshold" && self.options.stitch_distance.is_some() {
            return Some((NotAppliedCause::Excluded, "`stitch_distance` takes its place".to_owned()));
        }
        let own = || self.steps().filter(|step| step.operator.is_some_and(|it| operators.contains(&it)));
        let acted = own().any(|step| step.status == StepStatus::Done && has_acted(step, name));
        let left = own().filter_map(|step| step.note.as_deref()).filter(|note| *note != TAKEN_OVER).last();
        if acted {
            let some_left = left.filter(|_| name == "degenerate_tolerance").map(str::to_owned);
            return self.kept_input().or_else(|| some_left.map(|left| (NotAppliedCause::Limited, left)));
        }
        if let Ending::InputKept { best: None, why } = self.ending {
            return Some((NotAppliedCause::Unavailable, (*why).to_owned()));
        }
        let broken = own().filter(|step| matches!(step.status, StepStatus::Undone | StepStatus::Failed)).last();
        if let Some(step) = broken {
            let why = step.note.clone().unwrap_or_else(|| "it failed".to_owned());
            return Some((NotAppliedCause::Unavailable, why));
        }
        if let Some(left) = left {
            return Some((NotAppliedCause::Unavailable, left.to_owned()));
        }
        let needs_tier_2 = own().next().is_none() && self.rung().is_some() && self.options.max_tier < 2;
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

    fn of_own(&self, name: &str) -> Found {
        match name {
            "preset" => self.of_preset(),
            "category" if self.options.preset != Preset::Auto => {
                Some((NotAppliedCause::Excluded, "`preset` chooses the plan".to_owned()))
            }
            "category" => self.of_plan(),
            "overlap_angle_deg" if !self.options.with.contains(&Operator::RemoveOverlappingNeighbours) => {
                Some((NotAppliedCause::Excluded, "set `with=remove_overlapping_neighbours` too".to_owned()))
            }
            "overlaps" if self.options.overlaps == Overlaps::Keep && self.remeshed() => {
                Some((NotAppliedCause::Excluded, "the surface was made anew, which unites what overlaps".to_owned()))
            }
            "max_hole_size" | "max_holes" if self.remeshed() => {
                Some((NotAppliedCause::Limited, "the surface was made anew, which closes every hole".to_owned()))
            }
            "max_holes" if self.patched() => {
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
                let skipped = self.steps.iter().find(|step| step.rung == 0 && step.status == StepStatus::Skipped);
                let why = skipped.and_then(|step| step.note.clone());
                let cause = if why.is_some() { NotAppliedCause::Unavailable } else { NotAppliedCause::Limited };
                let why = why.unwrap_or_else(|| "its result was not good".to_owned());
                Some((cause, format!("{why}; the result is that of the preset {}", super::plan::name(preset))))
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
            let (cause, reason) = self.of_operators("with", &[operator], &nothing)?;
            let with = OptionNotApplied::new(self.options, "with", cause, reason);
            Some(OptionNotApplied { value: operator.as_str().to_owned(), ..with })
        };
        self.options.with.iter().filter_map(one).collect()
    }
}

/// Whether a step changed something for an option.
fn has_acted(step: &Step, name: &str) -> bool {
    step.changed.iter().any(|change| match name {
        "thickness" => change.what.gives_thickness(),
        _ => !change.what.is_only_counted(),
    })
}

/// The options of which an operator could follow only a part, since vertices may move by no more than `reach`.
pub(super) fn limits_of(
    operator: Operator,
    options: &Options,
    diagonal: f64,
    reach: f64,
) -> Vec<(&'static str, String)> {
    let usual = Options::default();
    let threshold = options.stitch_threshold.filter(|_| options.stitch_distance.is_none());
    let asked = match operator {
        Operator::MergeVertices => ("merge_distance", options.merge_distance),
        Operator::Weld if options.weld_tolerance != usual.weld_tolerance => {
            ("weld_tolerance", Some(options.weld_tolerance * diagonal))
        }
        Operator::Stitch if threshold.is_some() => ("stitch_threshold", threshold.map(|it| it * diagonal)),
        Operator::Stitch => ("stitch_distance", options.stitch_distance),
        Operator::RemoveSlivers if options.degenerate_tolerance != usual.degenerate_tolerance => {
            ("degenerate_tolerance", Some(options.degenerate_tolerance * diagonal))
        }
        Operator::ThickenSheets | Operator::AddBase => ("thickness", options.thickness),
        _ => return Vec::new(),
    };
    let (name, Some(length)) = asked else { return Vec::new() };
    if length <= reach {
        return Vec::new();
    }
    vec![(name, format!("`max_deviation` lets surface move by {reach} more, so that was used instead of {length}"))]
}
