//! Reopens patches: finds regions that are inside only because holes were patched, and that hide surface visible
//! through those holes.
//!
//! Each sight line that reaches a hidden facet through patches alone is evidence against the regions it crosses. A
//! minimum cut over the regions (Boykov and Kolmogorov 2004) weighs the surface that would be hidden against the skin
//! that would be left open. It fills a region with a small hole, but not a jar with something in it.

use std::collections::{BTreeMap, VecDeque};

use glam::DVec3;
use petgraph::algo::dinics;
use petgraph::visit::EdgeRef;
use petgraph::{Direction, Graph};

use super::cells::Cells;
use super::complex::{ArrangeError, Complex, SolidFaces};
use crate::context::Context;
use crate::math::threads::{self, FEW_SEARCHES};
use crate::math::{Tree, hit, ray_direction};
use crate::mesh::UnionFind;

/// Directions tested from each hidden facet.
const DIRECTIONS: u32 = 32;
/// Maximum number of hidden facets tested; the largest are tested first.
const MAX_HIDDEN: usize = 20_000;
/// Number of facets tested in parallel before the steps are counted.
const FACETS_PER_BLOCK: usize = 1024;
/// Maximum number of facets that all sight lines together may visit.
const STEPS: u64 = 100_000_000;
/// Length of a sight line in the scale of the tree, in which the model is about 1 wide.
const SIGHT_LENGTH: f64 = 8.0;
/// Offset of a ray's start from the farthest corner of a piece, as a share of the way to the centroid of that corner's
/// facet.
const CORNER_OFFSET: f64 = 1e-3;
/// Share of all surface that must be hidden before patches are reopened.
const MIN_HIDDEN_SHARE: f64 = 0.005;
/// Weight of skin that would be left open, relative to the same area of hidden surface that is visible in all
/// directions. Openings reduce the weight by `OPENING_DISCOUNT` times their area: it is zero where they reach half the
/// area of the skin.
const SKIN_WEIGHT: f64 = 0.01;
const OPENING_DISCOUNT: f64 = 2.0;
/// Weight of a patch that would stay as boundary.
const PATCH_WEIGHT: f64 = 0.001;
/// Integer weight of the whole surface. Integer weights make sums independent of their order.
const WEIGHT_SCALE: f64 = (1u64 << 40) as f64;

/// The cells that are inside only because of patches through which hidden surface is visible; none if there are no such
/// cells.
pub(super) fn cells_to_reopen(
    complex: &Complex,
    cells: &Cells,
    inside: &[bool],
    is_patch: impl Fn(u32) -> bool,
    context: &Context<'_>,
) -> Result<Option<Vec<bool>>, ArrangeError> {
    let patch: Vec<bool> = complex.facets.iter().map(|facet| facet.faces.iter().all(|&f| is_patch(f))).collect();
    if !patch.contains(&true) {
        return Ok(None);
    }
    let Some(regions) = Regions::new(complex, cells, inside, patch, context)? else { return Ok(None) };
    let doubtful = regions.behind_patches(|_| true);
    if !doubtful.contains(&true) {
        return Ok(None);
    }
    let Some(hidden) = regions.hidden(&doubtful, context)? else { return Ok(None) };
    context.check()?;
    let outside = regions.cut(&hidden, &doubtful);
    let opened_regions = regions.behind_patches(|region| outside[region]);
    let opened: Vec<bool> = regions.region_of.iter().map(|&region| opened_regions[region as usize]).collect();
    Ok(opened.contains(&true).then_some(opened))
}

/// The regions of space. A region is a set of cells, of pieces of the surface that do not touch, with no facet between
/// them.
struct Regions<'a> {
    cells: &'a Cells,
    /// Which cells, and therefore the regions they represent, are inside.
    inside: &'a [bool],
    /// The region of each cell, identified by one of its cells.
    region_of: Vec<u32>,
    /// The pairs of regions connected by a portal: a patch facet between them. Both directions, sorted.
    portals: Vec<(usize, usize)>,
    tree: Tree,
    /// All points, scaled.
    points: Vec<DVec3>,
    /// The corners of each facet.
    corners: Vec<[u32; 3]>,
    /// Whether each facet is covered by patches alone.
    patch: Vec<bool>,
    /// The area of each facet, as a share of all area that is not patch.
    area: Vec<f64>,
}

