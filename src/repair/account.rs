//! The account of the repair of one body, of an object, or of a file, as values, and the reports that are made of it.

use std::time::Duration;

use super::input::Input;
use super::options::{Category, Options};
use super::options_not_applied::limited_options;
use super::report::{
    Assumption, Candidate, FileSummary, NotAppliedCause, ObjectReport, OmittedSection, OptionNotApplied, Outcome, Plan,
    REPORT_VERSION, RedFlag, RedFlagCode, Report, Step, Verdict,
};
use crate::inspect::{Changes, Inspection, InstanceContact, PartAccounting};

/// What was done to one body, or to all bodies of a file, and what became of it.
pub(super) struct Account {
    pub outcome: Outcome,
    pub summary: String,
    pub after: Option<Inspection>,
    pub changes: Option<Changes>,
    pub part_accounting: Option<PartAccounting>,
    pub plan: Plan,
    pub steps: Vec<Step>,
    pub candidates: Vec<Candidate>,
    pub red_flags: Vec<RedFlag>,
    pub assumptions: Vec<Assumption>,
    pub options_not_applied: Vec<OptionNotApplied>,
    pub omitted: Vec<OmittedSection>,
    /// Warnings about the repair; those about the input are [`Input::warnings`].
    pub warnings: Vec<String>,
}

/// What a report says of the file beyond the account of its repair.
pub(super) struct FileAccount<'a> {
    pub input: &'a Input<'a>,
    pub bytes: u64,
    pub options: &'a Options,
    pub output: FileSummary,
    /// The accounts of its objects, where they were repaired apart.
    pub objects: Vec<ObjectReport>,
    /// What was assumed of the file before its repair.
    pub assumptions: Vec<Assumption>,
    /// Options that concern the file rather than its meshes.
    pub options_not_applied: Option<OptionNotApplied>,
    pub warnings: Vec<String>,
}

impl Account {
    /// The account of an unrepairable body of which nothing is known but a plan.
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

    /// The report of the file; only its time is missing.
    pub fn into_report(self, file: FileAccount<'_>) -> Report {
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
            unit: file.input.analysis.subject.unit.cloned().unwrap_or_default(),
            before: file.input.before.clone(),
            verified_from_output_bytes: self.after.is_some(),
            after: self.after,
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
            milliseconds: 0.0,
        };
        let limited = limited_options(&report);
        report.options_not_applied.extend(limited);
        report.warnings.extend(report.options_not_applied.iter().map(OptionNotApplied::in_words));
        report.verdict = Verdict::of(&report);
        report
    }

    /// The account of a file by those of its objects: what was planned and done for a single one is what was done to the file.
    pub fn of_objects(sections: &[ObjectReport]) -> Self {
        let mut whole = Self {
            summary: "The file has no object that is to be printed; it is handed back unchanged.".to_owned(),
            options_not_applied: options_of(sections),
            ..Self::of_plan(Plan::nothing(""))
        };
        for section in sections {
            let titled =
                |text: &str| if sections.len() == 1 { text.to_owned() } else { format!("{}: {text}", section.title()) };
            let flags = section.red_flags.iter();
            whole.red_flags.extend(flags.map(|flag| RedFlag { detail: titled(&flag.detail), ..flag.clone() }));
            whole.warnings.extend(section.warnings.iter().map(|warning| titled(warning)));
            let assumed = section.assumptions.iter();
            whole.assumptions.extend(assumed.map(|it| Assumption { detail: titled(&it.detail), ..it.clone() }));
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
                whole.summary = objects_in_words(several);
                whole.plan = Plan {
                    category: Category::MultipleComponents,
                    preset: several[0].plan.preset,
                    ..Plan::nothing("each object has a plan of its own")
                };
            }
        }
        whole
    }
}

/// Places of each kind that the account of an object has: with those of all, reports of many objects would be too large.
const PLACES: usize = 5;

