//! How far two meshes are apart, and whether they agree on what is inside.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::super::analysis::Pair;
use super::super::distribution::percentile;
use super::super::sampling::{InsideTest, Sample, ask};
use super::super::{Analysis, finite, percent};
use crate::context::{Cancelled, Context};
use crate::math::{Box3, r3};

/// Boxes and triangles that all searches of one direction together may look at: so many, and so many more for each point.
const BUDGET: u64 = 10_000_000;
const BUDGET_A_POINT: u64 = 500;
/// Nodes and triangles that all winding numbers of both meshes together may look at: so many, and so many more for each
/// point.
const INSIDE_BUDGET: u64 = 10_000_000;
const INSIDE_BUDGET_A_POINT: u64 = 2000;
/// Faces of which is asked whether they are buried, at most.
const BURIED_FACES: usize = 1000;
/// Nodes and triangles that the questions about them together may look at.
const BURIED_BUDGET: u64 = 10_000_000;
/// How far on both sides of a face winding numbers are asked, in unit coordinates, which reach 2.
const BESIDE: f64 = 1e-6;
/// A winding number of at least this is material.
const MATERIAL: f64 = 0.9;
/// The winding number from which on a point counts as inside a closed mesh.
pub(super) const INSIDE_WINDING: f64 = 0.5;

/// How far the surface of one mesh is from that of another, sampled evenly by area.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Deviation {
    /// Points on faces that were measured.
    pub samples: u64,
    /// Vertices that were measured beside them; they count for the largest distance only.
    pub vertices: u64,
    /// Whether all points were measured to the end; not on meshes made to be slow.
    pub complete: bool,
    /// In the unit of the input.
    pub distance: Spread,
    /// In percent of the diagonal of the input's box.
    pub percent: Spread,
    /// The point that is farthest away, in the unit of the input.
    pub farthest: [f64; 3],
}

/// Distances in figures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Spread {
    /// The largest, of samples and vertices.
    pub max: f64,
    /// The mean.
    pub mean: f64,
    /// The root of the mean square.
    pub rms: f64,
    /// The median.
    pub p50: f64,
    /// Not exceeded by 95 % of the area.
    pub p95: f64,
    /// Not exceeded by 99 % of the area.
    pub p99: f64,
}

/// Distances from points of a mesh to another mesh, in the unit coordinates of the first.
pub(super) struct Distances {
    /// From each sample; none where the budget ended before.
    pub samples: Vec<Option<f64>>,
    /// From some vertices, each with its index.
    pub vertices: Vec<(u32, f64)>,
    /// Whether all were measured to the end.
    pub complete: bool,
}

/// Measures from the samples, and from at most `vertices` vertices, to the nearest point of the other mesh. What is on a
/// face that `stands` in the other is at no distance and costs nothing.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub(super) fn distances(
    pair: Pair<'_>,
    samples: &[Sample],
    vertices: u32,
    stands: impl Fn(u32) -> bool,
    context: &Context<'_>,
) -> Result<Distances, Cancelled> {
    let missing: Vec<usize> = (0..samples.len()).filter(|&i| !stands(samples[i].face)).collect();
    let surface = &pair.from.surface;
    let mut settled = vec![vertices == 0; surface.positions.len()];
    for (face, index) in surface.faces.iter().zip(0u32..) {
        if stands(index) {
            for &v in face {
                settled[v as usize] = true;
            }
        }
    }
    let apart: Vec<u32> = (0u32..).zip(settled).filter(|(_, settled)| !settled).map(|(v, _)| v).collect();
    let step = apart.len().div_ceil(vertices.max(1) as usize).max(1);
    let apart: Vec<u32> = apart.into_iter().step_by(step).collect();
    let mut all = Distances { samples: vec![Some(0.0); samples.len()], vertices: Vec::new(), complete: true };
    if missing.is_empty() && apart.is_empty() {
        return Ok(all);
    }
    let mine = pair.from.unit();
    let tree = pair.to.tree();
    let count = missing.len() + apart.len();
    let answers = ask(count, BUDGET + BUDGET_A_POINT * count as u64, context, |i, steps| {
        let point = missing.get(i).map_or_else(|| mine[apart[i - missing.len()] as usize], |&i| samples[i].point);
        let nearest = tree.nearest(point * pair.ratio, f64::INFINITY, steps, |f| pair.to.unit_corners(f));
        nearest.map(|nearest| nearest.distance / pair.ratio)
    })?;
    all.complete = answers.complete;
    let (of_samples, of_vertices) = answers.values.split_at(missing.len());
    for (&i, &distance) in missing.iter().zip(of_samples) {
        all.samples[i] = distance;
    }
    all.vertices = apart.iter().zip(of_vertices).filter_map(|(&v, &distance)| Some((v, distance?))).collect();
    Ok(all)
}

/// The points of a mesh from which distances to another were measured.
pub(super) struct Measured<'a> {
    pub analysis: &'a Analysis<'a>,
    pub samples: &'a [Sample],
    pub found: &'a Distances,
    /// The diagonal of the input, in unit coordinates of `analysis`.
    pub diagonal: f64,
}

