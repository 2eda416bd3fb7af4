//! Distances between the surfaces of two meshes, and agreement of the two meshes on which points are inside.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::super::analysis::Pair;
use super::super::distribution::percentile;
use super::super::ray_winding::RayWinding;
use super::super::sampling::{InsideTest, Sample, run_coherent_queries, run_queries};
use super::super::{Analysis, finite, percent};
use crate::context::{Cancelled, Context};
use crate::math::{Box3, r3};

/// Budget of all searches in one direction: boxes and triangles visited, plus an allowance per point.
const BUDGET: u64 = 10_000_000;
const BUDGET_PER_POINT: u64 = 500;
/// Budget of all winding numbers of both meshes: nodes and triangles visited, plus an allowance per point.
const INSIDE_BUDGET: u64 = 10_000_000;
const INSIDE_BUDGET_PER_POINT: u64 = 2000;
/// Maximum number of faces tested for being buried in material.
const BURIED_FACES: usize = 1000;
/// Budget of these tests: nodes and triangles visited.
const BURIED_BUDGET: u64 = 10_000_000;
/// Offset from a face, on both sides, at which winding numbers are evaluated, in unit coordinates (which reach 2).
const NORMAL_OFFSET: f64 = 1e-6;
/// Winding number from which a point counts as material.
const MATERIAL: f64 = 0.9;
/// Winding number from which a point counts as inside a closed mesh.
pub(super) const INSIDE_WINDING: f64 = 0.5;

/// Distance from the surface of one mesh to the surface of another, sampled evenly by area.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Deviation {
    /// Number of sample points on faces.
    pub samples: u64,
    /// Number of vertices measured in addition to the samples. Vertices contribute to the maximum distance only.
    pub vertices: u64,
    /// Whether every point was measured. False if the search ran out of its budget.
    pub complete: bool,
    /// Distances in the unit of the input.
    pub distance: Spread,
    /// Distances in percent of the diagonal of the input's bounding box.
    pub percent: Spread,
    /// Point with the largest distance, in the unit of the input.
    pub farthest: [f64; 3],
}

/// Statistics of a set of distances.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Spread {
    /// Maximum over samples and vertices.
    pub max: f64,
    /// Arithmetic mean over the samples.
    pub mean: f64,
    /// Root mean square over the samples.
    pub rms: f64,
    /// Median: half of the area is within this distance.
    pub p50: f64,
    /// 95th percentile: 95 % of the area is within this distance.
    pub p95: f64,
    /// 99th percentile: 99 % of the area is within this distance.
    pub p99: f64,
}

/// Distances from points of one mesh to another mesh, in unit coordinates of the first mesh.
pub(super) struct Distances {
    /// Distance of each sample; `None` if the budget ran out first.
    pub samples: Vec<Option<f64>>,
    /// Distances of a subset of the vertices, each with its vertex index.
    pub vertices: Vec<(u32, f64)>,
    /// Whether every distance was measured.
    pub complete: bool,
}

/// Measures the distance from each sample, and from at most `max_vertices` vertices, to the nearest point of the
/// other mesh. Points on faces for which `is_kept` returns true have distance 0 and cost nothing, as do all points if both
/// meshes are one.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub(super) fn distances(
    pair: Pair<'_>,
    samples: &[Sample],
    max_vertices: u32,
    is_kept: impl Fn(u32) -> bool,
    context: &Context<'_>,
) -> Result<Distances, Cancelled> {
    let mut all = Distances { samples: vec![Some(0.0); samples.len()], vertices: Vec::new(), complete: true };
    if std::ptr::eq(pair.from, pair.to) {
        return Ok(all);
    }
    let missing: Vec<usize> = (0..samples.len()).filter(|&i| !is_kept(samples[i].face)).collect();
    let surface = &pair.from.surface;
    let mut settled = vec![max_vertices == 0; surface.positions.len()];
    for (face, index) in surface.faces.iter().zip(0u32..) {
        if is_kept(index) {
            for &v in face {
                settled[v as usize] = true;
            }
        }
    }
    let apart: Vec<u32> = (0u32..).zip(settled).filter(|(_, settled)| !settled).map(|(v, _)| v).collect();
    let step = apart.len().div_ceil(max_vertices.max(1) as usize).max(1);
    let apart: Vec<u32> = apart.into_iter().step_by(step).collect();
    if missing.is_empty() && apart.is_empty() {
        return Ok(all);
    }
    let own_positions = pair.from.unit();
    let tree = pair.to.tree();
    let count = missing.len() + apart.len();
    let budget = BUDGET + BUDGET_PER_POINT * count as u64;
    let answers = run_coherent_queries(count, budget, context, |i, last, steps| {
        let point =
            missing.get(i).map_or_else(|| own_positions[apart[i - missing.len()] as usize], |&i| samples[i].point);
        let distance = tree.distance(point * pair.ratio, last, steps, |f| pair.to.unit_corners(f));
        distance.map(|distance| distance / pair.ratio)
    })?;
    all.complete = answers.complete;
    let (of_samples, of_vertices) = answers.values.split_at(missing.len());
    for (&i, &distance) in missing.iter().zip(of_samples) {
        all.samples[i] = distance;
    }
    all.vertices = apart.iter().zip(of_vertices).filter_map(|(&v, &distance)| Some((v, distance?))).collect();
    Ok(all)
}

