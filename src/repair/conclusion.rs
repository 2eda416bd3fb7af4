//! The conclusion of one body's repair: its summary for the reader, and the assumptions behind its result.

use super::change::ChangeKind;
use super::input::{Input, RepairError};
use super::judge::Judged;
use super::operators::thicken::THICKNESS;
use super::options::{Category, Interior, Islands, Operator, Options, Preset, WindingRuleChoice};
use super::presets::changes_printable;
use super::report::{
    Assumption, AssumptionKind, Candidate, OmittedSection, Outcome, Plan, SkipReason, Step, StepStatus, Strategy,
};
use super::report_draft::ReportDraft;
use super::tasks::counts_inverted_as_solid;
use crate::context::Context;
use crate::inspect::{Analysis, Changes, DefectKind, Inspection, Level, Measures, PartAccounting, PartReason, Solid};

/// The end of one body's repair, before its result is inspected.
pub(super) struct Conclusion {
    /// The draft of the report, without the inspection of the result.
    pub draft: ReportDraft,
    /// The result to return; none if there is nothing to return.
    pub judged: Option<Judged>,
    /// Index of the strategy that made the result; none if the input itself is returned.
    pub strategy: Option<u32>,
}

impl Conclusion {
    /// Concludes with the input itself, or with nothing, before any plan was made.
    pub fn with_input(judged: Option<Judged>, reason: &str) -> Self {
        let candidates = judged.iter().map(|judged| Candidate::new(None, judged, true)).collect();
        let draft = ReportDraft { candidates, ..ReportDraft::of_plan(Plan::without_strategies(reason)) };
        Self { draft, judged, strategy: None }
    }
}

/// A repaired body: its file in the judging format, and the draft of its report.
pub(super) struct RepairedBody {
    /// The draft of the body's report.
    pub draft: ReportDraft,
    /// The file; empty if nothing can be returned.
    pub bytes: Vec<u8>,
    /// The dialect of the file's format.
    pub dialect: String,
    /// For each face of the result, the input face that it comes from.
    pub source: Vec<u32>,
}

impl RepairedBody {
    /// Inspects the result and completes the draft of the report.
    ///
    /// # Errors
    /// [`RepairError`] if the job was canceled or the result cannot be read back.
    pub fn of(
        conclusion: Conclusion,
        input: &Input<'_>,
        options: &Options,
        context: &Context<'_>,
    ) -> Result<Self, RepairError> {
        let summary = summary_of(&conclusion, input, options);
        let repaired = conclusion.judged.as_ref().filter(|_| conclusion.strategy.is_some());
        let assumptions =
            repaired.map(|judged| assumptions_of(&conclusion, judged, input, options)).unwrap_or_default();
        let mut draft = ReportDraft { summary, assumptions, ..conclusion.draft };
        let Some(mut judged) = conclusion.judged else {
            draft.omitted = input.time.omitted();
            return Ok(Self { draft, bytes: Vec::new(), dialect: String::new(), source: Vec::new() });
        };
        let after = input.after(&mut judged, context)?;
        if after.level == Level::None {
            input.time.omit(OmittedSection::ResultDetails);
        }
        if judged.details.surface.is_none() {
            input.time.omit(OmittedSection::SurfaceChanges);
        }
        draft.omitted = input.time.omitted();
        draft.summary.push_str(&harmless_rest(&after));
        draft.after = Some(after);
        draft.changes = Some(Changes { surface: judged.details.surface, ..judged.changes });
        // The reasons of all parts are for internal use; the report lists only the first.
        draft.part_accounting =
            judged.part_accounting.map(|part_accounting| PartAccounting { all_reasons: Vec::new(), ..part_accounting });
        draft.red_flags = judged.red_flags;
        Ok(Self { draft, bytes: judged.bytes, dialect: judged.dialect, source: judged.source })
    }
}

