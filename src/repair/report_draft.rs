//! The draft of a report for one body or for a file, and the reports of files and objects that are made from it.

use std::time::Duration;

use super::input::Input;
use super::options::{Category, Options};
use super::options_limited::limited_options;
use super::report::{
    Assumption, Candidate, FileSummary, NotAppliedCause, ObjectReport, OmittedSection, OptionNotApplied, Outcome, Plan,
    REPORT_VERSION, RedFlag, RedFlagCode, Report, Step, Verdict,
};
use crate::inspect::{Changes, Inspection, InstanceContact, PartAccounting};
use crate::printing::readiness::PrintReadiness;
use crate::printing::unit_candidates::UnitCandidates;
use crate::scene::LengthUnit;

/// The draft of a report: what was done to one body, or to all bodies of a file, and with what result.
///
/// The fields have the meanings of the [`Report`] fields of the same names.
pub(super) struct ReportDraft {
    /// The outcome for the body or file.
    pub outcome: Outcome,
    /// The outcome as text.
    pub summary: String,
    /// The inspection of the result.
    pub after: Option<Inspection>,
    /// The changes from the input to the result.
    pub changes: Option<Changes>,
    /// The whereabouts of the input's parts.
    pub part_accounting: Option<PartAccounting>,
    /// The repair plan.
    pub plan: Plan,
    /// The steps that were run or skipped.
    pub steps: Vec<Step>,
    /// The results that were judged.
    pub candidates: Vec<Candidate>,
    /// The red flags of the chosen result.
    pub red_flags: Vec<RedFlag>,
    /// The assumptions behind the chosen result.
    pub assumptions: Vec<Assumption>,
    /// The options that were not followed.
    pub options_not_applied: Vec<OptionNotApplied>,
    /// The work left out for lack of time.
    pub omitted: Vec<OmittedSection>,
    /// Warnings about the repair; [`Input::warnings`] gives those about the input.
    pub warnings: Vec<String>,
}

/// The parts of a file's report that do not come from the repair of its bodies.
pub(super) struct FileDetails<'a> {
    /// The input.
    pub input: &'a Input<'a>,
    /// The input file's size in bytes.
    pub bytes: u64,
    /// The options of the repair.
    pub options: &'a Options,
    /// The unit of every length in the report.
    pub unit: LengthUnit,
    /// Factor by which the model was scaled to the size that the options ask for; none without such a request.
    pub scaled_by: Option<f64>,
    /// The units that the file may have; none if its unit is plausible.
    pub unit_candidates: Option<UnitCandidates>,
    /// The assessment of the returned file against a process.
    pub print_ready: Option<PrintReadiness>,
    /// Format and size of the returned file.
    pub output: FileSummary,
    /// The reports of objects that were repaired separately.
    pub objects: Vec<ObjectReport>,
    /// Assumptions about the file, made before its repair.
    pub assumptions: Vec<Assumption>,
    /// Options that concern the file rather than its meshes.
    pub options_not_applied: Option<OptionNotApplied>,
    /// Warnings about the written file.
    pub warnings: Vec<String>,
    /// Time of the whole repair.
    pub time: Duration,
}

