//! The thickness at vertices and face centres: a perpendicular chord, then an inscribed ball.

use crate::context::{Cancelled, Context};
use glam::DVec3;
use rayon::prelude::*;

use super::places::ThicknessField;
use super::prepared::{OPPOSED, Prepared};

/// Samples between two checks for cancellation.
const BLOCK: usize = 1 << 15;
/// Steps of one ray and of one ball.
const RAY: u64 = 1 << 14;
const BALL: u64 = 1 << 12;
/// Steps of all balls together: a base, and a number per sample.
const BUDGET: [u64; 2] = [1 << 28, 300];
/// A chord between planes this close to parallel needs no ball.
const PARALLEL: f64 = -0.999;
/// A vertex is smooth if the normals of its faces have at least this dot product with their mean; else it has the least
/// thickness of its faces. Cosine of 30 degrees.
const SMOOTH: f64 = 0.866;
/// Faces between two reductions of the bound in [`Prepared::least_ray`].
const RAYS: usize = 1 << 12;

/// The limits of a measurement at many samples.
struct Sampling {
    /// Length of the longest ray.
    longest: f64,
    /// Steps left for balls.
    left: u64,
    /// Whether no ball ran out of steps.
    is_complete: bool,
}

impl Prepared<'_> {
    /// The length of the shortest perpendicular chord at a face's centre; infinity if there is none.
    pub(super) fn least_ray(&self, context: &Context<'_>) -> Result<f64, Cancelled> {
        let (mut least, count) = (f64::INFINITY, self.len());
        let corners = self.surface.bounds();
        let longest = if corners.is_empty() { 0.0 } else { corners.diagonal() * 1.01 };
        // A stride through the faces that has no common divisor with most counts spreads each block.
        for block in 0..count.div_ceil(RAYS) {
            context.check()?;
            let blocks = count.div_ceil(RAYS);
            let chords = (0..RAYS).into_par_iter().filter_map(|i| {
                let f = u32::try_from(block + i * blocks).ok().filter(|&f| (f as usize) < count)?;
                let n = self.normal(f);
                let [a, b, c] = self.corners(f);
                let centre = (a + b + c) / 3.0;
                let hit = self.first_hit([centre, -n], longest.min(least), Some(f), &mut RAY.clone())?;
                let opposed = n != DVec3::ZERO && n.dot(self.normal(hit.1)) <= OPPOSED;
                (opposed && !self.share_a_vertex(f, hit.1)).then_some(hit.0)
            });
            least = least.min(chords.reduce(|| f64::INFINITY, f64::min));
        }
        Ok(least)
    }

    /// The thickness of the surface's faces and vertices.
    pub(super) fn field(&self, context: &Context<'_>) -> Result<ThicknessField, Cancelled> {
        let longest = self.surface.bounds().diagonal() * 1.01;
        let left = BUDGET[0] + BUDGET[1] * (self.len() + self.surface.positions.len()) as u64;
        let mut sampling = Sampling { longest, left, is_complete: true };
        let face = |f: usize| {
            let [a, b, c] = self.surface.corners(f);
            ([(a + b + c) / 3.0, self.normals[f]], u32::try_from(f).ok())
        };
        let faces = self.measure_all(self.len(), &mut sampling, context, face)?;
        let vertex = |v: usize| {
            let around = u32::try_from(v).map_or(&[][..], |v| self.stars.of(v));
            let mean = around.iter().map(|&f| self.normal(f)).sum::<DVec3>().normalize_or_zero();
            let is_smooth = around.iter().all(|&f| self.normal(f).dot(mean) > SMOOTH);
            ([self.surface.positions[v], if is_smooth { mean } else { DVec3::ZERO }], None)
        };
        let mut vertices = self.measure_all(self.surface.positions.len(), &mut sampling, context, vertex)?;
        vertices.iter_mut().zip(0u32..).for_each(|(value, v)| {
            if value.is_nan() {
                *value = self.stars.of(v).iter().map(|&f| faces[f as usize]).fold(f64::INFINITY, f64::min);
            }
        });
        #[expect(clippy::cast_possible_truncation, reason = "for display")]
        let rounded = |values: Vec<f64>| -> Vec<f32> {
            let at = |value: f64| if value.is_nan() { f32::INFINITY } else { (value / self.scale) as f32 };
            values.into_iter().map(at).collect()
        };
        let is_complete = sampling.is_complete;
        Ok(ThicknessField { at_vertices: rounded(vertices), at_faces: rounded(faces), is_complete })
    }

    /// Measures at all samples, a point with its outward normal each; not a number where the normal is zero.
    fn measure_all(
        &self,
        count: usize,
        sampling: &mut Sampling,
        context: &Context<'_>,
        sample: impl Fn(usize) -> ([DVec3; 2], Option<u32>) + Sync,
    ) -> Result<Vec<f64>, Cancelled> {
        let mut values = Vec::with_capacity(count);
        let longest = sampling.longest;
        for block in 0..count.div_ceil(BLOCK) {
            context.check()?;
            let most = BALL.min(sampling.left);
            let range = block * BLOCK..count.min((block + 1) * BLOCK);
            let measured: Vec<(f64, u64)> = range
                .into_par_iter()
                .map(|i| {
                    let (place, skip) = sample(i);
                    if place[1] == DVec3::ZERO { (f64::NAN, 0) } else { self.measure_at(place, skip, longest, most) }
                })
                .collect();
            for (value, steps) in measured {
                values.push(value);
                sampling.left = sampling.left.saturating_sub(steps);
                sampling.is_complete &= steps < most;
            }
        }
        Ok(values)
    }

    /// The thickness at a point, and the steps that the ball took, at most `most`.
    fn measure_at(&self, [point, normal]: [DVec3; 2], skip: Option<u32>, longest: f64, most: u64) -> (f64, u64) {
        let from = point - normal * (longest * 1e-9);
        let Some((distance, face)) = self.first_hit([from, -normal], longest, skip, &mut RAY.clone()) else {
            return (f64::INFINITY, 0);
        };
        let cosine = normal.dot(self.normal(face));
        let chord = if cosine <= OPPOSED { distance } else { f64::INFINITY };
        if cosine <= PARALLEL {
            return (chord, 0);
        }
        let mut steps = most;
        let ball = self.tree.shrunk_ball([point, -normal], distance / 2.0, &mut steps, |f| self.corners(f));
        let Some(ball) = ball else { return (chord, most - steps) };
        let opposed = ball.touches.is_some_and(|touched| {
            let outward = (touched.point - (point - normal * ball.radius)) / ball.radius;
            outward.dot(normal) <= OPPOSED
        });
        (if opposed { 2.0 * ball.radius } else { chord }, most - steps)
    }
}
