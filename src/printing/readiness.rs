//! Print readiness: whether a file meets each rule of a process, with the measured values and their places.

use serde::{Deserialize, Serialize};

use super::features::{Features, find_features};
use super::hollows::{Cavity, Hollows, ResinCup, Trap, find_hollows};
use super::profile::{Limit, Profile};
use super::rules::{PrintRule, RuleOutcome, RulePlace, RuleResult, Severity};
use super::unit_candidates::units_of_box_in_doubt;
use crate::context::{Cancelled, Context};
use crate::inspect::{Analysis, Measures, Solid};

/// Whether a file meets the rules of a process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct PrintReadiness {
    /// Name of the profile.
    pub process: String,
    /// The profile's title.
    pub title: String,
    /// Whether the file passes every rule. A rule that could not be decided counts as not passed.
    pub ready: bool,
    /// The result for each rule of the profile.
    pub rules: Vec<RuleResult>,
    /// Sealed cavities, the largest first; at most 20.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cavities: Vec<Cavity>,
    /// Resin cups in the model's present orientation, the largest first; at most 20. Listed only for processes that print
    /// in liquid resin.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cups: Vec<ResinCup>,
}

/// The remedy for a file that cannot say its unit.
const LOST: &str = "Convert the lengths with `scale_to=mm`, or choose 3MF as output format.";
/// The remedy for a model that was scaled to a longest side of 1 or 2.
const NORMALISED: &str = "The size does not reveal the unit; set `target_height_mm` or `target_longest_mm`.";

/// A file to assess: the mesh as read from its bytes, and the number of these bytes.
#[derive(Clone, Copy)]
pub struct AssessedFile<'a> {
    /// The mesh, with its unit.
    pub analysis: &'a Analysis<'a>,
    /// The mesh's measures.
    pub measures: &'a Measures,
    /// Size of the file.
    pub bytes: u64,
    /// Whether the lengths are in another unit than millimetres, and the file cannot say so: slicers will read them as millimetres.
    pub lost_unit: bool,
}

impl AssessedFile<'_> {
    fn millimetres(&self) -> f64 {
        self.analysis.facts.unit.map_or(1.0, |unit| unit.used.millimetres())
    }
}

/// Assesses a file against the rules of a profile.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn assess(file: AssessedFile<'_>, profile: &Profile, context: &Context<'_>) -> Result<PrintReadiness, Cancelled> {
    let features = if file.measures.printable() { Some(find_features(file.analysis, profile, context)?) } else { None };
    let mut rules = vec![solid_rule(file.measures)];
    rules.extend(feature_rules(features.as_ref(), profile));
    rules.push(part_volume_rule(&file, profile, context)?);
    let escape_mm = profile.escape_holes.as_ref().map(|holes| holes.diameter_mm);
    let hollows = match features {
        Some(_) => find_hollows(file.analysis, escape_mm, profile.checks_cups, context)?,
        None => None,
    };
    rules.extend(escape_hole_rule(hollows.as_ref(), profile));
    rules.extend(build_volume_rule(&file, profile));
    rules.push(unit_rule(&file, profile));
    #[expect(clippy::cast_precision_loss, reason = "counts far below 2^53")]
    let counts = [
        (PrintRule::FaceCount, &profile.max_faces, file.measures.faces as f64),
        (PrintRule::FileSize, &profile.max_bytes, file.bytes as f64),
    ];
    rules.extend(counts.into_iter().filter_map(|(rule, limit, value)| Some(at_most(rule, limit.as_ref()?, value))));
    let ready = rules.iter().all(|rule| rule.result == RuleOutcome::Pass);
    let Hollows { cavities, cups, .. } = hollows.unwrap_or_default();
    Ok(PrintReadiness { process: profile.name.clone(), title: profile.title.clone(), ready, rules, cavities, cups })
}

impl PrintReadiness {
    /// The rules that the file does not pass.
    pub fn shortfalls(&self) -> impl Iterator<Item = &RuleResult> {
        self.rules.iter().filter(|rule| rule.result != RuleOutcome::Pass)
    }

    /// Shortens each list of places to its first `most` items. Keeps all counts.
    pub fn abridge(&mut self, most: usize) {
        self.rules.iter_mut().for_each(|rule| rule.places.truncate(most));
        self.cavities.truncate(most);
        self.cups.truncate(most);
    }

