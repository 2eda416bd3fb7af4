//! The cells that the sides of facets bound, and what is known of them.

use super::evidence::Evidence;
use crate::arrange::FacetSides;
use crate::mesh::UnionFind;

/// The cells that the sides bound: sides joined around edges.
pub struct SideCells {
    /// For each side, the smallest side of its cell.
    pub of_side: Vec<u32>,
    /// For each cell, at its smallest side, whether a boundary edge joins both sides of a facet in it.
    pub(super) has_boundary: Vec<bool>,
}

impl SideCells {
    /// Joins the sides around the edges.
    pub fn new(sides: &FacetSides) -> Self {
        let mut sets = UnionFind::new(2 * sides.corners.len());
        for link in &sides.links {
            sets.unite(link.sides[0], link.sides[1]);
        }
        let of_side = sets.into_roots();
        let mut has_boundary = vec![false; of_side.len()];
        for link in sides.links.iter().filter(|link| link.sides[0] ^ 1 == link.sides[1]) {
            has_boundary[of_side[link.sides[0] as usize] as usize] = true;
        }
        Self { of_side, has_boundary }
    }

    /// Whether the two sides of some facet bound the same cell at an edge: the surface is open.
    pub fn is_open(&self) -> bool {
        self.has_boundary.contains(&true)
    }
}

/// The state of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellState {
    /// Outside air.
    Outer,
    /// No outside air.
    Hidden,
    /// Outside air in front of a part of its sides.
    Cut,
    /// No evidence.
    Unknown,
}

/// What is known about the sides of the facets.
pub struct Labels<'a> {
    /// The facets.
    pub sides: &'a FacetSides,
    /// The cells that the sides bound.
    pub cells: &'a SideCells,
    /// The evidence for each side.
    pub evidence: &'a [Evidence],
    /// The state of each cell, at its smallest side.
    pub states: Vec<CellState>,
    /// For each side whether outside air is in front of it.
    pub outer: Vec<bool>,
}

impl Labels<'_> {
    /// Whether a side's cell is cut.
    pub fn is_cut(&self, side: u32) -> bool {
        self.states[self.cells.of_side[side as usize] as usize] == CellState::Cut
    }
}
