//! Samples put inside whatever the winding number says: so that thin parts stay, and the surface is manifold.

use glam::DVec3;

use super::band::Sampling;
use super::field::{Field, LEVEL, Stop, ask};
use super::grid::{Grid, Place, Samples, corner};

/// How far on each side of a face it is asked what is there, in cells, one after another: parts may be thinner.
const ASIDE: [f64; 3] = [1.0 / 64.0, 1.0 / 1024.0, 1.0 / 16384.0];
/// How much a point must be inside on one side of a face: next to an open sheet, which has no inside, it is a half.
const SOLID: f64 = 0.6;
/// How far from the edges of a face, in cells, or in shares of the way to its middle where that is shorter.
const OFF_EDGE: f64 = 0.1;
/// Triangles of a cell that are asked.
const MOST: usize = 64;

/// Corners of the sides of a cell, around each.
const SIDES: [[u8; 4]; 6] = [[0, 2, 6, 4], [1, 3, 7, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 1, 3, 2], [4, 5, 7, 6]];

impl Sampling<'_> {
    /// Puts samples inside in parts that are thinner than a cell: first away from everything else, then towards what they
    /// are joined to. `cells` are those that triangles meet. Answers how many samples it put inside.
    ///
    /// # Errors
    /// [`Stop`] where a limit is met.
    pub fn keep_thin_parts(&mut self, cells: &[Place]) -> Result<u64, Stop> {
        let mut made = 0;
        for beside_made in [false, true] {
            let thin = self.thin_parts(cells, beside_made)?;
            for &place in &thin {
                self.samples.make_inside(place);
            }
            self.settle(&thin)?;
            made += thin.len() as u64;
        }
        Ok(made)
    }

    /// The samples to put inside so that parts thinner than a cell, such as walls and wires, do not vanish: of every cell without
    /// a corner inside that a border of the inside passes, the corners nearest to it. `cells` are those that triangles meet.
    ///
    /// Where there is some inside next to a cell, what is in it is a tip of that, and the surface is bent out to it later; but
    /// `beside_made`, next to samples that were put inside, thin parts are filled up to what they are joined to.
    ///
    /// # Errors
    /// [`Stop`] where a limit is met.
    fn thin_parts(&mut self, cells: &[Place], beside_made: bool) -> Result<Vec<Place>, Stop> {
        let wanted = |cell: Place| {
            self.samples.mask(cell) == 0
                && if beside_made {
                    around(cell, 3).any(|p| self.samples.is_made(p))
                } else {
                    !is_tip(&self.samples, cell)
                }
        };
        let alone: Vec<Place> = cells.iter().copied().filter(|&cell| wanted(cell)).collect();
        let found = ask(&alone, &mut self.limits.steps, self.context, |&cell, steps| {
            thin(self.field, &self.grid, cell, steps)
        })?;
        let mut places: Vec<Place> = found.into_iter().flatten().collect();
        places.sort_unstable();
        places.dedup();
        Ok(places)
    }

    /// Puts samples inside until the inside is well-composed (Latecki 1997): no side of a cell has its inside corners only
    /// across from one another, and no cell has just two corners on one side of the surface, at opposite ends.
    ///
    /// ```text
    ///    o---x        o---x
    ///    |   |   ->   |   |     o outside, x inside
    ///    x---o        x---x
    /// ```
    ///
    /// Then the surface passes every cell in one disc, and every side of a cell in one line. Of the samples that would do, the
    /// one that is most inside is taken. Each round puts at least one sample inside, and the whole grid but its outermost layer
    /// is well-composed, so it ends. Answers how many samples it put inside.
    ///
    /// # Errors
    /// [`Stop`] where a limit is met.
    pub fn compose(&mut self) -> Result<u64, Stop> {
        let mut made = 0;
        let mut cells = self.samples.mixed_cells();
        while !cells.is_empty() {
            self.context.check()?;
            let mut changed = Vec::new();
            for cell in cells {
                while let Some(place) = missing(&self.grid, &self.samples, cell) {
                    self.samples.make_inside(place);
                    changed.push(place);
                }
            }
            made += changed.len() as u64;
            cells = self.settle(&changed)?;
        }
        Ok(made)
    }

    /// Makes the cells around samples that were put inside known, and all that the surface passes next to them. Answers
    /// those whose corners may have changed.
    fn settle(&mut self, changed: &[Place]) -> Result<Vec<Place>, Stop> {
        // A sample inside is not in the grid's outermost layer, so all its cells are there.
        let mut around: Vec<Place> = changed
            .iter()
            .flat_map(|&place| (0..8u8).map(move |c| corner(place.map(|x| x.saturating_sub(1)), c)))
            .collect();
        around.sort_unstable();
        around.dedup();
        self.reach(around.clone())?;
        Ok(around)
    }
}

