//! How the attempts on one body ended: in words, and what was decided on the way without proof.

use super::account::Account;
use super::change::ChangeKind;
use super::input::{Input, RepairError};
use super::judge::Judged;
use super::operators::thicken::THICKNESS;
use super::options::{Category, Operator, Options, WindingRuleChoice};
use super::presets::ask_of_printable;
use super::report::{Assumption, AssumptionKind, Candidate, OmittedSection, Outcome, Plan, Step, StepStatus, Strategy};
use super::tasks::takes_inverted_for_solid;
use crate::context::Context;
use crate::inspect::{Analysis, Changes, DefectKind, Inspection, Level, Measures, PartAccounting, PartReason, Solid};

/// How the attempts on one body ended, before its result was inspected.
pub(super) struct Ended {
    /// What is known without the result.
    pub account: Account,
    /// What is to be handed out; none where there is nothing.
    pub judged: Option<Judged>,
    /// Index of the strategy that made the result; none where the input itself is handed out.
    pub strategy: Option<u32>,
}

impl Ended {
    /// The input handed back, or nothing, before a plan was made.
    pub fn with_input(judged: Option<Judged>, reason: &str) -> Self {
        let candidates = judged.iter().map(|judged| Candidate::new(None, judged, true)).collect();
        let account = Account { candidates, ..Account::of_plan(Plan::nothing(reason)) };
        Self { account, judged, strategy: None }
    }
}

/// A repaired body: its file in the format that results are judged in, and its account.
pub(super) struct RepairedBody {
    pub account: Account,
    /// Empty where nothing can be handed out.
    pub bytes: Vec<u8>,
    pub dialect: String,
    /// For each face of the result the input's face that it was cut from.
    pub source: Vec<u32>,
}

impl RepairedBody {
    /// Inspects the result of ended attempts, and completes their account.
    pub fn of(ended: Ended, input: &Input<'_>, options: &Options, context: &Context<'_>) -> Result<Self, RepairError> {
        let summary = in_words(&ended, input, options);
        let guesses = ended.judged.as_ref().filter(|_| ended.strategy.is_some());
        let guesses = guesses.map(|judged| assumptions(&ended, judged, input, options)).unwrap_or_default();
        let mut account = Account { summary, assumptions: guesses, ..ended.account };
        let Some(mut judged) = ended.judged else {
            account.omitted = input.time.omitted();
            return Ok(Self { account, bytes: Vec::new(), dialect: String::new(), source: Vec::new() });
        };
        let after = input.after(&mut judged, context)?;
        if after.level == Level::None {
            input.time.leave_out(OmittedSection::ResultDetails);
        }
        if judged.details.surface.is_none() {
            input.time.leave_out(OmittedSection::SurfaceChanges);
        }
        account.omitted = input.time.omitted();
        account.summary.push_str(&what_remains(&after));
        account.after = Some(after);
        account.changes = Some(Changes { surface: judged.details.surface, ..judged.changes });
        // The reasons part by part are for the program alone.
        account.part_accounting =
            judged.part_accounting.map(|part_accounting| PartAccounting { certified: Vec::new(), ..part_accounting });
        account.red_flags = judged.red_flags;
        Ok(Self { account, bytes: judged.bytes, dialect: judged.dialect, source: judged.source })
    }
}

/// What a printable result keeps though it is not ideal, in words; empty where there is nothing of the kind.
fn what_remains(after: &Inspection) -> String {
    if !after.measures.printable() {
        return String::new();
    }
    let kinds = [(DefectKind::DegenerateFace, "with a very short edge"), (DefectKind::FlatFace, "of almost no height")];
    let found = kinds.map(|(kind, what)| {
        let count = after.count(kind);
        (count > 0).then(|| format!("{} {what}", counted(count, "face", "faces")))
    });
    let remaining: Vec<String> = found.into_iter().flatten().collect();
    if remaining.is_empty() {
        return String::new();
    }
    format!(" Left as found, since slicers accept them: {}.", remaining.join(", "))
}