impl Measured<'_> {
    /// The distances in figures: those of the samples that `counts` says, and of the vertices that `vertices` says. None where nothing
    /// was measured.
    pub fn deviation(&self, counts: impl Fn(usize) -> bool, vertices: impl Fn(u32) -> bool) -> Option<Deviation> {
        let &Self { analysis, samples, found, diagonal } = self;
        let mut farthest = (f64::NEG_INFINITY, None);
        let mut note = |distance: f64, at: DVec3| {
            if distance > farthest.0 {
                farthest = (distance, Some(at));
            }
        };
        let mut sorted = Vec::with_capacity(samples.len());
        for (i, distance) in found.samples.iter().enumerate() {
            if let Some(distance) = distance.filter(|_| counts(i)) {
                note(distance, samples[i].point);
                sorted.push(distance);
            }
        }
        let mut vertex_count = 0;
        for &(v, distance) in found.vertices.iter().filter(|&&(v, _)| vertices(v)) {
            note(distance, analysis.unit()[v as usize]);
            vertex_count += 1;
        }
        let (max, at) = (farthest.0, farthest.1?);
        sorted.sort_unstable_by(f64::total_cmp);
        let count = sorted.len().max(1) as f64;
        let largest = sorted.last().copied().unwrap_or(0.0);
        // By shares of the largest, since squares of huge distances overflow.
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
            complete: found.complete,
            distance: spread(1.0, scale),
            percent: spread(100.0, diagonal),
            farthest: at.to_array().map(|x| finite(x / scale)),
        })
    }
}

/// Whether two meshes agree on what is inside, by generalized winding numbers (Jacobson et al. 2013) at points spread evenly
/// in the box around both. Inside is where the number is at least a half, whichever way the mesh is turned.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct InsideAgreement {
    /// Points that were asked for.
    pub points: u64,
    /// Share of them on which both agree, in percent.
    pub agree_pct: f64,
    /// Share of those inside at least one that are inside both, in percent; none where no point is inside.
    pub overlap_pct: Option<f64>,
    /// Points inside the first mesh.
    pub inside_before: u64,
    /// Points inside the second mesh.
    pub inside_after: u64,
}

impl InsideAgreement {
    /// Share of the points inside the first mesh that are inside the second too, in percent; none where the first has none.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
    pub fn kept_pct(&self) -> Option<f64> {
        let (before, after) = (self.inside_before as f64, self.inside_after as f64);
        let overlap = self.overlap_pct? / 100.0;
        let both = overlap * (before + after) / (1.0 + overlap);
        (before > 0.0).then(|| (both / before * 100.0).min(100.0))
    }
}

/// Compares what is inside. Points count as inside the first mesh from a winding number of `least_before` on. None where one mesh has no face or no point could be asked for.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
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
    let insides = [InsideTest::new(pair.from), InsideTest::new(pair.to)];
    context.check()?;
    let answers =
        ask(points as usize, INSIDE_BUDGET + INSIDE_BUDGET_A_POINT * u64::from(points), context, |i, steps| {
            let share = DVec3::from(r3(i as f64));
            let point = bounds.min * (DVec3::ONE - share) + bounds.max * share;
            let is_inside = [insides[0].winding(point, steps), insides[1].winding(point * pair.ratio, steps)];
            let found = (is_inside[0] >= least_before, is_inside[1] >= INSIDE_WINDING);
            (*steps > 0).then_some(found)
        })?;
    let count =
        |wanted: fn(&(bool, bool)) -> bool| answers.values.iter().flatten().filter(|it| wanted(it)).count() as f64;
    let asked = count(|_| true);
    let (either, both) = (count(|it| it.0 || it.1), count(|it| it.0 && it.1));
    Ok((asked > 0.0).then(|| InsideAgreement {
        points: asked as u64,
        agree_pct: (asked - either + both) / asked * 100.0,
        overlap_pct: (either > 0.0).then(|| both / either * 100.0),
        inside_before: count(|it| it.0) as u64,
        inside_after: count(|it| it.1) as u64,
    }))
}

/// Of the faces of `pair.from` that `stands` denies, the share with material of `pair.to` on both sides, in percent: walls that
/// parts had inside one another, and that their union has no more. Faces spread evenly over all of them are asked. None where
/// all stand, or none could be asked for.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub(super) fn buried_pct(
    pair: Pair<'_>,
    stands: impl Fn(u32) -> bool,
    context: &Context<'_>,
) -> Result<Option<f64>, Cancelled> {
    let gone: Vec<u32> = (0u32..).take(pair.from.surface.faces.len()).filter(|&f| !stands(f)).collect();
    let asked: Vec<u32> = gone.iter().copied().step_by(gone.len().div_ceil(BURIED_FACES).max(1)).collect();
    if asked.is_empty() || pair.to.surface.faces.is_empty() {
        return Ok(None);
    }
    let points = asked.iter().map(|&f| (pair.from.unit_centre(f), pair.from.unit_normal(f)));
    let known: Vec<bool> = are_buried(pair, &points.collect::<Vec<_>>(), context)?.into_iter().flatten().collect();
    let buried = known.iter().filter(|&&buried| buried).count();
    Ok(percent(buried as f64, known.len() as f64))
}

/// Which points of `pair.from`, each with the unit normal there, have material of `pair.to` on both sides; none for those that the
/// budget did not reach.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
pub(super) fn are_buried(
    pair: Pair<'_>,
    points: &[(DVec3, DVec3)],
    context: &Context<'_>,
) -> Result<Vec<Option<bool>>, Cancelled> {
    let inside = InsideTest::new(pair.to);
    let answers = ask(points.len(), BURIED_BUDGET, context, |i, steps| {
        let (point, normal) = points[i];
        let sides = inside.windings(point * pair.ratio, normal * BESIDE, steps);
        (*steps > 0).then(|| sides.iter().all(|&number| number >= MATERIAL))
    })?;
    Ok(answers.values)
}
