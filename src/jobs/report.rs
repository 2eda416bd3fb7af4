//! The report of a job, in full and abridged, and the quote derived from it.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::job::{JobOutcome, JobProblem, ProblemKind, StoredReport};
use crate::analyze::{AnalysisReport, FileAnalysis};
use crate::format::Format;
use crate::printing::readiness::PrintReadiness;
use crate::repair::{AssumptionKind, OfferedFile, Outcome, RedFlagCode, Report, Require, Step};
use crate::scene::{Unit, UnitSource};

/// The target size of an abridged report, in bytes.
const ABRIDGED_BYTES: usize = 32 << 10;
/// The maximum list lengths to try for an abridged report, until its size fits.
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

/// The report of a job; `mode` says which kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "mode", rename_all = "snake_case")]
pub enum JobReport {
    /// The report of a repair.
    #[schema(title = "RepairReport")]
    Repair(Box<Report>),
    /// The report of an analysis.
    #[schema(title = "AnalyzeReport")]
    Analyze(Box<AnalysisReport>),
}

impl JobReport {
    /// Reads a report from JSON. It reads the mode first and then the whole text, because serde's tagged enums buffer all content
    /// in an intermediate copy.
    ///
    /// # Errors
    /// When the text is not a report.
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

    /// The abridged report, which the API returns with the job: short lists and no statistics, in at most 32 KiB of JSON for one
    /// model. Lists get shorter the longer the full report is.
    #[must_use]
    pub fn abridged(&self) -> Self {
        let shortened = |&max: &usize| {
            let mut report = self.clone();
            match &mut report {
                Self::Repair(report) => report.abridge(max),
                Self::Analyze(report) => report.abridge(max),
            }
            report
        };
        let is_small = |report: &Self| serde_json::to_vec(report).is_ok_and(|json| json.len() <= ABRIDGED_BYTES);
        let [max, fewer @ ..] = &ITEMS;
        let mut report = shortened(max);
        for max in fewer {
            if is_small(&report) {
                break;
            }
            report = shortened(max);
        }
        report
    }

    /// The job's outcome.
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

    /// The file that the job offers, and the format of a repaired model.
    #[must_use]
    pub fn offered_file(&self) -> (OfferedFile, Option<Format>) {
        match self {
            Self::Repair(report) => (report.verdict.file, report.output.as_ref().map(|output| output.format)),
            Self::Analyze(_) => (OfferedFile::None, None),
        }
    }

    /// The alternatives that the job offers beside its default result: pairs of an id and the format of the model.
    #[must_use]
    pub fn alternatives(&self) -> Vec<(&str, Format)> {
        let Self::Repair(report) = self else { return Vec::new() };
        let offered = report.alternatives.iter().flat_map(|alternatives| &alternatives.offered);
        offered
            .filter(|offered| !offered.is_default)
            .map(|offered| (offered.id.as_str(), offered.file.format))
            .collect()
    }

    /// The pictures that can be drawn of the job's files: pairs of a file's number, counted from 0, and the picture's name.
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

    /// The problem of a job that fails although it has a report; `None` if the job succeeds.
    #[must_use]
    pub fn refusal(&self) -> Option<JobProblem> {
        let Self::Repair(report) = self else { return None };
        let demands_rules = report.options.require == Require::PrintReady && report.outcome.is_printable();
        let kind = if demands_rules { ProblemKind::NotPrintReady } else { ProblemKind::NotPrintable };
        Some(JobProblem::new(kind, report.refusal()?))
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
    /// The report to store.
    #[must_use]
    pub(super) fn of(report: &JobReport) -> Self {
        // Serialization of these types can't fail.
        Self(serde_json::value::to_raw_value(report).unwrap_or_default())
    }
}

/// The figures from which a shop prices a model: those of the offered file, or of an analysed file. Lengths are in millimetres
/// whatever the file's unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Quote {
    /// Whether the file is printable; null if the inspection could not decide.
    pub printable: Option<bool>,
    /// Side lengths of the bounding box, in mm; null for a file without faces.
    #[schema(required)]
    pub size_mm: Option<[f64; 3]>,
    /// Enclosed volume, in mm³; null if the mesh encloses no volume.
    #[schema(required)]
    pub volume_mm3: Option<f64>,
    /// Surface area, in mm².
    pub area_mm2: f64,
    /// Thinnest wall found, in mm; null if none was measured.
    #[schema(required)]
    pub thinnest_wall_mm: Option<f64>,
    /// The unit of the file's lengths.
    pub unit: Unit,
    /// The source of the unit.
    pub unit_source: UnitSource,
    /// Number of faces.
    pub faces: u64,
    /// Number of connected parts.
    pub parts: u64,
    /// Codes of the red flags, each once.
    pub red_flags: Vec<RedFlagCode>,
    /// Kinds of the assumptions on which the result depends, each once.
    pub assumptions: Vec<AssumptionKind>,
    /// Whether the file meets each rule of the process, without places; null without the option `process`.
    #[schema(required)]
    pub print_ready: Option<PrintReadiness>,
}

impl Quote {
    /// The quote from a report; `None` if the report has several files, or is of an earlier version without these figures.
    #[must_use]
    pub fn of(report: &StoredReport) -> Option<Self> {
        let QuotedReport { verdict, unit, after, before, printable, files, print_ready } =
            serde_json::from_str(report.json()).ok()?;
        let (printable, unit, figures, mut print_ready) = match files {
            Some(files) => {
                let [file] = <[QuotedFile; 1]>::try_from(files).ok()?;
                (printable, file.unit, file.inspection, file.print_ready)
            }
            None => (verdict.and_then(|verdict| verdict.printable), unit?, after.or(before)?, print_ready),
        };
        print_ready.iter_mut().for_each(|readiness| readiness.abridge(0));
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
            print_ready,
        })
    }
}

/// The fields of a report of either mode that a quote needs. Other fields are skipped while parsing.
#[derive(Deserialize)]
struct QuotedReport {
    verdict: Option<StoredVerdict>,
    unit: Option<StoredUnit>,
    after: Option<Figures>,
    before: Option<Figures>,
    printable: Option<bool>,
    files: Option<Vec<QuotedFile>>,
    print_ready: Option<PrintReadiness>,
}

#[derive(Deserialize)]
struct StoredVerdict {
    printable: Option<bool>,
}

#[derive(Deserialize)]
struct QuotedFile {
    unit: StoredUnit,
    inspection: Figures,
    print_ready: Option<PrintReadiness>,
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