impl ReportDraft {
    /// Makes the draft for a body that counts as unrepairable until a result is known.
    pub fn of_plan(plan: Plan) -> Self {
        Self {
            outcome: Outcome::Unrepairable,
            summary: String::new(),
            after: None,
            changes: None,
            part_accounting: None,
            plan,
            steps: Vec::new(),
            candidates: Vec::new(),
            red_flags: Vec::new(),
            assumptions: Vec::new(),
            options_not_applied: Vec::new(),
            omitted: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// Makes the report of the file.
    pub fn into_report(self, file: FileDetails<'_>) -> Report {
        let mesh = file.input.mesh;
        let mut report = Report {
            version: REPORT_VERSION,
            abridged: false,
            engine: crate::ENGINE.to_owned(),
            outcome: self.outcome,
            verdict: Verdict::default(),
            summary: self.summary,
            input: FileSummary { format: mesh.format, dialect: mesh.dialect.clone(), bytes: file.bytes },
            output: self.after.is_some().then_some(file.output),
            options: file.options.clone().into(),
            unit: file.unit,
            scaled_by: file.scaled_by,
            unit_candidates: file.unit_candidates,
            before: file.input.before.clone(),
            verified_from_output_bytes: self.after.is_some(),
            after: self.after,
            print_ready: file.print_ready,
            alternatives: None,
            changes: self.changes,
            part_accounting: self.part_accounting,
            plan: self.plan,
            steps: self.steps,
            candidates: self.candidates,
            red_flags: self.red_flags,
            assumptions: [file.assumptions, self.assumptions].concat(),
            options_not_applied: file.options_not_applied.into_iter().chain(self.options_not_applied).collect(),
            objects: file.objects,
            omitted: self.omitted,
            warnings: [file.input.warnings(), file.warnings, self.warnings].concat(),
            milliseconds: file.time.as_secs_f64() * 1e3,
        };
        let limited = limited_options(&report);
        report.options_not_applied.extend(limited);
        report.warnings.extend(report.options_not_applied.iter().map(OptionNotApplied::in_words));
        report.verdict = Verdict::of(&report);
        report
    }

    /// Makes the draft of a file's report from the reports of its objects. Plan and steps of a single object become the file's.
    pub fn of_objects(sections: &[ObjectReport]) -> Self {
        let mut whole = Self {
            summary: "The file has no object to print; it is returned unchanged.".to_owned(),
            options_not_applied: options_of(sections),
            ..Self::of_plan(Plan::without_strategies(""))
        };
        for section in sections {
            let titled =
                |text: &str| if sections.len() == 1 { text.to_owned() } else { format!("{}: {text}", section.title()) };
            let flags = section.red_flags.iter();
            whole.red_flags.extend(flags.map(|flag| RedFlag { detail: titled(&flag.detail), ..flag.clone() }));
            whole.warnings.extend(section.warnings.iter().map(|warning| titled(warning)));
            let assumed = section.assumptions.iter();
            let with_title =
                |assumption: &Assumption| Assumption { detail: titled(&assumption.detail), ..assumption.clone() };
            whole.assumptions.extend(assumed.map(with_title));
            whole.omitted.extend(&section.omitted);
        }
        match sections {
            [] => {}
            [only] => {
                whole.summary.clone_from(&only.summary);
                (whole.plan, whole.steps, whole.candidates) =
                    (only.plan.clone(), only.steps.clone(), only.candidates.clone());
                (whole.changes, whole.part_accounting) = (only.changes, only.part_accounting.clone());
            }
            several => {
                whole.summary = summary_of_objects(several);
                whole.plan = Plan {
                    category: Category::MultipleComponents,
                    preset: several[0].plan.preset,
                    ..Plan::without_strategies("each object has its own plan")
                };
            }
        }
        whole
    }
}

/// Most places of each defect in an object's report. It keeps the reports of files with many objects small.
const MAX_PLACES: usize = 5;

/// Most contacts of objects, or members of a union, that a sentence names.
pub(super) const MAX_NAMED: usize = 5;

/// The name, index and number of instances of an object.
pub(super) struct ObjectPlace {
    /// The object's name in the file.
    pub name: Option<String>,
    /// The object's index in the file, from 0.
    pub index: usize,
    /// The number of instances of the object.
    pub places: u64,
}

impl ObjectReport {
    /// Makes the report of an object from the draft of its repair.
    pub(super) fn new(place: ObjectPlace, input: &Input<'_>, draft: ReportDraft, time: Duration) -> Self {
        let (mut before, mut after) = (input.before.clone(), draft.after);
        for inspection in std::iter::once(&mut before).chain(&mut after) {
            inspection.keep_places(MAX_PLACES);
        }
        Self {
            name: place.name,
            number: u32::try_from(place.index + 1).unwrap_or(u32::MAX),
            places: place.places,
            outcome: draft.outcome,
            summary: draft.summary,
            before,
            after,
            changes: draft.changes,
            part_accounting: draft.part_accounting,
            plan: draft.plan,
            steps: draft.steps,
            candidates: draft.candidates,
            red_flags: draft.red_flags,
            assumptions: draft.assumptions,
            options_not_applied: draft.options_not_applied,
            omitted: draft.omitted,
            warnings: [input.warnings(), draft.warnings].concat(),
            milliseconds: time.as_secs_f64() * 1e3,
        }
    }
}

/// The outcome of the file: that of its objects, unless they are printable separately but not in their places.
pub(super) fn outcome_of(sections: &[ObjectReport], is_printable: bool, has_union: bool) -> Outcome {
    let all = |outcome| sections.iter().all(|section| section.outcome == outcome);
    let all_good = sections.iter().all(|section| section.outcome.is_printable());
    if all_good && !sections.is_empty() && !is_printable {
        Outcome::PartiallyRepaired
    } else if !has_union && all(Outcome::AlreadyPrintable) {
        Outcome::AlreadyPrintable
    } else if all_good {
        Outcome::Repaired
    } else if sections.iter().any(|section| matches!(section.outcome, Outcome::Repaired | Outcome::PartiallyRepaired)) {
        Outcome::PartiallyRepaired
    } else {
        Outcome::Unrepairable
    }
}

/// The options that some object's result does not follow. An option that had nothing to do counts only if that
/// holds for all objects.
fn options_of(sections: &[ObjectReport]) -> Vec<OptionNotApplied> {
    let mut all: Vec<OptionNotApplied> = Vec::new();
    for section in sections {
        for entry in &section.options_not_applied {
            let same = |other: &&OptionNotApplied| (&other.option, &other.value) == (&entry.option, &entry.value);
            let same_cause = |other: &OptionNotApplied| same(&other) && other.cause == entry.cause;
            let by_all = || sections.iter().all(|section| section.options_not_applied.iter().any(same_cause));
            let is_listed = all.iter().any(same_cause);
            if is_listed || (entry.cause == NotAppliedCause::NothingToDo && !by_all()) {
                continue;
            }
            let is_shared = sections.len() == 1 || entry.cause == NotAppliedCause::NothingToDo;
            let reason =
                if is_shared { entry.reason.clone() } else { format!("{}: {}", section.title(), entry.reason) };
            all.push(OptionNotApplied { reason, ..entry.clone() });
        }
    }
    all
}

/// The summary of a file with several objects.
fn summary_of_objects(sections: &[ObjectReport]) -> String {
    let count = |outcome, was_printable: Option<bool>| {
        let is_counted = |section: &&ObjectReport| {
            let was = section.before.measures.printable();
            section.outcome == outcome && was_printable.is_none_or(|printable| printable == was)
        };
        sections.iter().filter(is_counted).count()
    };
    let words: Vec<String> = [
        (count(Outcome::AlreadyPrintable, None), "already printable"),
        (count(Outcome::Repaired, Some(true)), "already printable and changed"),
        (count(Outcome::Repaired, Some(false)), "repaired and printable"),
        (count(Outcome::PartiallyRepaired, None), "partially repaired"),
        (count(Outcome::Unrepairable, None), "unchanged and not printable"),
    ]
    .into_iter()
    .filter(|(count, _)| *count > 0)
    .map(|(count, words)| format!("{count} {words}"))
    .collect();
    let mut text = format!("Of {} objects: {}.", sections.len(), words.join(", "));
    let bad = |section: &&ObjectReport| matches!(section.outcome, Outcome::PartiallyRepaired | Outcome::Unrepairable);
    if let Some(first) = sections.iter().find(bad) {
        text.push_str(&format!(" {}: {}", first.title(), first.summary));
    }
    text
}

/// The red flag for objects that intersect in their placed positions; none if no objects do.
pub(super) fn objects_intersect(contacts: &[(InstanceContact, [String; 2])], contained: &[String]) -> Option<RedFlag> {
    if contacts.is_empty() && contained.is_empty() {
        return None;
    }
    let pairs: u64 = contacts.iter().map(|(contact, _)| contact.pairs).sum();
    let named = contacts.iter().take(MAX_NAMED).map(|(contact, [a, b])| {
        let [x, y, z] = contact.at;
        format!("{a} and {b} near ({x:.6}, {y:.6}, {z:.6})")
    });
    let mut named: Vec<String> = named.collect();
    if contacts.len() > MAX_NAMED {
        named.push(format!("{} more pairs of objects", contacts.len() - MAX_NAMED));
    }
    let detail = match pairs {
        0 if contacts.is_empty() => format!("objects lie inside objects of another material: {}", contained.join(", ")),
        0 => format!("objects touch: {}", named.join("; ")),
        1 => format!("objects intersect in 1 pair of faces: {}", named.join("; ")),
        _ => format!("objects intersect in {pairs} pairs of faces: {}", named.join("; ")),
    };
    #[expect(clippy::cast_precision_loss, reason = "a count to show")]
    let value = pairs.max(contacts.len() as u64).max(contained.len() as u64) as f64;
    let places = contacts.iter().take(MAX_NAMED).map(|(contact, _)| contact.at).collect();
    Some(RedFlag { code: RedFlagCode::ObjectsIntersect, value, threshold: 0.0, detail, places })
}
