//! Decides for each side of a facet whether air from outside is in front of it.
//!
//! Sides joined around edges bound one cell of space. Where all evidence in a cell agrees, it decides. Otherwise a
//! minimum cut separates the sides that a ball from outside touches from those that it cannot reach: the cut runs along
//! the shortest edges, round pinholes and tunnels. Cells that no ball touches are decided by the sides in sight.

use std::collections::BTreeMap;

use super::cut::Network;
use super::evidence::Evidence;
use super::sight::Sight;
use super::states::{CellState, Labels, SideCells};
use crate::arrange::{FacetSides, SideLink};
use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree};

/// Depth of a slit, in ball diameters, from which it counts as hidden in a cell that must be cut.
const SLIT_DEPTH: f64 = 4.0;
/// Weight of evidence: to ignore it on an area costs as much as an edge of this multiple of the area over the diameter.
const EVIDENCE_WEIGHT: f64 = 4.0;
/// Least share of a cell's area with evidence of either kind for the cell to be cut.
const MIN_SHARE: f64 = 1e-6;
/// Least share of a cell's area, times the weight of its evidence, for the whole cell to be outside air.
const MIN_WEIGHTED_SHARE: f64 = 0.05;
/// Integer capacity of an edge as long as the model's diagonal.
const SCALE: f64 = (1u64 << 40) as f64;
/// The most rounds of keeping facets that hang on by few edges; chains of such facets are kept one after another.
const MAX_KEEPING_ROUNDS: usize = 4;
/// The most that keeping such a facet may lengthen the cut, as a share of its edges' length.
const MAX_CUT_GROWTH: f64 = 0.5;

/// Areas with evidence in a cell.
#[derive(Debug, Clone, Copy, Default)]
struct Areas {
    all: f64,
    outer: f64,
    hidden: f64,
    /// The area with evidence of outside air, times its weight.
    weighted: f64,
}

impl<'a> Labels<'a> {
    /// Decides all sides. `diameter` is that of the ball.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn new(
        (sides, cells): (&'a FacetSides, &'a SideCells),
        evidence: &'a [Evidence],
        (tree, diameter): (&Tree, f64),
        context: &Context<'_>,
    ) -> Result<Self, Cancelled> {
        let states = states(sides, cells, evidence);
        let outer = cells.of_side.iter().map(|&cell| states[cell as usize] == CellState::Outer).collect();
        let mut labels = Self { sides, cells, evidence, states, outer };
        if labels.states.contains(&CellState::Cut) {
            labels.cut(diameter, context)?;
            keep_frayed(&mut labels);
        }
        Sight { tree, labels: &mut labels }.decide(context)?;
        Ok(labels)
    }

    /// Labels the sides of the cells that must be cut.
    fn cut(&mut self, diameter: f64, context: &Context<'_>) -> Result<(), Cancelled> {
        let unit = SCALE / Box3::of(self.sides.positions.iter().copied()).diagonal();
        let mut node = vec![u32::MAX; self.outer.len()];
        let mut terminal: Vec<i64> = Vec::new();
        let mut side_of: Vec<u32> = Vec::new();
        for side in (0u32..).take(self.outer.len()).filter(|&side| self.is_cut(side)) {
            let share = self.sides.area_vector(side / 2).length() / 2.0 / diameter * unit;
            let [weight, behind] = [side, side ^ 1].map(|side| self.evidence[side as usize].weight());
            let weight = match weight {
                // A facet with outside air on one side alone is not a sheet.
                0.0 if behind > 0.0 => -share * EVIDENCE_WEIGHT,
                0.0 => -share / SLIT_DEPTH,
                weight => share * EVIDENCE_WEIGHT * weight,
            };
            node[side as usize] = index(side_of.len());
            side_of.push(side);
            #[expect(clippy::cast_possible_truncation, reason = "rounded to an integer weight")]
            terminal.push(weight as i64);
        }
        let links = self.sides.links.iter().filter(|link| self.is_cut(link.sides[0]));
        let edges: Vec<([u32; 2], u64)> = links
            .map(|link| {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a positive weight")]
                let capacity = (link.length * unit) as u64;
                (link.sides.map(|side| node[side as usize]), capacity.max(1))
            })
            .collect();
        let is_outer = Network::new(terminal, &edges).source_side(context)?;
        for (side, is_outer) in side_of.into_iter().zip(is_outer) {
            self.outer[side as usize] = is_outer;
        }
        Ok(())
    }
}

