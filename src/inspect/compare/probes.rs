//! Sample points on parts of an input mesh, and their location relative to a result.

use glam::DVec3;

use super::original::{FAR, ROUNDING};
use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;
use crate::inspect::analysis::Pair;
use crate::inspect::matching::NO_FACE;
use crate::inspect::ray_winding::RayWinding;
use crate::inspect::sampling::{run_queries, spread_by_area};
use crate::math::nearest_on_triangle;
use crate::mesh::Parts;

/// Number of sample points on all parts without a kept face, and the minimum and maximum per part.
const SAMPLES: usize = 60_000;
const SAMPLES_EACH: [u32; 2] = [4, 64];
/// Budget of all searches: boxes, nodes and triangles visited, plus an allowance per point.
const BUDGET: u64 = 10_000_000;
const BUDGET_PER_POINT: u64 = 1000;
/// Search radius for a part's surface in the result, as a fraction of the part's mean thickness; for an open part, of
/// its diagonal. The limit keeps a thin plate from matching the surface beneath.
const REACH_OF_THICKNESS: f64 = 0.25;

/// Sample points on selected parts of the input.
pub(super) struct Probes {
    /// Positions, in unit coordinates.
    pub points: Vec<DVec3>,
    /// For each point its part and its search radius in unit coordinates.
    part: Vec<u32>,
    reach: Vec<f64>,
    /// For each selected part the range of its points.
    pub of_part: Vec<std::ops::Range<usize>>,
}

impl Probes {
    /// Spreads points by area over each of `parts`.
    pub fn new(analysis: &Analysis<'_>, parts: &[u32]) -> Self {
        let each = u32::try_from(SAMPLES / parts.len().max(1)).unwrap_or(u32::MAX);
        let each = each.clamp(SAMPLES_EACH[0], SAMPLES_EACH[1]);
        let mut number_of_part = vec![NO_FACE; analysis.parts.count];
        for (number, &part) in (0u32..).zip(parts) {
            number_of_part[part as usize] = number;
        }
        let mut faces: Vec<Vec<u32>> = vec![Vec::new(); parts.len()];
        for (&part, f) in analysis.parts.of_face.iter().zip(0u32..).filter(|(part, _)| **part != Parts::NONE) {
            if let Some(faces) = faces.get_mut(number_of_part[part as usize] as usize) {
                faces.push(f);
            }
        }
        let area = |f: u32| analysis.unit_area_vector(f).length() / 2.0;
        let far = FAR * analysis.unit_diagonal();
        let mut probes = Self { points: Vec::new(), part: Vec::new(), reach: Vec::new(), of_part: Vec::new() };
        for (&part, faces) in parts.iter().zip(&faces) {
            let begin = probes.points.len();
            let solid = &analysis.solids[part as usize];
            let size = if solid.closed { 2.0 * (solid.volume / solid.area).abs() } else { solid.bounds.diagonal() };
            // `size` is NaN if the area is 0; `max` then selects the rounding distance.
            let reach = far.min(REACH_OF_THICKNESS * size * analysis.scale()).max(2.0 * ROUNDING);
            let spread = spread_by_area(faces.iter().copied(), each, area, |face| analysis.unit_corners(face));
            probes.points.extend(spread.iter().map(|&(_, point)| point));
            // A part without area is represented by its first corner.
            if spread.is_empty() {
                probes.points.extend(faces.first().map(|&f| analysis.unit_corners(f)[0]));
            }
            probes.part.resize(probes.points.len(), part);
            probes.reach.resize(probes.points.len(), reach);
            probes.of_part.push(begin..probes.points.len());
        }
        probes
    }
}

/// Position of a point of the input relative to the result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum PointLocation {
    /// On a face of the result; `another` is true if the point is also on another part of the input.
    On { face: u32, another: bool },
    /// Inside the result, by winding number.
    In,
    /// Neither on nor in the result.
    Outside,
}

/// Locates points of the input relative to the result.
pub(super) struct PointLocator<'a> {
    before: &'a Analysis<'a>,
    after: &'a Analysis<'a>,
    has_kept_face: &'a [bool],
    inside: RayWinding<'a>,
    /// Factor from unit coordinates of the input to unit coordinates of the result.
    ratio: f64,
}

impl<'a> PointLocator<'a> {
    /// Prepares queries. `has_kept_face` holds for each input part whether the result has one of its faces.
    pub fn new(before: &'a Analysis<'a>, after: &'a Analysis<'a>, has_kept_face: &'a [bool]) -> Self {
        let ratio = Pair::new(before, after).ratio;
        // Computed here, before several threads need it.
        before.tree();
        Self { before, after, has_kept_face, inside: RayWinding::new(after), ratio }
    }

    /// Locates each point; `None` for points beyond the budget.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn locate(&self, probes: &Probes, context: &Context<'_>) -> Result<Vec<Option<PointLocation>>, Cancelled> {
        let count = probes.points.len();
        let budget = BUDGET + BUDGET_PER_POINT * count as u64;
        let answers = run_queries(count, budget, context, |i, steps| {
            let location = self.classify(probes.points[i], probes.part[i], probes.reach[i], steps);
            (*steps > 0).then_some(location)
        })?;
        Ok(answers.values)
    }

    fn classify(&self, point: DVec3, part: u32, reach: f64, steps: &mut u64) -> PointLocation {
        let in_result = point * self.ratio;
        match self.after.tree().nearest(in_result, reach * self.ratio, steps, |f| self.after.unit_corners(f)) {
            Some(nearest) => {
                PointLocation::On { face: nearest.face, another: self.is_on_another(point, part, reach, steps) }
            }
            None if self.inside.winding(in_result, steps) >= 0.5 => PointLocation::In,
            None => PointLocation::Outside,
        }
    }

    /// Whether the point is also on a part with a kept face, or on a part with a lower number. Of coincident parts
    /// without kept faces, the first is taken as present in the result.
    fn is_on_another(&self, point: DVec3, part: u32, reach: f64, steps: &mut u64) -> bool {
        let parts = &self.before.parts;
        let mut is_near = false;
        self.before.tree().around(point, reach, |f| {
            *steps = steps.saturating_sub(1);
            let other = parts.of_face[f as usize];
            if other != part && other != Parts::NONE && (other < part || self.has_kept_face[other as usize]) {
                is_near = nearest_on_triangle(point, self.before.unit_corners(f)).distance(point) <= reach;
            }
            !is_near && *steps > 0
        });
        is_near
    }
}