/// Measured points of a mesh, with their distances to another mesh.
pub(super) struct Measured<'a> {
    /// The mesh with the points.
    pub analysis: &'a Analysis<'a>,
    /// Sample points on faces.
    pub samples: &'a [Sample],
    /// Distances of the samples and of some vertices.
    pub distances: &'a Distances,
    /// Diagonal of the input, in unit coordinates of `analysis`.
    pub diagonal: f64,
}

impl Measured<'_> {
    /// Statistics over the samples and vertices that the two filters accept. `None` if no point was measured.
    pub fn deviation(&self, counts: impl Fn(usize) -> bool, vertices: impl Fn(u32) -> bool) -> Option<Deviation> {
        let &Self { analysis, samples, distances, diagonal } = self;
        let mut farthest = (f64::NEG_INFINITY, None);
        let mut update_farthest = |distance: f64, at: DVec3| {
            if distance > farthest.0 {
                farthest = (distance, Some(at));
            }
        };
        let mut sorted = Vec::with_capacity(samples.len());
        for (i, distance) in distances.samples.iter().enumerate() {
            if let Some(distance) = distance.filter(|_| counts(i)) {
                update_farthest(distance, samples[i].point);
                sorted.push(distance);
            }
        }
        let mut vertex_count = 0;
        for &(v, distance) in distances.vertices.iter().filter(|&&(v, _)| vertices(v)) {
            update_farthest(distance, analysis.unit()[v as usize]);
            vertex_count += 1;
        }
        let (max, at) = (farthest.0, farthest.1?);
        sorted.sort_unstable_by(f64::total_cmp);
        let count = sorted.len().max(1) as f64;
        let largest = sorted.last().copied().unwrap_or(0.0);
        // Fractions of the largest distance, since squares of huge distances overflow.
        let share = |x: f64| if largest > 0.0 { x / largest } else { 0.0 };
        let spread = |factor: f64, over: f64| {
            let [max, mean, rms, p50, p95, p99] = [
                max,
                sorted.iter().map(|&x| share(x)).sum::<f64>() / count * largest,
                (sorted.iter().map(|&x| share(x).powi(2)).sum::<f64>() / count).sqrt() * largest,
                percentile(&sorted, 0.50),
                percentile(&sorted, 0.95),
                percentile(&sorted, 0.99),
            ]
            .map(|x| finite(x / over * factor));
            Spread { max, mean, rms, p50, p95, p99 }
        };
        let scale = analysis.scale();
        Some(Deviation {
            samples: sorted.len() as u64,
            vertices: vertex_count,
            complete: distances.complete,
            distance: spread(1.0, scale),
            percent: spread(100.0, diagonal),
            farthest: at.to_array().map(|x| finite(x / scale)),
        })
    }
}

/// Agreement of two meshes on which points are inside. Points are spread evenly in the bounding box of both meshes. A
/// point is inside if its generalized winding number (Jacobson et al. 2013) has an absolute value of at least 0.5.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct InsideAgreement {
    /// Number of points evaluated.
    pub points: u64,
    /// Share of the points on which both meshes agree, in percent.
    pub agree_pct: f64,
    /// Intersection over union: of the points inside at least one mesh, the share inside both, in percent. `null` if
    /// no point is inside.
    pub overlap_pct: Option<f64>,
    /// Number of points inside the first mesh.
    pub inside_before: u64,
    /// Number of points inside the second mesh.
    pub inside_after: u64,
}

