//! Presets as data: the actions of each preset, the operators of each action, and the operators that options add.

use super::options::{
    Category, Interior, Islands, Nested, OpenSheets, Operator, Options, Preset, Voids, WindingRuleChoice,
};
use super::remesher::RemeshAction;
use super::report::{Action, PlannedAction, Strategy, When};

/// A preset with its actions in order.
pub(super) struct Recipe {
    /// The preset.
    pub preset: Preset,
    /// The actions in order.
    pub actions: &'static [Action],
}

/// The presets, after the MeshPrep repair strategy guide ("Filter Scripts & When to Use Them").
///
/// - Faces are oriented consistently before holes are closed, because a hole's boundary is followed along the winding. They are oriented
///   outward afterwards, because only a closed part has an outside.
/// - Cracks are stitched before edges are split or holes filled; both would leave slivers in the cracks.
/// - Intersections are resolved last, because only closed surface has an inside. Coincident vertices are moved apart after all operators
///   that move or create faces.
pub(super) const RECIPES: [Recipe; 7] = {
    use Action::{BasicCleanup, FillHoles, FixNormals, Validate, VoxelRemesh};
    [
        Recipe { preset: Preset::BasicCleanup, actions: &[BasicCleanup, FixNormals, Validate] },
        Recipe { preset: Preset::FillHoles, actions: &[BasicCleanup, FixNormals, FillHoles, FixNormals, Validate] },
        Recipe { preset: Preset::FullRepair, actions: &tier_2_actions(Action::FullRepair) },
        Recipe { preset: Preset::ConservativeRepair, actions: &tier_2_actions(Action::ConservativeRepair) },
        Recipe { preset: Preset::ManifoldRepair, actions: &tier_2_actions(Action::MakeManifold) },
        Recipe {
            preset: Preset::Generated,
            actions: &[
                BasicCleanup,
                FixNormals,
                Action::FillInterior,
                FixNormals,
                Action::SelfUnion,
                Action::TreatIslands,
                Validate,
            ],
        },
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

/// The actions of the tier-2 presets, which differ only in the action `repair_action`.
const fn tier_2_actions(repair_action: Action) -> [Action; 9] {
    use Action::{BasicCleanup, FillHoles, FixNormals, Perturb, SelfUnion, Stitch, Validate};
    [BasicCleanup, FixNormals, Stitch, repair_action, FillHoles, FixNormals, SelfUnion, Perturb, Validate]
}

/// The operators of an action in order, before the options add or remove any.
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
        // The exact operator comes first: it moves no vertex, and vertices of edges that it closes cannot be merged wrongly.
        Action::Stitch => &[O::SplitTJunctions, O::Sew, O::Stitch, O::RemoveSlivers],
        // Open debris would leave the model without an inside.
        Action::SelfUnion => &[O::RemoveDebris, O::SelfUnion],
        // Moving a vertex may move it through another face.
        Action::Perturb => &[O::Perturb, O::SelfUnion],
        // Unlike the other presets, this one keeps sheets inside a solid, because they may be visible through a hole.
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
        Action::FillInterior => &[O::FillInterior],
        Action::TreatIslands => &[O::TreatIslands],
        Action::TreatVoids => &[O::FillVoids, O::VentVoids],
        Action::ThickenWalls => &[O::ThickenWalls],
        Action::CleanAndPatch => &[O::CleanAndPatch],
        Action::DropSmallParts => &[O::DropSmallParts],
        Action::Simplify => &[O::Simplify],
        // Debris and sheets inside a solid are removed first, so that they are not made solid.
        Action::CloseSheets if sheets == OpenSheets::Base => &[O::RemoveDebris, O::AddBase],
        Action::CloseSheets => &[O::RemoveDebris, O::ThickenSheets, O::RemoveCaps],
        Action::NativeRemesh => &[O::Remesh],
        Action::VoxelRemesh | Action::BooleanUnion | Action::Validate => &[],
    }
}