/// The outcome in words, with what to do next where it is not good.
fn in_words(ended: &Ended, input: &Input<'_>, options: &Options) -> String {
    let out_of_time = input.time.omitted();
    let is_left_out = |what| out_of_time.contains(&what);
    let deadline = options.deadline_s;
    let mut text = match outcome_in_words(ended, input, options) {
        Words::All(text) => return text,
        Words::First(text) => text,
    };
    if ended.account.plan.category == Category::OpenSheet && ended.account.outcome == Outcome::PartiallyRepaired {
        text.push_str(
            " It is an open surface that encloses nothing: ask for open_sheets thicken or base to have it made solid.",
        );
    }
    if let Some(left) = left_open_by_options(&ended.account.steps) {
        text.push_str(&left);
    }
    if is_left_out(OmittedSection::Repair) || is_left_out(OmittedSection::Verification) {
        text.push_str(&format!(" The deadline of {deadline} s came before everything was tried: raise deadline_s."));
    }
    let skipped = ended.account.steps.iter().any(|s| s.tier == 3 && s.status == StepStatus::Skipped);
    if skipped {
        text.push_str(" A remesh with Blender was planned and could not run.");
    } else if options.max_tier < 3 {
        text.push_str(" Raising max_tier to 3 lets Blender try.");
    }
    text
}

/// Words for an outcome.
enum Words {
    /// All that is to be said.
    All(String),
    /// What is followed by what to do.
    First(String),
}

fn outcome_in_words(ended: &Ended, input: &Input<'_>, options: &Options) -> Words {
    let all = |text: &str| Words::All(text.to_owned());
    let was_printable = input.before.measures.printable();
    let left = ended.judged.as_ref().map_or_else(String::new, |judged| judged.measures.faults().join(", "));
    match ended.account.outcome {
        Outcome::AlreadyPrintable => all("The model is printable already; its geometry was not touched."),
        Outcome::Repaired if was_printable && options.asks_for_fewer_faces() => {
            all("The model was printable already; it has fewer faces now, as was asked for.")
        }
        Outcome::Repaired if was_printable && ask_of_printable(options) => {
            all("The model was printable already; it was changed as the options ask.")
        }
        Outcome::Repaired => all("The model was repaired and is printable."),
        Outcome::PartiallyRepaired if left.is_empty() => Words::First(
            "The result passes every check, but a red flag is up: compare it with the original before you print it."
                .to_owned(),
        ),
        Outcome::PartiallyRepaired => {
            Words::First(format!("The model is better than it was, but not printable: {left}."))
        }
        Outcome::Unrepairable => unrepairable_in_words(ended, &input.time.omitted(), options.deadline_s, &left),
    }
}

fn unrepairable_in_words(ended: &Ended, omitted: &[OmittedSection], deadline: f64, left: &str) -> Words {
    let is_handed_out = ended.judged.is_some();
    let is_left_out = |what| omitted.contains(&what);
    if is_left_out(OmittedSection::InputVerification) {
        Words::All(format!(
            "The deadline of {deadline} s came before the model was inspected, so it is not known whether it is printable; it is {}. \
             Raise deadline_s.",
            if is_handed_out { "handed back unchanged" } else { "not handed out" }
        ))
    } else if !is_handed_out && is_left_out(OmittedSection::Verification) {
        Words::All(format!(
            "The deadline of {deadline} s came before a result was verified, so nothing is handed out. Raise deadline_s."
        ))
    } else if !is_handed_out {
        Words::First(
            "The file has no face that could be written: nothing is handed out. Export the model again.".to_owned(),
        )
    } else if ended.account.plan.category == Category::OpenSheet {
        Words::All(
            "The model is an open surface that encloses nothing, so there is no solid to print; it is handed \
             back unchanged. Ask for open_sheets thicken or base to have it made solid."
                .to_owned(),
        )
    } else if is_left_out(OmittedSection::Repair) {
        Words::First(format!(
            "Nothing made the model better in the time there was; it is handed back unchanged: {left}."
        ))
    } else {
        Words::First(format!("Nothing that ran made the model better; it is handed back unchanged: {left}."))
    }
}

/// The holes that the options leave open, with what to do.
fn left_open_by_options(steps: &[Step]) -> Option<String> {
    let changes = steps.iter().filter(|step| step.status == StepStatus::Done).flat_map(|step| &step.changed);
    let most = changes.filter(|it| it.kind == ChangeKind::HolesOverLimit).map(|it| it.count).max()?;
    let plural = if most == 1 { "hole was" } else { "holes were" };
    Some(format!(
        " {most} {plural} left open by max_hole_edges, max_hole_size or max_holes: raise them, or set open_sheets=thicken for a \
         shell."
    ))
}

/// What was left when faces were to be removed and none was.
pub(super) fn why_no_face_went(steps: &[Step]) -> Option<String> {
    let last = steps.iter().rev().find(|step| step.operator == Some(Operator::Simplify))?;
    Some(last.note.clone().unwrap_or_else(|| "no face could be removed".to_owned()))
}

