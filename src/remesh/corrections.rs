//! Forces samples inside, regardless of their winding number, to preserve thin parts and to keep the surface manifold.

use glam::DVec3;

use super::band::Sampling;
use super::field::{Field, LEVEL, Stop, evaluate};
use super::grid::{Grid, GridIndex, Samples, corner};
use super::region::Region;

/// Offsets from a face, in cells, at which both sides are sampled, tried in turn: parts may be thinner than the first.
const SIDE_OFFSETS: [f64; 3] = [1.0 / 64.0, 1.0 / 1024.0, 1.0 / 16384.0];
/// Winding number above which one side of a face counts as solid. Beside an open sheet, which has no inside, it is one
/// half.
const SOLID_LEVEL: f64 = 0.6;
/// Distance of a test point from a face's edges, in cells. If shorter, the same share of the way to the face's
/// centroid.
const EDGE_OFFSET: f64 = 0.1;
/// Maximum triangles tested per cell.
const MAX_TRIANGLES: usize = 64;

/// The corners of each side of a cell, in cyclic order.
const SIDES: [[u8; 4]; 6] = [[0, 2, 6, 4], [1, 3, 7, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 1, 3, 2], [4, 5, 7, 6]];

impl Sampling<'_, Field<'_>> {
    /// Forces samples inside in parts thinner than a cell: first away from everything else, then towards the parts they
    /// connect to. `cells` are the cells that triangles meet. Returns the number of samples forced inside.
    ///
    /// # Errors
    /// [`Stop`] if a limit is exceeded or the work is cancelled.
    pub fn keep_thin_parts(&mut self, cells: &[GridIndex]) -> Result<u64, Stop> {
        let mut forced = 0;
        for beside_forced in [false, true] {
            let thin_corners = self.thin_parts(cells, beside_forced)?;
            for &index in &thin_corners {
                self.samples.force_inside(index);
            }
            self.sample_around_forced(&thin_corners)?;
            forced += thin_corners.len() as u64;
        }
        Ok(forced)
    }

    /// The samples to force inside so that parts thinner than a cell, such as thin walls and wires, do not vanish. For
    /// every cell without an inside corner that a border of the inside passes through, these are the corners nearest to
    /// the border.
    ///
    /// A cell with some inside next to it contains only the tip of that part, and the surface is extended to it later.
    /// With `beside_forced`, thin parts next to forced samples are filled up to the parts they connect to.
    ///
    /// # Errors
    /// [`Stop`] if a limit is exceeded or the work is cancelled.
    fn thin_parts(&mut self, cells: &[GridIndex], beside_forced: bool) -> Result<Vec<GridIndex>, Stop> {
        let helpful = |cell: GridIndex| {
            self.samples.mask(cell) == 0
                && if beside_forced {
                    around(cell, 3).any(|p| self.samples.is_forced(p))
                } else {
                    !is_tip(&self.samples, cell)
                }
        };
        let selected: Vec<GridIndex> = cells.iter().copied().filter(|&cell| helpful(cell)).collect();
        let found = evaluate(&selected, &mut self.limits.steps, self.context, |&cell, steps| {
            thin_corners(self.field, &self.grid, cell, steps)
        })?;
        let mut indices: Vec<GridIndex> = found.into_iter().flatten().collect();
        indices.sort_unstable();
        indices.dedup();
        Ok(indices)
    }
}

impl<R: Region> Sampling<'_, R> {
    /// Forces samples inside until the inside is well-composed (Latecki 1997). No side of a cell then has only
    /// diagonally opposite inside corners. No cell has exactly two corners of one kind at opposite ends.
    ///
    /// ```text
    ///    o---x        o---x
    ///    |   |   ->   |   |     o outside, x inside
    ///    x---o        x---x
    /// ```
    ///
    /// The surface then passes through every cell in one disc, and through every side of a cell in one line. Of the
    /// samples that would help, the one deepest inside is chosen. The loop terminates: each round forces at least one
    /// sample inside, and a grid with all samples inside except the outermost layer is well-composed. Returns the
    /// number of samples forced inside.
    ///
    /// # Errors
    /// [`Stop`] if a limit is exceeded or the work is cancelled.
    pub fn compose(&mut self) -> Result<u64, Stop> {
        let mut forced = 0;
        let mut cells = self.samples.mixed_cells();
        while !cells.is_empty() {
            self.context.check()?;
            let mut changed = Vec::new();
            for cell in cells {
                while let Some(index) = corner_to_force(&self.grid, &self.samples, cell) {
                    self.samples.force_inside(index);
                    changed.push(index);
                }
            }
            forced += changed.len() as u64;
            cells = self.sample_around_forced(&changed)?;
        }
        Ok(forced)
    }

    /// Samples the cells around forced samples, and all cells that the surface passes through next to them. Returns the
    /// cells whose corners may have changed.
    fn sample_around_forced(&mut self, changed: &[GridIndex]) -> Result<Vec<GridIndex>, Stop> {
        // A forced sample is not in the grid's outermost layer, so all its cells exist.
        let mut around: Vec<GridIndex> = changed
            .iter()
            .flat_map(|&index| (0..8u8).map(move |c| corner(index.map(|x| x.saturating_sub(1)), c)))
            .collect();
        around.sort_unstable();
        around.dedup();
        self.sample_around(around.clone())?;
        Ok(around)
    }
}