/// The summary's sentence on harmless defects that a printable result keeps; empty if there are none.
fn harmless_rest(after: &Inspection) -> String {
    if !after.measures.printable() {
        return String::new();
    }
    let kinds = [(DefectKind::DegenerateFace, "with a very short edge"), (DefectKind::FlatFace, "of almost no height")];
    let remaining = kinds.map(|(kind, property)| {
        let count = after.count(kind);
        let faces = if count == 1 { "one face".to_owned() } else { format!("{count} faces") };
        (count > 0).then(|| format!("{faces} {property}"))
    });
    let remaining: Vec<String> = remaining.into_iter().flatten().collect();
    if remaining.is_empty() {
        return String::new();
    }
    format!(" Left unchanged because slicers accept them: {}.", remaining.join(", "))
}

/// The summary: the outcome as text, with advice if the result is not printable.
fn summary_of(conclusion: &Conclusion, input: &Input<'_>, options: &Options) -> String {
    let omitted = input.time.omitted();
    let is_omitted = |section| omitted.contains(&section);
    let deadline = options.deadline_s;
    let mut text = match outcome_text(conclusion, input, options) {
        SummaryText::Complete(text) => return text,
        SummaryText::BeforeAdvice(text) => text,
    };
    if conclusion.draft.plan.category == Category::OpenSheet && conclusion.draft.outcome == Outcome::PartiallyRepaired {
        text.push_str(
            " The model is an open surface that encloses nothing: set `open_sheets` to `thicken` or `base` to make it solid.",
        );
    }
    if let Some(advice) = holes_left_open_by_options(&conclusion.draft.steps) {
        text.push_str(&advice);
    }
    if is_omitted(OmittedSection::Repair) || is_omitted(OmittedSection::Verification) {
        text.push_str(&format!(
            " The deadline of {deadline} s passed before all strategies were tried: raise `deadline_s`."
        ));
    }
    if conclusion.draft.steps.iter().any(|s| s.tier == 3 && s.skip_reason == Some(SkipReason::Unavailable)) {
        text.push_str(" A planned remesh with Blender could not run.");
    } else if options.max_tier < 3 {
        text.push_str(" Set `max_tier` to 3 to try Blender too.");
    }
    text
}

/// The text for an outcome.
enum SummaryText {
    /// The whole summary.
    Complete(String),
    /// The start of the summary; advice follows.
    BeforeAdvice(String),
}

fn outcome_text(conclusion: &Conclusion, input: &Input<'_>, options: &Options) -> SummaryText {
    let all = |text: &str| SummaryText::Complete(text.to_owned());
    let was_printable = input.before.measures.printable();
    let faults = conclusion.judged.as_ref().map_or_else(String::new, |judged| judged.measures.faults().join(", "));
    match conclusion.draft.outcome {
        Outcome::AlreadyPrintable if options.print.asks_for_size() => {
            all("The model is already printable; it was scaled to the requested size, and its shape is unchanged.")
        }
        Outcome::AlreadyPrintable => all("The model is already printable; its geometry is unchanged."),
        Outcome::Repaired if was_printable && options.asks_for_fewer_faces() => {
            all("The model was already printable; its faces were reduced as requested.")
        }
        Outcome::Repaired if was_printable && changes_printable(options) => {
            all("The model was already printable; it was changed as the options request.")
        }
        Outcome::Repaired => all("The model was repaired and is printable."),
        Outcome::PartiallyRepaired if faults.is_empty() => SummaryText::BeforeAdvice(
            "The result passes every check but has a red flag: compare it with the original before printing."
                .to_owned(),
        ),
        Outcome::PartiallyRepaired => {
            SummaryText::BeforeAdvice(format!("The model was improved but is not printable: {faults}."))
        }
        Outcome::Unrepairable => unrepairable_text(conclusion, &input.time.omitted(), options.deadline_s, &faults),
    }
}

