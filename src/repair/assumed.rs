//! What was decided without proof on the way to a result.

use super::account::Ended;
use super::input::Input;
use super::operators::thicken::THICKNESS;
use super::verdict::Judged;
use super::{Assumption, AssumptionKind, ChangeKind, InsideRule, Operator, Options, Rung, Step, StepStatus};
use crate::inspect::{Analysis, Certificate, Measures, Solid};

/// The assumptions behind the result of a strategy.
pub(super) fn assumptions(ended: &Ended, judged: &Judged, input: &Input<'_>, options: &Options) -> Vec<Assumption> {
    let of_strategy = |step: &&Step| Some(step.rung) == ended.strategy && step.status == StepStatus::Done;
    let steps: Vec<&Step> = ended.steps.iter().filter(of_strategy).collect();
    let (before, input) = (&input.before.measures, input.analysis);
    let diagonal = input.surface.bounds().diagonal();
    let mut all = judged.assumptions.clone();
    all.extend(small_parts_dropped(&steps, judged, input));
    all.extend(invented(&steps, judged, options, diagonal));
    all.extend(large_holes(judged, diagonal));
    let strategy = ended.strategy.and_then(|index| ended.plan.rungs.get(index as usize));
    all.extend(strategy.and_then(|strategy| winding_rule(&steps, strategy, before, options)));
    all.extend(pieces_dropped(judged, input));
    all.extend(cavities(judged, input));
    all
}

/// How much of one kind the operator changed.
fn changed(steps: &[&Step], operator: Operator, what: ChangeKind) -> u64 {
    let of_operator = steps.iter().filter(|step| step.operator == Some(operator));
    of_operator.flat_map(|step| &step.changed).filter(|change| change.what == what).map(|change| change.count).sum()
}

/// "One" and the singular, or the count and the plural.
pub(super) fn counted(count: u64, one: &str, many: &str) -> String {
    if count == 1 { format!("One {one}") } else { format!("{count} {many}") }
}

/// Thickened sheets, bases, and parts joined.
fn invented(steps: &[&Step], judged: &Judged, options: &Options, diagonal: f64) -> Vec<Assumption> {
    let (it, mut all) = (&judged.invented, Vec::new());
    let places = || it.places.iter().map(|at| at.to_array());
    let thickness = options.thickness.unwrap_or(THICKNESS * diagonal);
    let sheets = changed(steps, Operator::ThickenSheets, ChangeKind::SheetsThickened);
    if sheets > 0 {
        let share = it.share_pct(it.skins);
        let detail = format!(
            "{} given a thickness of {thickness:.4}; {share:.1} % of the result's surface is new by it.",
            counted(sheets, "open sheet that encloses nothing was", "open sheets that enclose nothing were")
        );
        let told = Assumption::new(AssumptionKind::SheetsThickened, sheets, detail).with_amount(thickness);
        all.push(told.with_share(share).at(places()).unless("open_sheets=leave"));
    }
    let faces = changed(steps, Operator::Resolve, ChangeKind::FacesAroundOpenRoomsThickened);
    if faces > 0 {
        let share = it.share_pct(it.opened_skins);
        let detail = format!(
            "{} around regions into which one can look through holes given a thickness of {thickness:.4}, and the regions \
             were left open; {share:.1} % of the result's surface is new by it.",
            counted(faces, "face was", "faces were")
        );
        let told = Assumption::new(AssumptionKind::SheetsThickened, faces, detail).with_amount(thickness);
        all.push(told.with_share(share).at(places()).unless("open_sheets=leave"));
    }
    let bases = changed(steps, Operator::AddBase, ChangeKind::BasesAdded);
    if bases > 0 {
        let share = it.share_pct(it.bases);
        let detail = format!(
            "{} closed by a base {thickness:.4} thick at its lowest point; {share:.1} % of the result's surface is new by it.",
            counted(bases, "open surface was", "open surfaces were")
        );
        let told = Assumption::new(AssumptionKind::BasesAdded, bases, detail).with_amount(thickness);
        all.push(told.with_share(share).at(places()).unless("open_sheets=leave"));
    }
    let joined = changed(steps, Operator::JoinParts, ChangeKind::PartsJoined);
    if joined > 0 {
        let detail = format!("{joined} bands of surface join parts that were apart.");
        all.push(Assumption::new(AssumptionKind::PartsJoined, joined, detail).unless("without=join_parts"));
    }
    all
}

fn large_holes(judged: &Judged, diagonal: f64) -> Option<Assumption> {
    let it = &judged.invented;
    let smallest = it.patches.iter().map(|patch| patch.extent).reduce(f64::min)?;
    let (count, area) = (it.patches.len() as u64, it.patch_area());
    let share = it.share_pct(area);
    let detail = format!(
        "{} closed with {share:.1} % of the result's surface.",
        counted(count, "large hole was", "large holes were")
    );
    let below = ((smallest / diagonal * 1000.0).floor() - 1.0).clamp(0.0, 999.0) / 1000.0;
    let told = Assumption::new(AssumptionKind::LargeHolesClosed, count, detail).with_amount(area).with_share(share);
    let places = it.patches.iter().map(|patch| patch.at.to_array());
    Some(told.at(places).unless(&format!("max_hole_size={below}")))
}

