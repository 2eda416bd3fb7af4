//! The air that a ball coming from outside can reach, and the regions of air that it cannot reach.
//!
//! An octree holds the clearance of the air: the distance from a point to the nearest face. The distance is
//! 1-Lipschitz, so one value at a node's centre bounds the clearance in the whole node. A node is open if a ball
//! centred anywhere in it fits, blocked if it fits nowhere, and is split otherwise, down to a finest cell. Orientation
//! of the faces plays no part.

mod flood;
mod octree;

use flood::{Adjacency, Flood};
use glam::DVec3;
use octree::{BATCH, Fit, Node};
pub use octree::{HiddenRegion, Reach, Reached};
use rayon::prelude::*;

use crate::context::{Cancelled, Context};
use crate::math::{Box3, Tree, nearest_on_triangle};

/// Margin around the model, in ball diameters. The ball moves freely there.
const MARGIN: f64 = 2.0;
/// Finest depth of the octree. Positions of cells are integers of this many bits.
const MAX_DEPTH: u32 = 20;
/// The most rounds of splitting leaves at openings of undecided width.
const MAX_ROUNDS: u32 = 40;

/// How finely [`Reach`] decides, and how much it may cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReachOptions {
    /// Diameter of the ball, in the model's unit; positive.
    pub diameter: f64,
    /// Cells per diameter. Cells at openings of undecided width are split further, see [`ReachOptions::refinements`].
    pub cells_per_diameter: u32,
    /// How often cells at openings of undecided width are halved. With `n` cells per diameter then, openings from about
    /// `1 - 1.8 / n` to `1 + 3.2 / n` diameters wide are undecided, and the air behind them is doubtful.
    pub refinements: u32,
    /// The most octree nodes. Each takes some 100 bytes and one to two microseconds.
    pub max_nodes: usize,
}

/// A node that is to be evaluated.
#[derive(Debug, Clone, Copy)]
struct Pending {
    node: u32,
    /// The node's lowest cell at its level.
    cell: [u32; 3],
    /// A face near the parent's centre, and a bound of the parent's clearance.
    near: u32,
    parent: Clearance,
}

/// What is known of the distance of a node's centre from the nearest face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Clearance {
    /// At least the radius.
    Wide,
    /// Less than the radius.
    Narrow,
    /// Nothing.
    Unknown,
}

