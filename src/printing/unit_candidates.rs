//! The likely unit of a file: candidates, ranked by their evidence.
//!
//! The score of a unit is the natural logarithm of its prior probability, plus a log-likelihood ratio for each piece of evidence. Priors,
//! weights and caps are judgement, tested with typical cases.

mod reasons;

use std::fmt;

use serde::{Deserialize, Serialize};

pub use self::reasons::UnitReason;
use super::designed_sizes::{DesignedSizes, designed_sizes};
use crate::inspect::{Analysis, BoundingBox, Inspection};
use crate::math::Box3;
use crate::scene::{LengthUnit, PLAUSIBLE_SIZE_MM, Unit, UnitSource};

/// Largest log ratio of one piece of evidence.
const MAX_LOG_RATIO: f64 = 3.0;
/// Largest log ratio of size and walls together, which are correlated.
const MAX_LOG_RATIO_OF_SIZE: f64 = 4.0;
/// By how much another unit must lead to cast doubt on millimetres that are only assumed.
const LEAD_OVER_ASSUMED: f64 = 3.0;
/// By how much another unit must lead to cast doubt on a stated unit.
const LEAD_OVER_STATED: f64 = 5.0;

/// Median of the longest sides of printed models, in millimetres. Longest sides are taken as log-normal.
const USUAL_SIZE: f64 = 60.0;
/// Factor between longest sides that are one standard deviation apart.
const SIZE_FACTOR: f64 = 3.0;
/// The log ratio of the usual size against a log-uniform size from 0.01 mm to 10 m.
const AT_USUAL_SIZE: f64 = 1.6;
/// Range of usual median wall thicknesses, in millimetres.
const USUAL_WALL: [f64; 2] = [0.8, 5.0];
/// Least wall thickness that is plausible, in millimetres.
const LEAST_WALL: f64 = 0.2;
/// The log ratio of a usual wall thickness.
const AT_USUAL_WALL: f64 = 1.0;
/// The decrease of the log ratio for each factor of e outside of the usual range.
const WALL_SLOPE: f64 = 1.2;

/// Round lengths are multiples of these, in millimetres, within a relative tolerance.
const ROUND_METRIC: f64 = 0.5;
const ROUND_IMPERIAL: f64 = 25.4 / 32.0;
const ROUND_TOLERANCE: f64 = 1e-4;
/// Lengths are ignored if more than this share of them would be round by chance.
const MAX_CHANCE: f64 = 0.2;
/// Number of lengths for full weight. With fewer lengths, the weight is in proportion.
const ENOUGH_LENGTHS: usize = 5;

/// Diameters of clearance holes for screws M3 to M8, in millimetres (ISO 273, fine to coarse).
const SCREW_HOLES: [[f64; 2]; 5] = [[3.2, 3.4], [4.3, 4.5], [5.3, 5.5], [6.4, 6.6], [8.4, 9.0]];
/// The log ratio if all holes fit screws.
const AT_SCREW_HOLES: f64 = 1.5;

/// Programs that write one unit, the unit, and the log ratio.
const PROGRAMS: [(&str, Unit, f64); 7] = [
    ("openscad", Unit::Millimetre, 3.0),
    ("prusaslicer", Unit::Millimetre, 3.0),
    ("bambustudio", Unit::Millimetre, 3.0),
    ("orcaslicer", Unit::Millimetre, 3.0),
    ("cura", Unit::Millimetre, 2.0),
    ("sketchup", Unit::Inch, 1.5),
    ("onshape", Unit::Metre, 1.5),
];
/// Generators and scanners that normalise the size of their models.
const NORMALISERS: [&str; 8] =
    ["trellis", "hunyuan", "tripo", "meshy", "rodin", "stable-fast-3d", "instantmesh", "triposr"];
/// Ranges of the longest side of a normalised model, from and to.
const NORMALISED: [[f64; 2]; 2] = [[0.9, 1.0], [1.8, 2.0]];
/// How far the centre of a normalised model's bounding box may be from the origin, as a share of the longest side.
const CENTRED: f64 = 0.02;

/// The evidence about a file's unit. Lengths are in the file's unit.
#[derive(Debug, Clone, Copy)]
pub struct SizeEvidence<'a> {
    /// The bounding box.
    pub bounds: Box3,
    /// The median wall thickness, if measured.
    pub median_wall: Option<f64>,
    /// The least wall thickness, if measured.
    pub least_wall: Option<f64>,
    /// Lengths that a designer chose: distances between parallel planes, and diameters. The sides of the box count as well.
    pub lengths: &'a [f64],
    /// Diameters of round holes.
    pub holes: &'a [f64],
    /// The unit that the request or the file states.
    pub stated: Option<(Unit, UnitSource)>,
    /// Text about the program that wrote the file: header, comment or metadata.
    pub program: Option<&'a str>,
    /// The unit of other files of the same job, if they agree.
    pub siblings: Option<Unit>,
    /// Smallest and largest value of the longest side that the process can print, in millimetres.
    pub printed_mm: [f64; 2],
}

