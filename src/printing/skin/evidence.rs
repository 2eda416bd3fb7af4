//! Evidence for each side of a facet: whether a ball that touches it comes from outside.

use glam::DVec3;
use rayon::prelude::*;

use crate::arrange::FacetSides;
use crate::context::{Cancelled, Context};
use crate::math::{Tree, hit};
use crate::printing::reach::{Reach, Reached};

/// Least clearance of a touching ball's centre, as a share of its radius: rough surface intrudes a little.
const MIN_CLEARANCE: f64 = 0.9;
/// Barycentric weights of the points at which a ball may touch a facet.
const TOUCHES: [[f64; 3]; 4] = [[1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0], [0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.2, 0.2, 0.6]];
/// Sides examined between two checks for cancellation.
const BATCH: usize = 1 << 14;
/// Boxes and facets that one query may visit.
const STEPS: u64 = 1 << 20;

/// What a touching ball says about a side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Evidence {
    /// A ball from outside touches the side.
    Outer,
    /// A ball that fits, but cannot come from outside, touches the side.
    Hidden,
    /// No ball fits there, or it is not decided whether the ball comes from outside.
    None,
}

/// The evidence for each side.
pub fn evidence(
    sides: &FacetSides,
    tree: &Tree,
    reach: &Reach,
    context: &Context<'_>,
) -> Result<Vec<Evidence>, Cancelled> {
    let facets: Vec<u32> = (0u32..).take(sides.corners.len()).collect();
    let mut all = Vec::with_capacity(2 * facets.len());
    for batch in facets.chunks(BATCH) {
        context.check()?;
        let found: Vec<[Evidence; 2]> = batch.par_iter().map(|&facet| of_facet(sides, tree, reach, facet)).collect();
        all.extend(found.into_iter().flatten());
    }
    Ok(all)
}

/// The evidence in front of and behind a facet.
fn of_facet(sides: &FacetSides, tree: &Tree, reach: &Reach, facet: u32) -> [Evidence; 2] {
    let normal = sides.area_vector(facet).normalize_or_zero();
    if normal == DVec3::ZERO {
        return [Evidence::None; 2];
    }
    let corners = sides.triangle(facet);
    let is_large = corners[0].distance(corners[1]).max(corners[1].distance(corners[2])) > reach.diameter();
    let touches = if is_large { &TOUCHES[..] } else { &TOUCHES[..1] };
    [normal, -normal].map(|direction| {
        let at = |weights: &[f64; 3]| (0..3).map(|i| corners[i] * weights[i]).sum::<DVec3>();
        let all = touches.iter().map(|weights| at_point(sides, tree, reach, (facet, at(weights), direction)));
        all.fold(Evidence::None, |before, now| match (before, now) {
            (Evidence::None, now) => now,
            (before, Evidence::None) => before,
            (before, now) if before == now => now,
            _ => Evidence::Outer,
        })
    })
}

/// The evidence at a point of a facet in a direction.
fn at_point(
    sides: &FacetSides,
    tree: &Tree,
    reach: &Reach,
    (facet, point, direction): (u32, DVec3, DVec3),
) -> Evidence {
    let radius = reach.diameter() / 2.0;
    let centre = point + direction * radius;
    let found = match reach.at(centre) {
        Reached::Outside => Evidence::Outer,
        Reached::Hidden(_) => Evidence::Hidden,
        Reached::Doubtful => Evidence::Outer,
        Reached::Blocked => return Evidence::None,
    };
    let triangle = |f: u32| sides.triangle(f);
    let mut steps = STEPS;
    let bound = radius * MIN_CLEARANCE;
    if tree.nearest(centre, bound, &mut steps, triangle).is_some() || steps == 0 {
        return Evidence::None;
    }
    let step = centre - point;
    let mut is_clear = true;
    tree.along(point, centre, |f| {
        is_clear = f == facet || hit(point, step, triangle(f)).is_none();
        is_clear
    });
    if is_clear { found } else { Evidence::None }
}
