use glam::DVec3;

use super::field::LEVEL;
use crate::math::Box3;

/// Mantissa bits of a cell's edge, where the model is not far from the origin for its size.
const BITS: i32 = 8;
/// Bits of an f32's mantissa.
const F32_BITS: i32 = 24;
/// Steps of f32 at the largest coordinate that a cell must have, so that there is room in it for a vertex.
const LEAST_STEPS: f64 = 64.0;
/// Layers of cells beyond the box of the model, and one more for every so many cells along it: where it is open its inside
/// may bulge beyond its box.
const MARGIN: [u32; 2] = [3, 8];
/// Places of the grid against the model that are tried.
const SHIFTS: i64 = 16;

/// Samples along the side of a block.
pub(super) const SIDE: u32 = 8;
const BLOCK: usize = 512;
/// No block.
const NONE: u32 = u32::MAX;

/// A sample that was not asked for yet.
const UNKNOWN: f32 = f32::INFINITY;
/// A sample outside that was put inside.
const MADE: f32 = f32::MAX;

/// A cell that was not reached.
const UNSEEN: u32 = u32::MAX;
/// A cell whose samples are known.
const SEEN: u32 = u32::MAX - 1;

/// A place in a grid: of a sample, or of the cell whose lowest corner that sample is.
pub(super) type Place = [u32; 3];

/// A cubic grid whose coordinates are all exact in f32, so that a vertex on an edge of it can be written as it is.
///
/// Coordinates are those of the model scaled by a power of two into `[-2, 2]`.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    /// Edge of a cell.
    pub cell: f64,
    /// Samples along each axis.
    pub size: Place,
    /// All coordinates are whole multiples of it.
    unit: f64,
    step: i64,
    offset: [i64; 3],
}

impl Grid {
    /// A grid around `bounds` whose cells have about the edge `wanted`, or one of the smallest that can be told apart.
    pub fn around(bounds: &Box3, wanted: f64) -> Self {
        let largest = bounds.min.abs().max(bounds.max.abs()).max_element() + 0.5 * bounds.diagonal();
        let wanted = wanted.max(largest * LEAST_STEPS * f64::from(f32::EPSILON));
        let bits = (F32_BITS - exponent(largest / wanted) - 2).clamp(1, BITS);
        let unit = 2f64.powi(exponent(wanted) - bits);
        #[expect(clippy::cast_possible_truncation, reason = "it has at most 9 bits")]
        let step = (wanted / unit).ceil() as i64;
        let cell = unit * step as f64;
        let (mut offset, mut size) = ([0; 3], [0; 3]);
        for axis in 0..3 {
            let [low, high] = [bounds.min[axis], bounds.max[axis]].map(|x| x / unit);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "cells are counted in u32")]
            let along = ((high - low) / step as f64).ceil() as u32 + 1;
            let margin = MARGIN[0] + along / MARGIN[1];
            #[expect(clippy::cast_possible_truncation, reason = "below 2^24 by the choice of the unit")]
            let start = low.floor() as i64 - step * i64::from(margin);
            // A side of the model that lies in a plane of samples is neither inside nor outside of them.
            let clearance = |shift: i64| {
                let phase = |x: f64| ((x - (start - shift) as f64) / step as f64).rem_euclid(1.0);
                [low, high].map(|x| (phase(x) - phase(x).round()).abs()).into_iter().fold(0.5, f64::min)
            };
            let shifts = (0..SHIFTS.min(step)).map(|i| i * step / SHIFTS.min(step));
            let shift = shifts.max_by(|&a, &b| clearance(a).total_cmp(&clearance(b)).then(b.cmp(&a))).unwrap_or(0);
            offset[axis] = start - shift;
            size[axis] = along + 2 * margin + 2;
        }
        Self { cell, size, unit, step, offset }
    }

    /// Where a sample is.
    pub fn point(&self, place: Place) -> DVec3 {
        DVec3::new(self.coordinate(0, place[0]), self.coordinate(1, place[1]), self.coordinate(2, place[2]))
    }

    /// A coordinate of the samples with this number along an axis.
    pub fn coordinate(&self, axis: usize, number: u32) -> f64 {
        (self.step * i64::from(number) + self.offset[axis]) as f64 * self.unit
    }

    /// A coordinate in cells along an axis.
    pub fn in_cells(&self, axis: usize, x: f64) -> f64 {
        (x / self.unit - self.offset[axis] as f64) / self.step as f64
    }

    /// Whether a sample is in the outermost layer, which is taken for outside.
    pub fn is_limit(&self, place: Place) -> bool {
        (0..3).any(|k| place[k] == 0 || place[k] + 1 >= self.size[k])
    }

    /// The box of a cell.
    pub fn bounds(&self, cell: Place) -> Box3 {
        let min = self.point(cell);
        Box3 { min, max: self.point(cell.map(|c| c + 1)) }
    }

    /// The distance that a vertex keeps from the sides of its cell.
    pub fn clearance(&self) -> f64 {
        (self.cell / 128.0).max(2.0 * self.unit.min(self.cell / 16.0))
    }
}