impl<'a> Regions<'a> {
    fn new(
        complex: &Complex,
        cells: &'a Cells,
        inside: &'a [bool],
        patch: Vec<bool>,
        context: &Context<'_>,
    ) -> Result<Option<Self>, ArrangeError> {
        #[expect(clippy::cast_possible_truncation, reason = "points are counted in u32")]
        let points: Vec<DVec3> =
            (0..complex.points.len() as u32).map(|p| SolidFaces::to_unit(complex.points.place(p))).collect();
        let corners: Vec<[u32; 3]> = complex.facets.iter().map(|facet| facet.corners).collect();
        let mut area: Vec<f64> = corners.iter().map(|face| normal(face.map(|p| points[p as usize])).length()).collect();
        let all: f64 = area.iter().zip(&patch).filter(|(_, patch)| !**patch).map(|(area, _)| area).sum();
        area.iter_mut().for_each(|area| *area /= all.max(f64::MIN_POSITIVE));
        let tree = Tree::new(&points, &corners);
        let mut regions =
            Self { cells, inside, region_of: Vec::new(), portals: Vec::new(), tree, points, corners, patch, area };
        let Some(region_of) = regions.find(context)? else { return Ok(None) };
        regions.region_of = region_of;
        regions.portals = regions.find_portals();
        Ok(Some(regions))
    }

    /// The portals, from the patch facets.
    fn find_portals(&self) -> Vec<(usize, usize)> {
        let mut portals: Vec<(usize, usize)> = Vec::new();
        for facet in (0..self.patch.len()).filter(|&facet| self.patch[facet]) {
            let [a, b] = self.beside(facet);
            portals.extend([(a, b), (b, a)]);
        }
        portals.sort_unstable();
        portals.dedup();
        portals
    }

    /// Calls `visit` with the parameter and the index of every facet along a line, except the facet where the line
    /// starts, until `visit` returns `false`. Returns whether the steps sufficed.
    fn along(
        &self,
        from: (DVec3, usize),
        line: DVec3,
        steps: &mut u64,
        mut visit: impl FnMut(f64, usize) -> bool,
    ) -> bool {
        let (from, start) = from;
        self.tree.along(from, from + line, |facet| {
            let facet = facet as usize;
            *steps = steps.saturating_sub(1);
            let met = if facet == start { None } else { hit(from, line, self.triangle(facet)) };
            met.is_none_or(|at| visit(at, facet)) && *steps > 0
        });
        *steps > 0
    }

    /// The region of each cell. From the outermost point of each piece a ray runs in a fixed direction. The region
    /// around the piece is that of the next facet along the ray. All rays have the same direction, so pieces cannot
    /// refer to each other in a cycle. None if the steps run out.
    fn find(&self, context: &Context<'_>) -> Result<Option<Vec<u32>>, ArrangeError> {
        let direction = ray_direction(0);
        let piece_of = &self.cells.piece_of;
        // For each piece its extent in the direction, and the facet and corner that reach it.
        let mut last: BTreeMap<u32, (f64, usize, DVec3)> = BTreeMap::new();
        for (facet, &piece) in piece_of.iter().enumerate() {
            for corner in self.triangle(facet) {
                let at = corner.dot(direction);
                let best = last.entry(piece).or_insert((at, facet, corner));
                if at > best.0 {
                    *best = (at, facet, corner);
                }
            }
        }
        let mut regions = UnionFind::new(self.cells.winding.len());
        let mut steps = STEPS;
        for (piece, (_, facet, corner)) in last {
            context.check()?;
            let [a, b, c] = self.triangle(facet);
            let from = corner.lerp((a + b + c) / 3.0, CORNER_OFFSET);
            let mut own = (0.0, facet);
            let mut others: Vec<(f64, usize)> = Vec::new();
            let in_time = self.along((from, facet), direction * SIGHT_LENGTH, &mut steps, |at, other| {
                if piece_of[other] != piece {
                    others.push((at, other));
                } else if at > own.0 {
                    own = (at, other);
                }
                true
            });
            if !in_time {
                return Ok(None);
            }
            let next =
                others.into_iter().filter(|next| next.0 > own.0).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            if let Some((_, next)) = next {
                let ends = [self.side(own.1, direction, true), self.side(next, direction, false)];
                let [around, beside] = ends.map(|cell| self.cells.winding[cell]);
                if around == beside {
                    regions.unite(index(ends[0]), index(ends[1]));
                }
            }
        }
        Ok(Some(regions.into_roots()))
    }

