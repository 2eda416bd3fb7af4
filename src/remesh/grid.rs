//! The sampling grid of a remesh, with coordinates exact in f32, and the sparse storage of its samples.

use glam::DVec3;

use super::field::LEVEL;
use crate::math::Box3;

/// Mantissa bits of a cell's edge length, unless the model is far from the origin for its size.
const BITS: i32 = 8;
/// Mantissa bits of an f32.
const F32_BITS: i32 = 24;
/// Minimum edge length of a cell, in f32 steps at the largest coordinate, so that the cell has room for a vertex.
const MIN_F32_STEPS: f64 = 64.0;
/// Layers of cells beyond the model's bounding box, plus one more for each so many cells along it. At an opening the
/// inside may bulge beyond the bounding box.
const MARGIN: [u32; 2] = [3, 8];
/// Number of grid offsets relative to the model that are tried.
const SHIFTS: i64 = 16;

/// Samples along the side of a block of samples.
pub(super) const SIDE: u32 = 8;
const BLOCK: usize = 512;
/// Marks an absent block.
const NONE: u32 = u32::MAX;

/// A sample that was not taken yet.
const UNKNOWN: f32 = f32::INFINITY;
/// A sample that was forced inside.
const FORCED: f32 = f32::MAX;

/// A cell that was not visited.
const UNSEEN: u32 = u32::MAX;
/// A visited cell, whose corners are sampled.
const SEEN: u32 = u32::MAX - 1;

/// Index in a grid: of a sample, or of the cell whose lowest corner is that sample.
pub(super) type GridIndex = [u32; 3];

/// A cubic grid whose coordinates are all exact in f32, so that a vertex on a grid edge can be stored without rounding.
///
/// Coordinates are those of the model, scaled by a power of two into `[-2, 2]`.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    /// Edge length of a cell.
    pub cell: f64,
    /// Number of samples along each axis.
    pub size: GridIndex,
    /// All coordinates are integer multiples of this unit.
    unit: f64,
    step: i64,
    offset: [i64; 3],
}

impl Grid {
    /// A grid around `bounds` with cells of about the edge length `requested`, but not below the smallest cell that f32
    /// resolves.
    pub fn around(bounds: &Box3, requested: f64) -> Self {
        let largest = bounds.min.abs().max(bounds.max.abs()).max_element() + 0.5 * bounds.diagonal();
        let requested = requested.max(largest * MIN_F32_STEPS * f64::from(f32::EPSILON));
        let bits = (F32_BITS - exponent(largest / requested) - 2).clamp(1, BITS);
        let unit = 2f64.powi(exponent(requested) - bits);
        #[expect(clippy::cast_possible_truncation, reason = "at most 9 bits")]
        let step = (requested / unit).ceil() as i64;
        let cell = unit * step as f64;
        let (mut offset, mut size) = ([0; 3], [0; 3]);
        for axis in 0..3 {
            let [low, high] = [bounds.min[axis], bounds.max[axis]].map(|x| x / unit);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "cells are counted in u32")]
            let along = ((high - low) / step as f64).ceil() as u32 + 1;
            let margin = MARGIN[0] + along / MARGIN[1];
            #[expect(clippy::cast_possible_truncation, reason = "below 2^24 by the choice of the unit")]
            let start = low.floor() as i64 - step * i64::from(margin);
            // A side of the model in a plane of samples would be neither inside nor outside of them.
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

    /// The position of a sample.
    pub fn point(&self, index: GridIndex) -> DVec3 {
        DVec3::new(self.coordinate(0, index[0]), self.coordinate(1, index[1]), self.coordinate(2, index[2]))
    }

    /// The coordinate of the samples with an index along an axis.
    pub fn coordinate(&self, axis: usize, number: u32) -> f64 {
        (self.step * i64::from(number) + self.offset[axis]) as f64 * self.unit
    }

