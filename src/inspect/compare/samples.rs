use glam::DVec3;

use crate::context::{Cancelled, Context};
use crate::inspect::Analysis;
use crate::inspect::queries::ask;
use crate::math::{hit, r2, ray_direction};

/// Directions in which a point may see the outside.
const DIRECTIONS: u32 = 32;
/// How far in front of its face a ray starts, as a share of the diagonal.
const LIFT: f64 = 1e-5;
/// Faces that all rays together may look at: so many, and so many more for each point.
const BUDGET: u64 = 10_000_000;
const BUDGET_A_POINT: u64 = 500;

/// A point on a face.
#[derive(Debug, Clone, Copy)]
pub(in crate::inspect) struct Sample {
    /// The face of the analysis's surface.
    pub face: u32,
    /// Where it is, in the coordinates of [`Analysis::unit`].
    pub point: DVec3,
    /// The face's unit normal.
    pub normal: DVec3,
}

/// Points spread by area, in order of their faces: one in each of `count` equal shares of it, placed in its face by the R2
/// sequence. None where the mesh has no area. The same for the same mesh.
pub(in crate::inspect) fn samples(analysis: &Analysis<'_>, count: u32) -> Vec<Sample> {
    let unit = analysis.unit();
    let corners = |face: &[u32; 3]| face.map(|v| unit[v as usize]);
    let cross = |face: &[u32; 3]| {
        let [a, b, c] = corners(face);
        (b - a).cross(c - a)
    };
    let faces = &analysis.surface.faces;
    let total: f64 = faces.iter().map(|face| cross(face).length()).sum();
    if total <= 0.0 {
        return Vec::new();
    }
    let mut samples = Vec::with_capacity(count as usize);
    let (mut passed, mut number) = (0.0, 0);
    for (face, index) in faces.iter().zip(0u32..) {
        let cross = cross(face);
        passed += cross.length();
        while number < count && (f64::from(number) + 0.5) / f64::from(count) * total < passed {
            let [u, v] = r2(f64::from(number));
            let u = u.sqrt();
            let [a, b, c] = corners(face);
            let point = a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v);
            samples.push(Sample { face: index, point, normal: cross.normalize_or_zero() });
            number += 1;
        }
    }
    samples
}

/// Which of the points can be seen from outside, in one of some fixed directions and from either side of their face, so
/// that inner walls, which a union removes, are told from the rest. None for points that the budget did not reach.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub(super) fn visible(
    analysis: &Analysis<'_>,
    samples: &[Sample],
    context: &Context<'_>,
) -> Result<Vec<Option<bool>>, Cancelled> {
    let (unit, faces, tree) = (analysis.unit(), &analysis.surface.faces, analysis.tree());
    let diagonal = analysis.extent().diagonal();
    let sees_outside = |sample: &Sample, steps: &mut u64| {
        for number in 0..DIRECTIONS {
            let direction = ray_direction(number);
            let from = sample.point + sample.normal * sample.normal.dot(direction).signum() * (LIFT * diagonal);
            let ray = direction * (2.0 * diagonal);
            let mut free = true;
            tree.along(from, from + ray, |face| {
                *steps = steps.saturating_sub(1);
                free = hit(from, ray, faces[face as usize].map(|v| unit[v as usize])).is_none();
                free && *steps > 0
            });
            if *steps == 0 {
                return None;
            }
            if free {
                return Some(true);
            }
        }
        Some(false)
    };
    let budget = BUDGET + BUDGET_A_POINT * samples.len() as u64;
    Ok(ask(samples.len(), budget, context, |i, steps| sees_outside(&samples[i], steps))?.values)
}
