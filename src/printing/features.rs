//! The narrow features of a solid, sorted by the rule of a process profile that applies to each.

use glam::DVec3;

use super::profile::Profile;
use super::rules::PrintRule;
use super::thickness::{FeatureKind, Space, ThinRegion, rounded_limit, thin_features};
use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;
use crate::math::{centre_and_radius, halves, nearest_on_segment};

/// A wall, bar or recess less high or deep than this multiple of its width is a detail: low relief prints finer than a free wall.
const DETAIL: f64 = 2.0;
/// Most distances computed to tell a detail from a wall. A region that needs more counts as a wall.
const MAX_FOOT_STEPS: usize = 4_000_000;
/// Error of a region's height, as a fraction of the height that makes it a wall.
const HEIGHT_RESOLUTION: f64 = 0.01;

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
    let is_detail = || stays_near_foot(analysis, region, DETAIL * region.least);
    let is_in_cavity = || {
        let part = region.faces.first().map(|&face| analysis.parts.of_face[face as usize] as usize);
        part.and_then(|part| analysis.solids.get(part)).is_some_and(|solid| solid.volume < 0.0)
    };
    let rule = match region.kind {
        FeatureKind::ThroughHole | FeatureKind::BlindHole | FeatureKind::Slot if is_in_cavity() => return None,
        FeatureKind::FreeWall | FeatureKind::SupportedWall | FeatureKind::Wire | FeatureKind::Pin if is_detail() => {
            PrintRule::EmbossedDetail
        }
        FeatureKind::Slot | FeatureKind::BlindHole if is_detail() => PrintRule::EngravedDetail,
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

/// Whether the whole of a region is nearer than `height` to its foot: the concave edges at which the region meets other faces. For a
/// raised detail, the foot runs around its base, and for a slot around its floor. False for a region without a foot, and for one that
/// would take too many steps.
///
/// Vertices alone do not decide, since those of a wall between two blocks all lie on its foot. A triangle is halved until its centre is
/// too far from the foot, or no point of it can be.
fn stays_near_foot(analysis: &Analysis<'_>, region: &ThinRegion, height: f64) -> bool {
    let foot = foot(analysis, region);
    let mut left = MAX_FOOT_STEPS.checked_div(foot.len()).unwrap_or(0);
    let mut pending: Vec<[DVec3; 3]> = region.faces.iter().map(|&f| analysis.surface.corners(f as usize)).collect();
    while let Some(corners) = pending.pop() {
        if left == 0 {
            return false;
        }
        left -= 1;
        let (centre, radius) = centre_and_radius(corners);
        let to_edge = |&edge: &[DVec3; 2]| nearest_on_segment(centre, edge).distance(centre);
        let distance = foot.iter().map(to_edge).fold(f64::INFINITY, f64::min);
        if distance >= height {
            return false;
        }
        if distance + radius >= height && radius > HEIGHT_RESOLUTION * height {
            pending.extend(halves(corners));
        }
    }
    true
}

/// The concave edges at which a region meets other faces.
fn foot(analysis: &Analysis<'_>, region: &ThinRegion) -> Vec<[DVec3; 2]> {
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
    edges.into_iter().filter(is_foot).map(|edge| edge.map(|v| positions[v as usize])).collect()
}

fn sides_of([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]].map(|[v, w]| [v.min(w), v.max(w)])
}