    /// The cell behind a facet (`to`) or in front of it, along a direction.
    fn side(&self, facet: usize, direction: DVec3, to: bool) -> usize {
        let is_aligned = normal(self.triangle(facet)).dot(direction) > 0.0;
        self.cells.beside(facet)[usize::from(is_aligned != to)]
    }

    /// The regions in front of and behind a facet.
    fn beside(&self, facet: usize) -> [usize; 2] {
        self.cells.beside(facet).map(|cell| self.region_of[cell] as usize)
    }

    fn triangle(&self, facet: usize) -> [DVec3; 3] {
        self.corners[facet].map(|p| self.points[p as usize])
    }

    /// The inside cells that are reachable from outside through portals and other such cells for which `may_pass`
    /// returns true.
    fn behind_patches(&self, may_pass: impl Fn(usize) -> bool) -> Vec<bool> {
        let mut reached = vec![false; self.inside.len()];
        let mut next: VecDeque<usize> =
            self.portals.iter().map(|&(from, _)| from).filter(|&region| !self.inside[region]).collect();
        while let Some(cell) = next.pop_front() {
            let first = self.portals.partition_point(|&(from, _)| from < cell);
            for &(_, to) in self.portals[first..].iter().take_while(|&&(from, _)| from == cell) {
                if self.inside[to] && !reached[to] && may_pass(to) {
                    reached[to] = true;
                    next.push_back(to);
                }
            }
        }
        reached
    }

    /// The hidden surface seen through each region: area times the share of directions from which it is visible. None
    /// if there is too little, or the steps run out.
    fn hidden(&self, doubtful: &[bool], context: &Context<'_>) -> Result<Option<Vec<f64>>, ArrangeError> {
        let is_hidden = |&facet: &usize| {
            let sides = self.beside(facet);
            !self.patch[facet]
                && sides.iter().all(|&region| self.inside[region])
                && sides.iter().any(|&region| doubtful[region])
        };
        let mut facets: Vec<usize> = (0..self.area.len()).filter(is_hidden).collect();
        if facets.iter().map(|&facet| self.area[facet]).sum::<f64>() <= MIN_HIDDEN_SHARE {
            return Ok(None);
        }
        facets.sort_by(|&a, &b| self.area[b].total_cmp(&self.area[a]));
        facets.truncate(MAX_HIDDEN);
        let mut hidden = vec![0.0; self.inside.len()];
        let (mut all, mut left) = (0.0, STEPS);
        for block in facets.chunks(FACETS_PER_BLOCK) {
            context.check()?;
            let seen = threads::map(block.len(), FEW_SEARCHES, |i| {
                let mut steps = left;
                let sights = (0..DIRECTIONS).filter_map(|n| self.sight(block[i], ray_direction(n), &mut steps));
                (sights.collect::<Vec<Vec<usize>>>(), left - steps)
            });
            for (&facet, (lines, steps)) in block.iter().zip(seen) {
                left = left.saturating_sub(steps);
                if !lines.is_empty() {
                    all += self.area[facet];
                }
                // Each side of a facet is visible in only half of the directions.
                let share = 2.0 / f64::from(DIRECTIONS);
                for &region in lines.iter().flatten() {
                    hidden[region] += self.area[facet] * share;
                }
            }
            if left == 0 {
                return Ok(None);
            }
        }
        Ok((all > MIN_HIDDEN_SHARE).then_some(hidden))
    }

