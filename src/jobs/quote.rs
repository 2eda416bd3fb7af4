use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::StoredReport;
use crate::repair::{AssumptionKind, RedFlagCode};
use crate::scene::{Unit, UnitSource};

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
