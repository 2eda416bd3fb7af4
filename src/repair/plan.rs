//! The plan of a repair: the category of a model, and the strategies that follow from it and from the options.

use super::operators::sheets::SHEET_SHARE;
use super::options::{Category, Interior, OpenSheets, Operator, Options, Overlaps, Preset};
use super::presets::{RECIPES, planned, preset_for, tier_of, with_requests};
use super::report::{Action, Plan, PlannedAction, Strategy, When};
use crate::inspect::Measures;

/// Makes the plan: the requested preset, or the preset for the model's category; then Blender, unless the model is an open sheet or
/// `max_tier` forbids it.
///
/// If the options ask for solid sheets, every strategy makes them solid. Otherwise separate strategies do so, unless the whole model is a
/// sheet. They come after the strategies that leave sheets open, and before Blender, which would drop the sheets.
///
/// If no strategy can keep the faces, the surface is remeshed ([`Operator::Remesh`]) before Blender is tried.
///
/// Blender runs in two ways. A boolean union of the mesh with itself keeps sharp edges and faces but needs closed parts. It is tried first
/// if there are several parts, which may overlap or lie inside each other, or non-manifold edges, which often arise where solids touch. A
/// voxel remesh accepts any mesh and keeps no face. The preset `blender-remesh` runs only the voxel remesh.
#[must_use]
pub fn make_plan(before: &Measures, category: Category, is_double_shell: bool, options: &Options) -> Plan {
    let (preset, reason) = match options.preset {
        Preset::Auto => {
            let (preset, reason) = if category == Category::OpenSheet && asks_for_solids(options) {
                (Preset::ConservativeRepair, "the model is an open surface, and the options ask to make it solid")
            } else {
                preset_for(category, before.parts)
            };
            let reason = options.category.map_or_else(
                || reason.to_owned(),
                |category| format!("the options set the category `{}`: {reason}", category.as_str()),
            );
            (preset, format!("{reason}, so the preset `{}` was chosen", preset.as_str()))
        }
        requested => (requested, format!("the options set the preset `{}`", requested.as_str())),
    };
    let (filling, preset_and_reason) = filling_plan(is_double_shell, options, (preset, reason));
    let (plan_preset, reason) = preset_and_reason;
    let mut strategies: Vec<Strategy> = filling.into_iter().collect();
    let mut with_overlaps = None;
    if preset != Preset::BlenderRemesh {
        strategies.extend(strategy(preset, options, options.max_tier, None));
    }
    if options.preset == Preset::Auto && options.max_tier >= 2 && tier(preset) == 2 {
        // The other strategy pairs faces around non-manifold edges differently, and treats inverted parts differently.
        let other = if preset == Preset::FullRepair { Preset::ConservativeRepair } else { Preset::FullRepair };
        strategies.extend(strategy(other, options, options.max_tier, None));
        let both = [preset, other].map(|preset| strategy(preset, options, options.max_tier, None));
        let [mut first, _] = both.clone();
        // The last strategies before a remesh: remove defective regions and close their holes, or keep overlaps as they are.
        let cleaned = first.clone().map(|first| with_clean_and_patch(first, options));
        if options.open_sheets == OpenSheets::Auto {
            let closed = both.into_iter().flatten().map(|strategy| with_sheets_closed(strategy, options));
            strategies.extend(closed.map(|strategy| Strategy { when: When::OpenSheetsRemain, ..strategy }));
            first = first.map(|first| with_sheets_closed(first, options));
        }
        strategies.extend(cleaned);
        with_overlaps = first.map(without_self_union);
    }
    let remesh = preset == Preset::BlenderRemesh || !matches!(category, Category::OpenSheet | Category::Clean);
    // A remesh unites overlapping parts.
    let remesh = remesh && (options.overlaps == Overlaps::Union || options.preset == Preset::BlenderRemesh);
    if remesh && options.max_tier >= 2 && options.preset == Preset::Auto {
        let full_repair = strategy(Preset::FullRepair, options, options.max_tier, None);
        strategies.extend(full_repair.map(|strategy| with_native_remesh(strategy, options)));
    }
    strategies.extend(with_overlaps);
    if remesh && options.max_tier >= 3 {
        let union = before.parts > 1 || before.non_manifold_edges > 0;
        if union && preset != Preset::BlenderRemesh {
            strategies.extend(strategy(Preset::BlenderRemesh, options, 3, Some(Action::BooleanUnion)));
        }
        strategies.extend(strategy(Preset::BlenderRemesh, options, 3, None));
    }
    if preset == Preset::BlenderRemesh {
        // Blender may be missing, not allowed, or fail; a tier 1 result is better than none.
        strategies.extend(strategy(Preset::FillHoles, options, 1, None));
    }
    let strategies = strategies.into_iter().map(|strategy| with_requests(strategy, options)).collect();
    Plan { category, preset: plan_preset, reason, strategies }
}

