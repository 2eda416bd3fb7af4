//! Decides cells that no ball touches by the sides that are in sight of them.

use glam::DVec3;
use rustc_hash::FxHashMap;

use super::states::{CellState, Labels};
use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree, ray_direction};

/// Rays cast from each cell without evidence.
const RAYS: u32 = 24;
/// The most rounds in which cells learn from each other.
const MAX_ROUNDS: usize = 32;
/// Boxes and facets that one ray may visit.
const STEPS: u64 = 1 << 22;

/// Rays between the facets.
pub struct Sight<'l, 'a> {
    /// The tree of the facets.
    pub tree: &'l Tree,
    /// The labels to complete.
    pub labels: &'l mut Labels<'a>,
}

impl Sight<'_, '_> {
    /// Decides the unknown cells. A cell from which rays meet only its own sides is closed: no air from outside.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn decide(&mut self, context: &Context<'_>) -> Result<(), Cancelled> {
        let unknown = self.unknown_cells();
        let far = Box3::of(self.labels.sides.positions.iter().copied()).diagonal() * 2.0;
        // The sides in sight of each unknown cell; none stands for open space.
        let mut in_sight: Vec<Vec<Option<u32>>> = Vec::with_capacity(unknown.len());
        for &(cell, side) in &unknown {
            context.check()?;
            let seen = (0..RAYS).map(|ray| self.first_side(side, ray_direction(ray) * far));
            let is_other = |seen: &Option<u32>| seen.is_none_or(|side| self.cell_of(side) != cell);
            in_sight.push(seen.filter(is_other).collect());
        }
        let mut decided: FxHashMap<u32, bool> = FxHashMap::default();
        for _ in 0..MAX_ROUNDS {
            let before = decided.len();
            for (&(cell, _), seen) in unknown.iter().zip(&in_sight) {
                if decided.contains_key(&cell) {
                    continue;
                }
                let votes: Vec<bool> = seen.iter().filter_map(|side| self.is_outer(*side, &decided)).collect();
                let for_outer = votes.iter().filter(|&&vote| vote).count();
                if !votes.is_empty() {
                    decided.insert(cell, 2 * for_outer > votes.len());
                }
            }
            if decided.len() == before {
                break;
            }
        }
        for (side, &cell) in self.labels.cells.of_side.iter().enumerate() {
            if self.labels.states[cell as usize] == CellState::Unknown {
                self.labels.outer[side] = decided.get(&cell).copied().unwrap_or(false);
            }
        }
        Ok(())
    }

    fn cell_of(&self, side: u32) -> u32 {
        self.labels.cells.of_side[side as usize]
    }

    /// Whether outside air is in front of a side, as far as known.
    fn is_outer(&self, side: Option<u32>, decided: &FxHashMap<u32, bool>) -> Option<bool> {
        let Some(side) = side else { return Some(true) };
        let cell = self.cell_of(side);
        match self.labels.states[cell as usize] {
            CellState::Unknown => decided.get(&cell).copied(),
            _ => Some(self.labels.outer[side as usize]),
        }
    }

    /// The unknown cells, each with its largest side.
    fn unknown_cells(&self) -> Vec<(u32, u32)> {
        let mut largest: FxHashMap<u32, (f64, u32)> = FxHashMap::default();
        for (side, &cell) in (0u32..).zip(&self.labels.cells.of_side) {
            if self.labels.states[cell as usize] == CellState::Unknown {
                let area = self.labels.sides.area_vector(side / 2).length_squared();
                let best = largest.entry(cell).or_insert((-1.0, side));
                if area > best.0 {
                    *best = (area, side);
                }
            }
        }
        let mut unknown: Vec<(u32, u32)> = largest.into_iter().map(|(cell, (_, side))| (cell, side)).collect();
        unknown.sort_unstable();
        unknown
    }

    /// The first side that a ray from the centre of a side meets; none if the ray leaves the model. The ray is turned
    /// to start in front of the side.
    fn first_side(&self, side: u32, step: DVec3) -> Option<u32> {
        let (sides, facet) = (self.labels.sides, side / 2);
        let corners = sides.triangle(facet);
        let middle = corners.into_iter().sum::<DVec3>() / 3.0;
        let normal = if side.is_multiple_of(2) { sides.area_vector(facet) } else { -sides.area_vector(facet) };
        let step = if step.dot(normal) < 0.0 { -step } else { step };
        let mut steps = STEPS;
        let found = self.tree.first_hit([middle, step], Some(facet), &mut steps, |f| sides.triangle(f));
        found.map(|(_, f)| 2 * f + u32::from(sides.area_vector(f).dot(step) > 0.0))
    }
}