/// Whether a cell that shares a side with this one has an inside sample.
fn is_tip(samples: &Samples, cell: GridIndex) -> bool {
    around(cell, 1).any(|index| samples.inside(index) == Some(true))
}

/// The samples up to one step from a cell's corners, along at most `axes` axes.
fn around(cell: GridIndex, axes: usize) -> impl Iterator<Item = GridIndex> {
    let low = cell.map(|c| c.saturating_sub(1));
    let steps = (0..64u32).map(|i| [i % 4, i / 4 % 4, i / 16]);
    let near = steps.filter(move |step| step.iter().filter(|s| [0, 3].contains(s)).count() <= axes);
    near.map(move |step| [0, 1, 2].map(|k| low[k] + step[k]))
}

/// The corners of a cell nearest to a border of the inside in it: those within half a cell of the border along each
/// axis, so that the corners of neighbouring cells connect.
fn thin_corners(field: &Field<'_>, grid: &Grid, cell: GridIndex, steps: &mut u64) -> Vec<GridIndex> {
    let bounds = grid.bounds(cell);
    let mut faces = Vec::new();
    field.tree().overlapping(&bounds, |face| {
        *steps = steps.saturating_sub(1);
        faces.push(face);
        *steps > 0 && faces.len() < 16 * MAX_TRIANGLES
    });
    faces.sort_unstable();
    faces.truncate(MAX_TRIANGLES);
    let (centre, half) = (bounds.centre(), grid.cell / 2.0);
    let mut indices = Vec::new();
    for face in faces {
        let p = field.nearest_on(face, centre);
        if (p - centre).abs().max_element() > half || !is_border(field, grid, face, p, steps) {
            continue;
        }
        for index in (0..8).map(|c| corner(cell, c)).filter(|&index| !grid.is_limit(index)) {
            let at = grid.point(index);
            if (field.nearest_on(face, at) - at).abs().max_element() <= half {
                indices.push(index);
            }
        }
    }
    indices
}

/// Whether the inside ends at a point of a face. The test point is moved slightly off the face's edges, where other
/// faces may begin.
fn is_border(field: &Field<'_>, grid: &Grid, face: u32, point: DVec3, steps: &mut u64) -> bool {
    let [a, b, c] = field.corners(face);
    let inward = (a + b + c) / 3.0 - point;
    let point = point + inward * (EDGE_OFFSET * grid.cell / inward.length().max(grid.cell));
    SIDE_OFFSETS.into_iter().any(|offset| {
        let [a, b] = field.depths(point, field.normal(face) * (offset * grid.cell), steps);
        a.min(b) < LEVEL && a.max(b) > SOLID_LEVEL
    })
}

/// The outside corner of a cell to force inside: the one deepest inside among those that would help to make the cell
/// well-composed.
fn corner_to_force(grid: &Grid, samples: &Samples, cell: GridIndex) -> Option<GridIndex> {
    let mask = samples.mask(cell);
    let helpful = critical(mask)?;
    let depth = |c: u8| samples.value(corner(cell, c)).unwrap_or(0.0);
    let outside = (0..8u8).filter(|c| helpful >> c & 1 == 1 && !grid.is_limit(corner(cell, *c)));
    outside.max_by(|&a, &b| depth(a).total_cmp(&depth(b)).then(b.cmp(&a))).map(|c| corner(cell, c))
}

/// The outside corners, as a bit mask, one of which must become inside; none if the cell is well-composed.
fn critical(mask: u8) -> Option<u8> {
    let inside = |c: u8| mask >> c & 1 == 1;
    for [a, b, c, d] in SIDES {
        if inside(a) == inside(c) && inside(b) == inside(d) && inside(a) != inside(b) {
            return Some(if inside(a) { 1 << b | 1 << d } else { 1 << a | 1 << c });
        }
    }
    let opposite = |few: u8| few.count_ones() == 2 && few.trailing_zeros() + 7 - few.leading_zeros() == 7;
    (opposite(mask) || opposite(!mask)).then_some(!mask)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The number of edge-connected groups of corners of one kind (inside or outside).
    fn groups(mask: u8, kind: bool) -> u32 {
        let mut left: Vec<u8> = (0..8).filter(|c| (mask >> c & 1 == 1) == kind).collect();
        let mut count = 0;
        while let Some(start) = left.pop() {
            count += 1;
            let mut stack = vec![start];
            while let Some(c) = stack.pop() {
                let (near, far): (Vec<u8>, Vec<u8>) = left.iter().partition(|&&d| (c ^ d).count_ones() == 1);
                stack.extend(near);
                left = far;
            }
        }
        count
    }

    #[test]
    fn well_composed_masks_have_one_inside_and_one_outside_group() {
        for mask in 1..=254u8 {
            if critical(mask).is_none() {
                assert_eq!((groups(mask, true), groups(mask, false)), (1, 1), "{mask:08b}");
            }
        }
    }

    #[test]
    fn only_outside_corners_are_forced_inside() {
        for mask in 0..=255u8 {
            if let Some(helpful) = critical(mask) {
                assert!(helpful != 0 && helpful & mask == 0, "{mask:08b}");
            }
        }
    }
}