impl InsideAgreement {
    /// Of the points inside the first mesh, the share inside the second too, in percent. `None` if no point is inside
    /// the first.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
    pub fn kept_pct(&self) -> Option<f64> {
        let (before, after) = (self.inside_before as f64, self.inside_after as f64);
        let overlap = self.overlap_pct? / 100.0;
        let both = overlap * (before + after) / (1.0 + overlap);
        (before > 0.0).then(|| (both / before * 100.0).min(100.0))
    }
}

/// Compares which points are inside each mesh. `least_before` is the winding number from which a point is inside the
/// first mesh. Returns `None` if a mesh has no faces or no point was evaluated.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub(super) fn inside_agreement(
    pair: Pair<'_>,
    least_before: f64,
    points: u32,
    context: &Context<'_>,
) -> Result<Option<InsideAgreement>, Cancelled> {
    let mut bounds = Box3::of(pair.from.unit().iter().copied());
    for &p in pair.to.unit() {
        bounds.extend(p / pair.ratio);
    }
    if points == 0 || pair.from.surface.faces.is_empty() || pair.to.surface.faces.is_empty() {
        return Ok(None);
    }
    let insides = [RayWinding::new(pair.from), RayWinding::new(pair.to)];
    context.check()?;
    let answers = run_queries(
        points as usize,
        INSIDE_BUDGET + INSIDE_BUDGET_PER_POINT * u64::from(points),
        context,
        |i, steps| {
            let share = DVec3::from(r3(i as f64));
            let point = bounds.min * (DVec3::ONE - share) + bounds.max * share;
            let is_inside = [insides[0].winding(point, steps), insides[1].winding(point * pair.ratio, steps)];
            let sides = (is_inside[0] >= least_before, is_inside[1] >= INSIDE_WINDING);
            (*steps > 0).then_some(sides)
        },
    )?;
    let count = |predicate: fn(&(bool, bool)) -> bool| {
        answers.values.iter().flatten().filter(|sides| predicate(sides)).count() as f64
    };
    let evaluated = count(|_| true);
    let (either, both) = (count(|sides| sides.0 || sides.1), count(|sides| sides.0 && sides.1));
    Ok((evaluated > 0.0).then(|| InsideAgreement {
        points: evaluated as u64,
        agree_pct: (evaluated - either + both) / evaluated * 100.0,
        overlap_pct: (either > 0.0).then(|| both / either * 100.0),
        inside_before: count(|sides| sides.0) as u64,
        inside_after: count(|sides| sides.1) as u64,
    }))
}

/// Of the faces of `pair.from` without a counterpart, the share with material of `pair.to` on both sides, in percent.
/// These are internal faces that a union removes. Tests a subset spread evenly over these faces. Returns `None` if
/// every face is kept or no test finished.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub(super) fn buried_pct(
    pair: Pair<'_>,
    is_kept: impl Fn(u32) -> bool,
    context: &Context<'_>,
) -> Result<Option<f64>, Cancelled> {
    let without_counterpart: Vec<u32> = (0u32..).take(pair.from.surface.faces.len()).filter(|&f| !is_kept(f)).collect();
    let evaluated: Vec<u32> =
        without_counterpart.iter().copied().step_by(without_counterpart.len().div_ceil(BURIED_FACES).max(1)).collect();
    if evaluated.is_empty() || pair.to.surface.faces.is_empty() {
        return Ok(None);
    }
    let points = evaluated.iter().map(|&f| (pair.from.unit_centre(f), pair.from.unit_normal(f)));
    let known: Vec<bool> = are_buried(pair, &points.collect::<Vec<_>>(), context)?.into_iter().flatten().collect();
    let buried = known.iter().filter(|&&buried| buried).count();
    Ok(percent(buried as f64, known.len() as f64))
}

/// For each point of `pair.from`, given with its unit normal, whether material of `pair.to` is on both sides. `None`
/// for points beyond the budget.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub(super) fn are_buried(
    pair: Pair<'_>,
    points: &[(DVec3, DVec3)],
    context: &Context<'_>,
) -> Result<Vec<Option<bool>>, Cancelled> {
    let inside = InsideTest::new(pair.to);
    let answers = run_queries(points.len(), BURIED_BUDGET, context, |i, steps| {
        let (point, normal) = points[i];
        let sides = inside.windings(point * pair.ratio, normal * NORMAL_OFFSET, steps);
        (*steps > 0).then(|| sides.iter().all(|&number| number >= MATERIAL))
    })?;
    Ok(answers.values)
}
