//! What presets and actions consist of, and what the options ask for beside a printable result.

use super::options::{Category, Nested, OpenSheets, Operator, Options, Preset, WindingRuleChoice};
use super::remesher::RemeshAction;
use super::report::{Action, PlannedAction, Strategy, When};

/// What a preset does, in order, and what runs after it when the result is not good enough.
pub(super) struct Recipe {
    pub preset: Preset,
    pub actions: &'static [Action],
}

/// The presets of the guide ("Filter Scripts & When to Use Them"). Normals are made consistent before holes are closed,
/// because a hole's border is walked along the winding, and outward afterwards, because only a closed part has a sign.
/// Cracks are stitched before anything is cut apart or filled, which would leave slivers in them.
/// What intersects is resolved last, because only closed surface has an inside, and sheets are kept apart after everything
/// that moves or makes faces.
pub(super) const RECIPES: [Recipe; 6] = {
    use Action::{BasicCleanup, FillHoles, FixNormals, Validate, VoxelRemesh};
    [
        Recipe { preset: Preset::BasicCleanup, actions: &[BasicCleanup, FixNormals, Validate] },
        Recipe { preset: Preset::FillHoles, actions: &[BasicCleanup, FixNormals, FillHoles, FixNormals, Validate] },
        Recipe { preset: Preset::FullRepair, actions: &mending(Action::FullRepair) },
        Recipe { preset: Preset::ConservativeRepair, actions: &mending(Action::ConservativeRepair) },
        Recipe { preset: Preset::ManifoldRepair, actions: &mending(Action::MakeManifold) },
        // A voxel remesh keeps only what is enclosed, so holes are closed before it.
        Recipe {
            preset: Preset::BlenderRemesh,
            actions: &[
                BasicCleanup,
                FixNormals,
                FillHoles,
                FixNormals,
                VoxelRemesh,
                BasicCleanup,
                FixNormals,
                FillHoles,
                FixNormals,
                Validate,
            ],
        },
    ]
};

/// The actions of the presets that mend, which differ in how.
const fn mending(mend: Action) -> [Action; 9] {
    use Action::{BasicCleanup, FillHoles, FixNormals, Perturb, SelfUnion, Stitch, Validate};
    [BasicCleanup, FixNormals, Stitch, mend, FillHoles, FixNormals, SelfUnion, Perturb, Validate]
}

/// What an action comes to, in order, before the options switch operators off.
fn operators_of(action: Action, sheets: OpenSheets) -> &'static [Operator] {
    use Operator as O;
    match action {
        Action::BasicCleanup => &[
            O::RoundCoordinates,
            O::RemoveCollapsedFaces,
            O::MergeVertices,
            O::Weld,
            O::RemoveDuplicates,
            O::RemoveCaps,
        ],
        Action::FixNormals => &[O::Orient, O::CutNonOrientable],
        Action::FillHoles => &[O::JoinParts, O::FillHoles, O::RemoveCaps],
        // What is exact first: it moves nothing, and what is then closed can't be merged amiss.
        Action::Stitch => &[O::SplitTJunctions, O::Sew, O::Stitch, O::RemoveSlivers],
        // What is open and no part of the model would leave it without an inside.
        Action::SelfUnion => &[O::RemoveDebris, O::SelfUnion],
        // A vertex that is moved aside may be moved into another face.
        Action::Perturb => &[O::Perturb, O::SelfUnion],
        // One of the two ways of `auto` leaves sheets that lie within a solid, since they may be seen through a hole of it.
        Action::FullRepair => &[
            O::UnfoldFoldovers,
            O::RemoveOverlappingNeighbours,
            O::RemoveInternalFaces,
            O::SplitNonManifold,
            O::DetachFins,
            O::CutNonOrientable,
        ],
        Action::ConservativeRepair | Action::MakeManifold => &[
            O::UnfoldFoldovers,
            O::RemoveOverlappingNeighbours,
            O::RemoveInternalSheets,
            O::RemoveInternalFaces,
            O::SplitNonManifold,
            O::DetachFins,
            O::CutNonOrientable,
        ],
        Action::CleanAndPatch => &[O::CleanAndPatch],
        Action::DropSmallParts => &[O::DropSmallParts],
        Action::Simplify => &[O::Simplify],
        // Small bits and what lies inside a solid go before they are made solid.
        Action::CloseSheets if sheets == OpenSheets::Base => &[O::RemoveDebris, O::AddBase],
        Action::CloseSheets => &[O::RemoveDebris, O::ThickenSheets, O::RemoveCaps],
        Action::NativeRemesh => &[O::Remesh],
        Action::VoxelRemesh | Action::BooleanUnion | Action::Validate => &[],
    }
}

/// An action with the operators that the options leave it.
pub(super) fn planned(action: Action, options: &Options) -> PlannedAction {
    let runs = |operator: &Operator| {
        let is_asked = match operator {
            Operator::MergeVertices => options.merge_distance.is_some_and(|distance| distance > 0.0),
            _ => !operator.is_on_request() || options.with.contains(operator),
        };
        is_asked && !options.without.contains(operator)
    };
    PlannedAction {
        action,
        operators: operators_of(action, options.open_sheets).iter().copied().filter(runs).collect(),
    }
}

/// The place of an operator in an action; those that it does not have come last.
fn in_order_of(action: Action, operator: Operator) -> usize {
    let operators = operators_of(action, OpenSheets::Auto);
    operators.iter().position(|&it| it == operator).unwrap_or(operators.len())
}