fn unrepairable_text(conclusion: &Conclusion, omitted: &[OmittedSection], deadline: f64, faults: &str) -> SummaryText {
    let is_returned = conclusion.judged.is_some();
    let is_omitted = |section| omitted.contains(&section);
    if is_omitted(OmittedSection::InputVerification) {
        SummaryText::Complete(format!(
            "The deadline of {deadline} s passed before the inspection finished, so it is unknown whether the model is printable. {} \
             Raise `deadline_s`.",
            if is_returned { "The input is returned unchanged." } else { "No model is returned." }
        ))
    } else if !is_returned && is_omitted(OmittedSection::Verification) {
        SummaryText::Complete(format!(
            "The deadline of {deadline} s passed before any result was verified, so no model is returned. Raise `deadline_s`."
        ))
    } else if !is_returned {
        SummaryText::BeforeAdvice(
            "The file has no face that can be written, so no model is returned. Export the model again.".to_owned(),
        )
    } else if conclusion.draft.plan.category == Category::OpenSheet {
        SummaryText::Complete(
            "The model is an open surface that encloses nothing, so there is no solid to print. The input is returned unchanged. \
             Set `open_sheets` to `thicken` or `base` to make the model solid."
                .to_owned(),
        )
    } else if is_omitted(OmittedSection::Repair) {
        SummaryText::BeforeAdvice(format!(
            "No repair step improved the model before the deadline. The input is returned unchanged: {faults}."
        ))
    } else {
        SummaryText::BeforeAdvice(format!(
            "No repair step improved the model. The input is returned unchanged: {faults}."
        ))
    }
}

/// The summary's sentence on holes that the options leave open, with advice; none if there are none.
fn holes_left_open_by_options(steps: &[Step]) -> Option<String> {
    let changes = steps.iter().filter(|step| step.status == StepStatus::Done).flat_map(|step| &step.changed);
    let over_limit = changes.filter(|change| change.kind == ChangeKind::HolesOverLimit);
    let most = over_limit.map(|change| change.count).max()?;
    let (holes, exceed) = if most == 1 { ("hole is", "it exceeds") } else { ("holes are", "they exceed") };
    Some(format!(
        " {most} {holes} still open because {exceed} `max_hole_edges`, `max_hole_size` or `max_holes`: raise these options, or set \
         `open_sheets=thicken` to get a shell."
    ))
}

/// The warning for a model whose faces were to be reduced but were not; none if no step tried.
pub(super) fn why_no_face_was_removed(steps: &[Step]) -> Option<String> {
    let last = steps.iter().rev().find(|step| step.operator == Some(Operator::Simplify))?;
    Some(last.note.clone().unwrap_or_else(|| "no face could be removed".to_owned()))
}

/// The assumptions behind the result of a strategy.
fn assumptions_of(conclusion: &Conclusion, judged: &Judged, input: &Input<'_>, options: &Options) -> Vec<Assumption> {
    let of_strategy = |step: &&Step| Some(step.strategy) == conclusion.strategy && step.status == StepStatus::Done;
    let steps: Vec<&Step> = conclusion.draft.steps.iter().filter(of_strategy).collect();
    let (before, input) = (&input.before.measures, input.analysis);
    let diagonal = input.surface.bounds().diagonal();
    let mut all = judged.assumptions.clone();
    all.extend(small_parts_dropped(&steps, judged, input));
    all.extend(added_surface(&steps, judged, options, diagonal));
    all.extend(large_holes(judged, diagonal));
    let strategy = conclusion.strategy.and_then(|index| conclusion.draft.plan.strategies.get(index as usize));
    all.extend(strategy.and_then(|strategy| winding_rule(&steps, strategy, before, options)));
    all.extend(pieces_dropped(judged, input));
    all.extend(fins_dropped(&steps, judged));
    all.extend(cavities(judged, input, options));
    all.extend(interior_filled(&steps, options));
    all.extend(islands_dropped(&steps, options));
    all.extend(gaps_closed(&steps));
    all
}