/// The least `e` with `x <= 2^e`, for `x` above zero, or one more.
fn exponent(x: f64) -> i32 {
    #[expect(clippy::cast_possible_truncation, reason = "of a logarithm")]
    let e = x.log2().ceil() as i32;
    e
}

/// What is known at the samples of a grid, kept in blocks only where something is known.
pub(super) struct Samples {
    across: [usize; 3],
    directory: Vec<u32>,
    blocks: Vec<Block>,
}

struct Block {
    low: Place,
    value: [f32; BLOCK],
    cell: [u32; BLOCK],
}

impl Samples {
    /// Bytes that a block takes.
    pub const BLOCK_BYTES: u64 = 4200;
    /// Cells in a block.
    pub const BLOCK_CELLS: u64 = BLOCK as u64;

    pub fn new(grid: &Grid) -> Self {
        let across = grid.size.map(|n| (n / SIDE + 1) as usize);
        Self { across, directory: vec![NONE; across.iter().product()], blocks: Vec::new() }
    }

    fn slot(&self, place: Place) -> usize {
        let [x, y, z] = place.map(|c| (c / SIDE) as usize);
        (z * self.across[1] + y) * self.across[0] + x
    }

    fn within(place: Place) -> usize {
        let [x, y, z] = place.map(|c| (c % SIDE) as usize);
        (z * SIDE as usize + y) * SIDE as usize + x
    }

    fn get(&self, place: Place) -> Option<(&Block, usize)> {
        let block = *self.directory.get(self.slot(place))?;
        Some((self.blocks.get(block as usize)?, Self::within(place)))
    }

    fn get_mut(&mut self, place: Place) -> (&mut Block, usize) {
        let slot = self.slot(place);
        if self.directory[slot] == NONE {
            #[expect(clippy::cast_possible_truncation, reason = "blocks are far fewer than 2^32")]
            {
                self.directory[slot] = self.blocks.len() as u32;
            }
            let low = place.map(|c| c / SIDE * SIDE);
            self.blocks.push(Block { low, value: [UNKNOWN; BLOCK], cell: [UNSEEN; BLOCK] });
        }
        let block = self.directory[slot] as usize;
        (&mut self.blocks[block], Self::within(place))
    }

    /// How many blocks there are.
    pub fn blocks(&self) -> usize {
        self.blocks.len()
    }

    /// What was put at a sample.
    pub fn value(&self, place: Place) -> Option<f32> {
        self.get(place).map(|(block, i)| block.value[i]).filter(|&v| v != UNKNOWN)
    }

    /// Puts a value at a sample.
    pub fn set(&mut self, place: Place, value: f32) {
        let (block, i) = self.get_mut(place);
        block.value[i] = value;
    }

    /// Puts a sample inside that is not.
    pub fn make_inside(&mut self, place: Place) {
        self.set(place, MADE);
    }

