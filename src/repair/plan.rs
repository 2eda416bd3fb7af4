//! The plan of a repair: the category of a model, and the strategies that follow from it and from the options.

use super::options::{Category, OpenSheets, Operator, Options, Overlaps, Preset};
use super::presets::{RECIPES, planned, preset_for, tier_of, with_requests};
use super::report::{Action, Plan, PlannedAction, Strategy, When};
use super::sheets::SHEET_SHARE;
use crate::inspect::Measures;

/// Makes the plan: the preset that was asked for, or the one for the model's category; then Blender, unless the model
/// is an open sheet or `max_tier` forbids it.
///
/// Open sheets are made solid in every strategy where that was asked for. Otherwise, where they are not the whole model, in a strategy
/// of its own, after those that leave them open and before Blender, which would keep nothing of them.
///
/// Where no way keeps the faces, the surface is made anew ([`Operator::Remesh`]), before Blender is asked for the same.
///
/// Blender comes in two ways. A boolean union with itself keeps sharp edges and faces where they are but needs
/// closed parts; so it is tried first where there are several parts, which may overlap or lie in one another, or
/// non-manifold edges, which often are where solids touch. A voxel remesh takes anything and keeps no face; it alone runs where it was
/// asked for.
#[must_use]
pub fn make_plan(before: &Measures, category: Category, options: &Options) -> Plan {
    let (preset, reason) = match options.preset {
        Preset::Auto => {
            let (preset, reason) = if category == Category::OpenSheet && asks_for_solids(options) {
                (Preset::ConservativeRepair, "the model is an open surface and was asked to be made solid")
            } else {
                preset_for(category, before.parts)
            };
            let reason = options.category.map_or_else(
                || reason.to_owned(),
                |it| format!("the category {} was asked for: {reason}", it.as_str()),
            );
            (preset, format!("{reason}, so {} was chosen", preset.as_str()))
        }
        asked => (asked, format!("{} was asked for", asked.as_str())),
    };
    let mut strategies = Vec::new();
    let mut whole = None;
    if preset != Preset::BlenderRemesh {
        strategies.extend(strategy(preset, options, options.max_tier, None));
    }
    if options.preset == Preset::Auto && options.max_tier >= 2 && tier(preset) == 2 {
        // The other way to pair faces around non-manifold edges, and to take what is turned inside out.
        let other = if preset == Preset::FullRepair { Preset::ConservativeRepair } else { Preset::FullRepair };
        strategies.extend(strategy(other, options, options.max_tier, None));
        let both = [preset, other].map(|preset| strategy(preset, options, options.max_tier, None));
        let [mut first, _] = both.clone();
        // The last ways before another tier: what is bad goes, and its holes are closed; what overlaps is kept so.
        let cleaned = first.clone().map(|first| cleaning(first, options));
        if options.open_sheets == OpenSheets::Auto {
            let closed = both.into_iter().flatten().map(|it| with_sheets_closed(it, options));
            strategies.extend(closed.map(|it| Strategy { when: When::OpenSheetsRemain, ..it }));
            first = first.map(|first| with_sheets_closed(first, options));
        }
        strategies.extend(cleaned);
        whole = first.map(without_resolving);
    }
    let remesh = preset == Preset::BlenderRemesh || !matches!(category, Category::OpenSheet | Category::Clean);
    // A remesh unites what overlaps.
    let remesh = remesh && (options.overlaps == Overlaps::Union || options.preset == Preset::BlenderRemesh);
    if remesh && options.max_tier >= 2 && options.preset == Preset::Auto {
        strategies
            .extend(strategy(Preset::FullRepair, options, options.max_tier, None).map(|it| remeshing(it, options)));
    }
    strategies.extend(whole);
    if remesh && options.max_tier >= 3 {
        let union = before.parts > 1 || before.non_manifold_edges > 0;
        if union && preset != Preset::BlenderRemesh {
            strategies.extend(strategy(Preset::BlenderRemesh, options, 3, Some(Action::BooleanUnion)));
        }
        strategies.extend(strategy(Preset::BlenderRemesh, options, 3, None));
    }
    if preset == Preset::BlenderRemesh {
        // Blender may be missing, not allowed, or fail; what tier 1 can do is better than nothing.
        strategies.extend(strategy(Preset::FillHoles, options, 1, None));
    }
    let strategies = strategies.into_iter().map(|it| with_requests(it, options)).collect();
    Plan { category, preset, reason, strategies }
}

/// The preset's actions up to a tier, the remesh being replaced where asked, and at last fewer faces where asked.
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
        let at = actions.iter().position(|it| it.action == Action::Validate).unwrap_or(actions.len());
        actions.insert(at, planned(Action::Simplify, options));
    }
    let strategy = Strategy { when: When::NothingAcceptable, tier, preset, actions };
    Some(if asks_for_solids(options) && max_tier >= 2 { with_sheets_closed(strategy, options) } else { strategy })
}

/// Whether open sheets are to be made solid, whatever else is in the model.
fn asks_for_solids(options: &Options) -> bool {
    matches!(options.open_sheets, OpenSheets::Thicken | OpenSheets::Base)
}

/// The strategy with open sheets made solid before what needs closed surface: the resolving of intersections, a remesh.
fn with_sheets_closed(mut strategy: Strategy, options: &Options) -> Strategy {
    let needs_solids = |action| {
        matches!(action, Action::SelfUnion | Action::NativeRemesh | Action::VoxelRemesh | Action::BooleanUnion)
    };
    let at = strategy.actions.iter().position(|it| needs_solids(it.action) || it.action == Action::Validate);
    strategy.actions.insert(at.unwrap_or(strategy.actions.len()), planned(Action::CloseSheets, options));
    strategy.tier = strategy.tier.max(tier_of(Action::CloseSheets));
    strategy
}

/// The strategy with what is bad removed and closed again, before what intersects is resolved.
fn cleaning(mut strategy: Strategy, options: &Options) -> Strategy {
    let at = strategy.actions.iter().position(|a| a.action == Action::SelfUnion).unwrap_or(strategy.actions.len());
    strategy.actions.insert(at, planned(Action::CleanAndPatch, options));
    strategy
}

/// The strategy with the surface made anew in place of resolving what intersects.
fn remeshing(mut strategy: Strategy, options: &Options) -> Strategy {
    strategy.actions.retain(|it| it.action != Action::Perturb);
    for action in &mut strategy.actions {
        if action.action == Action::SelfUnion {
            *action = planned(Action::NativeRemesh, options);
        }
    }
    strategy
}

/// The strategy with what overlaps kept as it is: closed, but not printable.
fn without_resolving(mut strategy: Strategy) -> Strategy {
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

/// Where one kind of trouble ends and another begins.
struct Thresholds {
    /// Share of the area in open sheets that makes the whole an open sheet.
    sheet_share: f64,
    /// Boundary loops from which on holes are many.
    many_loops: u64,
    /// Parts from which on a model is fragmented, ...
    fragments: u64,
    /// ... if it has on average at most this many faces a part, or
    faces_a_fragment: u64,
    /// boundary loops for at least this share of its parts.
    open_fragments: f64,
}

const THRESHOLDS: Thresholds =
    Thresholds { sheet_share: SHEET_SHARE, many_loops: 8, fragments: 10, faces_a_fragment: 20, open_fragments: 0.5 };

/// What kind of trouble a model is in, by its measures and by the share of its area in open sheets.
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
    let small = m.faces <= m.parts.saturating_mul(t.faces_a_fragment);
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
