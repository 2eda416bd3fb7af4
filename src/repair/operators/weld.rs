//! Merges vertices by distance.
//!
//! [`MergeVertices`] merges any vertices, [`Weld`] merges almost coincident boundary vertices, and [`Sew`] merges boundary
//! vertices that are close relative to the length of their edges.

use std::sync::Arc;

use glam::DVec3;
use rustc_hash::FxHashMap;

use super::border::{Border, NearbyEdge};
use super::degenerate::remove_collapsed;
use super::operator::{Applied, Counter, Operation, Scope};
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context, Options};

/// Merges close vertices, on the boundary or inside the surface.
#[derive(Debug, Clone, Copy)]
pub struct MergeVertices {
    /// Vertices closer than this are merged, in the model's unit.
    pub distance: f64,
    /// No vertex is moved farther than this, in the model's unit.
    pub max_deviation: f64,
}

impl MergeVertices {
    /// Merges each vertex into the nearest earlier vertex that stays, within the distance; removes the collapsed faces.
    ///
    /// Precondition: none. Result: the remaining vertices keep their positions and are farther apart than the distance; no
    /// vertex moves farther than the distance. Leaves: any defect that merging creates, such as non-manifold edges where a
    /// solid is thinner than the distance.
    ///
    /// After *Merge by Distance* of Blender and *Simple Clean* of Mesh Heal.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let reach = self.distance.min(self.max_deviation);
        let usable = reach > 0.0 && reach.is_finite();
        // A cell holds only vertices that stay. Those are at least the distance apart, so a cell holds few.
        let cell = |p: DVec3| (p / reach).floor().to_array().map(to_cell);
        let mut kept: FxHashMap<[i64; 3], Vec<u32>> = FxHashMap::default();
        let mut target: Vec<u32> = (0u32..).zip(&surface.positions).map(|(v, _)| v).collect();
        let (mut merged, mut moved) = (0u64, 0.0f64);
        let mut used = vec![false; surface.positions.len()];
        surface.faces.iter().flatten().for_each(|&v| used[v as usize] = true);
        for v in (0..target.len()).filter(|&v| usable && used[v]) {
            if v % 4096 == 0 {
                context.check()?;
            }
            let at = surface.positions[v];
            let nearest = neighbours(cell(at))
                .filter_map(|cell| kept.get(&cell))
                .flatten()
                .map(|&other| (at.distance(surface.positions[other as usize]), other))
                .filter(|&(distance, _)| distance <= reach)
                .min_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
            match nearest {
                Some((distance, other)) => {
                    merged += 1;
                    moved = moved.max(distance);
                    target[v] = other;
                }
                None => kept.entry(cell(at)).or_default().push(target[v]),
            }
        }
        if merged == 0 {
            return Ok(Applied::default());
        }
        for v in surface.faces.iter_mut().flatten() {
            *v = target[*v as usize];
        }
        let mut changes = Change::list([(ChangeKind::VerticesMerged, merged)]);
        changes.extend(remove_collapsed(surface));
        surface.drop_unreferenced();
        Ok(Applied { changes, moved, ..Applied::default() })
    }
}

/// A grid cell and its 26 neighbours.
fn neighbours([x, y, z]: [i64; 3]) -> impl Iterator<Item = [i64; 3]> {
    let steps = -1..=1;
    steps.clone().flat_map(move |i| {
        let steps = steps.clone();
        steps.clone().flat_map(move |j| steps.clone().map(move |k| [x + i, y + j, z + k]))
    })
}

impl Operation<'_> for MergeVertices {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &Counter::ALL;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { distance: scope.options.merge_distance.unwrap_or_default(), max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}

/// The most vertices tested in one grid cell. A fuller cell holds vertices closer than the tolerance; their edges are then
/// shorter still, so they are not merged.
const MAX_VERTICES_PER_CELL: usize = 32;

/// Merges boundary vertices that almost coincide.
#[derive(Debug, Clone, Copy)]
pub struct Weld {
    /// The largest distance, as a share of the bounding box's diagonal.
    pub tolerance: f64,
    /// No vertex is moved farther than this, in the model's unit.
    pub max_deviation: f64,
}