    /// Whether a sample was put inside by [`Samples::make_inside`].
    pub fn is_made(&self, place: Place) -> bool {
        self.value(place) == Some(MADE)
    }

    /// Whether a sample is inside; none where nothing is known.
    pub fn inside(&self, place: Place) -> Option<bool> {
        self.value(place).map(is_inside)
    }

    /// Marks a cell as reached. Answers whether it was not before.
    pub fn reach(&mut self, cell: Place) -> bool {
        let (block, i) = self.get_mut(cell);
        std::mem::replace(&mut block.cell[i], SEEN) == UNSEEN
    }

    /// Which corners of a reached cell are inside, by bit: bit 0 of a corner's number is along x, bit 1 y, bit 2 z.
    pub fn mask(&self, cell: Place) -> u8 {
        (0..8u8).filter(|&c| self.inside(corner(cell, c)) == Some(true)).fold(0, |mask, c| mask | 1 << c)
    }

    /// Numbers a reached cell.
    pub fn number(&mut self, cell: Place, vertex: u32) {
        let (block, i) = self.get_mut(cell);
        block.cell[i] = vertex;
    }

    /// The number of a cell, where it has one.
    pub fn vertex(&self, cell: Place) -> Option<u32> {
        self.get(cell).map(|(block, i)| block.cell[i]).filter(|&v| v < SEEN)
    }

    /// Every reached cell that the surface passes, in a fixed order.
    pub fn mixed_cells(&self) -> Vec<Place> {
        let mut found = Vec::new();
        for block in &self.blocks {
            for (i, _) in block.cell.iter().enumerate().filter(|(_, cell)| **cell != UNSEEN) {
                let cell = place_in(block.low, i);
                if !matches!(self.mask(cell), 0 | 0xff) {
                    found.push(cell);
                }
            }
        }
        found
    }

    /// Calls `visit` with the lower end and the axis of every edge between an inside and an outside sample, in a fixed order.
    pub fn mixed_edges(&self) -> Vec<(Place, usize)> {
        let mut found = Vec::new();
        for block in &self.blocks {
            for (i, value) in block.value.iter().enumerate().filter(|(_, value)| **value != UNKNOWN) {
                let place = place_in(block.low, i);
                for axis in 0..3 {
                    if self.inside(along(place, axis)).is_some_and(|inside| inside != is_inside(*value)) {
                        found.push((place, axis));
                    }
                }
            }
        }
        found
    }
}

fn is_inside(value: f32) -> bool {
    f64::from(value) > LEVEL
}

fn place_in(low: Place, i: usize) -> Place {
    #[expect(clippy::cast_possible_truncation, reason = "below 512")]
    let i = i as u32;
    [low[0] + i % SIDE, low[1] + i / SIDE % SIDE, low[2] + i / (SIDE * SIDE)]
}

/// Groups places by the block that they are in, in a fixed order.
pub(super) fn by_block(mut places: Vec<Place>) -> Vec<Vec<Place>> {
    let block = |place: &Place| place.map(|c| c / SIDE);
    places.sort_unstable_by_key(|place| (block(place), *place));
    places.chunk_by(|a, b| block(a) == block(b)).map(<[Place]>::to_vec).collect()
}

/// The next place along an axis.
pub(super) fn along(mut place: Place, axis: usize) -> Place {
    place[axis] += 1;
    place
}

/// A corner of a cell by its number.
pub(super) fn corner(cell: Place, number: u8) -> Place {
    [0, 1, 2].map(|k| cell[k] + u32::from(number >> k & 1))
}

/// The four cells around the edge from a sample along an axis, counter-clockwise seen from where the axis points. None
/// at the border of the grid.
pub(super) fn around_edge(place: Place, axis: usize) -> Option<[Place; 4]> {
    let (u, w) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut cells = [place; 4];
    for (i, back) in [(1, u), (2, u), (2, w), (3, w)] {
        cells[i][back] = cells[i][back].checked_sub(1)?;
    }
    Some(cells)
}