    /// Converts a coordinate along an axis to cells.
    pub fn in_cells(&self, axis: usize, x: f64) -> f64 {
        (x / self.unit - self.offset[axis] as f64) / self.step as f64
    }

    /// Whether a sample is in the outermost layer, which always counts as outside.
    pub fn is_limit(&self, index: GridIndex) -> bool {
        (0..3).any(|k| index[k] == 0 || index[k] + 1 >= self.size[k])
    }

    /// The bounding box of a cell.
    pub fn bounds(&self, cell: GridIndex) -> Box3 {
        let min = self.point(cell);
        Box3 { min, max: self.point(cell.map(|c| c + 1)) }
    }

    /// The minimum distance of a vertex from the sides of its cell.
    pub fn clearance(&self) -> f64 {
        (self.cell / 128.0).max(2.0 * self.unit.min(self.cell / 16.0))
    }
}

/// The least `e` with `x <= 2^e` for positive `x`, or one more.
fn exponent(x: f64) -> i32 {
    #[expect(clippy::cast_possible_truncation, reason = "of a logarithm")]
    let e = x.log2().ceil() as i32;
    e
}

/// The samples of a grid, stored in blocks only where samples were taken.
pub(super) struct Samples {
    across: [usize; 3],
    directory: Vec<u32>,
    blocks: Vec<Block>,
}

struct Block {
    low: GridIndex,
    value: [f32; BLOCK],
    cell: [u32; BLOCK],
}

impl Samples {
    /// Memory of a block, in bytes.
    pub const BLOCK_BYTES: u64 = 4200;
    /// Number of cells of a block.
    pub const BLOCK_CELLS: u64 = BLOCK as u64;

    /// Storage for the samples of a grid, without any sample.
    pub fn new(grid: &Grid) -> Self {
        let across = grid.size.map(|n| (n / SIDE + 1) as usize);
        Self { across, directory: vec![NONE; across.iter().product()], blocks: Vec::new() }
    }

    fn slot(&self, index: GridIndex) -> usize {
        let [x, y, z] = index.map(|c| (c / SIDE) as usize);
        (z * self.across[1] + y) * self.across[0] + x
    }

    fn within(index: GridIndex) -> usize {
        let [x, y, z] = index.map(|c| (c % SIDE) as usize);
        (z * SIDE as usize + y) * SIDE as usize + x
    }

    fn get(&self, index: GridIndex) -> Option<(&Block, usize)> {
        let block = *self.directory.get(self.slot(index))?;
        Some((self.blocks.get(block as usize)?, Self::within(index)))
    }

