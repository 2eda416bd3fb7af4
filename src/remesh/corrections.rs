use super::Stop;
use super::band::{Limits, reach};
use super::field::Field;
use super::grid::{Grid, Place};
use super::samples::{Samples, corner};
use crate::context::Context;

/// Corners of the sides of a cell, around each.
const SIDES: [[u8; 4]; 6] = [[0, 2, 6, 4], [1, 3, 7, 5], [0, 1, 5, 4], [2, 3, 7, 6], [0, 1, 3, 2], [4, 5, 7, 6]];

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
pub(super) fn compose(
    field: &Field<'_>,
    grid: &Grid,
    samples: &mut Samples,
    limits: &mut Limits,
    context: &Context<'_>,
) -> Result<u64, Stop> {
    let mut made = 0;
    let mut cells = samples.mixed_cells();
    while !cells.is_empty() {
        context.check()?;
        let mut changed = Vec::new();
        for cell in cells {
            while let Some(place) = missing(grid, samples, cell) {
                samples.make_inside(place);
                changed.push(place);
            }
        }
        made += changed.len() as u64;
        cells = settle(field, grid, samples, &changed, limits, context)?;
    }
    Ok(made)
}

/// Makes the cells around samples that were put inside known, and all that the surface passes next to them. Answers
/// those whose corners may have changed.
pub(super) fn settle(
    field: &Field<'_>,
    grid: &Grid,
    samples: &mut Samples,
    changed: &[Place],
    limits: &mut Limits,
    context: &Context<'_>,
) -> Result<Vec<Place>, Stop> {
    // A sample inside is not in the grid's outermost layer, so all its cells are there.
    let mut around: Vec<Place> = changed
        .iter()
        .flat_map(|&place| (0..8u8).map(move |c| corner(place.map(|x| x.saturating_sub(1)), c)))
        .collect();
    around.sort_unstable();
    around.dedup();
    reach(field, grid, samples, around.clone(), limits, context)?;
    Ok(around)
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