/// The state of each cell by the evidence for its sides.
fn states(sides: &FacetSides, cells: &SideCells, evidence: &[Evidence]) -> Vec<CellState> {
    let mut areas = vec![Areas::default(); cells.of_side.len()];
    for (side, &cell) in (0u32..).zip(&cells.of_side) {
        let (areas, area) = (&mut areas[cell as usize], sides.area_vector(side / 2).length());
        areas.all += area;
        let weight = evidence[side as usize].weight();
        areas.outer += if weight > 0.0 { area } else { 0.0 };
        areas.weighted += area * weight.max(0.0);
        areas.hidden += if weight < 0.0 { area } else { 0.0 };
    }
    let state = |(areas, &has_boundary): (&Areas, &bool)| {
        let [outer, hidden] = [areas.outer, areas.hidden].map(|area| area > MIN_SHARE * areas.all);
        match (outer, hidden) {
            (true, true) => CellState::Cut,
            (true, false) if has_boundary && areas.outer < (1.0 - MIN_SHARE) * areas.all => CellState::Cut,
            // A few facets behind pinholes say nothing about the slit around them.
            (true, false) if areas.weighted < MIN_WEIGHTED_SHARE * areas.all => CellState::Unknown,
            (true, false) => CellState::Outer,
            (false, true) => CellState::Hidden,
            (false, false) => CellState::Unknown,
        }
    };
    areas.iter().zip(&cells.has_boundary).map(state).collect()
}

#[expect(clippy::cast_possible_truncation, reason = "sides are counted in u32")]
fn index(count: usize) -> u32 {
    count as u32
}

/// Keeps facets that a ball from outside touches on one side alone, and that the cut gave up: where it is shorter, the
/// cut runs along the one edge that still holds such a facet.
fn keep_frayed(labels: &mut Labels<'_>) {
    for _ in 0..MAX_KEEPING_ROUNDS {
        let given_up: Vec<bool> =
            (0u32..).take(labels.outer.len() / 2).map(|facet| is_given_up(labels, facet)).collect();
        // For each such facet, the growth of the cut and the length of its edges, both counted twice.
        let mut growth: BTreeMap<u32, [f64; 2]> = BTreeMap::new();
        for &SideLink { sides: [a, b], length } in &labels.sides.links {
            let wanted = |side: u32, facet: u32| {
                if side / 2 == facet { wants_outer(labels, side) } else { labels.outer[side as usize] }
            };
            for facet in if a / 2 == b / 2 { vec![a / 2] } else { vec![a / 2, b / 2] } {
                if given_up[facet as usize] {
                    let was_cut = labels.outer[a as usize] != labels.outer[b as usize];
                    let is_cut = wanted(a, facet) != wanted(b, facet);
                    let [growth, edges] = growth.entry(facet).or_default();
                    *growth += 2.0 * length * (f64::from(u8::from(is_cut)) - f64::from(u8::from(was_cut)));
                    *edges += if a / 2 == b / 2 { 2.0 * length } else { length };
                }
            }
        }
        let kept = growth.into_iter().filter(|(_, [growth, edges])| *growth <= MAX_CUT_GROWTH * edges);
        let kept: Vec<u32> = kept.map(|(facet, _)| facet).collect();
        for side in kept.iter().flat_map(|facet| [2 * facet, 2 * facet + 1]) {
            labels.outer[side as usize] = wants_outer(labels, side);
        }
        if kept.is_empty() {
            return;
        }
    }
}

/// Whether a ball from outside touches a side.
fn wants_outer(labels: &Labels<'_>, side: u32) -> bool {
    labels.evidence[side as usize] == Evidence::Outer
}

/// Whether a ball from outside touches a facet on one side alone, yet both sides have the same label.
fn is_given_up(labels: &Labels<'_>, facet: u32) -> bool {
    let sides = [2 * facet, 2 * facet + 1];
    sides.iter().all(|&side| labels.is_cut(side))
        && labels.outer[sides[0] as usize] == labels.outer[sides[1] as usize]
        && wants_outer(labels, sides[0]) != wants_outer(labels, sides[1])
}