/// The strategy that fills the interior, if the model is a double shell or the options ask for a solid, with the plan's preset and reason.
fn filling_plan(
    is_double_shell: bool,
    options: &Options,
    usual: (Preset, String),
) -> (Option<Strategy>, (Preset, String)) {
    let is_requested = options.print.interior == Interior::Fill;
    if options.preset == Preset::Generated || !(is_requested || is_double_shell) || options.max_tier < 2 {
        return (None, usual);
    }
    let reason = if is_requested {
        "the options ask to fill the interior, so the preset `generated` is tried first"
    } else {
        "the model is a double shell, which 3D model generators often produce, so the preset `generated` was chosen"
    };
    (strategy(Preset::Generated, options, options.max_tier, None), (Preset::Generated, reason.to_owned()))
}

/// The strategy of a preset: its actions up to a tier, with `instead_of_voxels` in place of the voxel remesh. The options may add a
/// reduction of faces before validation.
fn strategy(preset: Preset, options: &Options, max_tier: u8, instead_of_voxels: Option<Action>) -> Option<Strategy> {
    let recipe = RECIPES.iter().find(|r| r.preset == preset)?;
    let actions: Vec<Action> = recipe
        .actions
        .iter()
        .filter(|&&a| tier_of(a) <= max_tier)
        .map(|&a| if a == Action::VoxelRemesh { instead_of_voxels.unwrap_or(a) } else { a })
        .collect();
    let tier = actions.iter().map(|&a| tier_of(a)).max()?;
    let mut actions: Vec<PlannedAction> = actions.into_iter().map(|action| planned(action, options)).collect();
    if options.asks_for_fewer_faces() {
        let at = actions.iter().position(|planned| planned.action == Action::Validate).unwrap_or(actions.len());
        actions.insert(at, planned(Action::Simplify, options));
    }
    let strategy = Strategy { when: When::NothingAcceptable, tier, preset, actions };
    Some(if asks_for_solids(options) && max_tier >= 2 { with_sheets_closed(strategy, options) } else { strategy })
}

/// Whether the options ask to make open sheets solid.
fn asks_for_solids(options: &Options) -> bool {
    matches!(options.open_sheets, OpenSheets::Thicken | OpenSheets::Base)
}

/// Adds the closing of open sheets before the first action that needs closed surface: a self-union or a remesh.
fn with_sheets_closed(mut strategy: Strategy, options: &Options) -> Strategy {
    let needs_solids = |action| {
        matches!(action, Action::SelfUnion | Action::NativeRemesh | Action::VoxelRemesh | Action::BooleanUnion)
    };
    let is_later = |planned: &PlannedAction| needs_solids(planned.action) || planned.action == Action::Validate;
    let at = strategy.actions.iter().position(is_later);
    strategy.actions.insert(at.unwrap_or(strategy.actions.len()), planned(Action::CloseSheets, options));
    strategy.tier = strategy.tier.max(tier_of(Action::CloseSheets));
    strategy
}