/// An action with the operators that the options leave it.
pub(super) fn planned(action: Action, options: &Options) -> PlannedAction {
    let runs = |operator: &Operator| {
        let is_requested = match operator {
            Operator::TreatIslands => options.print.islands.drops(true),
            Operator::MergeVertices => options.merge_distance.is_some_and(|distance| distance > 0.0),
            _ => !operator.is_on_request() || options.with.contains(operator),
        };
        is_requested && !options.without.contains(operator)
    };
    PlannedAction {
        action,
        operators: operators_of(action, options.open_sheets).iter().copied().filter(runs).collect(),
    }
}

/// The position of an operator in an action. Operators that the action lacks come last.
fn position_in(action: Action, operator: Operator) -> usize {
    let operators = operators_of(action, OpenSheets::Auto);
    operators.iter().position(|&other| other == operator).unwrap_or(operators.len())
}

/// The preset for a category, with the reason, after the MeshPrep guide ("Category-to-Filter Mapping").
pub(super) fn preset_for(category: Category, parts: u64) -> (Preset, &'static str) {
    match category {
        Category::Clean => (Preset::BasicCleanup, "the model has no defects"),
        Category::Orientation => (Preset::BasicCleanup, "only the orientation of faces is wrong"),
        // Duplicate faces may be a two-sided sheet inside a solid.
        Category::Degenerate if parts > 1 => {
            (Preset::ConservativeRepair, "the model has degenerate or duplicate faces and several parts")
        }
        Category::Degenerate => (Preset::BasicCleanup, "the only defects are degenerate, duplicate or unjoined faces"),
        Category::OpenSheet => (
            Preset::BasicCleanup,
            "the model is an open surface that encloses nothing, and closing it would invent a solid",
        ),
        _ if parts > 1 => (Preset::ConservativeRepair, "the model has several parts, and all must be kept"),
        Category::Holes | Category::ManySmallHoles => (Preset::FullRepair, "the model is one part with holes"),
        Category::SelfIntersecting => (Preset::FullRepair, "the model is one part with intersecting faces"),
        Category::NonManifold => (Preset::ManifoldRepair, "the model is one part with non-manifold edges or vertices"),
        Category::Fragmented | Category::MultipleComponents | Category::Complex => {
            (Preset::ConservativeRepair, "the model has several kinds of damage, and this preset is the safest")
        }
    }
}

/// The tier of an action; 0 for validation.
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
        | Action::FillInterior
        | Action::TreatIslands
        | Action::TreatVoids
        | Action::ThickenWalls
        | Action::NativeRemesh => 2,
        Action::VoxelRemesh | Action::BooleanUnion => 3,
        _ => 2,
    }
}

/// The work that an action gives to Blender; none if the action does not use Blender.
pub(super) fn remesh_action(action: Action) -> Option<RemeshAction> {
    match action {
        Action::VoxelRemesh => Some(RemeshAction::VoxelRemesh),
        Action::BooleanUnion => Some(RemeshAction::BooleanUnion),
        _ => None,
    }
}

/// The actions in the order in which a strategy runs them.
const ORDER: [Action; 20] = [
    Action::BasicCleanup,
    Action::FixNormals,
    Action::FillInterior,
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
    Action::TreatIslands,
    Action::TreatVoids,
    Action::ThickenWalls,
    Action::Simplify,
    Action::Validate,
];

/// Whether the options ask for changes to a printable model, apart from fewer faces. Otherwise a printable model is returned unchanged.
///
/// Options about holes, cracks and open sheets do not count, because a printable model has none.
pub(super) fn changes_printable(options: &Options) -> bool {
    let affects_closed = |operator: &Operator| !matches!(operator, Operator::Sew | Operator::Stitch);
    options.preset != Preset::Auto
        || options.category.is_some()
        || options.print.interior == Interior::Fill
        || operators_asked_for(options).iter().any(affects_closed)
}

