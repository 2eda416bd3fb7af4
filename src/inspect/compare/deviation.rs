use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::super::analysis::Pair;
use super::super::distribution::percentile;
use super::super::sampling::{Sample, ask};
use super::super::{Analysis, finite};
use crate::context::{Cancelled, Context};

/// Boxes and triangles that all searches of one direction together may look at: so many, and so many more for each point.
const BUDGET: u64 = 10_000_000;
const BUDGET_A_POINT: u64 = 500;

/// How far the surface of one mesh is from that of another, sampled evenly by area.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
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
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
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
    let (unit, faces, tree) = (pair.to.unit(), &pair.to.surface.faces, pair.to.tree());
    let count = missing.len() + apart.len();
    let answers = ask(count, BUDGET + BUDGET_A_POINT * count as u64, context, |i, steps| {
        let point = missing.get(i).map_or_else(|| mine[apart[i - missing.len()] as usize], |&i| samples[i].point);
        let corners = |f: u32| faces[f as usize].map(|v| unit[v as usize]);
        tree.nearest(point * pair.ratio, f64::INFINITY, steps, corners).map(|nearest| nearest.distance / pair.ratio)
    })?;
    all.complete = answers.complete;
    let (of_samples, of_vertices) = answers.values.split_at(missing.len());
    for (&i, &distance) in missing.iter().zip(of_samples) {
        all.samples[i] = distance;
    }
    all.vertices = apart.iter().zip(of_vertices).filter_map(|(&v, &distance)| Some((v, distance?))).collect();
    Ok(all)
}

/// The distances in figures: those of the samples that `counts` says, and of the vertices that `vertices` says. None
/// where nothing was measured. `diagonal` is the input's, in the same unit coordinates.
pub(super) fn deviation(
    analysis: &Analysis<'_>,
    samples: &[Sample],
    found: &Distances,
    diagonal: f64,
    counts: impl Fn(usize) -> bool,
    vertices: impl Fn(u32) -> bool,
) -> Option<Deviation> {
    let mut farthest = (f64::NEG_INFINITY, None);
    let mut look = |distance: f64, at: glam::DVec3| {
        if distance > farthest.0 {
            farthest = (distance, Some(at));
        }
    };
    let mut sorted = Vec::with_capacity(samples.len());
    for (i, distance) in found.samples.iter().enumerate() {
        if let Some(distance) = distance.filter(|_| counts(i)) {
            look(distance, samples[i].point);
            sorted.push(distance);
        }
    }
    let mut looked = 0;
    for &(v, distance) in found.vertices.iter().filter(|&&(v, _)| vertices(v)) {
        look(distance, analysis.unit()[v as usize]);
        looked += 1;
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
        vertices: looked,
        complete: found.complete,
        distance: spread(1.0, scale),
        percent: spread(100.0, diagonal),
        farthest: at.to_array().map(|x| finite(x / scale)),
    })
}
