use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use utoipa::ToSchema;

use super::{JobProblem, ProblemKind};
use crate::analyze::{AnalysisReport, FileAnalysis};
use crate::format::Format;
use crate::repair::{AssumptionKind, HandedOut, Outcome, RedFlagCode, Report, Step};
use crate::scene::LengthUnit;

/// Most bytes of an abridged report.
const ABRIDGED_BYTES: usize = 32 << 10;
/// Most items of each list of an abridged report, the first that makes it small enough.
const ITEMS: [usize; 4] = [3, 2, 1, 0];

/// What became of a job's model, apart from whether the job ran.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobOutcome {
    /// Repair: the input is printable; its geometry comes back untouched.
    AlreadyPrintable,
    /// Repair: the result passes every check, and no red flag is up.
    Repaired,
    /// Repair: the result is better than the input, but fails a check, or passes all of them with a red flag up.
    PartiallyRepaired,
    /// Repair: nothing that ran made the model better; the reason is in the report.
    Unrepairable,
    /// Analysis: every file can be printed as it is, as far as the level of inspection tells.
    Printable,
    /// Analysis: at least one file can't be printed as it is.
    NotPrintable,
    /// Analysis: nothing is wrong that was looked for, but the level did not ask for faces that intersect, or they could
    /// not all be counted.
    Undecided,
}

impl JobOutcome {
    /// Whether what the job hands out, or of an analysis every file, can be printed as it is; none where that is not known.
    #[must_use]
    pub fn is_printable(self) -> Option<bool> {
        match self {
            Self::AlreadyPrintable | Self::Repaired | Self::Printable => Some(true),
            Self::PartiallyRepaired | Self::Unrepairable | Self::NotPrintable => Some(false),
            Self::Undecided => None,
        }
    }
}

impl From<Outcome> for JobOutcome {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::AlreadyPrintable => Self::AlreadyPrintable,
            Outcome::Repaired => Self::Repaired,
            Outcome::PartiallyRepaired => Self::PartiallyRepaired,
            Outcome::Unrepairable => Self::Unrepairable,
        }
    }
}

/// The account that a job leaves; its `mode` tells which.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "mode", rename_all = "snake_case")]
pub enum JobReport {
    /// Of a repair.
    #[schema(title = "RepairReport")]
    Repair(Box<Report>),
    /// Of an analysis.
    #[schema(title = "AnalyzeReport")]
    Analyze(Box<AnalysisReport>),
}

impl JobReport {
    /// Reads an account from JSON: first its mode, then all of it at once, without a copy of everything in between as a tagged type
    /// makes.
    ///
    /// # Errors
    /// When it is none.
    pub fn from_json(text: &[u8]) -> serde_json::Result<Self> {
        #[derive(Deserialize)]
        #[serde(rename_all = "snake_case")]
        enum Mode {
            Repair,
            Analyze,
        }
        #[derive(Deserialize)]
        struct Head {
            mode: Mode,
        }
        Ok(match serde_json::from_slice(text)? {
            Head { mode: Mode::Repair } => Self::Repair(serde_json::from_slice(text)?),
            Head { mode: Mode::Analyze } => Self::Analyze(serde_json::from_slice(text)?),
        })
    }

    /// The report that a job answers with: short lists and no statistics, in at most 32 KiB of JSON for one model. The more it has to tell,
    /// the shorter its lists are.
    #[must_use]
    pub fn abridged(&self) -> Self {
        let shortened = |&most: &usize| {
            let mut report = self.clone();
            match &mut report {
                Self::Repair(report) => report.abridge(most),
                Self::Analyze(report) => report.abridge(most),
            }
            report
        };
        let is_small = |report: &Self| serde_json::to_vec(report).is_ok_and(|json| json.len() <= ABRIDGED_BYTES);
        let [most, fewer @ ..] = &ITEMS;
        let mut report = shortened(most);
        for most in fewer {
            if is_small(&report) {
                break;
            }
            report = shortened(most);
        }
        report
    }