/// The preset for each category (the guide's "Category-to-Filter Mapping") and why.
pub(super) fn preset_for(category: Category, parts: u64) -> (Preset, &'static str) {
    match category {
        Category::Clean => (Preset::BasicCleanup, "nothing is wrong with the model"),
        Category::Orientation => (Preset::BasicCleanup, "only the direction of faces is wrong"),
        // Duplicates may be a sheet of two sides within a solid.
        Category::Degenerate if parts > 1 => {
            (Preset::ConservativeRepair, "faces are degenerate or duplicate, and there are several parts")
        }
        Category::Degenerate => (Preset::BasicCleanup, "only degenerate, duplicate or unjoined faces are wrong"),
        Category::OpenSheet => (
            Preset::BasicCleanup,
            "the model is an open surface that encloses nothing; closing it would invent a solid that it does not describe",
        ),
        _ if parts > 1 => (Preset::ConservativeRepair, "the model has several parts, and each must be kept"),
        Category::Holes | Category::ManySmallHoles => (Preset::FullRepair, "one part with holes"),
        Category::SelfIntersecting => (Preset::FullRepair, "one part whose faces intersect"),
        Category::NonManifold => (Preset::ManifoldRepair, "one part with non-manifold edges or vertices"),
        Category::Fragmented | Category::MultipleComponents | Category::Complex => {
            (Preset::ConservativeRepair, "several kinds of damage; the safe choice")
        }
    }
}

/// The tier that an action belongs to; 0 for validation.
pub(super) fn tier_of(action: Action) -> u8 {
    match action {
        Action::Validate => 0,
        Action::BasicCleanup | Action::FixNormals | Action::FillHoles | Action::DropSmallParts | Action::Simplify => 1,
        Action::FullRepair
        | Action::ConservativeRepair
        | Action::MakeManifold
        | Action::CloseSheets
        | Action::SelfUnion
        | Action::Perturb
        | Action::NativeRemesh => 2,
        Action::VoxelRemesh | Action::BooleanUnion => 3,
        _ => 2,
    }
}

/// What an action asks of Blender.
pub(super) fn remesh_action(action: Action) -> Option<RemeshAction> {
    match action {
        Action::VoxelRemesh => Some(RemeshAction::VoxelRemesh),
        Action::BooleanUnion => Some(RemeshAction::BooleanUnion),
        _ => None,
    }
}

/// The actions in the order in which a strategy runs them.
const ORDER: [Action; 16] = [
    Action::BasicCleanup,
    Action::FixNormals,
    Action::Stitch,
    Action::FullRepair,
    Action::ConservativeRepair,
    Action::MakeManifold,
    Action::FillHoles,
    Action::CleanAndPatch,
    Action::CloseSheets,
    Action::SelfUnion,
    Action::NativeRemesh,
    Action::VoxelRemesh,
    Action::Perturb,
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
    options.preset != Preset::Auto || options.category.is_some() || operators_asked_for(options).iter().any(closed_too)
}

/// The operators that the options ask for, whichever strategy is planned.
fn operators_asked_for(options: &Options) -> Vec<Operator> {
    let usual = Options::default();
    let above_zero = |value: Option<f64>| value.is_some_and(|value| value > 0.0);
    let is_raised = options.degenerate_tolerance > usual.degenerate_tolerance;
    let asked = [
        (options.nested == Nested::Alternate, Operator::Orient),
        (options.winding_rule != WindingRuleChoice::Auto, Operator::SelfUnion),
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
pub(super) fn with_requests(mut strategy: Strategy, options: &Options) -> Strategy {
    let remeshes = |it: &PlannedAction| {
        matches!(it.action, Action::NativeRemesh | Action::VoxelRemesh | Action::BooleanUnion)
            || it.operators.contains(&Operator::Remesh)
    };
    let decides_inside = strategy.when == When::NothingClosed || strategy.actions.iter().any(remeshes);
    for operator in operators_asked_for(options) {
        let runs = strategy.actions.iter().any(|it| it.operators.contains(&operator));
        let home = home_of(operator);
        let needless = operator == Operator::SelfUnion && decides_inside;
        if runs || needless || tier_of(home) > options.max_tier {
            continue;
        }
        strategy.tier = strategy.tier.max(tier_of(home));
        if let Some(own) = strategy.actions.iter_mut().find(|it| it.action == home) {
            own.operators.push(operator);
            own.operators.sort_by_key(|&it| in_order_of(home, it));
            continue;
        }
        let place = |action: Action| ORDER.iter().position(|&it| it == action);
        let at = strategy.actions.iter().skip(2).position(|it| place(it.action) > place(home));
        let at = at.map_or(strategy.actions.len(), |at| at + 2);
        strategy.actions.insert(at, PlannedAction { action: home, operators: vec![operator] });
    }
    strategy
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
        O::Orient | O::CutNonOrientable => Action::FixNormals,
        O::SplitTJunctions | O::Sew | O::Stitch | O::RemoveSlivers => Action::Stitch,
        O::UnfoldFoldovers
        | O::RemoveOverlappingNeighbours
        | O::RemoveInternalSheets
        | O::RemoveInternalFaces
        | O::SplitNonManifold
        | O::DetachFins => Action::MakeManifold,
        O::JoinParts | O::FillHoles => Action::FillHoles,
        O::CleanAndPatch => Action::CleanAndPatch,
        O::ThickenSheets | O::AddBase => Action::CloseSheets,
        O::SelfUnion | O::RemoveDebris => Action::SelfUnion,
        O::Remesh => Action::NativeRemesh,
        O::Perturb => Action::Perturb,
        O::DropSmallParts => Action::DropSmallParts,
        O::Simplify => Action::Simplify,
    }
}

/// The action of a strategy that Blender does, if there is one.
pub(super) fn remesh_of(strategy: &Strategy) -> Option<Action> {
    strategy.actions.iter().map(|planned| planned.action).find(|&action| remesh_action(action).is_some())
}