    /// The result in a sentence, and a second sentence about resin cups.
    #[must_use]
    pub fn in_words(&self) -> String {
        let failed: Vec<&str> = self.shortfalls().map(|rule| rule.rule.in_words()).collect();
        let result = match self.ready {
            true => format!("The model meets every rule of {}.", self.title),
            false => format!("The model does not meet these rules of {}: {}.", self.title, failed.join(", ")),
        };
        if self.cups.is_empty() {
            return result;
        }
        format!(
            "{result} In this orientation, {} during the print: {:.0} mm³. Turn the model, or drill a drain hole at the lowest point.",
            match self.cups.len() {
                1 => "a hollow holds resin".to_owned(),
                n => format!("{n} hollows hold resin"),
            },
            self.cups.iter().map(|cup| cup.volume_mm3).sum::<f64>()
        )
    }
}

/// Whether the value is at most the limit.
fn at_most(rule: PrintRule, limit: &Limit, value: f64) -> RuleResult {
    if value <= limit.limit {
        RuleResult::pass(rule, Some(limit.limit), Some(value))
    } else {
        RuleResult::fail(rule, limit.limit, value > limit.minimum.max(limit.limit), value)
    }
}

fn solid_rule(measures: &Measures) -> RuleResult {
    match measures.verdict() {
        Some(true) => RuleResult::pass(PrintRule::Solid, None, None),
        None => RuleResult::undecided(PrintRule::Solid, None),
        Some(false) => RuleResult {
            result: RuleOutcome::Fail,
            severity: Some(Severity::BeyondAll),
            count: measures.defects(),
            remedy: Some(PrintRule::Solid.remedy(0.0)),
            ..RuleResult::pass(PrintRule::Solid, None, None)
        },
    }
}

/// The rules about walls, bars, details and gaps.
fn feature_rules(features: Option<&Features>, profile: &Profile) -> Vec<RuleResult> {
    let rules = [
        (PrintRule::SupportedWall, &profile.supported_wall_mm),
        (PrintRule::FreeWall, &profile.free_wall_mm),
        (PrintRule::Wire, &profile.wire_mm),
        (PrintRule::Pin, &profile.pin_mm),
        (PrintRule::EmbossedDetail, &profile.embossed_mm),
        (PrintRule::Hole, &profile.hole_mm),
        (PrintRule::Gap, &profile.gap_mm),
        (PrintRule::Clearance, &profile.clearance_mm),
        (PrintRule::EngravedDetail, &profile.engraved_mm),
    ];
    rules.into_iter().map(|(rule, limit)| feature_rule(features, rule, limit)).collect()
}

fn feature_rule(features: Option<&Features>, rule: PrintRule, limit: &Limit) -> RuleResult {
    let Some(features) = features else { return RuleResult::undecided(rule, Some(limit.limit)) };
    let of_rule = || features.all.iter().filter(|feature| feature.rule == rule);
    let measured = of_rule().map(|feature| feature.width_mm).min_by(f64::total_cmp);
    let broken = || of_rule().filter(|feature| feature.width_mm < limit.limit);
    let Some(worst) = broken().map(|feature| feature.width_mm).min_by(f64::total_cmp) else {
        return match features.is_complete {
            true => RuleResult::pass(rule, Some(limit.limit), measured),
            false => RuleResult { measured, ..RuleResult::undecided(rule, Some(limit.limit)) },
        };
    };
    let places = broken().map(|feature| RulePlace {
        at: feature.at.to_array(),
        value: feature.width_mm,
        area_mm2: Some(feature.area_mm2),
    });
    RuleResult::fail(rule, limit.limit, worst < limit.minimum, worst).at(places.collect())
}