impl Weld {
    /// Merges boundary vertices that are closer than the tolerance and closer than half of the shortest edge at either of
    /// the two vertices.
    ///
    /// ```text
    ///   ----a b----        ----a----
    ///       | |       ->       |
    ///   ----a'b'---        ----a'---
    /// ```
    ///
    /// Precondition: none. Result: each merged vertex takes the position of the first vertex of its group. No face
    /// collapses, because two vertices of a face are never both within half an edge of a third vertex. Interior vertices do
    /// not move. Leaves: gaps wider than the tolerance; where several sheets meet, merging may create a non-manifold edge.
    ///
    /// After Guéziec et al. 2001, "Cutting and Stitching", which raises the tolerance step by step; here there is one step.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let diagonal = surface.bounds().diagonal();
        let reach = (self.tolerance * diagonal).min(self.max_deviation);
        let radii = radii(surface, &edges, reach);
        let boundary: Vec<u32> = (0u32..).zip(&radii).filter(|(_, r)| **r > 0.0).map(|(v, _)| v).collect();
        if boundary.len() < 2 || !reach.is_finite() {
            return Ok(Applied::default());
        }
        let grid = Grid::new(surface, &boundary, reach);
        let mut target: Vec<u32> = (0u32..).zip(&surface.positions).map(|(v, _)| v).collect();
        let (mut merged, mut moved) = (0u64, 0.0f64);
        for (count, &v) in boundary.iter().enumerate() {
            if count % 4096 == 0 {
                context.check()?;
            }
            if let Some(other) = grid.nearest_kept(v, surface, &radii, &target) {
                target[v as usize] = other;
                merged += 1;
                moved = moved.max(surface.positions[v as usize].distance(surface.positions[other as usize]));
            }
        }
        if merged > 0 {
            for v in surface.faces.iter_mut().flatten() {
                *v = target[*v as usize];
            }
            surface.drop_unreferenced();
        }
        let mut limited = Vec::new();
        let short = boundary.iter().filter(|&&v| radii[v as usize] < reach).count();
        if short > 0 && self.tolerance > Options::default().weld_tolerance {
            limited.push((
                "weld_tolerance",
                format!(
                    "{short} boundary vertices have an edge shorter than twice the tolerance; they were merged only within half \
                     of that edge, so that no face collapses"
                ),
            ));
        }
        let changes = Change::list([(ChangeKind::BoundaryVerticesMerged, merged)]);
        Ok(Applied { changes, moved, limited, ..Applied::default() })
    }
}

/// The merge radius of each vertex; 0 for vertices that are not on the boundary.
fn radii(surface: &Surface, edges: &Edges, reach: f64) -> Vec<f64> {
    let mut radii = vec![0.0; surface.positions.len()];
    for (e, _) in edges.iter().enumerate().filter(|(_, h)| h.len() == 1) {
        for v in edges.vertices(e) {
            radii[v as usize] = reach;
        }
    }
    for e in 0..edges.len() {
        let [a, b] = edges.vertices(e);
        let half = surface.positions[a as usize].distance(surface.positions[b as usize]) * 0.5;
        for v in [a, b] {
            radii[v as usize] = half.min(radii[v as usize]);
        }
    }
    radii
}

/// Boundary vertices sorted by grid cell.
struct Grid {
    size: f64,
    vertices: Vec<([i64; 3], u32)>,
}

impl Grid {
    /// Creates a grid whose cells are twice as wide as the reach: cell indices fit i64 for every tolerance above 2^-60.
    fn new(surface: &Surface, boundary: &[u32], reach: f64) -> Self {
        let mut grid = Self { size: 2.0 * reach, vertices: Vec::new() };
        grid.vertices = boundary.iter().map(|&v| (grid.cell(surface.positions[v as usize]), v)).collect();
        grid.vertices.sort_unstable();
        grid
    }

    fn cell(&self, p: DVec3) -> [i64; 3] {
        (p / self.size).floor().to_array().map(to_cell)
    }

    /// The nearest vertex before `v` that stays in place and lies within merge distance of `v`.
    fn nearest_kept(&self, v: u32, surface: &Surface, radii: &[f64], target: &[u32]) -> Option<u32> {
        let at = surface.positions[v as usize];
        let reach = radii[v as usize];
        let (low, high) = (self.cell(at - reach), self.cell(at + reach));
        let mut best: Option<(f64, u32)> = None;
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    let from = &self.vertices[self.vertices.partition_point(|&(c, _)| c < [x, y, z])..];
                    for &(_, other) in from.iter().take_while(|&&(c, _)| c == [x, y, z]).take(MAX_VERTICES_PER_CELL) {
                        if other >= v || target[other as usize] != other {
                            continue;
                        }
                        let distance = at.distance(surface.positions[other as usize]);
                        if distance < reach.min(radii[other as usize]) && best.is_none_or(|b| (distance, other) < b) {
                            best = Some((distance, other));
                        }
                    }
                }
            }
        }
        best.map(|(_, other)| other)
    }
}

/// Converts to a cell index; out-of-range values saturate instead of panicking.
#[expect(clippy::cast_possible_truncation, reason = "a float to integer cast saturates")]
fn to_cell(x: f64) -> i64 {
    (x as i64).clamp(i64::MIN / 4, i64::MAX / 4)
}

impl Operation<'_> for Weld {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges];
    // Where several sheets meet, a boundary edge may become an edge with several faces.
    const MAY_RAISE: &'static [Counter] =
        &[Counter::NonManifoldEdges, Counter::MisorientedEdges, Counter::PinchedVertices, Counter::DuplicateFaces];
    const ACTS_ON: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { tolerance: scope.options.weld_tolerance, max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let mut applied = self.apply(surface, context)?;
        applied.changes.extend(remove_collapsed(surface));
        Ok(applied)
    }
}