    /// The inside regions along the line of sight from a facet's centroid in a direction. None if a facet that is no
    /// patch blocks the line, or the line runs too close to an edge to be followed.
    fn sight(&self, facet: usize, direction: DVec3, steps: &mut u64) -> Option<Vec<usize>> {
        let corners = self.triangle(facet);
        let from = (corners[0] + corners[1] + corners[2]) / 3.0;
        let mut patches: Vec<(f64, usize)> = Vec::new();
        let mut is_clear = true;
        let in_time = self.along((from, facet), direction * SIGHT_LENGTH, steps, |at, other| {
            patches.push((at, other));
            is_clear = self.patch[other];
            is_clear
        });
        if !is_clear || !in_time {
            return None;
        }
        patches.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let region = |facet: usize, to: bool| self.region_of[self.side(facet, direction, to)] as usize;
        let mut here = region(facet, true);
        let mut passed = vec![here];
        for (_, patch) in patches {
            if region(patch, false) != here {
                return None;
            }
            here = region(patch, true);
            passed.push(here);
        }
        if self.inside[here] {
            return None;
        }
        passed.retain(|&region| self.inside[region]);
        passed.sort_unstable();
        passed.dedup();
        Some(passed)
    }

    /// The regions on the outer side of the minimum cut.
    fn cut(&self, hidden: &[f64], doubtful: &[bool]) -> Vec<bool> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share, and far below 2^64")]
        let weight = |share: f64| (share * WEIGHT_SCALE) as u64;
        let (mut skin, mut openings) = (vec![0.0; doubtful.len()], vec![0.0; doubtful.len()]);
        let mut between: BTreeMap<[usize; 2], u64> = BTreeMap::new();
        for (facet, &area) in self.area.iter().enumerate() {
            let [a, b] = self.beside(facet);
            for (region, other) in [(a, b), (b, a)] {
                if self.patch[facet] {
                    openings[region] += area;
                } else if !self.inside[other] {
                    skin[region] += area;
                }
            }
            if self.patch[facet] && a != b && doubtful[a] && doubtful[b] {
                *between.entry([a.min(b), a.max(b)]).or_default() += weight(PATCH_WEIGHT * area);
            }
        }
        let mut graph = Graph::<(), u64>::new();
        let (outer, inner) = (graph.add_node(()), graph.add_node(()));
        let mut node = vec![inner; doubtful.len()];
        for cell in (0..doubtful.len()).filter(|&cell| doubtful[cell]) {
            node[cell] = graph.add_node(());
            graph.add_edge(outer, node[cell], weight(hidden[cell]));
            graph.add_edge(
                node[cell],
                inner,
                weight(SKIN_WEIGHT * (skin[cell] - OPENING_DISCOUNT * openings[cell]).max(0.0)),
            );
        }
        for (cells, weight) in between {
            let [a, b] = cells.map(|cell| node[cell]);
            graph.add_edge(a, b, weight);
            graph.add_edge(b, a, weight);
        }
        let (_, flow) = dinics(&graph, outer, inner);
        let mut reached = vec![false; graph.node_count()];
        reached[outer.index()] = true;
        let mut next = VecDeque::from([outer]);
        while let Some(at) = next.pop_front() {
            let on = graph.edges(at).filter(|edge| flow[edge.id().index()] < *edge.weight()).map(|edge| edge.target());
            let back = graph.edges_directed(at, Direction::Incoming);
            let back = back.filter(|edge| flow[edge.id().index()] > 0).map(|edge| edge.source());
            for to in on.chain(back) {
                if !std::mem::replace(&mut reached[to.index()], true) {
                    next.push_back(to);
                }
            }
        }
        node.iter().map(|node| reached[node.index()]).collect()
    }
}

#[expect(clippy::cast_possible_truncation, reason = "sides are counted in u32")]
fn index(cell: usize) -> u32 {
    cell as u32
}

/// A triangle's area vector: its normal with the length of twice its area.
fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}
