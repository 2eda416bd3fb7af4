//! Merging boundary vertices that almost coincide.

use glam::DVec3;

use super::degenerate::remove_collapsed;
use super::{Applied, Counter, Operation, Scope};
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context, Options};

/// Vertices looked at in one cell of the grid: more can't lie in a cell further apart than the tolerance unless their
/// own edges are shorter still, and then they are not merged.
const MOST_PER_CELL: usize = 32;

/// How far boundary vertices may be apart to be merged.
#[derive(Debug, Clone, Copy)]
pub struct Weld {
    /// Share of the bounding box's diagonal.
    pub tolerance: f64,
    /// No vertex is moved farther than this, in the model's unit.
    pub max_deviation: f64,
}

impl Weld {
    /// Merges boundary vertices that stand closer than the tolerance and closer than half of the shortest edge at
    /// either of them.
    ///
    /// ```text
    ///   ----a b----        ----a----
    ///       | |       ->       |
    ///   ----a'b'---        ----a'---
    /// ```
    ///
    /// Precondition: none. Result: each merged vertex stands where the first one of its group stood; no face
    /// collapses, because two vertices of a face are never both within half an edge of a third; interior vertices do
    /// not move. Leaves: gaps wider than the tolerance, and it may make an edge of more than two faces where
    /// several sheets meet.
    ///
    /// After the tolerance ladder of Guéziec et al. 2001, "Cutting and Stitching", with one rung.
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
        // Cells twice as wide as the reach are few enough to count in i64 for every tolerance above 2^-60.
        let cell = |p: DVec3| (p / (2.0 * reach)).floor().to_array().map(to_cell);
        let mut grid: Vec<([i64; 3], u32)> =
            boundary.iter().map(|&v| (cell(surface.positions[v as usize]), v)).collect();
        grid.sort_unstable();
        let mut target: Vec<u32> = (0u32..).zip(&surface.positions).map(|(v, _)| v).collect();
        let (mut merged, mut moved) = (0u64, 0.0f64);
        for (count, &v) in boundary.iter().enumerate() {
            if count % 4096 == 0 {
                context.check()?;
            }
            if let Some(other) = nearest_kept(v, surface, &grid, &radii, &target, cell) {
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
                    "{short} boundary vertices have an edge shorter than twice the tolerance; there only what is within half of that edge \
                     was merged, so that no face collapses"
                ),
            ));
        }
        let changes = Change::list([(ChangeKind::BoundaryVerticesMerged, merged)]);
        Ok(Applied { changes, moved, limited, ..Applied::default() })
    }
}

/// How far each vertex may be merged; 0 for those not on the boundary.
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

/// The nearest vertex before `v` that stays where it is and within whose reach `v` lies.
fn nearest_kept(
    v: u32,
    surface: &Surface,
    grid: &[([i64; 3], u32)],
    radii: &[f64],
    target: &[u32],
    cell: impl Fn(DVec3) -> [i64; 3],
) -> Option<u32> {
    let at = surface.positions[v as usize];
    let reach = radii[v as usize];
    let (low, high) = (cell(at - reach), cell(at + reach));
    let mut best: Option<(f64, u32)> = None;
    for x in low[0]..=high[0] {
        for y in low[1]..=high[1] {
            for z in low[2]..=high[2] {
                let from = grid.partition_point(|&(c, _)| c < [x, y, z]);
                for &(_, other) in grid[from..].iter().take_while(|&&(c, _)| c == [x, y, z]).take(MOST_PER_CELL) {
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

/// Saturates, so that a cell beyond the range is some cell and not a panic.
#[expect(clippy::cast_possible_truncation, reason = "a float to integer cast saturates")]
fn to_cell(x: f64) -> i64 {
    (x as i64).clamp(i64::MIN / 4, i64::MAX / 4)
}

impl Operation for Weld {
    const FIXES: &'static [Counter] = &[Counter::BoundaryEdges];
    // Where several sheets meet, what was open becomes an edge of several faces.
    const MAY_RAISE: &'static [Counter] =
        &[Counter::NonmanifoldEdges, Counter::MisorientedEdges, Counter::PinchedVertices, Counter::DuplicateFaces];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { tolerance: scope.options.weld_tolerance, max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let mut applied = self.apply(surface, context)?;
        applied.changes.extend(remove_collapsed(surface));
        Ok(applied)
    }
}