/// The rule about the volume of separate solids. Surfaces of cavities are not solids.
fn part_volume_rule(
    file: &AssessedFile<'_>,
    profile: &Profile,
    context: &Context<'_>,
) -> Result<RuleResult, Cancelled> {
    let limit = &profile.part_volume_mm3;
    if !file.measures.printable() {
        return Ok(RuleResult::undecided(PrintRule::PartVolume, Some(limit.limit)));
    }
    let depths = file.analysis.depths(context)?;
    let mm3 = file.millimetres().powi(3);
    let is_solid =
        |(solid, depth): &(&Solid, &Option<u32>)| solid.volume != 0.0 && depth.is_none_or(|depth| depth % 2 == 0);
    let solids = file.analysis.solids.iter().zip(depths).filter(is_solid);
    let volumes: Vec<(f64, [f64; 3])> =
        solids.map(|(solid, _)| (solid.volume.abs() * mm3, solid.bounds.centre().to_array())).collect();
    let least = volumes.iter().map(|(volume, _)| *volume).min_by(f64::total_cmp);
    let Some(least) = least else { return Ok(RuleResult::undecided(PrintRule::PartVolume, Some(limit.limit))) };
    if least >= limit.limit {
        return Ok(RuleResult::pass(PrintRule::PartVolume, Some(limit.limit), Some(least)));
    }
    let small = volumes.into_iter().filter(|(volume, _)| *volume < limit.limit);
    let places = small.map(|(value, at)| RulePlace { at, value, area_mm2: None }).collect();
    Ok(RuleResult::fail(PrintRule::PartVolume, limit.limit, least < limit.minimum, least).at(places))
}

/// The rule about escape holes; `None` if the process lets cavities stay closed. The measured value is the least
/// width of a cavity's widest opening: 0 for a sealed cavity.
fn escape_hole_rule(hollows: Option<&Hollows>, profile: &Profile) -> Option<RuleResult> {
    let limit = profile.escape_holes.as_ref()?.diameter_mm;
    let rule = PrintRule::EscapeHoles;
    let Some(hollows) = hollows else { return Some(RuleResult::undecided(rule, Some(limit))) };
    let place = |trap: &Trap| RulePlace { at: trap.at, value: trap.opening_mm, area_mm2: None };
    let places: Vec<RulePlace> = hollows.traps.iter().map(place).collect();
    let least = places.iter().map(|place| place.value).min_by(f64::total_cmp);
    Some(match least {
        Some(least) => RuleResult::fail(rule, limit, least == 0.0, least).at(places),
        None if hollows.is_complete => RuleResult::pass(rule, Some(limit), None),
        None => RuleResult::undecided(rule, Some(limit)),
    })
}

/// The rule about the unit. Measured are the millimetres of the file's unit, the limit those of the likely unit, or of the one that
/// slicers assume.
fn unit_rule(file: &AssessedFile<'_>, profile: &Profile) -> RuleResult {
    let (Some(bounds), Some(unit)) = (file.measures.bounding_box, file.analysis.facts.unit) else {
        return RuleResult::undecided(PrintRule::Unit, None);
    };
    if file.lost_unit {
        let failed = RuleResult::fail(PrintRule::Unit, 1.0, true, unit.used.millimetres());
        return RuleResult { remedy: Some(LOST.to_owned()), ..failed };
    }
    let volume = profile.build_volume_mm.as_ref().map(|volume| volume.size);
    let Some(doubt) = units_of_box_in_doubt(bounds, unit, volume) else {
        return RuleResult::pass(PrintRule::Unit, None, None);
    };
    match doubt.likely {
        Some(likely) => RuleResult::fail(PrintRule::Unit, likely.millimetres(), false, unit.used.millimetres()),
        None if doubt.normalised => {
            RuleResult { remedy: Some(NORMALISED.to_owned()), ..RuleResult::undecided(PrintRule::Unit, None) }
        }
        // The size is unusual, but no other unit is much more likely.
        None => RuleResult::pass(PrintRule::Unit, None, None),
    }
}

/// The rule about the build volume; `None` if the process has no limit. Limit and measured value are the side length
/// that needs the largest share of the machine's side, with the axes in the best order.
fn build_volume_rule(file: &AssessedFile<'_>, profile: &Profile) -> Option<RuleResult> {
    let mut available = profile.build_volume_mm.as_ref()?.size;
    let Some(bounds) = file.measures.bounding_box else {
        return Some(RuleResult::undecided(PrintRule::BuildVolume, None));
    };
    let mut sides = [0, 1, 2].map(|k| (bounds.max[k] - bounds.min[k]) * file.millimetres());
    sides.sort_by(f64::total_cmp);
    available.sort_by(f64::total_cmp);
    let shares = sides.iter().zip(available).map(|(&side, limit)| (side / limit, side, limit));
    let (share, side, limit) = shares.max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(if share <= 1.0 {
        RuleResult::pass(PrintRule::BuildVolume, Some(limit), Some(side))
    } else {
        RuleResult::fail(PrintRule::BuildVolume, limit, false, side)
    })
}