/// Whether a sample is inside in a cell that has a side in common with this one.
fn is_tip(samples: &Samples, cell: Place) -> bool {
    around(cell, 1).any(|place| samples.inside(place) == Some(true))
}

/// The samples up to one step from a cell's corners, along at most so many axes.
fn around(cell: Place, axes: usize) -> impl Iterator<Item = Place> {
    let low = cell.map(|c| c.saturating_sub(1));
    let steps = (0..64u32).map(|i| [i % 4, i / 4 % 4, i / 16]);
    let near = steps.filter(move |step| step.iter().filter(|s| [0, 3].contains(s)).count() <= axes);
    near.map(move |step| [0, 1, 2].map(|k| low[k] + step[k]))
}

/// The corners of a cell that a border of the inside in it is nearest to: those around which it comes within half a cell along
/// each axis, so that the corners of neighbouring cells are joined.
fn thin(field: &Field<'_>, grid: &Grid, cell: Place, steps: &mut u64) -> Vec<Place> {
    let bounds = grid.bounds(cell);
    let mut faces = Vec::new();
    field.tree().overlapping(&bounds, |face| {
        *steps = steps.saturating_sub(1);
        faces.push(face);
        *steps > 0 && faces.len() < 16 * MOST
    });
    faces.sort_unstable();
    faces.truncate(MOST);
    let (centre, half) = (bounds.centre(), grid.cell / 2.0);
    let mut places = Vec::new();
    for face in faces {
        let p = field.nearest_on(face, centre);
        if (p - centre).abs().max_element() > half || !is_border(field, grid, face, p, steps) {
            continue;
        }
        for place in (0..8).map(|c| corner(cell, c)).filter(|&place| !grid.is_limit(place)) {
            let at = grid.point(place);
            if (field.nearest_on(face, at) - at).abs().max_element() <= half {
                places.push(place);
            }
        }
    }
    places
}

/// Whether what is inside ends at a point of a face. What is asked for is a bit off its edges, where other faces may begin.
fn is_border(field: &Field<'_>, grid: &Grid, face: u32, point: DVec3, steps: &mut u64) -> bool {
    let [a, b, c] = field.corners(face);
    let inward = (a + b + c) / 3.0 - point;
    let point = point + inward * (OFF_EDGE * grid.cell / inward.length().max(grid.cell));
    ASIDE.into_iter().any(|aside| {
        let [a, b] = field.depths(point, field.normal(face) * (aside * grid.cell), steps);
        a.min(b) < LEVEL && a.max(b) > SOLID
    })
}

/// The outside corner of a cell that is most inside, of those one of which must be inside for the cell to be well-composed.
fn missing(grid: &Grid, samples: &Samples, cell: Place) -> Option<Place> {
    let mask = samples.mask(cell);
    let wanted = critical(mask)?;
    let depth = |c: u8| samples.value(corner(cell, c)).unwrap_or(0.0);
    let outside = (0..8u8).filter(|c| wanted >> c & 1 == 1 && !grid.is_limit(corner(cell, *c)));
    outside.max_by(|&a, &b| depth(a).total_cmp(&depth(b)).then(b.cmp(&a))).map(|c| corner(cell, c))
}

/// The outside corners, by bit, one of which must be inside; none where the cell is well-composed.
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

    /// Pieces of the surface in a cell: corners of one kind that are joined along edges, counted for both kinds.
    fn pieces(mask: u8, kind: bool) -> u32 {
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
    fn what_is_not_critical_has_one_piece_inside_and_one_outside() {
        for mask in 1..=254u8 {
            if critical(mask).is_none() {
                assert_eq!((pieces(mask, true), pieces(mask, false)), (1, 1), "{mask:08b}");
            }
        }
    }

    #[test]
    fn only_corners_outside_are_wanted_inside() {
        for mask in 0..=255u8 {
            if let Some(wanted) = critical(mask) {
                assert!(wanted != 0 && wanted & mask == 0, "{mask:08b}");
            }
        }
    }
}
