//! The narrow features of a solid, sorted by the rule of a process profile that applies to each.

use glam::DVec3;

use super::profile::Profile;
use super::rules::PrintRule;
use super::thickness::{FeatureKind, Space, ThinRegion, rounded_limit, thin_features};
use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;

/// A wall or slot less high than this multiple of its width is a detail: low relief prints finer than a free wall.
const DETAIL: f64 = 2.0;
/// Most distances computed to tell a detail from a wall. A region of more faces and edges counts as a wall.
const MAX_FOOT_STEPS: usize = 2_000_000;

/// A narrow feature: thin material, or a narrow gap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feature {
    /// The rule that applies.
    pub rule: PrintRule,
    /// Least width.
    pub width_mm: f64,
    /// The point of least width, in the model's unit.
    pub at: DVec3,
    /// Area of the surface of the feature.
    pub area_mm2: f64,
}

/// The narrow features of a solid.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Features {
    /// Features narrower than a limit of the profile.
    pub all: Vec<Feature>,
    /// Whether the search covered the whole surface.
    pub is_complete: bool,
}

/// Finds the features of a printable solid that are narrower than the profile's limits.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn find_features(analysis: &Analysis<'_>, profile: &Profile, context: &Context<'_>) -> Result<Features, Cancelled> {
    let mm = analysis.facts.unit.map_or(1.0, |unit| unit.used.millimetres());
    let walls = [&profile.supported_wall_mm, &profile.free_wall_mm, &profile.wire_mm, &profile.pin_mm];
    let gaps = [&profile.hole_mm, &profile.gap_mm, &profile.clearance_mm];
    let largest = |limits: &[&super::profile::Limit]| limits.iter().map(|limit| limit.limit).fold(0.0, f64::max);
    let mut found = Features { all: Vec::new(), is_complete: true };
    for (side, limit_mm) in [(Space::Material, largest(&walls)), (Space::Air, largest(&gaps))] {
        let limit = rounded_limit(&analysis.surface, limit_mm / mm);
        let thin = thin_features(&analysis.surface, limit, side, context)?;
        found.is_complete &= thin.pairs.is_complete;
        for region in &thin.regions {
            context.check()?;
            found.all.extend(feature(analysis, region, mm));
        }
    }
    Ok(found)
}

/// The feature of a thin region; `None` for a sharp edge, which prints rounded but breaks no rule, and for a narrow place of a sealed
/// cavity, which nobody sees or uses. The rule about escape holes judges cavities.
fn feature(analysis: &Analysis<'_>, region: &ThinRegion, mm: f64) -> Option<Feature> {
    let is_detail = || foot_distance(analysis, region).is_some_and(|height| height < DETAIL * region.least);
    let is_in_cavity = || {
        let part = region.faces.first().map(|&face| analysis.parts.of_face[face as usize] as usize);
        part.and_then(|part| analysis.solids.get(part)).is_some_and(|solid| solid.volume < 0.0)
    };
    let rule = match region.kind {
        FeatureKind::ThroughHole | FeatureKind::BlindHole | FeatureKind::Slot if is_in_cavity() => return None,
        FeatureKind::FreeWall | FeatureKind::SupportedWall if is_detail() => PrintRule::EmbossedDetail,
        FeatureKind::Slot if is_detail() => PrintRule::EngravedDetail,
        FeatureKind::SupportedWall => PrintRule::SupportedWall,
        FeatureKind::FreeWall => PrintRule::FreeWall,
        FeatureKind::Wire => PrintRule::Wire,
        FeatureKind::Pin => PrintRule::Pin,
        FeatureKind::ThroughHole | FeatureKind::BlindHole => PrintRule::Hole,
        FeatureKind::Slot => PrintRule::Gap,
        FeatureKind::Clearance => PrintRule::Clearance,
        FeatureKind::SharpEdge => return None,
    };
    Some(Feature { rule, width_mm: region.least * mm, at: region.at, area_mm2: region.area * mm * mm })
}

/// The largest distance of a region's vertices from its foot: the concave edges at which the region meets other faces.
/// For a raised detail, the foot runs around its base, and the distance is its height. For a slot, the foot runs around
/// its floor, and the distance is its depth. `None` if the region has no foot.
fn foot_distance(analysis: &Analysis<'_>, region: &ThinRegion) -> Option<f64> {
    let faces = &analysis.surface.faces;
    let positions = &analysis.surface.positions;
    let is_own = |face: u32| region.faces.binary_search(&face).is_ok();
    let mut edges: Vec<[u32; 2]> = region.faces.iter().flat_map(|&f| sides_of(faces[f as usize])).collect();
    edges.sort_unstable();
    edges.dedup();
    let is_foot = |&[a, b]: &[u32; 2]| {
        let Some(edge) = analysis.edges.find(a, b) else { return false };
        let &[one, other] = analysis.edges.half_edges(edge) else { return false };
        let [one, other] = [one / 3, other / 3];
        let apex = faces[other as usize].into_iter().find(|&v| v != a && v != b);
        let normal = analysis.surface.area_vector(one as usize);
        let is_concave = apex.is_some_and(|v| normal.dot(positions[v as usize] - positions[a as usize]) > 0.0);
        is_own(one) != is_own(other) && is_concave
    };
    let foot: Vec<[DVec3; 2]> =
        edges.into_iter().filter(is_foot).map(|edge| edge.map(|v| positions[v as usize])).collect();
    if foot.is_empty() || foot.len().saturating_mul(region.faces.len()) > MAX_FOOT_STEPS {
        return None;
    }
    let corners = region.faces.iter().flat_map(|&f| faces[f as usize]).map(|v| positions[v as usize]);
    let distance = |p: DVec3| foot.iter().map(|&[a, b]| distance_to_segment(p, a, b)).fold(f64::INFINITY, f64::min);
    corners.map(distance).max_by(f64::total_cmp)
}

fn sides_of([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]].map(|[v, w]| [v.min(w), v.max(w)])
}

fn distance_to_segment(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    let along = b - a;
    let length = along.length_squared();
    let t = if length > 0.0 { ((p - a).dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
    p.distance(a + along * t)
}
