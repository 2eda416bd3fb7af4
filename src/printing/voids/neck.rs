//! The narrowest way in a void: the neck between two of its chambers.

use glam::DVec3;

use super::regions::Regions;
use super::sealed::SealedVoid;
use super::widest::RegionFaces;
use crate::context::{Cancelled, Context};
use crate::math::{to_unit_range, unit_scale};
use crate::mesh::{Surface, UnionFind};

/// A neck joins chambers that are wider by at least this factor.
const WIDER: f64 = 1.5;

/// A narrow passage between two wider chambers. Lengths are in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neck {
    /// A place in the passage.
    pub at: DVec3,
    /// A ball of this diameter passes; 0 if the passage is narrower than the resolution.
    pub width: f64,
    /// No ball of a larger diameter passes.
    pub width_at_most: f64,
    /// The widest places of the two chambers.
    pub chambers: [DVec3; 2],
}

/// The narrowest passage between chambers of a void that are at least 1.5 times as wide; `None` if there is none as far as
/// a grid of `cells` cells shows.
///
/// Joins the cells of the grid by falling distance from the faces: chambers appear at the widest places and meet at the
/// necks. The distance changes by no more than the way, so that cells give bounds of the width.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn narrowest_neck(
    surface: &Surface,
    regions: &Regions,
    void: &SealedVoid,
    cells: usize,
    context: &Context<'_>,
) -> Result<Option<Neck>, Cancelled> {
    let (unit, scale) = (to_unit_range(&surface.positions), unit_scale(&surface.positions));
    let faces = RegionFaces::new(surface, &unit, regions, void.region, &void.faces);
    let (low, size) = (void.bounds.min * scale, (void.bounds.max - void.bounds.min) * scale);
    #[expect(clippy::cast_precision_loss, reason = "a budget")]
    let step = (size.x * size.y * size.z / cells.max(8) as f64).cbrt().max(size.max_element() / 256.0);
    if !(step > 0.0 && step.is_finite()) {
        return Ok(None);
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 256 along an axis")]
    let counts = (size / step).to_array().map(|count| count.ceil().max(1.0) as usize);
    let place = |cell: usize| {
        let [i, j, k] = [cell % counts[0], cell / counts[0] % counts[1], cell / counts[0] / counts[1]];
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let at = DVec3::new(i as f64, j as f64, k as f64) + 0.5;
        low + at * step
    };
    let mut clearance = Vec::with_capacity(counts.iter().product());
    for cell in 0..counts.iter().product() {
        if cell % 256 == 0 {
            context.check()?;
        }
        let is_inside = faces.holds(place(cell)) == Some(true);
        clearance.push(if is_inside { faces.distance(place(cell)) } else { 0.0 });
    }
    let grid = Grid { counts, step, clearance };
    Ok(grid.narrowest().map(|passage| Neck {
        at: place(passage.cell) / scale,
        width: passage.width[0] / scale,
        width_at_most: passage.width[1] / scale,
        chambers: passage.peaks.map(|cell| place(cell) / scale),
    }))
}

/// The distances from the faces at the centres of cells; 0 outside of the void.
struct Grid {
    counts: [usize; 3],
    step: f64,
    clearance: Vec<f64>,
}

/// A passage between two chambers.
struct Passage {
    cell: usize,
    width: [f64; 2],
    peaks: [usize; 2],
}

impl Grid {
    /// The neighbours of a cell through its sides.
    fn neighbours(&self, cell: usize) -> impl Iterator<Item = usize> {
        let [x, y, z] = self.counts;
        let [i, j, k] = [cell % x, cell / x % y, cell / x / y];
        [
            (i > 0).then(|| cell - 1),
            (i + 1 < x).then_some(cell + 1),
            (j > 0).then(|| cell - x),
            (j + 1 < y).then_some(cell + x),
            (k > 0).then(|| cell - x * y),
            (k + 1 < z).then_some(cell + x * y),
        ]
        .into_iter()
        .flatten()
    }

    /// The narrowest passage between two chambers.
    fn narrowest(&self) -> Option<Passage> {
        // Half a cell's diagonal: how far a way through a cell is from its centre at most.
        let reach = self.step * 3f64.sqrt() / 2.0;
        let mut order: Vec<usize> = (0..self.clearance.len()).filter(|&cell| self.clearance[cell] > 0.0).collect();
        order.sort_by(|&a, &b| self.clearance[b].total_cmp(&self.clearance[a]).then(a.cmp(&b)));
        let mut rank = vec![u32::MAX; self.clearance.len()];
        for (at, &cell) in (0u32..).zip(&order) {
            rank[cell] = at;
        }
        // The smallest member of a set is its widest cell.
        let mut sets = UnionFind::new(order.len());
        let mut narrowest: Option<Passage> = None;
        for (at, &cell) in (0u32..).zip(&order) {
            let here = self.clearance[cell];
            for other in self.neighbours(cell).filter(|&other| rank[other] < at) {
                let (a, b) = (sets.root(at), sets.root(rank[other]));
                let peak = order[a.max(b) as usize];
                if a != b && self.clearance[peak] >= WIDER * (here + reach) {
                    let width = [(2.0 * here - self.step).max(0.0), 2.0 * (here + reach)];
                    // Later passages are narrower.
                    narrowest = Some(Passage { cell, width, peaks: [order[a.min(b) as usize], peak] });
                }
                sets.unite(a, b);
            }
        }
        // Chambers that never meet are joined by passages narrower than the cells.
        let mut roots: Vec<u32> = sets.into_roots();
        roots.sort_unstable();
        roots.dedup();
        let apart =
            roots.get(1).map(|&root| order[root as usize]).filter(|&cell| self.clearance[cell] >= WIDER * reach);
        match (apart, order.first()) {
            (Some(peak), Some(&widest)) => {
                let width = [0.0, 2.0 * reach];
                Some(Passage { cell: peak, width, peaks: [widest, peak] })
            }
            _ => narrowest,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::sealed::voids_of;
    use super::*;
    use crate::printing::shapes::*;

    fn neck(surface: &Surface, cells: usize) -> Option<Neck> {
        let mut found = None;
        quietly(|context| {
            let regions = Regions::of_closed(surface, context);
            let voids = voids_of(surface, &regions, context).unwrap();
            assert_eq!(voids.len(), 1);
            found = narrowest_neck(surface, &regions, &voids[0], cells, context).unwrap();
        });
        found
    }

    /// A block with two rooms of 3 and 5, joined by a passage of the given width and length 3.
    fn rooms(width: f64) -> Surface {
        let mut rooms = Voxels::filled([13, 7, 7]);
        for cell in 0..13 * 7 * 7 {
            let [i, j, k] = [cell % 13, cell / 13 % 7, cell / 91];
            let in_room = |low: usize, high: usize| (low..high).contains(&j) && (low..high).contains(&k);
            let is_air = match i {
                1..=3 => in_room(2, 5),
                4..=6 => in_room(3, 4),
                7..=11 => in_room(1, 6),
                _ => false,
            };
            rooms.set([i, j, k], !is_air);
        }
        let mut surface = rooms.surface();
        // The passage is 1 wide; its corners move to the requested width.
        for p in &mut surface.positions {
            let on = |x: f64, values: &[f64]| values.contains(&x);
            if on(p.x, &[4.0, 5.0, 6.0, 7.0]) && on(p.y, &[3.0, 4.0]) && on(p.z, &[3.0, 4.0]) {
                let scaled = (*p - 3.5) * width + 3.5;
                *p = DVec3::new(p.x, scaled.y, scaled.z);
            }
        }
        surface
    }

    #[test]
    fn the_neck_between_two_rooms_has_the_width_of_the_passage() {
        for width in [0.8, 1.0, 1.4] {
            let found = neck(&rooms(width), 15_000).unwrap();
            assert!(found.width <= width + 1e-9 && found.width_at_most >= width - 1e-9, "{width}: {found:?}");
            assert!(found.width_at_most - found.width < 1.0, "{width}: {found:?}");
            assert!((3.9..7.1).contains(&found.at.x), "{found:?}");
            assert!(found.chambers[0].x > 7.0 && found.chambers[1].x < 4.0, "{found:?}");
        }
    }

    #[test]
    fn a_passage_narrower_than_the_cells_is_told_as_such() {
        let found = neck(&rooms(0.05), 8_000).unwrap();
        assert!(found.width == 0.0 && found.width_at_most >= 0.05, "{found:?}");
    }

    #[test]
    fn one_room_has_no_neck() {
        let hollow =
            joined(&[cuboid(DVec3::ZERO, DVec3::splat(9.0)), inverted(cuboid(DVec3::ONE, DVec3::new(8.0, 5.0, 3.0)))]);
        assert_eq!(neck(&hollow, 8_000), None);
        assert_eq!(neck(&joined(&[sphere(5.0, 2), inverted(sphere(3.0, 2))]), 8_000), None);
    }
}
