use super::field::LEVEL;
use super::grid::{Grid, Place};

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