/// Merges boundary vertices that are close relative to the length of their boundary edges.
#[derive(Debug, Clone, Copy)]
pub struct Sew {
    /// The largest distance as a share of the shortest boundary edge at either vertex; 0.2 by default.
    pub ratio: f64,
    /// The largest distance as a share of the bounding box's diagonal; 0.001 by default, infinite for no limit.
    pub tolerance: f64,
    /// No vertex is moved farther than this, in the model's unit.
    pub max_deviation: f64,
}

impl Default for Sew {
    fn default() -> Self {
        Self { ratio: 0.2, tolerance: 1e-3, max_deviation: f64::INFINITY }
    }
}

impl Sew {
    /// Merges boundary vertices whose distance is below a share of the shortest boundary edge at either, nearest pair
    /// first. The first vertex of a pair keeps its position; the second keeps it where moving into the first is not allowed.
    ///
    /// ```text
    ///   ---a-------b---         ---a-------b---
    ///   ---c-------d---   ->    ---'-------'---     |ac| < ratio * |ab|
    /// ```
    ///
    /// Both vertices must have boundary edges in nearly opposite directions, as the two sides of a crack have. Boundaries
    /// that only touch are not joined.
    ///
    /// Precondition: none. Result: no face disappears, loses its area or flips, and no edge gets more than two faces.
    /// Leaves: pairs that share an edge, and pairs whose merge would break these conditions.
    ///
    /// After *Sew* of the Blender add-on Mesh Heal.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; finished merges stay.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.run(surface, context)
    }
}

/// The pairs of vertices within merge distance of each other, nearest first.
fn pairs(border: &mut Border<'_>, reach: &[f64], context: &Context<'_>) -> Result<Vec<(f64, u32, u32)>, Cancelled> {
    let mut pairs = Vec::new();
    let mut near: Vec<NearbyEdge> = Vec::new();
    for (at, within) in reach.iter().enumerate() {
        if at % 4096 == 0 {
            context.check()?;
        }
        let v = border.vertices[at];
        near.clear();
        border.edges_near(v, *within, &mut near);
        for other in near.iter().flat_map(|edge| edge.ends).filter(|&other| other > v) {
            let distance = border.position(v).distance(border.position(other));
            if distance < within.min(reach[border.boundary_index(other)]) {
                pairs.push((distance, v, other));
            }
        }
    }
    pairs.sort_unstable_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
    pairs.dedup();
    Ok(pairs)
}

impl Operation<'_> for Sew {
    const FIXES: &'static [Counter] =
        &[Counter::BoundaryEdges, Counter::MisorientedEdges, Counter::NonManifoldEdges, Counter::DuplicateFaces];
    const MAY_RAISE: &'static [Counter] = &[Counter::PinchedVertices];
    const ACTS_ON: &'static [Counter] = &[Counter::BoundaryEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let (default, requested) = (Self::default(), scope.options.sew_ratio);
        // A requested ratio is the only limit.
        let tolerance = if requested.is_some() { f64::INFINITY } else { default.tolerance };
        Self { ratio: requested.unwrap_or(default.ratio), tolerance, max_deviation: scope.max_deviation }
    }

    fn run_shared(
        &self,
        surface: &mut Arc<Surface>,
        edges: Arc<Edges>,
        context: &Context<'_>,
    ) -> Result<Applied, Cancelled> {
        let cap = (self.tolerance * surface.bounds().diagonal()).min(self.max_deviation);
        let Some(mut border) = Border::new(surface, &edges).filter(|_| cap > 0.0) else {
            return Ok(Applied::default());
        };
        let mut reach = vec![cap; border.vertices.len()];
        for ([a, b], length) in border.edge_lengths().collect::<Vec<_>>() {
            for v in [a, b] {
                let reach = &mut reach[border.boundary_index(v)];
                *reach = reach.min(self.ratio * length);
            }
        }
        let pairs = pairs(&mut border, &reach, context)?;
        let mut merged = 0;
        for (count, &(_, a, b)) in pairs.iter().enumerate() {
            if count % 4096 == 0 {
                context.check()?;
            }
            let (a, b) = (border.current_vertex(a), border.current_vertex(b));
            let most = reach[border.boundary_index(a)].min(reach[border.boundary_index(b)]);
            if a == b || border.position(a).distance(border.position(b)) >= most {
                continue;
            }
            let [one, other] = [a, b].map(|v| border.boundary_directions(v));
            if Border::are_opposed(&one, &other) && (border.merge(b, a, cap) || border.merge(a, b, cap)) {
                merged += 1;
            }
        }
        let left = border.exhausted_note();
        let moved = border.max_displacement();
        if merged > 0 {
            Arc::make_mut(surface).drop_unreferenced();
        }
        Ok(Applied {
            changes: Change::list([(ChangeKind::BoundaryVerticesSewn, merged)]),
            moved,
            left,
            ..Applied::default()
        })
    }
}
