//! Vertices merged by their distance alone.

use glam::DVec3;
use rustc_hash::FxHashMap;

use super::degenerate::remove_collapsed;
use super::{Applied, Counter, Operation, Scope};
use crate::mesh::Surface;
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Merges vertices, on the boundary or not.
#[derive(Debug, Clone, Copy)]
pub struct MergeVertices {
    /// Vertices closer than this are merged, in the model's unit.
    pub distance: f64,
    /// No vertex is moved farther than this, in the model's unit.
    pub max_deviation: f64,
}

impl MergeVertices {
    /// Merges each vertex into the nearest earlier one within the distance that stays, and drops the faces that collapse.
    ///
    /// Precondition: none. Result: vertices that are left stand where they were and farther apart than the distance; no vertex moves
    /// farther than it. Leaves: whatever merging makes of the surface, such as edges of several faces where a wall is thinner than the
    /// distance.
    ///
    /// After *Merge by Distance* of Blender and *Simple Clean* of Mesh Heal.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let reach = self.distance.min(self.max_deviation);
        let usable = reach > 0.0 && reach.is_finite();
        // Only vertices that stay are in a cell, and those are at least the distance apart, so a cell holds few of them.
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

/// A cell and those around it.
fn neighbours([x, y, z]: [i64; 3]) -> impl Iterator<Item = [i64; 3]> {
    let steps = -1..=1;
    steps.clone().flat_map(move |i| {
        let steps = steps.clone();
        steps.clone().flat_map(move |j| steps.clone().map(move |k| [x + i, y + j, z + k]))
    })
}

/// Saturates, so that a cell beyond the range is some cell and not a panic.
#[expect(clippy::cast_possible_truncation, reason = "a float to integer cast saturates")]
fn to_cell(x: f64) -> i64 {
    (x as i64).clamp(i64::MIN / 4, i64::MAX / 4)
}

impl Operation for MergeVertices {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &Counter::ALL;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { distance: scope.options.merge_distance.unwrap_or_default(), max_deviation: scope.max_deviation }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
