use glam::DVec3;

use super::Stop;
use super::field::{Field, LEVEL, ask};
use crate::context::Context;
use crate::math::{Tree, r2};

/// Points that are measured on either surface.
const POINTS: u32 = 10_000;
/// How far on each side of the input it is asked what is there, in cells.
const ASIDE: f64 = 1.0 / 256.0;
/// Boxes and triangles that may be looked at.
const STEPS: u64 = 2_000_000_000;

/// How far the result is from the input, at points spread evenly by area, in the model's unit.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Deviation {
    /// From the input's surface, where that is a border of the inside, to the result: what was lost.
    pub lost: Distances,
    /// From the result to the input's surface: what was made, such as patches over holes.
    pub made: Distances,
}

/// Distances in figures.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distances {
    /// The largest.
    pub max: f64,
    /// Not exceeded by 99 % of the area.
    pub p99: f64,
}

/// Measures both ways, in the coordinates that both are given in.
///
/// # Errors
/// [`Stop`] where a limit is met.
pub(super) fn deviation(
    field: &Field<'_>,
    cell: f64,
    points: &[DVec3],
    faces: &[[u32; 3]],
    context: &Context<'_>,
) -> Result<Deviation, Stop> {
    let mut steps = STEPS;
    let tree = Tree::new(points, faces);
    context.check()?;
    let corners = |face: u32| faces[face as usize].map(|v| points[v as usize]);
    let count = |faces: &[[u32; 3]]| u32::try_from(faces.len()).unwrap_or(u32::MAX);
    let wanted = spread(count(field.faces()), |face| field.corners(face));
    let lost = ask(&wanted, &mut steps, context, |&(face, point), steps| {
        let depths = field.depths(point, field.normal(face) * (ASIDE * cell), steps);
        let is_border = (depths[0] > LEVEL) != (depths[1] > LEVEL);
        is_border.then(|| tree.nearest(point, f64::INFINITY, steps, corners).map(|nearest| nearest.distance))
    })?;
    let made = ask(&spread(count(faces), corners), &mut steps, context, |&(_, point), steps| {
        Some(field.distance(point, steps))
    })?;
    Ok(Deviation { lost: Distances::of(lost), made: Distances::of(made) })
}

impl Distances {
    fn of(found: Vec<Option<Option<f64>>>) -> Self {
        let mut sorted: Vec<f64> = found.into_iter().flatten().flatten().collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let p99 = sorted.get(sorted.len().saturating_sub(1) * 99 / 100).copied().unwrap_or(0.0);
        Self { max: sorted.last().copied().unwrap_or(0.0), p99 }
    }

    /// The same in another unit.
    pub(super) fn scaled(self, scale: f64) -> Self {
        Self { max: self.max * scale, p99: self.p99 * scale }
    }
}

/// Points spread by area, one in each of equal shares of it, each with its face.
fn spread(count: u32, corners: impl Fn(u32) -> [DVec3; 3]) -> Vec<(u32, DVec3)> {
    let area = |face: u32| {
        let [a, b, c] = corners(face);
        (b - a).cross(c - a).length()
    };
    let total: f64 = (0..count).map(area).sum();
    let (mut points, mut passed, mut number) = (Vec::new(), 0.0, 0);
    for face in 0..count {
        passed += area(face);
        while number < POINTS && (f64::from(number) + 0.5) / f64::from(POINTS) * total < passed {
            let [u, v] = r2(f64::from(number));
            let u = u.sqrt();
            let [a, b, c] = corners(face);
            points.push((face, a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v)));
            number += 1;
        }
    }
    points
}