    fn get_mut(&mut self, index: GridIndex) -> (&mut Block, usize) {
        let slot = self.slot(index);
        if self.directory[slot] == NONE {
            #[expect(clippy::cast_possible_truncation, reason = "blocks are far fewer than 2^32")]
            {
                self.directory[slot] = self.blocks.len() as u32;
            }
            let low = index.map(|c| c / SIDE * SIDE);
            self.blocks.push(Block { low, value: [UNKNOWN; BLOCK], cell: [UNSEEN; BLOCK] });
        }
        let block = self.directory[slot] as usize;
        (&mut self.blocks[block], Self::within(index))
    }

    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.blocks.len()
    }

    /// The value of a sample, if it was taken.
    pub fn value(&self, index: GridIndex) -> Option<f32> {
        self.get(index).map(|(block, i)| block.value[i]).filter(|&v| v != UNKNOWN)
    }

    /// Sets the value of a sample.
    pub fn set(&mut self, index: GridIndex, value: f32) {
        let (block, i) = self.get_mut(index);
        block.value[i] = value;
    }

    /// Forces an outside sample inside.
    pub fn force_inside(&mut self, index: GridIndex) {
        self.set(index, FORCED);
    }

    /// Whether a sample was forced inside by [`Samples::force_inside`].
    pub fn is_forced(&self, index: GridIndex) -> bool {
        self.value(index) == Some(FORCED)
    }

    /// Whether a sample is inside; none if it was not taken.
    pub fn inside(&self, index: GridIndex) -> Option<bool> {
        self.value(index).map(is_inside)
    }

    /// Marks a cell as visited. Returns whether the cell was not visited before.
    pub fn mark_seen(&mut self, cell: GridIndex) -> bool {
        let (block, i) = self.get_mut(cell);
        std::mem::replace(&mut block.cell[i], SEEN) == UNSEEN
    }

    /// The inside corners of a visited cell, as a bit mask: in a corner's number, bit 0 is along x, bit 1 along y, bit
    /// 2 along z.
    pub fn mask(&self, cell: GridIndex) -> u8 {
        (0..8u8).filter(|&c| self.inside(corner(cell, c)) == Some(true)).fold(0, |mask, c| mask | 1 << c)
    }

    /// Sets the vertex number of a visited cell.
    pub fn number(&mut self, cell: GridIndex, vertex: u32) {
        let (block, i) = self.get_mut(cell);
        block.cell[i] = vertex;
    }

    /// The vertex number of a cell, if it has one.
    pub fn vertex(&self, cell: GridIndex) -> Option<u32> {
        self.get(cell).map(|(block, i)| block.cell[i]).filter(|&v| v < SEEN)
    }

    /// Every visited cell that the surface passes through, in a fixed order.
    pub fn mixed_cells(&self) -> Vec<GridIndex> {
        let mut found = Vec::new();
        for block in &self.blocks {
            for (i, _) in block.cell.iter().enumerate().filter(|(_, cell)| **cell != UNSEEN) {
                let cell = index_in_block(block.low, i);
                if !matches!(self.mask(cell), 0 | 0xff) {
                    found.push(cell);
                }
            }
        }
        found
    }

    /// The lower end and the axis of every edge between an inside and an outside sample, in a fixed order.
    pub fn mixed_edges(&self) -> Vec<(GridIndex, usize)> {
        let mut found = Vec::new();
        for block in &self.blocks {
            for (i, value) in block.value.iter().enumerate().filter(|(_, value)| **value != UNKNOWN) {
                let index = index_in_block(block.low, i);
                for axis in 0..3 {
                    if self.inside(along(index, axis)).is_some_and(|inside| inside != is_inside(*value)) {
                        found.push((index, axis));
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

fn index_in_block(low: GridIndex, i: usize) -> GridIndex {
    #[expect(clippy::cast_possible_truncation, reason = "below 512")]
    let i = i as u32;
    [low[0] + i % SIDE, low[1] + i / SIDE % SIDE, low[2] + i / (SIDE * SIDE)]
}

/// Groups indices by block, in a fixed order.
pub(super) fn by_block(mut indices: Vec<GridIndex>) -> Vec<Vec<GridIndex>> {
    let block = |index: &GridIndex| index.map(|c| c / SIDE);
    indices.sort_unstable_by_key(|index| (block(index), *index));
    indices.chunk_by(|a, b| block(a) == block(b)).map(<[GridIndex]>::to_vec).collect()
}

/// The next index along an axis.
pub(super) fn along(mut index: GridIndex, axis: usize) -> GridIndex {
    index[axis] += 1;
    index
}

/// The index of a corner of a cell, by its number.
pub(super) fn corner(cell: GridIndex, number: u8) -> GridIndex {
    [0, 1, 2].map(|k| cell[k] + u32::from(number >> k & 1))
}

/// The four cells around the edge from a sample along an axis, counter-clockwise seen against the axis. None at the
/// border of the grid.
pub(super) fn around_edge(index: GridIndex, axis: usize) -> Option<[GridIndex; 4]> {
    let (u, w) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut cells = [index; 4];
    for (i, back) in [(1, u), (2, u), (2, w), (3, w)] {
        cells[i][back] = cells[i][back].checked_sub(1)?;
    }
    Some(cells)
}