/// Adds the removal and patching of defective regions before the self-union.
fn with_clean_and_patch(mut strategy: Strategy, options: &Options) -> Strategy {
    let at = strategy.actions.iter().position(|a| a.action == Action::SelfUnion).unwrap_or(strategy.actions.len());
    strategy.actions.insert(at, planned(Action::CleanAndPatch, options));
    strategy
}

/// Replaces the self-union by the native remesh.
fn with_native_remesh(mut strategy: Strategy, options: &Options) -> Strategy {
    strategy.actions.retain(|planned| planned.action != Action::Perturb);
    for action in &mut strategy.actions {
        if action.action == Action::SelfUnion {
            *action = planned(Action::NativeRemesh, options);
        }
    }
    strategy
}

/// Removes the self-union, so that overlaps stay: the result is closed but not printable.
fn without_self_union(mut strategy: Strategy) -> Strategy {
    for planned in &mut strategy.actions {
        planned.operators.retain(|&operator| operator != Operator::SelfUnion);
    }
    Strategy { when: When::NothingClosed, ..strategy }
}

/// The highest tier of a preset's actions.
fn tier(preset: Preset) -> u8 {
    let recipe = RECIPES.iter().find(|r| r.preset == preset);
    recipe.and_then(|r| r.actions.iter().map(|&a| tier_of(a)).max()).unwrap_or(0)
}

/// The thresholds between categories.
struct Thresholds {
    /// Least share of the area in open sheets of an open sheet.
    sheet_share: f64,
    /// Least number of boundary loops of a model with many holes.
    many_loops: u64,
    /// Least number of parts of a fragmented model, which must also meet one of the next two thresholds.
    fragments: u64,
    /// Most faces per part, on average.
    faces_per_fragment: u64,
    /// Least number of boundary loops per part.
    open_fragments: f64,
}

const THRESHOLDS: Thresholds =
    Thresholds { sheet_share: SHEET_SHARE, many_loops: 8, fragments: 10, faces_per_fragment: 20, open_fragments: 0.5 };

/// The category of a model's damage, by its measures and the share of its area in open sheets (0 to 1).
#[must_use]
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
pub fn categorise(m: &Measures, sheet_share: f64) -> Category {
    let t = &THRESHOLDS;
    if m.printable() {
        return Category::Clean;
    }
    if m.boundary_edges > 0 && sheet_share >= t.sheet_share {
        return Category::OpenSheet;
    }
    let small = m.faces <= m.parts.saturating_mul(t.faces_per_fragment);
    let open = m.boundary_loops as f64 >= m.parts as f64 * t.open_fragments;
    if m.parts >= t.fragments && (small || open) {
        return Category::Fragmented;
    }
    let nonmanifold = m.non_manifold_edges > 0 || m.non_manifold_vertices > 0;
    let holes = m.boundary_edges > 0;
    let turned = m.misoriented_edges > 0 || m.inverted_parts > 0 || m.volume.value < 0.0;
    let faces = m.degenerate_faces > 0
        || m.duplicate_faces > 0
        || m.non_finite_faces > 0
        || m.unreadable_faces > 0
        || m.unshared_edges > 0
        || m.near_coincident_defects > 0;
    let crossed = m.self_intersections.checked && !m.self_intersections.proven_none();
    match (nonmanifold, holes, crossed) {
        (false, false, false) if turned => Category::Orientation,
        (false, false, false) if faces => Category::Degenerate,
        _ if m.parts > 1 => Category::MultipleComponents,
        (true, false, false) => Category::NonManifold,
        (false, true, false) if turned => Category::Complex,
        (false, true, false) if m.boundary_loops >= t.many_loops => Category::ManySmallHoles,
        (false, true, false) => Category::Holes,
        (false, false, true) => Category::SelfIntersecting,
        _ => Category::Complex,
    }
}
