//! The integer grid of an arrangement, with planes and orientations evaluated exactly on it.

use glam::DVec3;

use crate::math::{Box3, Sign};

/// A position in grid steps.
pub(super) type Whole = [i64; 3];

/// Coordinates lie within `2^BITS` steps of the grid's origin. This represents f32 numbers of the model's size exactly.
/// It also keeps the plane of three positions and the side of a fourth within `i128`.
const BITS: i32 = 40;

/// Half a unit in the last place of 1.
pub(super) const ULP: f64 = 1.0 / (1u64 << 53) as f64;

/// The integer grid on which every decision is made: a power of two of steps over half the model's longest side.
#[derive(Debug, Clone, Copy)]
pub(super) struct Grid {
    origin: DVec3,
    /// The step in the model's unit: a power of two.
    step: f64,
}

impl Grid {
    /// The grid around positions, which must be finite and within 1e300 of 0.
    pub fn around(positions: &[DVec3]) -> Self {
        let bounds = Box3::of(positions.iter().copied());
        if positions.is_empty() {
            return Self { origin: DVec3::ZERO, step: 1.0 };
        }
        let half = ((bounds.max - bounds.min).max_element() * 0.5).max(f64::MIN_POSITIVE * 1e20);
        #[expect(clippy::cast_possible_truncation, reason = "an exponent")]
        let step = 2f64.powi((half.log2().ceil() as i32 - BITS).max(-1000));
        // A multiple of the step, so that positions on the grid stay on it.
        let origin = ((bounds.min * 0.5 + bounds.max * 0.5) / step).round() * step;
        Self { origin, step }
    }

    /// The nearest grid position.
    pub fn to_grid(self, p: DVec3) -> Whole {
        let q = (p - self.origin) / self.step;
        let limit = f64::from(2u32).powi(BITS + 1);
        #[expect(clippy::cast_possible_truncation, reason = "within the limit")]
        q.to_array().map(|x| x.round().clamp(-limit, limit) as i64)
    }

    /// Whether a position is on the grid, so that nothing is rounded.
    pub fn holds(self, p: DVec3) -> bool {
        self.to_model(DVec3::from(self.to_grid(p).map(|x| x as f64))) == p
    }

    /// Converts a position in grid steps to the model's coordinates.
    pub fn to_model(self, p: DVec3) -> DVec3 {
        p * self.step + self.origin
    }
}

/// A plane through three grid positions.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    /// A point of the plane.
    pub base: Whole,
    /// The exact normal; each component is at most `2^84`.
    pub normal: [i128; 3],
    /// The normal, rounded to f64.
    pub rounded: [f64; 3],
}

/// The vector from `b` to `a`.
pub(super) fn minus(a: Whole, b: Whole) -> Whole {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(u: Whole, v: Whole) -> [i128; 3] {
    let m = |i: usize, j: usize| i128::from(u[i]) * i128::from(v[j]) - i128::from(u[j]) * i128::from(v[i]);
    [m(1, 2), m(2, 0), m(0, 1)]
}

fn sign(value: i128) -> Sign {
    Sign::from(value.cmp(&0))
}

impl Plane {
    /// The plane through three positions, oriented so that they are counter-clockwise seen against the normal.
    pub fn through([a, b, c]: [Whole; 3]) -> Self {
        Self::with_normal(a, cross(minus(b, a), minus(c, a)))
    }

    /// The plane through an edge and parallel to a coordinate axis.
    pub fn along_axis([a, b]: [Whole; 2], axis: usize) -> Self {
        let mut direction = [0; 3];
        direction[axis] = 1;
        Self::with_normal(a, cross(minus(b, a), direction))
    }

    fn with_normal(base: Whole, normal: [i128; 3]) -> Self {
        Self { base, normal, rounded: normal.map(|x| x as f64) }
    }

    /// Whether the defining positions are collinear.
    pub fn is_flat(&self) -> bool {
        self.normal == [0; 3]
    }

    /// The axis of the normal's largest component.
    pub fn axis(&self) -> usize {
        let n = self.normal.map(i128::abs);
        (0..3).max_by_key(|&k| (n[k], 3 - k)).unwrap_or(0)
    }

    /// The side of a position, exactly: positive in the direction of the normal.
    pub fn side(&self, p: Whole) -> Sign {
        let d = minus(p, self.base);
        let terms = [0, 1, 2].map(|k| self.rounded[k] * d[k] as f64);
        let (sum, size) = (terms[0] + terms[1] + terms[2], terms.iter().map(|t| t.abs()).sum::<f64>());
        if sum.abs() > 8.0 * ULP * size {
            return Sign::of(sum);
        }
        sign(self.height(p))
    }

    /// The signed distance of a position times the normal's length, exactly: below `2^127`.
    pub fn height(&self, p: Whole) -> i128 {
        let d = minus(p, self.base);
        (0..3).map(|k| self.normal[k] * i128::from(d[k])).sum()
    }
}

/// The side of the plane through `a`, `b` and `c` on which `d` lies, exactly: positive where they appear
/// counter-clockwise.
pub(super) fn side(a: Whole, b: Whole, c: Whole, d: Whole) -> Sign {
    let [u, v, w] = [minus(b, a), minus(c, a), minus(d, a)];
    let [x, y, z] = [u, v, w].map(|t| t.map(|k| k as f64));
    let products = [(1, 2), (2, 0), (0, 1)].map(|(i, j)| (x[i] * y[j], x[j] * y[i]));
    let (mut sum, mut size) = (0.0, 0.0);
    for k in 0..3 {
        sum += (products[k].0 - products[k].1) * z[k];
        size += (products[k].0.abs() + products[k].1.abs()) * z[k].abs();
    }
    if sum.abs() > 16.0 * ULP * size {
        return Sign::of(sum);
    }
    let normal = cross(u, v);
    sign((0..3).map(|k| normal[k] * i128::from(w[k])).sum())
}

/// The orientation of three positions projected along an axis; the two other axes are taken in cyclic order.
pub(super) fn turn(axis: usize, a: Whole, b: Whole, c: Whole) -> Sign {
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    let (u, v) = (minus(a, c), minus(b, c));
    sign(i128::from(u[i]) * i128::from(v[j]) - i128::from(u[j]) * i128::from(v[i]))
}
