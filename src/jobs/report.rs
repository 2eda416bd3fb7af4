//! The report that a job leaves, and the quote that a shop makes of it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::job::{JobOutcome, JobProblem, ProblemKind, StoredReport};
use crate::analyze::{AnalysisReport, FileAnalysis};
use crate::format::Format;
use crate::repair::{AssumptionKind, OfferedFile, Outcome, RedFlagCode, Report, Step};
use crate::scene::{Unit, UnitSource};

/// Most bytes of an abridged report.
const ABRIDGED_BYTES: usize = 32 << 10;
/// Most items of each list of an abridged report, the first that makes it small enough.
const ITEMS: [usize; 4] = [3, 2, 1, 0];

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
    pub fn offered_file(&self) -> (OfferedFile, Option<Format>) {
        match self {
            Self::Repair(report) => (report.verdict.file, report.output.as_ref().map(|output| output.format)),
            Self::Analyze(_) => (OfferedFile::None, None),
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
        Some(JobProblem::new(ProblemKind::NotPrintable, report.refusal()?))
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

impl StoredReport {
    /// What is to be stored of an account.
    #[must_use]
    pub(super) fn of(report: &JobReport) -> Self {
        // None of its types can fail to be written.
        Self(serde_json::value::to_raw_value(report).unwrap_or_default())
    }
}

/// What a shop needs to price a model: the figures of the file that the job hands out, or of an analysed file. Lengths are in
/// millimetres whatever the file's unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Quote {
    /// Whether the file can be printed as it is; null where the inspection could not tell.
    pub printable: Option<bool>,
    /// Sides of the bounding box, in mm; null for a file without faces.
    #[schema(required)]
    pub size_mm: Option<[f64; 3]>,
    /// Enclosed volume, in mm³; null where the mesh does not enclose one.
    #[schema(required)]
    pub volume_mm3: Option<f64>,
    /// Surface area, in mm².
    pub area_mm2: f64,
    /// Thinnest wall that was found, in mm; null where none was measured.
    #[schema(required)]
    pub thinnest_wall_mm: Option<f64>,
    /// The unit of the file's lengths.
    pub unit: Unit,
    /// Where the unit comes from.
    pub unit_source: UnitSource,
    /// Number of faces.
    pub faces: u64,
    /// Number of connected parts.
    pub parts: u64,
    /// Codes of the red flags, each once.
    pub red_flags: Vec<RedFlagCode>,
    /// Kinds of the assumptions that the result depends on, each once.
    pub assumptions: Vec<AssumptionKind>,
}

impl Quote {
    /// The quote of a report; none where it is of several files, or of an earlier version that lacks the figures.
    #[must_use]
    pub fn of(report: &StoredReport) -> Option<Self> {
        let Account { verdict, unit, after, before, printable, files } = serde_json::from_str(report.json()).ok()?;
        let (printable, unit, figures) = match files {
            Some(files) => {
                let [file] = <[FileAccount; 1]>::try_from(files).ok()?;
                (printable, file.unit, file.inspection)
            }
            None => (verdict.and_then(|verdict| verdict.printable), unit?, after.or(before)?),
        };
        let (red_flags, assumptions) = report.remarks();
        let mm = unit.used.millimetres();
        let size_mm = figures.bounding_box.map(|Bounds { min, max }| [0, 1, 2].map(|k| (max[k] - min[k]) * mm));
        let wall = figures.print.and_then(|print| print.thinnest_wall);
        Some(Self {
            printable,
            size_mm,
            volume_mm3: figures.volume.filter(|volume| volume.reliable).map(|volume| volume.value * mm * mm * mm),
            area_mm2: figures.area * mm * mm,
            thinnest_wall_mm: wall.map(|wall| wall.thickness * mm),
            unit: unit.used,
            unit_source: unit.source,
            faces: figures.faces,
            parts: figures.parts,
            red_flags,
            assumptions,
        })
    }
}

/// The few fields of a report of either mode that a quote is made of. The rest is skipped as it is read.
#[derive(Deserialize)]
struct Account {
    verdict: Option<StoredVerdict>,
    unit: Option<StoredUnit>,
    after: Option<Figures>,
    before: Option<Figures>,
    printable: Option<bool>,
    files: Option<Vec<FileAccount>>,
}

#[derive(Deserialize)]
struct StoredVerdict {
    printable: Option<bool>,
}

#[derive(Deserialize)]
struct FileAccount {
    unit: StoredUnit,
    inspection: Figures,
}

#[derive(Deserialize)]
struct StoredUnit {
    used: Unit,
    source: UnitSource,
}

#[derive(Deserialize)]
struct Figures {
    faces: u64,
    parts: u64,
    area: f64,
    bounding_box: Option<Bounds>,
    volume: Option<StoredVolume>,
    print: Option<Print>,
}

#[derive(Deserialize)]
struct Bounds {
    min: [f64; 3],
    max: [f64; 3],
}

#[derive(Deserialize)]
struct StoredVolume {
    value: f64,
    reliable: bool,
}

#[derive(Deserialize)]
struct Print {
    thinnest_wall: Option<Wall>,
}

#[derive(Deserialize)]
struct Wall {
    thickness: f64,
}
