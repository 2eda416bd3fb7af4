use glam::DVec3;

use super::original::{FAR, ROUNDING};
use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;
use crate::inspect::analysis::Pair;
use crate::inspect::matching::NO_FACE;
use crate::inspect::sampling::{InsideTest, ask, spread_by_area};
use crate::math::nearest_on_triangle;
use crate::mesh::Parts;

/// Points on all parts of which no face stands, and on each of them at least and at most.
const SAMPLES: usize = 60_000;
const SAMPLES_EACH: [u32; 2] = [4, 64];
/// Boxes, nodes and triangles that all searches together may look at: so many, and so many more for each point.
const BUDGET: u64 = 10_000_000;
const BUDGET_A_POINT: u64 = 1000;
/// How near to the result a part's surface must be to be taken for its own, as a share of how thick it is on the whole, so
/// that the surface under a thin plate is none of the plate's; of the diagonal of an open part.
const OF_SIZE: f64 = 0.25;

/// Points on some parts.
pub(super) struct Probes {
    pub points: Vec<DVec3>,
    /// For each point its part, and how near counts, in unit coordinates.
    part: Vec<u32>,
    reach: Vec<f64>,
    /// For each of the parts its points.
    pub of_part: Vec<std::ops::Range<usize>>,
}

impl Probes {
    /// Points spread by area over each part.
    pub fn new(analysis: &Analysis<'_>, parts: &[u32]) -> Self {
        let each = u32::try_from(SAMPLES / parts.len().max(1)).unwrap_or(u32::MAX);
        let each = each.clamp(SAMPLES_EACH[0], SAMPLES_EACH[1]);
        let mut of = vec![NO_FACE; analysis.parts.count];
        for (number, &part) in (0u32..).zip(parts) {
            of[part as usize] = number;
        }
        let mut faces: Vec<Vec<u32>> = vec![Vec::new(); parts.len()];
        for (&part, f) in analysis.parts.of_face.iter().zip(0u32..).filter(|(part, _)| **part != Parts::NONE) {
            if let Some(faces) = faces.get_mut(of[part as usize] as usize) {
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
            // NaN where there is no area: then what rounding moves.
            let reach = far.min(OF_SIZE * size * analysis.scale()).max(2.0 * ROUNDING);
            let spread = spread_by_area(analysis, faces.iter().copied(), each, area);
            probes.points.extend(spread.iter().map(|&(_, point)| point));
            // A part without area is where its first corner is.
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

/// Where a point of the input is with regard to the result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Place {
    /// On a face, and whether also on another part of the input.
    On { face: u32, another: bool },
    /// Inside.
    In,
    /// Neither.
    Off,
}

/// Answers where points are.
pub(super) struct Places<'a> {
    before: &'a Analysis<'a>,
    after: &'a Analysis<'a>,
    stands: &'a [bool],
    inside: InsideTest<'a>,
    /// What unit coordinates of the input are multiplied by to be such of the result.
    ratio: f64,
}

impl<'a> Places<'a> {
    pub fn new(before: &'a Analysis<'a>, after: &'a Analysis<'a>, stands: &'a [bool]) -> Self {
        let ratio = Pair::new(before, after).ratio;
        Self { before, after, stands, inside: InsideTest::new(after), ratio }
    }

    pub fn locate(&self, probes: &Probes, context: &Context<'_>) -> Result<Vec<Option<Place>>, Cancelled> {
        let count = probes.points.len();
        let budget = BUDGET + BUDGET_A_POINT * count as u64;
        let found = ask(count, budget, context, |i, steps| {
            let place = self.place(probes.points[i], probes.part[i], probes.reach[i], steps);
            (*steps > 0).then_some(place)
        })?;
        Ok(found.values)
    }

    fn place(&self, point: DVec3, part: u32, reach: f64, steps: &mut u64) -> Place {
        let there = point * self.ratio;
        match self.after.tree().nearest(there, reach * self.ratio, steps, |f| self.after.unit_corners(f)) {
            Some(nearest) => Place::On { face: nearest.face, another: self.is_on_another(point, part, reach, steps) },
            None if self.inside.winding(there, steps) >= 0.5 => Place::In,
            None => Place::Off,
        }
    }

    /// Whether a point is also on a part that stands, or on one before it: of parts on one another that were made anew the
    /// first is taken to be there.
    fn is_on_another(&self, point: DVec3, part: u32, reach: f64, steps: &mut u64) -> bool {
        let parts = &self.before.parts;
        let mut found = false;
        self.before.tree().around(point, reach, |f| {
            *steps = steps.saturating_sub(1);
            let other = parts.of_face[f as usize];
            if other != part && other != Parts::NONE && (other < part || self.stands[other as usize]) {
                found = nearest_on_triangle(point, self.before.unit_corners(f)).distance(point) <= reach;
            }
            !found && *steps > 0
        });
        found
    }
}
