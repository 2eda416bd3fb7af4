//! The regions of space that a closed surface without intersections separates, and which of them are material.

use std::cmp::Ordering;

use glam::DVec3;
use smallvec::SmallVec;

use super::nesting::Nesting;
use crate::context::{Cancelled, Context};
use crate::math::{Box3, order_around, to_unit_range};
use crate::mesh::{ClosedSurface, Edges, NotClosed, Surface, UnionFind};

/// The region that reaches to infinity.
pub const OUTSIDE: u32 = 0;
/// The region of the sides of a face that bounds nothing: one with a repeated vertex, or in a piece without any area.
pub const NO_REGION: u32 = u32::MAX;

/// Why the regions of a surface could not be found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RegionsError {
    /// The surface is not closed, or not consistently wound.
    #[error(transparent)]
    NotClosed(#[from] NotClosed),
    /// Faces overlap or touch at so many places that the side of a piece stayed undecided, or the budget ran out.
    #[error("the nesting of the parts is undecided around face {face}")]
    Undecided {
        /// A face of the piece.
        face: u32,
    },
    /// The work was cancelled, or its deadline passed.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// The regions of space between the faces of a closed surface.
///
/// Material is where the surface winds around outward at least once, as for [`WindingRule::Positive`]. Regions on both
/// sides of a face with material (or air) on both sides count as one region.
///
/// [`WindingRule::Positive`]: crate::arrange::WindingRule::Positive
#[derive(Debug, Clone)]
pub struct Regions {
    /// The region at each side of each face: entry `2 f` in front of face `f`, where its normal points, and `2 f + 1`
    /// behind it.
    pub of_side: Vec<u32>,
    /// For each region, whether it is material.
    pub is_material: Vec<bool>,
    /// For each region the neighbouring region through which the fewest faces lead outside; [`OUTSIDE`] for itself.
    pub towards_outside: Vec<u32>,
    /// For each region the number of faces on that way.
    pub depth: Vec<u32>,
}

impl Regions {
    /// Finds the regions of a surface whose faces meet only in common edges and vertices. O(n log n), plus a few rays
    /// for each connected piece.
    ///
    /// Decisions are exact. Where the order of faces along a ray can't be decided, another ray is tried.
    ///
    /// # Errors
    /// [`RegionsError`] if winding numbers contradict each other, if the nesting is undecided, and on cancellation.
    pub fn new(surface: ClosedSurface<'_>, edges: &Edges, context: &Context<'_>) -> Result<Self, RegionsError> {
        let surface = surface.get();
        let unit = to_unit_range(&surface.positions);
        let count = surface.faces.len();
        // The last set is the space outside of all boxes.
        let infinity = index(2 * count);
        let (mut sides, mut pieces) = (UnionFind::new(2 * count + 1), UnionFind::new(count));
        for (edge, half_edges) in edges.iter().enumerate() {
            if edge % 65_536 == 0 {
                context.check()?;
            }
            let around =
                around_edge(surface, &unit, half_edges).ok_or(RegionsError::Undecided { face: half_edges[0] / 3 })?;
            for (k, &(face, forward)) in around.iter().enumerate() {
                let (next, next_forward) = around[(k + 1) % around.len()];
                // Counter-clockwise of a forward face is its front.
                sides.unite(2 * face + u32::from(!forward), 2 * next + u32::from(next_forward));
                pieces.unite(face, next);
            }
        }
        let mut nesting = Nesting::new(surface, &unit, pieces.into_roots());
        let is_flat = nesting.flat_faces();
        for piece in nesting.pieces().into_iter().filter(|&piece| !is_flat[piece as usize]) {
            context.check()?;
            let [outer, around] =
                nesting.surroundings(piece, infinity).ok_or(RegionsError::Undecided { face: piece })?;
            sides.unite(outer, around);
        }
        let (of_side, regions) = numbered(sides, &is_flat);
        Self::merged(of_side, regions)
    }

    /// The regions of a surface that is closed for certain.
    #[cfg(test)]
    pub fn of_closed(surface: &Surface, context: &Context<'_>) -> Self {
        let edges = Edges::new(&surface.faces);
        Self::new(ClosedSurface::new(surface, &edges).unwrap(), &edges, context).unwrap()
    }

    /// Merges neighbouring regions that are both material or both air.
    fn merged(of_side: Vec<u32>, regions: usize) -> Result<Self, RegionsError> {
        let winding = winding_numbers(&of_side, regions)?;
        let mut sets = UnionFind::new(regions);
        for sides in of_side.chunks_exact(2).filter(|sides| sides[0] != NO_REGION) {
            if (winding[sides[0] as usize] > 0) == (winding[sides[1] as usize] > 0) {
                sets.unite(sides[0], sides[1]);
            }
        }
        let roots = sets.into_roots();
        let mut number = vec![NO_REGION; regions];
        let mut is_material = Vec::new();
        for (region, &root) in roots.iter().enumerate() {
            if root as usize == region {
                number[region] = index(is_material.len());
                is_material.push(winding[region] > 0);
            } else {
                number[region] = number[root as usize];
            }
        }
        let renumbered = |side: u32| if side == NO_REGION { NO_REGION } else { number[side as usize] };
        let of_side: Vec<u32> = of_side.into_iter().map(renumbered).collect();
        let mut all = Self { towards_outside: Vec::new(), depth: Vec::new(), of_side, is_material };
        (all.towards_outside, all.depth) = all.ways_outside(|_| false);
        Ok(all)
    }

    /// Number of regions.
    #[must_use]
    pub fn count(&self) -> usize {
        self.is_material.len()
    }

    /// The regions in front of and behind a face.
    ///
    /// # Panics
    /// If there is no such face.
    #[must_use]
    pub fn beside(&self, face: u32) -> [u32; 2] {
        [0, 1].map(|side| self.of_side[2 * face as usize + side])
    }

    /// The faces with different regions on both sides, by region, in ascending order.
    #[must_use]
    pub fn faces(&self) -> Vec<Vec<u32>> {
        let mut faces = vec![Vec::new(); self.count()];
        for (face, sides) in (0u32..).zip(self.of_side.chunks_exact(2)) {
            if sides[0] != sides[1] {
                sides.iter().for_each(|&region| faces[region as usize].push(face));
            }
        }
        faces
    }

    /// For each region, whether every way from it to the outside passes through a region that is blocked.
    #[must_use]
    pub fn enclosed_in(&self, is_blocked: impl Fn(u32) -> bool) -> Vec<bool> {
        let (_, depth) = self.ways_outside(&is_blocked);
        depth.iter().zip(0u32..).map(|(&depth, region)| depth == u32::MAX && !is_blocked(region)).collect()
    }

    /// The volume of a region other than the outside, from its faces, by the divergence theorem.
    #[must_use]
    pub fn volume(&self, surface: &Surface, region: u32, faces: &[u32]) -> f64 {
        let about = bounds_of(surface, faces).centre();
        faces.iter().map(|&f| self.out_of(f, region) * wedge(surface, f, about)).sum::<f64>() / 6.0
    }

    /// 1 if the normal of a face of `region` points out of the region, -1 if it points into it.
    #[must_use]
    pub fn out_of(&self, face: u32, region: u32) -> f64 {
        if self.beside(face)[0] == region { -1.0 } else { 1.0 }
    }

    /// For each region the next on the way outside with the fewest faces, and their number, by breadth-first search that
    /// does not enter blocked regions. The number is `u32::MAX` where there is no way.
    fn ways_outside(&self, is_blocked: impl Fn(u32) -> bool) -> (Vec<u32>, Vec<u32>) {
        let mut neighbours = vec![Vec::new(); self.count()];
        for sides in self.of_side.chunks_exact(2).filter(|sides| sides[0] != sides[1]) {
            neighbours[sides[0] as usize].push(sides[1]);
            neighbours[sides[1] as usize].push(sides[0]);
        }
        for of_region in &mut neighbours {
            of_region.sort_unstable();
            of_region.dedup();
        }
        let mut depth = vec![u32::MAX; self.count()];
        let mut next = vec![OUTSIDE; self.count()];
        let mut queue = vec![OUTSIDE];
        if let Some(outside) = depth.first_mut() {
            *outside = 0;
        }
        let mut at = 0;
        while let Some(&region) = queue.get(at) {
            at += 1;
            for &other in neighbours.get(region as usize).into_iter().flatten() {
                if depth[other as usize] == u32::MAX && !is_blocked(other) {
                    depth[other as usize] = depth[region as usize] + 1;
                    next[other as usize] = region;
                    queue.push(other);
                }
            }
        }
        (next, depth)
    }
}

/// The faces around an edge, counter-clockwise seen from its larger vertex, each with whether its half-edge runs from
/// the smaller vertex to the larger. `None` if a face at an edge of more than two faces has no area.
#[must_use]
pub fn around_edge(surface: &Surface, unit: &[DVec3], half_edges: &[u32]) -> Option<SmallVec<[(u32, bool); 4]>> {
    let directed: SmallVec<[(u32, bool); 4]> =
        half_edges.iter().map(|&h| (h / 3, Edges::is_forward(&surface.faces, h))).collect();
    if half_edges.len() <= 2 {
        return Some(directed);
    }
    let [a, b] = Edges::ends(&surface.faces, half_edges[0]);
    let at = |v: u32| unit[v as usize];
    let opposite: SmallVec<[DVec3; 8]> = half_edges.iter().map(|&h| at(Edges::opposite(&surface.faces, h))).collect();
    let order = order_around(at(a.min(b)), at(a.max(b)), &opposite, |_, _| Ordering::Equal)?;
    Some(order.into_iter().map(|i| directed[i]).collect())
}

/// Numbers the sets of sides: the set of infinity is [`OUTSIDE`], the others follow by their first side.
fn numbered(sides: UnionFind, is_flat: &[bool]) -> (Vec<u32>, usize) {
    let (roots, faces) = (sides.into_roots(), is_flat.len());
    let mut number = vec![NO_REGION; roots.len()];
    let mut count = 1;
    number[roots[2 * faces] as usize] = OUTSIDE;
    let of_side = (0..2 * faces)
        .map(|side| {
            if is_flat[side / 2] {
                return NO_REGION;
            }
            let slot = &mut number[roots[side] as usize];
            if *slot == NO_REGION {
                *slot = count;
                count += 1;
            }
            *slot
        })
        .collect();
    (of_side, count as usize)
}

/// The winding number of each region: one more behind a face than in front of it.
fn winding_numbers(of_side: &[u32], regions: usize) -> Result<Vec<i32>, RegionsError> {
    let mut neighbours = vec![Vec::new(); regions];
    for sides in of_side.chunks_exact(2).filter(|sides| sides[0] != NO_REGION) {
        neighbours[sides[0] as usize].push((sides[1], 1));
        neighbours[sides[1] as usize].push((sides[0], -1));
    }
    let mut winding: Vec<Option<i32>> = vec![None; regions];
    winding[OUTSIDE as usize] = Some(0);
    let mut stack = vec![OUTSIDE];
    while let Some(region) = stack.pop() {
        let here = winding[region as usize].unwrap_or(0);
        for &(other, step) in &neighbours[region as usize] {
            match winding[other as usize] {
                None => {
                    winding[other as usize] = Some(here + step);
                    stack.push(other);
                }
                Some(known) if known != here + step => return Err(NotClosed.into()),
                Some(_) => {}
            }
        }
    }
    winding.into_iter().map(|number| number.ok_or(RegionsError::NotClosed(NotClosed))).collect()
}

/// Six times the signed volume between a point and a face.
fn wedge(surface: &Surface, face: u32, about: DVec3) -> f64 {
    let [a, b, c] = surface.corners(face as usize).map(|p| p - about);
    a.dot(b.cross(c))
}

/// The bounding box of faces.
pub(crate) fn bounds_of(surface: &Surface, faces: &[u32]) -> Box3 {
    Box3::of(faces.iter().flat_map(|&f| surface.corners(f as usize)))
}

/// Converts a count to an index.
#[expect(clippy::cast_possible_truncation, reason = "sides are counted in u32")]
fn index(count: usize) -> u32 {
    count as u32
}
