use glam::DVec3;

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