    /// What became of the model.
    #[must_use]
    pub fn outcome(&self) -> JobOutcome {
        match self {
            Self::Repair(report) => report.outcome.into(),
            Self::Analyze(report) => match report.printable {
                Some(true) => JobOutcome::Printable,
                Some(false) => JobOutcome::NotPrintable,
                None => JobOutcome::Undecided,
            },
        }
    }

    /// The file that the job hands out, with the format that a model has.
    #[must_use]
    pub fn handed_out(&self) -> (HandedOut, Option<Format>) {
        match self {
            Self::Repair(report) => (report.verdict.file, report.output.as_ref().map(|output| output.format)),
            Self::Analyze(_) => (HandedOut::None, None),
        }
    }

    /// The pictures that can be drawn of the job's files: the number of the file, counted from 0, with the picture's name.
    #[must_use]
    pub fn drawings(&self) -> Vec<(usize, &'static str)> {
        match self {
            Self::Repair(report) => report.drawings().into_iter().map(|name| (0, name)).collect(),
            Self::Analyze(report) => {
                let of_file = |(number, file): (usize, &FileAnalysis)| {
                    file.drawings().into_iter().map(move |name| (number, name))
                };
                report.files.iter().enumerate().flat_map(of_file).collect()
            }
        }
    }

    /// Why the job fails although it has a report; none where it succeeds.
    #[must_use]
    pub fn refusal(&self) -> Option<JobProblem> {
        let Self::Repair(report) = self else { return None };
        let detail = report.refusal()?;
        Some(JobProblem { code: ProblemKind::NotPrintable, detail, place: None, file: None })
    }

    /// The steps of a repair.
    #[must_use]
    pub fn steps(&self) -> &[Step] {
        match self {
            Self::Repair(report) => &report.steps,
            Self::Analyze(_) => &[],
        }
    }
}

/// A report as JSON, as it was written: its own `version` says how to read it, and rows of earlier versions of this
/// program stay readable.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(transparent)]
pub struct StoredReport(Box<RawValue>);

impl StoredReport {
    /// What is to be stored of an account.
    #[must_use]
    pub(super) fn of(report: &JobReport) -> Self {
        // None of its types can fail to be written.
        Self(serde_json::value::to_raw_value(report).unwrap_or_default())
    }

    /// Its JSON.
    pub(super) fn json(&self) -> &str {
        self.0.get()
    }

    /// The codes of a repair's red flags, and the kinds of its assumptions, each once.
    #[must_use]
    pub fn remarks(&self) -> (Vec<RedFlagCode>, Vec<AssumptionKind>) {
        #[derive(Deserialize)]
        struct Flag {
            code: RedFlagCode,
        }
        #[derive(Deserialize)]
        struct Assumed {
            kind: AssumptionKind,
        }
        #[derive(Deserialize)]
        struct Remarks {
            #[serde(default)]
            red_flags: Vec<Flag>,
            #[serde(default)]
            assumptions: Vec<Assumed>,
        }
        let Ok(Remarks { red_flags, assumptions }) = serde_json::from_str(self.json()) else {
            return Default::default();
        };
        let mut codes = Vec::new();
        for flag in red_flags {
            if !codes.contains(&flag.code) {
                codes.push(flag.code);
            }
        }
        let mut kinds: Vec<_> = assumptions.into_iter().map(|assumed| assumed.kind).collect();
        kinds.sort_unstable();
        kinds.dedup();
        (codes, kinds)
    }

    /// The unit of each file's lengths, in their order; none in reports of before there were units.
    #[must_use]
    pub fn units(&self) -> Vec<LengthUnit> {
        #[derive(Deserialize)]
        struct File {
            unit: LengthUnit,
        }
        // An analysis has files; a repair has one unit. The rest is passed over as it is read.
        #[derive(Deserialize)]
        struct Units {
            files: Option<Vec<File>>,
            unit: Option<LengthUnit>,
        }
        match serde_json::from_str(self.json()) {
            Ok(Units { files: Some(files), .. }) => files.into_iter().map(|file| file.unit).collect(),
            Ok(Units { unit, .. }) => unit.into_iter().collect(),
            Err(_) => Vec::new(),
        }
    }
}

impl PartialEq for StoredReport {
    fn eq(&self, other: &Self) -> bool {
        self.0.get() == other.0.get()
    }
}