/// The operators that the options ask for in every strategy.
fn operators_asked_for(options: &Options) -> Vec<Operator> {
    let defaults = Options::default();
    let above_zero = |value: Option<f64>| value.is_some_and(|value| value > 0.0);
    let is_raised = options.degenerate_tolerance > defaults.degenerate_tolerance;
    let requested = [
        (options.nested == Nested::Alternate, Operator::Orient),
        (options.winding_rule != WindingRuleChoice::Auto, Operator::SelfUnion),
        (is_raised, Operator::RemoveSlivers),
        (is_raised, Operator::UnfoldFoldovers),
        (above_zero(options.merge_distance), Operator::MergeVertices),
        (above_zero(options.sew_ratio), Operator::Sew),
        (above_zero(options.stitch_threshold) || above_zero(options.stitch_distance), Operator::Stitch),
        (options.min_part_volume_pct > 0.0, Operator::DropSmallParts),
        (matches!(options.print.islands, Islands::Drop | Islands::Attach), Operator::TreatIslands),
        (options.print.fills_cavities(), Operator::FillVoids),
        (options.print.voids == Voids::Vent, Operator::VentVoids),
        (options.print.wall_to_reach_mm().is_some(), Operator::ThickenWalls),
    ];
    let requested = requested.into_iter().filter(|(is_requested, _)| *is_requested).map(|(_, operator)| operator);
    let mut all: Vec<Operator> = requested.chain(options.with.iter().copied()).collect();
    // These operators open holes, so hole filling must follow.
    if all.iter().any(|operator| matches!(operator, Operator::RemoveOverlappingNeighbours | Operator::JoinParts)) {
        all.push(Operator::FillHoles);
    }
    all.retain(|operator| !options.without.contains(operator));
    all.sort_unstable();
    all.dedup();
    all
}

/// Adds to a strategy the operators that the options ask for and that the strategy lacks, as far as `max_tier` allows.
pub(super) fn with_requests(mut strategy: Strategy, options: &Options) -> Strategy {
    let remeshes = |planned: &PlannedAction| {
        matches!(planned.action, Action::NativeRemesh | Action::VoxelRemesh | Action::BooleanUnion)
            || planned.operators.contains(&Operator::Remesh)
    };
    let decides_inside = strategy.when == When::NothingClosed || strategy.actions.iter().any(remeshes);
    for operator in operators_asked_for(options) {
        let runs = strategy.actions.iter().any(|planned| planned.operators.contains(&operator));
        let action = action_for(operator);
        let needless = operator == Operator::SelfUnion && decides_inside;
        if runs || needless || tier_of(action) > options.max_tier {
            continue;
        }
        strategy.tier = strategy.tier.max(tier_of(action));
        if let Some(existing) = strategy.actions.iter_mut().find(|planned| planned.action == action) {
            existing.operators.push(operator);
            existing.operators.sort_by_key(|&other| position_in(action, other));
            continue;
        }
        let position = |action: Action| ORDER.iter().position(|&other| other == action);
        let at = strategy.actions.iter().skip(2).position(|planned| position(planned.action) > position(action));
        let at = at.map_or(strategy.actions.len(), |at| at + 2);
        strategy.actions.insert(at, PlannedAction { action, operators: vec![operator] });
    }
    strategy
}

/// The action that an operator is added to if a strategy lacks the operator.
fn action_for(operator: Operator) -> Action {
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
        O::FillInterior => Action::FillInterior,
        O::TreatIslands => Action::TreatIslands,
        O::FillVoids | O::VentVoids => Action::TreatVoids,
        O::ThickenWalls => Action::ThickenWalls,
        O::Simplify => Action::Simplify,
    }
}

/// The action of a strategy that uses Blender, if there is one.
pub(super) fn remesh_of(strategy: &Strategy) -> Option<Action> {
    strategy.actions.iter().map(|planned| planned.action).find(|&action| remesh_action(action).is_some())
}
