//! The account of one body's repair, as values, and the reports that are made of it.

use super::assumed::assumptions;
use super::input::Input;
use super::verdict::Judged;
use super::{
    Assumption, Candidate, Category, Changes, Context, FileSummary, Ledger, LeftOut, ObjectReport, OptionNotApplied,
    Options, Outcome, Plan, Preset, REPORT_VERSION, RedFlag, RepairError, Report, Step, Verdict, summary,
};
use crate::format::Format;
use crate::inspect::{Inspection, Level};

/// How the attempts on one body ended, before its result was inspected.
pub(super) struct Ended {
    pub outcome: Outcome,
    /// What is to be handed out; none where there is nothing.
    pub judged: Option<Judged>,
    pub plan: Plan,
    pub steps: Vec<Step>,
    pub candidates: Vec<Candidate>,
    /// Index of the strategy that made the result; none where the input itself is handed out.
    pub strategy: Option<u32>,
    pub options_not_applied: Vec<OptionNotApplied>,
    pub warnings: Vec<String>,
}

impl Ended {
    /// The input handed back, or nothing, before a plan was made.
    pub fn with_input(judged: Option<Judged>, reason: &str) -> Self {
        Self {
            outcome: Outcome::Unrepairable,
            candidates: judged.iter().map(|judged| Candidate::new(None, judged, true)).collect(),
            judged,
            plan: Plan::nothing(reason),
            steps: Vec::new(),
            strategy: None,
            options_not_applied: Vec::new(),
            warnings: Vec::new(),
        }
    }
}

/// What was done to one body, or to all bodies of a file, and what became of it.
pub(super) struct Account {
    pub outcome: Outcome,
    pub summary: String,
    pub after: Option<Inspection>,
    pub changes: Option<Changes>,
    pub ledger: Option<Ledger>,
    pub plan: Plan,
    pub steps: Vec<Step>,
    pub candidates: Vec<Candidate>,
    pub red_flags: Vec<RedFlag>,
    pub assumptions: Vec<Assumption>,
    pub options_not_applied: Vec<OptionNotApplied>,
    pub left_out: Vec<LeftOut>,
    /// Warnings about the repair; those about the input are [`Input::warnings`].
    pub warnings: Vec<String>,
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
    /// Inspects the result of ended attempts, and writes their account.
    pub fn of(ended: Ended, input: &Input<'_>, options: &Options, context: &Context<'_>) -> Result<Self, RepairError> {
        let words = summary::in_words(&ended, input, options);
        let guesses = ended.judged.as_ref().filter(|_| ended.strategy.is_some());
        let guesses = guesses.map(|judged| assumptions(&ended, judged, input, options)).unwrap_or_default();
        let mut account = Account {
            outcome: ended.outcome,
            summary: words,
            after: None,
            changes: None,
            ledger: None,
            plan: ended.plan,
            steps: ended.steps,
            candidates: ended.candidates,
            red_flags: Vec::new(),
            assumptions: guesses,
            options_not_applied: ended.options_not_applied,
            left_out: Vec::new(),
            warnings: ended.warnings,
        };
        let Some(mut judged) = ended.judged else {
            account.left_out = input.time.left_out();
            return Ok(Self { account, bytes: Vec::new(), dialect: String::new(), source: Vec::new() });
        };
        let after = input.after(&mut judged, context)?;
        if after.level == Level::None {
            input.time.leave_out(LeftOut::ResultDetails);
        }
        if judged.surface.is_none() {
            input.time.leave_out(LeftOut::SurfaceChanges);
        }
        account.left_out = input.time.left_out();
        account.summary.push_str(&summary::what_remains(&after));
        account.after = Some(after);
        account.changes = Some(Changes { surface: judged.surface, ..judged.changes });
        // The reasons part by part are for the program alone.
        account.ledger = judged.ledger.map(|ledger| Ledger { certified: Vec::new(), ..ledger });
        account.red_flags = judged.red_flags;
        Ok(Self { account, bytes: judged.bytes, dialect: judged.dialect, source: judged.source })
    }
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
            ledger: self.ledger,
            plan: self.plan,
            steps: self.steps,
            candidates: self.candidates,
            red_flags: self.red_flags,
            assumptions: [file.assumptions, self.assumptions].concat(),
            options_not_applied: file.options_not_applied.into_iter().chain(self.options_not_applied).collect(),
            objects: file.objects,
            left_out: self.left_out,
            warnings: [file.input.warnings(), file.warnings, self.warnings].concat(),
            milliseconds: 0.0,
        };
        let limited = super::limited_options::limited_options(&report);
        report.options_not_applied.extend(limited);
        report.warnings.extend(report.options_not_applied.iter().map(OptionNotApplied::in_words));
        report.verdict = Verdict::of(&report);
        report
    }
}

impl FileSummary {
    /// The summary of written bytes.
    pub(super) fn of(format: Format, dialect: &str, bytes: &[u8]) -> Self {
        Self { format, dialect: dialect.to_owned(), bytes: bytes.len() as u64 }
    }
}

impl Plan {
    /// A plan without a strategy, and why there is none.
    pub(super) fn nothing(reason: &str) -> Self {
        Self { category: Category::Clean, preset: Preset::BasicCleanup, reason: reason.to_owned(), rungs: Vec::new() }
    }
}