/// The assumption that a double shell is meant as a solid, unless the options ask for it.
fn interior_filled(steps: &[&Step], options: &Options) -> Option<Assumption> {
    let is_filled = steps.iter().any(|step| step.operator == Some(Operator::FillInterior) && !step.changed.is_empty());
    let is_own_decision = options.preset == Preset::Auto && options.print.interior == Interior::Auto;
    (is_filled && is_own_decision).then(|| {
        let sealed = changed(steps, Operator::FillInterior, ChangeKind::OpeningsSealed);
        let openings = match sealed {
            0 => String::new(),
            _ => format!(" {} sealed.", counted(sealed, "small opening in the outer skin was", "small openings in the outer skin were")),
        };
        let detail = format!(
            "The model is a double shell: two nested, nearly parallel skins around a void. The model was assumed to be a solid, and the inner \
             skin was removed.{openings}"
        );
        Assumption::new(AssumptionKind::InteriorFilled, 1, detail).unless("interior=keep")
    })
}

/// The assumption that small separate solids do not belong to the model, unless the options ask to remove just them.
fn islands_dropped(steps: &[&Step], options: &Options) -> Option<Assumption> {
    let count = changed(steps, Operator::TreatIslands, ChangeKind::IslandsDropped);
    (count > 0 && options.print.islands != Islands::Drop).then(|| {
        let detail = format!("{} removed.", counted(count, "small separate solid was", "small separate solids were"));
        Assumption::new(AssumptionKind::PiecesDropped, count, detail).unless(Islands::KEEP_SETTING)
    })
}

/// The assumptions that through holes and other gaps beside thickened walls are too narrow to print.
fn gaps_closed(steps: &[&Step]) -> impl Iterator<Item = Assumption> {
    let of = |change, kind, texts: [&str; 2], verb: &str| {
        let count = changed(steps, Operator::ThickenWalls, change);
        let subject = counted(count, texts[0], texts[1]);
        let detail = format!("{subject} {verb} by thicker walls: gaps as narrow as that do not print.");
        (count > 0).then(|| Assumption::new(kind, count, detail))
    };
    let holes = ["through hole was", "through holes were"];
    let gaps = ["narrow gap was", "narrow gaps were"];
    let closed = of(ChangeKind::ThroughHolesClosed, AssumptionKind::ThroughHolesClosed, holes, "closed");
    let filled = of(ChangeKind::NarrowGapsFilled, AssumptionKind::NarrowGapsFilled, gaps, "filled");
    closed.into_iter().chain(filled)
}

/// The operator's count of one kind of change.
fn changed(steps: &[&Step], operator: Operator, kind: ChangeKind) -> u64 {
    let of_operator = steps.iter().filter(|step| step.operator == Some(operator));
    of_operator.flat_map(|step| &step.changed).filter(|change| change.kind == kind).map(|change| change.count).sum()
}

/// "One" with the singular, or the count with the plural.
fn counted(count: u64, one: &str, many: &str) -> String {
    if count == 1 { format!("One {one}") } else { format!("{count} {many}") }
}