/// The assumptions behind the result of a strategy.
fn assumptions(ended: &Ended, judged: &Judged, input: &Input<'_>, options: &Options) -> Vec<Assumption> {
    let of_strategy = |step: &&Step| Some(step.strategy) == ended.strategy && step.status == StepStatus::Done;
    let steps: Vec<&Step> = ended.account.steps.iter().filter(of_strategy).collect();
    let (before, input) = (&input.before.measures, input.analysis);
    let diagonal = input.surface.bounds().diagonal();
    let mut all = judged.assumptions.clone();
    all.extend(small_parts_dropped(&steps, judged, input));
    all.extend(invented(&steps, judged, options, diagonal));
    all.extend(large_holes(judged, diagonal));
    let strategy = ended.strategy.and_then(|index| ended.account.plan.strategies.get(index as usize));
    all.extend(strategy.and_then(|strategy| winding_rule(&steps, strategy, before, options)));
    all.extend(pieces_dropped(judged, input));
    all.extend(cavities(judged, input));
    all
}

/// How much of one kind the operator changed.
fn changed(steps: &[&Step], operator: Operator, kind: ChangeKind) -> u64 {
    let of_operator = steps.iter().filter(|step| step.operator == Some(operator));
    of_operator.flat_map(|step| &step.changed).filter(|change| change.kind == kind).map(|change| change.count).sum()
}

/// "One" and the singular, or the count and the plural.
fn counted(count: u64, one: &str, many: &str) -> String {
    if count == 1 { format!("One {one}") } else { format!("{count} {many}") }
}

/// Thickened sheets, bases, and parts joined.
fn invented(steps: &[&Step], judged: &Judged, options: &Options, diagonal: f64) -> Vec<Assumption> {
    let (it, mut all) = (&judged.invented, Vec::new());
    let places = || it.places.iter().map(|at| at.to_array());
    let thickness = options.thickness.unwrap_or(THICKNESS * diagonal);
    let mut note = |kind, count: u64, area: f64, what: String| {
        let share = it.share_pct(area);
        let detail = format!("{what}; {share:.1} % of the result's surface is new by it.");
        let assumption = Assumption::new(kind, count, detail).with_amount(thickness).with_share(share);
        all.extend((count > 0).then(|| assumption.at(places()).unless("open_sheets=leave")));
    };
    let sheets = changed(steps, Operator::ThickenSheets, ChangeKind::SheetsThickened);
    let what = counted(sheets, "open sheet that encloses nothing was", "open sheets that enclose nothing were");
    let what = format!("{what} given a thickness of {thickness:.4}");
    note(AssumptionKind::SheetsThickened, sheets, it.skins, what);
    let faces = changed(steps, Operator::SelfUnion, ChangeKind::FacesAroundOpenRegionsThickened);
    let what = format!(
        "{} around regions into which one can look through holes given a thickness of {thickness:.4}, and the regions were left \
         open",
        counted(faces, "face was", "faces were")
    );
    note(AssumptionKind::SheetsThickened, faces, it.opened_skins, what);
    let bases = changed(steps, Operator::AddBase, ChangeKind::BasesAdded);
    let what = counted(bases, "open surface was", "open surfaces were");
    let what = format!("{what} closed by a base {thickness:.4} thick at its lowest point");
    note(AssumptionKind::BasesAdded, bases, it.bases, what);
    let joined = changed(steps, Operator::JoinParts, ChangeKind::PartsJoined);
    if joined > 0 {
        let detail = format!("{joined} bands of surface join parts that were apart.");
        all.push(Assumption::new(AssumptionKind::PartsJoined, joined, detail).unless("without=join_parts"));
    }
    all
}

fn large_holes(judged: &Judged, diagonal: f64) -> Option<Assumption> {
    let it = &judged.invented;
    let smallest = it.patches.iter().map(|patch| patch.extent).reduce(f64::min)?;
    let (count, area) = (it.patches.len() as u64, it.patch_area());
    let share = it.share_pct(area);
    let detail = format!(
        "{} closed with {share:.1} % of the result's surface.",
        counted(count, "large hole was", "large holes were")
    );
    let below = ((smallest / diagonal * 1000.0).floor() - 1.0).clamp(0.0, 999.0) / 1000.0;
    let assumption =
        Assumption::new(AssumptionKind::LargeHolesClosed, count, detail).with_amount(area).with_share(share);
    let places = it.patches.iter().map(|patch| patch.at.to_array());
    Some(assumption.at(places).unless(&format!("max_hole_size={below}")))
}