impl SizeEvidence<'_> {
    /// Evidence of the size alone, for any process.
    #[must_use]
    pub fn of(bounds: Box3) -> Self {
        Self {
            bounds,
            median_wall: None,
            least_wall: None,
            lengths: &[],
            holes: &[],
            stated: None,
            program: None,
            siblings: None,
            printed_mm: PLAUSIBLE_SIZE_MM,
        }
    }

    fn longest(&self) -> f64 {
        (self.bounds.max - self.bounds.min).max_element().max(0.0)
    }
}

/// A unit that the file may have.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct UnitCandidate {
    /// The unit.
    pub unit: Unit,
    /// Natural logarithm of the unit's likelihood by all evidence. A candidate whose score is higher by 1 is e times as likely.
    pub score: f64,
    /// Side lengths of the bounding box in millimetres, if the file is in this unit.
    pub size_mm: [f64; 3],
    /// Median wall thickness in millimetres, if the file is in this unit.
    pub wall_mm: Option<f64>,
    /// The evidence for and against this unit.
    pub reasons: Vec<UnitReason>,
}

/// The candidates for a file's unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct UnitCandidates {
    /// All units, most likely first.
    pub ranked: Vec<UnitCandidate>,
    /// The unit that the job uses: the stated one, or millimetres.
    pub taken: Unit,
    /// Another unit that is much more likely than the one in use. Ask the customer before you use it.
    pub likely: Option<Unit>,
    /// Whether the model was scaled to a longest side of 1 or 2, so that its size does not reveal the unit. Ask for a size.
    pub normalised: bool,
}

impl fmt::Display for UnitCandidates {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.normalised {
            return f.write_str(
                "the model was scaled to a size of 1 or 2, which does not reveal its unit; give its height",
            );
        }
        let Some(likely) = self.likely else {
            return write!(f, "the unit used is {}; no other unit is much more likely", self.taken);
        };
        write!(f, "the unit used is {}, but {likely} is more likely", self.taken)?;
        let words: Vec<String> = self
            .ranked
            .iter()
            .filter(|candidate| candidate.unit == likely)
            .flat_map(|candidate| candidate.reasons.iter().map(UnitReason::in_words))
            .collect();
        if words.is_empty() { Ok(()) } else { write!(f, ": {}", words.join("; ")) }
    }
}

/// The evidence in a file about its unit, apart from the size and the walls.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FileEvidence {
    /// Sizes that a designer chose, in the file's unit.
    pub sizes: DesignedSizes,
    /// Text about the program that wrote the file.
    pub program: Option<String>,
    /// The unit of other files of the same job, if they agree.
    pub siblings: Option<Unit>,
}

impl FileEvidence {
    /// The evidence of a file's surface and of the text in which it names a program; empty if the unit is declared.
    #[must_use]
    pub fn of(analysis: &Analysis<'_>, unit: &LengthUnit, program: Option<String>) -> Self {
        if unit.source == UnitSource::Declared {
            return Self::default();
        }
        Self { sizes: designed_sizes(&analysis.surface, &analysis.edges), program, siblings: None }
    }
}

/// The units that an inspected file may have, ranked; `None` if the unit is known and plausible.
#[must_use]
pub fn units_in_doubt(
    inspection: &Inspection,
    unit: &LengthUnit,
    file: &FileEvidence,
    build_volume_mm: Option<[f64; 3]>,
) -> Option<UnitCandidates> {
    let wall = inspection.print.as_ref().and_then(|print| print.thinnest_wall.as_ref());
    let bounds = inspection.measures.bounding_box?;
    let evidence = SizeEvidence {
        median_wall: wall.map(|wall| wall.median),
        least_wall: wall.map(|wall| wall.thickness),
        lengths: &file.sizes.lengths,
        holes: &file.sizes.holes,
        program: file.program.as_deref(),
        siblings: file.siblings,
        ..evidence_of_box(bounds, unit, build_volume_mm)
    };
    in_doubt(&evidence, unit)
}

/// The units that a file with these bounds may have, ranked; `None` if the unit is known and plausible.
#[must_use]
pub fn units_of_box_in_doubt(
    bounds: BoundingBox,
    unit: &LengthUnit,
    build_volume_mm: Option<[f64; 3]>,
) -> Option<UnitCandidates> {
    in_doubt(&evidence_of_box(bounds, unit, build_volume_mm), unit)
}