/// The assumptions of thickened sheets, bases and joined parts.
fn added_surface(steps: &[&Step], judged: &Judged, options: &Options, diagonal: f64) -> Vec<Assumption> {
    let (added, mut all) = (&judged.added_surface, Vec::new());
    let places = || added.places.iter().map(|at| at.to_array());
    let thickness = options.thickness.unwrap_or(THICKNESS * diagonal);
    let mut assume = |kind, count: u64, area: f64, sentence: String| {
        let share = added.share_pct(area);
        let detail = format!("{sentence} This added {share:.1} % of the result's surface.");
        let assumption = Assumption::new(kind, count, detail).with_amount(thickness).with_share(share);
        all.extend((count > 0).then(|| assumption.at(places()).unless("open_sheets=leave")));
    };
    let sheets = changed(steps, Operator::ThickenSheets, ChangeKind::SheetsThickened);
    let subject = counted(sheets, "open sheet that encloses nothing was", "open sheets that enclose nothing were");
    let sentence = format!("{subject} thickened to {thickness:.4}.");
    assume(AssumptionKind::SheetsThickened, sheets, added.skins, sentence);
    let faces = changed(steps, Operator::SelfUnion, ChangeKind::FacesAroundOpenRegionsThickened);
    let sentence = format!(
        "{} around open regions, which are visible through holes, thickened to {thickness:.4}. The regions stay open.",
        counted(faces, "face was", "faces were")
    );
    assume(AssumptionKind::SheetsThickened, faces, added.opened_skins, sentence);
    let bases = changed(steps, Operator::AddBase, ChangeKind::BasesAdded);
    let subject = counted(bases, "open surface was", "open surfaces were");
    let sentence = format!("{subject} closed by adding a base {thickness:.4} thick at its lowest point.");
    assume(AssumptionKind::BasesAdded, bases, added.bases, sentence);
    let joined = changed(steps, Operator::JoinParts, ChangeKind::PartsJoined);
    if joined > 0 {
        let detail = format!("{joined} bands of surface were added to join separate parts.");
        all.push(Assumption::new(AssumptionKind::PartsJoined, joined, detail).unless("without=join_parts"));
    }
    all
}

/// The assumption of closed large holes.
fn large_holes(judged: &Judged, diagonal: f64) -> Option<Assumption> {
    let added = &judged.added_surface;
    let smallest = added.patches.iter().map(|patch| patch.extent).reduce(f64::min)?;
    let (count, area) = (added.patches.len() as u64, added.patch_area());
    let share = added.share_pct(area);
    let detail = format!(
        "{} closed; the patches are {share:.1} % of the result's surface.",
        counted(count, "large hole was", "large holes were")
    );
    let below = ((smallest / diagonal * 1000.0).floor() - 1.0).clamp(0.0, 999.0) / 1000.0;
    let assumption =
        Assumption::new(AssumptionKind::LargeHolesClosed, count, detail).with_amount(area).with_share(share);
    let places = added.patches.iter().map(|patch| patch.at.to_array());
    Some(assumption.at(places).unless(&format!("max_hole_size={below}")))
}

/// The assumption of the winding rule that `auto` chose, if intersecting faces are oriented inconsistently.
fn winding_rule(steps: &[&Step], strategy: &Strategy, before: &Measures, options: &Options) -> Option<Assumption> {
    let has_self_union =
        steps.iter().any(|step| step.operator == Some(Operator::SelfUnion) && !step.changed.is_empty());
    let is_ambiguous = before.inverted_parts > 0 || before.misoriented_edges > 0;
    if options.winding_rule != WindingRuleChoice::Auto || !has_self_union || !is_ambiguous {
        return None;
    }
    let (detail, other) = match counts_inverted_as_solid(strategy, options) {
        true => ("Where faces intersect, parts that are inside out were assumed to be solid.", "winding_rule=positive"),
        false => (
            "Where faces intersect, only space inside outward-oriented surface was assumed to be solid.",
            "winding_rule=nonzero",
        ),
    };
    Some(Assumption::new(AssumptionKind::WindingRule, 1, detail).unless(other))
}

/// The input's parts whose reason in the part accounting is one that `is_wanted` accepts.
fn parts_with_reason<'a>(
    judged: &'a Judged,
    input: &'a Analysis<'_>,
    is_wanted: impl Fn(PartReason) -> bool + 'a,
) -> Vec<&'a Solid> {
    let parts = judged.part_accounting.iter().flat_map(|part_accounting| &part_accounting.reasons);
    parts.filter(|part| is_wanted(part.reason)).filter_map(|part| input.solids.get(part.part as usize)).collect()
}

