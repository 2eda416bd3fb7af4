//! What the options ask for beside a printable result.

use super::presets::{in_order_of, tier_of};
use super::{Action, InsideRule, Operator, Options, PlannedAction, Preset, Rung, When};
use crate::repair::operators::orient::Nested;

/// The actions in the order in which a strategy runs them.
const ORDER: [Action; 16] = [
    Action::BasicCleanup,
    Action::FixNormals,
    Action::Stitch,
    Action::Mend,
    Action::MendConservative,
    Action::MakeManifold,
    Action::FillHoles,
    Action::CleanAndPatch,
    Action::CloseSheets,
    Action::Resolve,
    Action::NativeRemesh,
    Action::VoxelRemesh,
    Action::Separate,
    Action::DropSmallParts,
    Action::Simplify,
    Action::Validate,
];

/// Whether the options ask for something that a printable model may not satisfy yet, fewer faces apart. Such a model is run through
/// the plan; without a request it comes back as it is.
///
/// Options about holes, cracks and open sheets ask for nothing here, since a printable model has none.
pub(super) fn ask_of_printable(options: &Options) -> bool {
    let closed_too = |operator: &Operator| !matches!(operator, Operator::Sew | Operator::Stitch);
    options.preset != Preset::Auto || options.category.is_some() || operators(options).iter().any(closed_too)
}

/// The operators that the options ask for, whichever strategy is planned.
pub(super) fn operators(options: &Options) -> Vec<Operator> {
    let usual = Options::default();
    let above_zero = |value: Option<f64>| value.is_some_and(|value| value > 0.0);
    let is_raised = options.degenerate_tolerance > usual.degenerate_tolerance;
    let asked = [
        (options.nested == Nested::Alternate, Operator::Orient),
        (options.inside != InsideRule::Auto, Operator::Resolve),
        (is_raised, Operator::RemoveSlivers),
        (is_raised, Operator::UnfoldFoldovers),
        (above_zero(options.merge_distance), Operator::MergeVertices),
        (above_zero(options.sew_ratio), Operator::Sew),
        (above_zero(options.stitch_threshold) || above_zero(options.stitch_distance), Operator::Stitch),
        (options.min_part_volume_pct > 0.0, Operator::DropSmallParts),
    ];
    let asked = asked.into_iter().filter(|(is_asked, _)| *is_asked).map(|(_, operator)| operator);
    let mut all: Vec<Operator> = asked.chain(options.with.iter().copied()).collect();
    // What opens holes is followed by what closes them.
    if all.iter().any(|it| matches!(it, Operator::RemoveOverlappingNeighbours | Operator::JoinParts)) {
        all.push(Operator::FillHoles);
    }
    all.retain(|operator| !options.without.contains(operator));
    all.sort_unstable();
    all.dedup();
    all
}

/// The strategy with every operator that the options ask for and that it lacks, as far as `max_tier` allows.
pub(super) fn with_requests(mut rung: Rung, options: &Options) -> Rung {
    let remeshes = |it: &PlannedAction| {
        matches!(it.action, Action::NativeRemesh | Action::VoxelRemesh | Action::BooleanUnion)
            || it.operators.contains(&Operator::Remesh)
    };
    let decides_inside = rung.when == When::NothingWhole || rung.actions.iter().any(remeshes);
    for operator in operators(options) {
        let runs = rung.actions.iter().any(|it| it.operators.contains(&operator));
        let home = home_of(operator);
        let needless = operator == Operator::Resolve && decides_inside;
        if runs || needless || tier_of(home) > options.max_tier {
            continue;
        }
        rung.tier = rung.tier.max(tier_of(home));
        if let Some(own) = rung.actions.iter_mut().find(|it| it.action == home) {
            own.operators.push(operator);
            own.operators.sort_by_key(|&it| in_order_of(home, it));
            continue;
        }
        let place = |action: Action| ORDER.iter().position(|&it| it == action);
        let at = rung.actions.iter().skip(2).position(|it| place(it.action) > place(home));
        let at = at.map_or(rung.actions.len(), |at| at + 2);
        rung.actions.insert(at, PlannedAction { action: home, operators: vec![operator] });
    }
    rung
}

/// The action that an operator runs in where a strategy lacks it.
fn home_of(operator: Operator) -> Action {
    use Operator as O;
    match operator {
        O::RoundCoordinates
        | O::RemoveCollapsedFaces
        | O::MergeVertices
        | O::Weld
        | O::RemoveDuplicates
        | O::RemoveCaps => Action::BasicCleanup,
        O::Orient | O::CutOneSided => Action::FixNormals,
        O::SplitTJunctions | O::Sew | O::Stitch | O::RemoveSlivers => Action::Stitch,
        O::UnfoldFoldovers
        | O::RemoveOverlappingNeighbours
        | O::RemoveSheetsWithin
        | O::RemoveMembranes
        | O::CutApart
        | O::FreeFins => Action::MakeManifold,
        O::JoinParts | O::FillHoles => Action::FillHoles,
        O::CleanAndPatch => Action::CleanAndPatch,
        O::ThickenSheets | O::AddBase => Action::CloseSheets,
        O::Resolve | O::RemoveDebris => Action::Resolve,
        O::Remesh => Action::NativeRemesh,
        O::Separate => Action::Separate,
        O::DropSmallParts => Action::DropSmallParts,
        O::Simplify => Action::Simplify,
    }
}