/// Contacts of objects, and members of a union, that a sentence names.
pub(super) const MAX_NAMED: usize = 5;

/// An object, and where it stands.
pub(super) struct ObjectPlace {
    pub name: Option<String>,
    /// Its number among the file's objects, from 0.
    pub index: usize,
    /// In how many places it stands.
    pub places: u64,
}

impl ObjectReport {
    /// The report of an object of its repair's account.
    pub(super) fn new(place: ObjectPlace, input: &Input<'_>, account: Account, time: Duration) -> Self {
        let (mut before, mut after) = (input.before.clone(), account.after);
        for inspection in std::iter::once(&mut before).chain(&mut after) {
            inspection.keep_places(PLACES);
        }
        Self {
            name: place.name,
            number: u32::try_from(place.index + 1).unwrap_or(u32::MAX),
            places: place.places,
            outcome: account.outcome,
            summary: account.summary,
            before,
            after,
            changes: account.changes,
            part_accounting: account.part_accounting,
            plan: account.plan,
            steps: account.steps,
            candidates: account.candidates,
            red_flags: account.red_flags,
            assumptions: account.assumptions,
            options_not_applied: account.options_not_applied,
            omitted: account.omitted,
            warnings: [input.warnings(), account.warnings].concat(),
            milliseconds: time.as_secs_f64() * 1e3,
        }
    }
}

/// The outcome of the file: that of its objects, as far as they are printable where they stand.
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

/// The options that some object's result does not follow; one that found nothing to do counts only where that is so of all objects.
fn options_of(sections: &[ObjectReport]) -> Vec<OptionNotApplied> {
    let mut all: Vec<OptionNotApplied> = Vec::new();
    for section in sections {
        for it in &section.options_not_applied {
            let same = |other: &&OptionNotApplied| (&other.option, &other.value) == (&it.option, &it.value);
            let by_all = || sections.iter().all(|section| section.options_not_applied.iter().any(|other| same(&other)));
            let is_listed = all.iter().any(|other| same(&other) && other.cause == it.cause);
            if is_listed || (it.cause == NotAppliedCause::NothingToDo && !by_all()) {
                continue;
            }
            let is_shared = sections.len() == 1 || it.cause == NotAppliedCause::NothingToDo;
            let reason = if is_shared { it.reason.clone() } else { format!("{}: {}", section.title(), it.reason) };
            all.push(OptionNotApplied { reason, ..it.clone() });
        }
    }
    all
}

/// What became of all objects together, in words.
fn objects_in_words(sections: &[ObjectReport]) -> String {
    let count = |outcome| sections.iter().filter(|section| section.outcome == outcome).count();
    let outcomes = [
        (Outcome::AlreadyPrintable, "already printable"),
        (Outcome::Repaired, "repaired and printable"),
        (Outcome::PartiallyRepaired, "partially repaired"),
        (Outcome::Unrepairable, "unchanged and not printable"),
    ];
    let words: Vec<String> = outcomes
        .into_iter()
        .map(|(outcome, words)| (count(outcome), words))
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

/// The red flag for objects that have points in common where they stand; none where there are no such objects.
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
        0 if contacts.is_empty() => format!("objects lie inside bodies of another material: {}", contained.join(", ")),
        0 => format!("objects touch: {}", named.join("; ")),
        1 => format!("objects intersect in 1 pair of faces: {}", named.join("; ")),
        _ => format!("objects intersect in {pairs} pairs of faces: {}", named.join("; ")),
    };
    #[expect(clippy::cast_precision_loss, reason = "a count to show")]
    let value = pairs.max(contacts.len() as u64).max(contained.len() as u64) as f64;
    let places = contacts.iter().take(MAX_NAMED).map(|(contact, _)| contact.at).collect();
    Some(RedFlag { code: RedFlagCode::ObjectsIntersect, value, threshold: 0.0, detail, places })
}