/// The winding rule that `auto` chose, where intersecting surface looks in different ways.
fn winding_rule(steps: &[&Step], strategy: &Rung, before: &Measures, options: &Options) -> Option<Assumption> {
    let resolved = steps.iter().any(|step| step.operator == Some(Operator::Resolve) && !step.changed.is_empty());
    let is_open_question = before.inverted_parts > 0 || before.misoriented_edges > 0;
    if options.inside != InsideRule::Auto || !resolved || !is_open_question {
        return None;
    }
    let (detail, other) = match super::tiers::takes_inverted_for_solid(strategy, options) {
        true => ("Where faces intersect, parts that are inside out were taken for solid too.", "inside=positive"),
        false => {
            ("Where faces intersect, only what the surface winds around outward was taken for solid.", "inside=nonzero")
        }
    };
    Some(Assumption::new(AssumptionKind::WindingRule, 1, detail).unless(other))
}

/// The input's parts with one of these certificates.
fn certified<'a>(
    judged: &'a Judged,
    input: &'a Analysis<'_>,
    is_one: impl Fn(Certificate) -> bool + 'a,
) -> Vec<&'a Solid> {
    let certificates = judged.ledger.iter().flat_map(|ledger| &ledger.certificates);
    certificates.filter(|it| is_one(it.certificate)).filter_map(|it| input.solids.get(it.part as usize)).collect()
}

/// The pieces that were dropped as the options ask, with the area of the input's parts among them.
fn small_parts_dropped(steps: &[&Step], judged: &Judged, input: &Analysis<'_>) -> Option<Assumption> {
    let count = changed(steps, Operator::DropSmallParts, ChangeKind::SmallPartsDropped);
    let words = if count == 1 { "1 closed part was".to_owned() } else { format!("{count} closed parts were") };
    let certified = judged.ledger.iter().flat_map(|ledger| &ledger.certified);
    let dropped = certified.filter(|(_, certificate)| *certificate == Certificate::Dropped);
    let area: f64 = dropped.map(|(part, _)| input.solids[*part as usize].area).sum();
    let told = format!("{words} dropped: smaller than `min_part_volume_pct`.");
    (count > 0).then(|| {
        Assumption::new(AssumptionKind::PiecesDropped, count, told)
            .with_amount(area)
            .with_share(area / judged.measures.area * 100.0)
            .unless("min_part_volume_pct=0")
    })
}

fn pieces_dropped(judged: &Judged, input: &Analysis<'_>) -> Option<Assumption> {
    let ledger = judged.ledger.as_ref()?;
    let count = ledger.debris + ledger.no_volume;
    if count == 0 {
        return None;
    }
    let pieces = certified(judged, input, |it| matches!(it, Certificate::Debris | Certificate::NoVolume));
    let area: f64 = pieces.iter().map(|piece| piece.area).sum();
    let detail = format!(
        "{} dropped: nothing is enclosed, or too little to print.",
        counted(count, "stray piece was", "stray pieces were")
    );
    let option = if ledger.debris > 0 { "without=remove_debris" } else { "open_sheets=thicken" };
    let told = Assumption::new(AssumptionKind::PiecesDropped, count, detail).with_amount(area);
    Some(told.at(pieces.iter().map(|piece| piece.bounds.centre().to_array())).unless(option))
}

/// Sealed cavities that are kept, and those that are filled.
fn cavities(judged: &Judged, input: &Analysis<'_>) -> Vec<Assumption> {
    let mut all = Vec::new();
    if !judged.cavities.is_empty() {
        let (count, volume) = (judged.cavities.len() as u64, judged.cavities.iter().map(|it| it.0).sum());
        let detail = format!("{} kept hollow.", counted(count, "sealed cavity was", "sealed cavities were"));
        let told = Assumption::new(AssumptionKind::CavitiesKept, count, detail).with_amount(volume);
        all.push(told.at(judged.cavities.iter().map(|it| it.1)));
    }
    let mut filled = certified(judged, input, |it| it == Certificate::InsideAnother);
    filled.retain(|part| part.closed && part.volume < 0.0);
    if !filled.is_empty() {
        let (count, volume) = (filled.len() as u64, filled.iter().map(|it| it.volume.abs()).sum());
        let detail = format!("{} filled.", counted(count, "sealed cavity was", "sealed cavities were"));
        let told = Assumption::new(AssumptionKind::CavitiesFilled, count, detail).with_amount(volume);
        all.push(told.at(filled.iter().map(|it| it.bounds.centre().to_array())).unless("inside=odd"));
    }
    all
}