/// The assumption of parts smaller than the options keep, with the area of the input's parts among them.
fn small_parts_dropped(steps: &[&Step], judged: &Judged, input: &Analysis<'_>) -> Option<Assumption> {
    let count = changed(steps, Operator::DropSmallParts, ChangeKind::SmallPartsDropped);
    let subject = if count == 1 { "1 closed part was".to_owned() } else { format!("{count} closed parts were") };
    let reasons = judged.part_accounting.iter().flat_map(|part_accounting| &part_accounting.all_reasons);
    let dropped = reasons.filter(|(_, reason)| *reason == PartReason::Dropped);
    let area: f64 = dropped.map(|(part, _)| input.solids[*part as usize].area).sum();
    let detail = format!("{subject} removed: smaller than `min_part_volume_pct`.");
    (count > 0).then(|| {
        Assumption::new(AssumptionKind::PiecesDropped, count, detail)
            .with_amount(area)
            .with_share(area / judged.measures.area * 100.0)
            .unless("min_part_volume_pct=0")
    })
}

/// The assumption of removed stray pieces.
fn pieces_dropped(judged: &Judged, input: &Analysis<'_>) -> Option<Assumption> {
    let part_accounting = judged.part_accounting.as_ref()?;
    let count = part_accounting.debris + part_accounting.no_volume;
    if count == 0 {
        return None;
    }
    let is_stray = |reason| matches!(reason, PartReason::Debris | PartReason::NoVolume);
    let pieces = parts_with_reason(judged, input, is_stray);
    let area: f64 = pieces.iter().map(|piece| piece.area).sum();
    let detail = format!(
        "{} no volume, or too little to print.",
        counted(count, "stray piece was removed: it encloses", "stray pieces were removed: they enclose")
    );
    let option = if part_accounting.debris > 0 { "without=remove_debris" } else { "open_sheets=thicken" };
    let assumption = Assumption::new(AssumptionKind::PiecesDropped, count, detail).with_amount(area);
    Some(assumption.at(pieces.iter().map(|piece| piece.bounds.centre().to_array())).unless(option))
}

/// The assumption of removed fins, which belong to larger parts of the input.
fn fins_dropped(steps: &[&Step], judged: &Judged) -> Option<Assumption> {
    let pieces = judged.part_accounting.as_ref()?.debris;
    let count = changed(steps, Operator::RemoveDebris, ChangeKind::DebrisPartsRemoved).saturating_sub(pieces);
    (count > 0).then(|| {
        let fins = counted(count, "fin was removed: a piece", "fins were removed: pieces");
        let detail = format!("{fins} of surface without thickness that stood on other faces.");
        Assumption::new(AssumptionKind::PiecesDropped, count, detail).unless("without=remove_debris")
    })
}

/// The assumptions of sealed cavities that were kept hollow or filled.
fn cavities(judged: &Judged, input: &Analysis<'_>, options: &Options) -> Vec<Assumption> {
    let mut all = Vec::new();
    if !judged.cavities.is_empty() {
        let (count, volume) = (judged.cavities.len() as u64, judged.cavities.iter().map(|cavity| cavity.0).sum());
        let detail = format!("{} kept hollow.", counted(count, "sealed cavity was", "sealed cavities were"));
        let assumption = Assumption::new(AssumptionKind::CavitiesKept, count, detail).with_amount(volume);
        all.push(assumption.at(judged.cavities.iter().map(|cavity| cavity.1)).unless("voids=fill"));
    }
    let mut filled = parts_with_reason(judged, input, |reason| reason == PartReason::InsideAnother);
    filled.retain(|part| part.closed && part.volume < 0.0);
    let is_requested = options.print.fills_cavities() || options.print.interior == Interior::Fill;
    if !filled.is_empty() && !is_requested {
        let (count, volume) = (filled.len() as u64, filled.iter().map(|cavity| cavity.volume.abs()).sum());
        let detail = format!("{} filled.", counted(count, "sealed cavity was", "sealed cavities were"));
        let assumption = Assumption::new(AssumptionKind::CavitiesFilled, count, detail).with_amount(volume);
        let places = filled.iter().map(|cavity| cavity.bounds.centre().to_array());
        all.push(assumption.at(places).unless("winding_rule=odd"));
    }
    all
}