fn evidence_of_box(bounds: BoundingBox, unit: &LengthUnit, build_volume_mm: Option<[f64; 3]>) -> SizeEvidence<'static> {
    let mut evidence = SizeEvidence::of(Box3 { min: bounds.min.into(), max: bounds.max.into() });
    evidence.stated = (unit.source != UnitSource::Assumed).then_some((unit.used, unit.source));
    if let Some(volume) = build_volume_mm {
        evidence.printed_mm[1] = volume.into_iter().fold(0.0, f64::max);
    }
    evidence
}

fn in_doubt(evidence: &SizeEvidence<'_>, unit: &LengthUnit) -> Option<UnitCandidates> {
    let candidates = unit_candidates(evidence);
    let longest_mm = evidence.longest() * candidates.taken.millimetres();
    let is_unusual = longest_mm > 0.0 && !(PLAUSIBLE_SIZE_MM[0]..=PLAUSIBLE_SIZE_MM[1]).contains(&longest_mm);
    let is_doubted = candidates.likely.is_some() || candidates.normalised;
    let is_in_doubt = is_doubted || (is_unusual && unit.source == UnitSource::Assumed);
    (is_in_doubt && unit.source != UnitSource::Declared).then_some(candidates)
}

/// Ranks the units that a file may have. O(n) in the number of lengths.
#[must_use]
pub fn unit_candidates(evidence: &SizeEvidence<'_>) -> UnitCandidates {
    let normalised = is_normalised(evidence);
    let mut ranked: Vec<UnitCandidate> = Unit::ALL.into_iter().map(|unit| candidate(evidence, unit)).collect();
    ranked.sort_by(|a, b| b.score.total_cmp(&a.score));
    let is_stated = |source| source == UnitSource::Declared || (source == UnitSource::File && !normalised);
    let stated = evidence.stated.filter(|&(_, source)| is_stated(source));
    let taken = stated.map_or(Unit::Millimetre, |(unit, _)| unit);
    let score_of = |unit: Unit| ranked.iter().find(|candidate| candidate.unit == unit).map_or(0.0, |c| c.score);
    let lead = ranked.first().map_or(0.0, |best| best.score - score_of(taken));
    let longest = evidence.longest() * taken.millimetres();
    let is_printed = longest >= evidence.printed_mm[0] && longest <= evidence.printed_mm[1];
    let is_doubted = match stated {
        Some(_) => lead > LEAD_OVER_STATED,
        None => lead > LEAD_OVER_ASSUMED && !is_printed && !normalised,
    };
    let likely = ranked.first().filter(|_| is_doubted && evidence.longest() > 0.0).map(|best| best.unit);
    UnitCandidates { ranked, taken, likely, normalised }
}

/// The log of the prior. Judgement: slicers assume millimetres, and files in inches or metres are the usual exceptions.
fn prior(unit: Unit) -> f64 {
    let share: f64 = match unit {
        Unit::Millimetre => 0.60,
        Unit::Inch => 0.20,
        Unit::Metre | Unit::Centimetre => 0.08,
        Unit::Foot | Unit::Micrometre => 0.02,
    };
    share.ln()
}

/// The score of a unit, with the reasons. A stated unit adds nothing to the score, because [`unit_candidates`] treats it separately.
fn candidate(evidence: &SizeEvidence<'_>, unit: Unit) -> UnitCandidate {
    let mm = unit.millimetres();
    let mut reasons = Vec::new();
    if let Some((_, source)) = evidence.stated.filter(|(stated, _)| *stated == unit) {
        reasons.extend(match source {
            UnitSource::Declared => Some(UnitReason::Declared),
            UnitSource::File => Some(UnitReason::StatedByFile),
            UnitSource::Assumed => None,
        });
    }
    let mut score = prior(unit);
    let by_size = size(evidence, mm, &mut reasons) + walls(evidence, mm, &mut reasons);
    score += by_size.clamp(-MAX_LOG_RATIO_OF_SIZE, MAX_LOG_RATIO_OF_SIZE);
    score += round_lengths(evidence, mm, &mut reasons);
    score += screw_holes(evidence, mm, &mut reasons);
    if let Some(weight) = program(evidence).filter(|(of, _)| *of == unit).map(|(_, weight)| weight) {
        reasons.push(UnitReason::Program);
        score += weight;
    }
    if evidence.siblings == Some(unit) {
        reasons.push(UnitReason::Siblings);
        score += 2.0;
    }
    let size_mm = ((evidence.bounds.max - evidence.bounds.min) * mm).to_array();
    UnitCandidate { unit, score, size_mm, wall_mm: evidence.median_wall.map(|wall| wall * mm), reasons }
}

fn size(evidence: &SizeEvidence<'_>, mm: f64, reasons: &mut Vec<UnitReason>) -> f64 {
    let longest_mm = evidence.longest() * mm;
    if longest_mm <= 0.0 {
        return 0.0;
    }
    let is_printed = longest_mm >= evidence.printed_mm[0] && longest_mm <= evidence.printed_mm[1];
    reasons.push(UnitReason::Size { longest_mm, is_printed });
    let deviations = (longest_mm / USUAL_SIZE).ln() / SIZE_FACTOR.ln();
    (AT_USUAL_SIZE - deviations * deviations / 2.0).clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO)
}