/// The winding rule that `auto` chose, where intersecting surface looks in different ways.
fn winding_rule(steps: &[&Step], strategy: &Strategy, before: &Measures, options: &Options) -> Option<Assumption> {
    let resolved = steps.iter().any(|step| step.operator == Some(Operator::SelfUnion) && !step.changed.is_empty());
    let is_open_question = before.inverted_parts > 0 || before.misoriented_edges > 0;
    if options.winding_rule != WindingRuleChoice::Auto || !resolved || !is_open_question {
        return None;
    }
    let (detail, other) = match takes_inverted_for_solid(strategy, options) {
        true => ("Where faces intersect, parts that are inside out were taken for solid too.", "winding_rule=positive"),
        false => (
            "Where faces intersect, only what the surface winds around outward was taken for solid.",
            "winding_rule=nonzero",
        ),
    };
    Some(Assumption::new(AssumptionKind::WindingRule, 1, detail).unless(other))
}

/// The input's parts with one of these reasons.
fn certified<'a>(
    judged: &'a Judged,
    input: &'a Analysis<'_>,
    is_one: impl Fn(PartReason) -> bool + 'a,
) -> Vec<&'a Solid> {
    let reasons = judged.part_accounting.iter().flat_map(|part_accounting| &part_accounting.reasons);
    reasons.filter(|it| is_one(it.reason)).filter_map(|it| input.solids.get(it.part as usize)).collect()
}

/// The pieces that were dropped as the options ask, with the area of the input's parts among them.
fn small_parts_dropped(steps: &[&Step], judged: &Judged, input: &Analysis<'_>) -> Option<Assumption> {
    let count = changed(steps, Operator::DropSmallParts, ChangeKind::SmallPartsDropped);
    let words = if count == 1 { "1 closed part was".to_owned() } else { format!("{count} closed parts were") };
    let certified = judged.part_accounting.iter().flat_map(|part_accounting| &part_accounting.certified);
    let dropped = certified.filter(|(_, reason)| *reason == PartReason::Dropped);
    let area: f64 = dropped.map(|(part, _)| input.solids[*part as usize].area).sum();
    let detail = format!("{words} dropped: smaller than `min_part_volume_pct`.");
    (count > 0).then(|| {
        Assumption::new(AssumptionKind::PiecesDropped, count, detail)
            .with_amount(area)
            .with_share(area / judged.measures.area * 100.0)
            .unless("min_part_volume_pct=0")
    })
}

fn pieces_dropped(judged: &Judged, input: &Analysis<'_>) -> Option<Assumption> {
    let part_accounting = judged.part_accounting.as_ref()?;
    let count = part_accounting.debris + part_accounting.no_volume;
    if count == 0 {
        return None;
    }
    let pieces = certified(judged, input, |it| matches!(it, PartReason::Debris | PartReason::NoVolume));
    let area: f64 = pieces.iter().map(|piece| piece.area).sum();
    let detail = format!(
        "{} dropped: nothing is enclosed, or too little to print.",
        counted(count, "stray piece was", "stray pieces were")
    );
    let option = if part_accounting.debris > 0 { "without=remove_debris" } else { "open_sheets=thicken" };
    let assumption = Assumption::new(AssumptionKind::PiecesDropped, count, detail).with_amount(area);
    Some(assumption.at(pieces.iter().map(|piece| piece.bounds.centre().to_array())).unless(option))
}

/// Sealed cavities that are kept, and those that are filled.
fn cavities(judged: &Judged, input: &Analysis<'_>) -> Vec<Assumption> {
    let mut all = Vec::new();
    if !judged.cavities.is_empty() {
        let (count, volume) = (judged.cavities.len() as u64, judged.cavities.iter().map(|it| it.0).sum());
        let detail = format!("{} kept hollow.", counted(count, "sealed cavity was", "sealed cavities were"));
        let assumption = Assumption::new(AssumptionKind::CavitiesKept, count, detail).with_amount(volume);
        all.push(assumption.at(judged.cavities.iter().map(|it| it.1)));
    }
    let mut filled = certified(judged, input, |it| it == PartReason::InsideAnother);
    filled.retain(|part| part.closed && part.volume < 0.0);
    if !filled.is_empty() {
        let (count, volume) = (filled.len() as u64, filled.iter().map(|it| it.volume.abs()).sum());
        let detail = format!("{} filled.", counted(count, "sealed cavity was", "sealed cavities were"));
        let assumption = Assumption::new(AssumptionKind::CavitiesFilled, count, detail).with_amount(volume);
        all.push(assumption.at(filled.iter().map(|it| it.bounds.centre().to_array())).unless("winding_rule=odd"));
    }
    all
}