impl Reach {
    /// Computes the reachable air around and in a surface. `tree` must be the tree of `faces`.
    ///
    /// `None` if the octree would need more than `max_nodes` nodes, or there are no faces.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn new(
        positions: &[DVec3],
        faces: &[[u32; 3]],
        tree: &Tree,
        options: ReachOptions,
        context: &Context<'_>,
    ) -> Result<Option<Self>, Cancelled> {
        let bounds = Box3::of_faces(positions, faces);
        let cell = options.diameter / f64::from(options.cells_per_diameter.max(2));
        let needed = (bounds.max - bounds.min).max_element() + 2.0 * MARGIN * options.diameter;
        if bounds.is_empty() || !(cell > 0.0 && needed.is_finite()) {
            return Ok(None);
        }
        let depth = (0..=MAX_DEPTH).find(|&depth| cell * f64::from(1u32 << depth) >= needed);
        let Some(depth) = depth else { return Ok(None) };
        let side = cell * f64::from(1u32 << depth);
        let mut reach = Self {
            diameter: options.diameter,
            low: bounds.centre() - DVec3::splat(side / 2.0),
            side,
            depth,
            finest: depth + options.refinements,
            nodes: vec![Node::undecided()],
            leaves: Vec::new(),
            regions: Vec::new(),
            doubtful_volume: 0.0,
        };
        let corners = |face: u32| faces[face as usize].map(|v| positions[v as usize]);
        if !reach.split(tree, &corners, options.max_nodes, context)? {
            return Ok(None);
        }
        reach.label(&corners, tree, options, context)?;
        Ok(Some(reach))
    }

    /// The diameter of the ball.
    #[must_use]
    pub fn diameter(&self) -> f64 {
        self.diameter
    }

    /// The length of the cells, apart from those at openings of undecided width.
    #[must_use]
    pub fn resolution(&self) -> f64 {
        self.size(self.depth)
    }

    /// Number of octree nodes.
    #[must_use]
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// The hidden regions, in the order of their first octree leaf.
    #[must_use]
    pub fn hidden_regions(&self) -> &[HiddenRegion] {
        &self.regions
    }

    /// The volume of the ball's centres that are reached only through openings of undecided width.
    #[must_use]
    pub fn doubtful_volume(&self) -> f64 {
        self.doubtful_volume
    }

    /// Whether the ball can be centred at a point, decided for the octree leaf that holds the point.
    #[must_use]
    pub fn at(&self, point: DVec3) -> Reached {
        let most = f64::from(1u32 << self.finest);
        let scaled = (point - self.low) / self.side * most;
        if !(scaled.min_element() >= 0.0 && scaled.max_element() < most) {
            return Reached::Outside;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be in range")]
        let cell = scaled.to_array().map(|x| x as u32);
        self.nodes[self.leaf(cell, self.finest).0 as usize].reached
    }

    /// Splits nodes level by level. Returns whether the nodes sufficed.
    fn split(
        &mut self,
        tree: &Tree,
        corners: &(impl Fn(u32) -> [DVec3; 3] + Sync),
        max_nodes: usize,
        context: &Context<'_>,
    ) -> Result<bool, Cancelled> {
        let mut pending = vec![unknown(0, [0; 3])];
        for level in 0..=self.depth {
            let mut next = Vec::new();
            for batch in pending.chunks(BATCH) {
                context.check()?;
                let found: Vec<(Fit, u32, Clearance)> =
                    batch.par_iter().map(|pending| self.fit(tree, corners, level, *pending)).collect();
                for (&Pending { node, cell, .. }, (fit, near, parent)) in batch.iter().zip(found) {
                    self.nodes[node as usize].fit = fit;
                    if fit != Fit::Undecided || level == self.depth {
                        self.leaves.push((node, level, cell));
                        continue;
                    }
                    if self.nodes.len() + 8 > max_nodes {
                        return Ok(false);
                    }
                    next.extend(self.divide(node, cell).map(|(node, cell)| Pending { node, cell, near, parent }));
                }
            }
            pending = next;
        }
        Ok(true)
    }

    /// Gives a node eight children, and returns them with their cells.
    fn divide(&mut self, node: u32, cell: [u32; 3]) -> impl Iterator<Item = (u32, [u32; 3])> + use<> {
        let children = index(self.nodes.len());
        self.nodes[node as usize].children = children;
        self.nodes.extend([Node::undecided(); 8]);
        (0..8u32).map(move |child| (children + child, [0, 1, 2].map(|axis| 2 * cell[axis] + (child >> axis & 1))))
    }

    /// Whether the ball fits in a node, a face near the node, and the clearance at the node's centre.
    ///
    /// The centres of a node and of its child are half of the node's half diagonal apart, which is the child's half
    /// diagonal. So the children of a node with a wide clearance are not blocked, and those of one with a narrow
    /// clearance are not open. At the finest level this answers most nodes without a search.
    fn fit(
        &self,
        tree: &Tree,
        corners: &impl Fn(u32) -> [DVec3; 3],
        level: u32,
        Pending { cell, near, parent, .. }: Pending,
    ) -> (Fit, u32, Clearance) {
        let size = self.size(level);
        let centre = self.low + (DVec3::from(cell.map(f64::from)) + 0.5) * size;
        let half_diagonal = size * 0.5 * 3f64.sqrt();
        let radius = self.diameter / 2.0;
        let of = |distance: f64| match distance {
            d if d >= radius + half_diagonal => Fit::Open,
            d if d < radius - half_diagonal => Fit::Blocked,
            _ => Fit::Undecided,
        };
        let first = nearest_on_triangle(centre, corners(near)).distance(centre);
        let is_last = level >= self.depth;
        let known = match (of(first), parent) {
            (Fit::Blocked, _) => Some(Fit::Blocked),
            (Fit::Undecided, Clearance::Wide) if is_last => Some(Fit::Undecided),
            _ => None,
        };
        if let Some(fit) = known {
            return (fit, near, Clearance::Unknown);
        }
        let bound = match (of(first), parent) {
            (Fit::Undecided, _) | (_, Clearance::Narrow) if is_last => radius - half_diagonal,
            _ => first.min(radius + half_diagonal),
        };
        let mut steps = u64::MAX;
        let found = tree.nearest(centre, bound, &mut steps, corners);
        let (distance, face) = found.map_or((bound, near), |found| (found.distance, found.face));
        (of(distance), face, if distance < radius { Clearance::Narrow } else { Clearance::Wide })
    }

    fn size(&self, level: u32) -> f64 {
        self.side / f64::from(1u32 << level)
    }

    /// Labels the leaves. Splits undecided leaves at openings of undecided width as long as that may help.
    fn label(
        &mut self,
        corners: &(impl Fn(u32) -> [DVec3; 3] + Sync),
        tree: &Tree,
        options: ReachOptions,
        context: &Context<'_>,
    ) -> Result<(), Cancelled> {
        let mut adjacency = Adjacency::new(self, context)?;
        for round in 0.. {
            let flood = Flood::new(self, &adjacency);
            let openings = if round < MAX_ROUNDS { flood.openings(self, &adjacency) } else { Vec::new() };
            let first_new = index(self.nodes.len());
            for batch in openings.chunks(BATCH / 8) {
                context.check()?;
                let mut children = Vec::with_capacity(8 * batch.len());
                for &at in batch {
                    let (node, level, cell) = self.leaves[at as usize];
                    if level < self.finest && self.nodes.len() + 8 <= options.max_nodes {
                        self.leaves[at as usize].0 = u32::MAX;
                        children.extend(self.divide(node, cell).map(|(node, cell)| (node, level + 1, cell)));
                    }
                }
                let found: Vec<Fit> = children
                    .par_iter()
                    .map(|&(node, level, cell)| self.fit(tree, corners, level, unknown(node, cell)).0)
                    .collect();
                for (&(node, ..), fit) in children.iter().zip(found) {
                    self.nodes[node as usize].fit = fit;
                }
                self.leaves.extend(children);
            }
            if first_new == index(self.nodes.len()) {
                self.record(&flood);
                return Ok(());
            }
            self.leaves.retain(|leaf| leaf.0 != u32::MAX);
            adjacency.update(self, first_new, context)?;
        }
        Ok(())
    }

    /// Writes the labels of the leaves and the hidden regions.
    fn record(&mut self, flood: &Flood) {
        let mut region_of: rustc_hash::FxHashMap<u32, u32> = rustc_hash::FxHashMap::default();
        for &(node, level, cell) in &self.leaves {
            let size = self.size(level);
            let is_open = self.nodes[node as usize].fit == Fit::Open;
            let reached = match self.nodes[node as usize].fit {
                Fit::Blocked => Reached::Blocked,
                Fit::Open if flood.is_sure(node) => Reached::Outside,
                _ if flood.is_possible(node) => Reached::Doubtful,
                Fit::Undecided => Reached::Blocked,
                Fit::Open => {
                    let region = *region_of.entry(flood.possible[node as usize]).or_insert_with(|| {
                        let at = self.low + (DVec3::from(cell.map(f64::from)) + 0.5) * size;
                        self.regions.push(HiddenRegion { at, volume: 0.0 });
                        index(self.regions.len() - 1)
                    });
                    self.regions[region as usize].volume += size.powi(3);
                    Reached::Hidden(region)
                }
            };
            self.nodes[node as usize].reached = reached;
            if is_open && reached == Reached::Doubtful {
                self.doubtful_volume += size.powi(3);
            }
        }
        // Undecided leaves belong to the hidden region beside them. Without such a region they stay blocked.
        for &(node, ..) in &self.leaves {
            if self.nodes[node as usize].fit == Fit::Undecided
                && let Some(&region) = region_of.get(&flood.possible[node as usize])
            {
                self.nodes[node as usize].reached = Reached::Hidden(region);
            }
        }
    }
}

/// A node whose parent is not evaluated.
fn unknown(node: u32, cell: [u32; 3]) -> Pending {
    Pending { node, cell, near: 0, parent: Clearance::Unknown }
}

#[expect(clippy::cast_possible_truncation, reason = "nodes are limited to fewer than 2^32")]
fn index(count: usize) -> u32 {
    count as u32
}

#[cfg(test)]
mod tests;