fn walls(evidence: &SizeEvidence<'_>, mm: f64, reasons: &mut Vec<UnitReason>) -> f64 {
    let Some(median_mm) = evidence.median_wall.map(|wall| wall * mm).filter(|wall| *wall > 0.0) else { return 0.0 };
    let [low, high] = USUAL_WALL;
    let beyond = (low / median_mm).max(median_mm / high).max(1.0).ln();
    reasons.push(UnitReason::Walls { median_mm, is_usual: beyond == 0.0 });
    let too_thin = evidence.least_wall.is_some_and(|wall| wall * mm < LEAST_WALL);
    let penalty = if too_thin { AT_USUAL_WALL } else { 0.0 };
    (AT_USUAL_WALL - WALL_SLOPE * beyond - penalty).clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO)
}

/// Whether a length is a multiple of `step`. `None` if too many lengths of this size are multiples by chance.
fn is_round(length_mm: f64, step: f64) -> Option<bool> {
    let tolerance = ROUND_TOLERANCE * length_mm;
    if length_mm <= 0.0 || 2.0 * tolerance / step > MAX_CHANCE {
        return None;
    }
    let nearest = (length_mm / step).round() * step;
    Some(nearest > 0.0 && (length_mm - nearest).abs() <= tolerance)
}

fn round_lengths(evidence: &SizeEvidence<'_>, mm: f64, reasons: &mut Vec<UnitReason>) -> f64 {
    let mut lengths: Vec<f64> = (evidence.bounds.max - evidence.bounds.min)
        .to_array()
        .into_iter()
        .chain(evidence.lengths.iter().copied())
        .chain(evidence.holes.iter().copied())
        .filter(|length| *length > 0.0 && length.is_finite())
        .collect();
    lengths.sort_by(f64::total_cmp);
    lengths.dedup_by(|a, b| (*a - *b).abs() <= ROUND_TOLERANCE * *b);
    let counted: Vec<[bool; 2]> = lengths
        .iter()
        .filter_map(|length| Some([is_round(length * mm, ROUND_METRIC)?, is_round(length * mm, ROUND_IMPERIAL)?]))
        .collect();
    if counted.is_empty() {
        return 0.0;
    }
    let [metric, imperial] = [0, 1].map(|k| counted.iter().filter(|round| round[k]).count());
    let of = counted.len();
    reasons.push(UnitReason::RoundLengths { metric, imperial, of });
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let (share, weight) =
        (metric.max(imperial) as f64 / of as f64, of.min(ENOUGH_LENGTHS) as f64 / ENOUGH_LENGTHS as f64);
    (((share + 0.05) / 1.05).ln() * weight).clamp(-MAX_LOG_RATIO, 0.0)
}

fn screw_holes(evidence: &SizeEvidence<'_>, mm: f64, reasons: &mut Vec<UnitReason>) -> f64 {
    let of = evidence.holes.len();
    let fits =
        |hole: &&f64| SCREW_HOLES.iter().any(|[low, high]| **hole * mm >= low - 1e-6 && **hole * mm <= high + 1e-6);
    let fit = evidence.holes.iter().filter(fits).count();
    if fit == 0 {
        return 0.0;
    }
    reasons.push(UnitReason::ScrewHoles { fit, of });
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let share = fit as f64 / of as f64;
    AT_SCREW_HOLES * share
}

fn program(evidence: &SizeEvidence<'_>) -> Option<(Unit, f64)> {
    let text = evidence.program?.to_lowercase();
    PROGRAMS.iter().find(|(name, ..)| text.contains(name)).map(|&(_, unit, weight)| (unit, weight))
}

/// Whether the longest side is 1 or 2. A side slightly below counts if the box is centred, or written by a program that normalises.
fn is_normalised(evidence: &SizeEvidence<'_>) -> bool {
    if evidence.stated.is_some_and(|(_, source)| source == UnitSource::Declared) {
        return false;
    }
    let longest = evidence.longest();
    let fits = NORMALISED.iter().any(|[low, high]| longest >= low - 1e-6 && longest <= high + 1e-6);
    let is_unit = [1.0, 2.0].iter().any(|side| (longest - side).abs() <= 1e-6);
    let is_centred = evidence.bounds.centre().abs().max_element() <= CENTRED * longest;
    let is_generated = evidence.program.is_some_and(|text| {
        let text = text.to_lowercase();
        NORMALISERS.iter().any(|name| text.contains(name))
    });
    (fits && (is_centred || is_generated)) || is_unit
}

#[cfg(test)]
mod tests;
