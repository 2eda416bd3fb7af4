//! Measurements between the meshes of a set: intersections, and distances to the nearest other mesh.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::analysis::Pair;
use super::sampling::run_queries;
use super::{Analysis, Bins, Distribution, Histogram, finite, intersections_between};
use crate::context::{Cancelled, Context};
use crate::math::Box3;
use crate::mesh::Soup;

/// Budget of the searches from one mesh: boxes and triangles visited, plus an allowance per vertex.
const BUDGET: u64 = 50_000_000;
const BUDGET_PER_VERTEX: u64 = 1000;

/// Measurements between the meshes of a set: characteristics 13 and 14 of the tool meshalyzer.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SetReport {
    /// Intersections between meshes; `null` unless requested.
    pub intersections: Option<SetIntersections>,
    /// Distances from each mesh to the others; `null` unless requested.
    pub spacing: Option<SetSpacing>,
}

/// Intersections between faces of different meshes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SetIntersections {
    /// Number of intersecting face pairs over all pairs of meshes.
    pub total: u64,
    /// Whether every pair of meshes was counted completely. If not, the total is a lower bound.
    pub complete: bool,
    /// The pairs of meshes with intersecting faces.
    pub between: Vec<MeshPair>,
}

/// Two intersecting meshes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MeshPair {
    /// Positions of the two meshes in the list of files, from 0, smaller first.
    pub meshes: [u32; 2],
    /// Number of intersecting face pairs, with one face of each mesh.
    pub pairs: u64,
    /// Whether all pairs were counted. If not, the number is a lower bound.
    pub complete: bool,
}

/// Distances from the vertices of each mesh to the nearest point of any other mesh, in the unit of the files.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SetSpacing {
    /// Distribution over the vertices of all meshes.
    pub all: Option<Distribution>,
    /// Whether every vertex was measured.
    pub complete: bool,
    /// Distances of each mesh, in the order of the files.
    pub of_mesh: Vec<MeshSpacing>,
}

/// Distances from the vertices of one mesh to the nearest point of any other mesh of the set.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MeshSpacing {
    /// Distribution of the distances; `null` if the mesh has no vertices or no other mesh has faces.
    pub distances: Option<Distribution>,
    /// Whether every vertex was measured.
    pub complete: bool,
    /// The vertex with the shortest distance to another mesh.
    pub nearest: Option<Nearest>,
}

/// The shortest distance from a vertex to another mesh.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Nearest {
    /// Length of the distance, in the unit of the files.
    pub distance: f64,
    /// Position of the vertex.
    pub from: [f64; 3],
    /// Nearest point of the other mesh.
    pub to: [f64; 3],
    /// Position of the other mesh in the list of files, from 0.
    pub mesh: u32,
    /// Face that contains the nearest point: index in the other mesh's file, from 0.
    pub face: u32,
}

impl SetReport {
    /// Shortens the list of pairs to its first `most` and removes the histograms.
    pub fn abridge(&mut self, most: usize) {
        self.intersections.iter_mut().for_each(|list| list.between.truncate(most));
        if let Some(spacing) = &mut self.spacing {
            let of_meshes = spacing.of_mesh.iter_mut().map(|mesh| &mut mesh.distances);
            for distribution in of_meshes.chain([&mut spacing.all]).flatten() {
                distribution.histogram = Histogram::default();
            }
        }
    }

    /// Measures intersections and distances between meshes, as requested. Returns `None` for fewer than two meshes,
    /// or if neither is requested.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn of(
        meshes: &[&Soup],
        intersections: bool,
        distances: bool,
        context: &Context<'_>,
    ) -> Result<Option<Self>, Cancelled> {
        if meshes.len() < 2 || !(intersections || distances) {
            return Ok(None);
        }
        let analyses: Vec<Analysis<'_>> =
            meshes.iter().map(|&soup| Analysis::new(soup.into(), context)).collect::<Result<_, _>>()?;
        let all: Vec<&Analysis<'_>> = analyses.iter().collect();
        let mut report = Self::default();
        if intersections {
            report.intersections = Some(SetIntersections::count(&all, context, |a, b| {
                let counts = intersections_between(a, b, context)?.counts;
                Ok((counts.pairs.unwrap_or(0), counts.complete))
            })?);
        }
        if distances {
            let measured = spacing(&all, context)?.into_iter();
            report.spacing =
                Some(SetSpacing::of(measured.map(|of_mesh| (of_mesh.distances, of_mesh.complete, of_mesh.least))));
        }
        Ok(Some(report))
    }
}

impl SetIntersections {
    /// Counts intersections with `between`, which returns the number of intersecting face pairs of two meshes and
    /// whether the count is complete. Calls `between` only for meshes whose bounding boxes overlap.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn count(
        meshes: &[&Analysis<'_>],
        context: &Context<'_>,
        mut between: impl FnMut(&Analysis<'_>, &Analysis<'_>) -> Result<(u64, bool), Cancelled>,
    ) -> Result<Self, Cancelled> {
        let mut counts = Self { complete: true, ..Self::default() };
        let boxes: Vec<Box3> = meshes.iter().map(|mesh| mesh.surface.bounds()).collect();
        // A sweep along x avoids testing a million pairs for a thousand meshes in a row.
        let mut order: Vec<usize> = (0..meshes.len()).filter(|&i| !boxes[i].is_empty()).collect();
        order.sort_by(|&i, &j| boxes[i].min.x.total_cmp(&boxes[j].min.x).then(i.cmp(&j)));
        let mut pairs = Vec::new();
        for (at, &i) in order.iter().enumerate() {
            context.check()?;
            let reached = order[at + 1..].iter().take_while(|&&j| boxes[j].min.x <= boxes[i].max.x);
            pairs.extend(reached.filter(|&&j| boxes[i].meets(&boxes[j])).map(|&j| [i.min(j), i.max(j)]));
        }
        pairs.sort_unstable();
        for [i, j] in pairs {
            context.check()?;
            let (pairs, complete) = between(meshes[i], meshes[j])?;
            counts.total += pairs;
            counts.complete &= complete;
            if pairs > 0 || !complete {
                #[expect(clippy::cast_possible_truncation, reason = "a list of files")]
                counts.between.push(MeshPair { meshes: [i as u32, j as u32], pairs, complete });
            }
        }
        Ok(counts)
    }
}

impl SetSpacing {
    /// Describes, for each mesh, the distances of its vertices in the unit of the files, whether all are measured,
    /// and the shortest distance.
    #[must_use]
    pub fn of(measured: impl IntoIterator<Item = (Vec<f64>, bool, Option<Nearest>)>) -> Self {
        let (mut every, mut report) = (Vec::new(), Self { complete: true, ..Self::default() });
        for (distances, complete, nearest) in measured {
            let distances: Vec<f64> = distances.into_iter().map(finite).collect();
            every.extend(&distances);
            report.complete &= complete;
            report.of_mesh.push(MeshSpacing {
                distances: Distribution::of(distances, Bins::ByRange),
                complete,
                nearest,
            });
        }
        report.all = Distribution::of(every, Bins::ByRange);
        report
    }
}

/// Distances from one mesh of a set to the others: characteristic 14 of the tool meshalyzer.
#[derive(Debug, Clone, PartialEq)]
pub struct Spacing {
    /// For each vertex, in order, the distance to the nearest surface of another mesh, in the model's unit. Empty if
    /// no other mesh has faces.
    pub distances: Vec<f64>,
    /// Whether every vertex was measured. If the budget ran out, the list omits some vertices.
    pub complete: bool,
    /// The vertex with the shortest distance to another mesh.
    pub least: Option<Nearest>,
}

/// Measures the distance from every vertex of every mesh to the nearest surface of the other meshes. All meshes must
/// share one unit and one coordinate system.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn spacing(meshes: &[&Analysis<'_>], context: &Context<'_>) -> Result<Vec<Spacing>, Cancelled> {
    let scales: Vec<f64> = meshes.iter().map(|mesh| mesh.scale()).collect();
    let boxes: Vec<Box3> = meshes.iter().map(|mesh| Box3::of(mesh.unit().iter().copied())).collect();
    (0..meshes.len()).map(|own| from_one(own, meshes, &scales, &boxes, context)).collect()
}

fn from_one(
    own: usize,
    meshes: &[&Analysis<'_>],
    scales: &[f64],
    boxes: &[Box3],
    context: &Context<'_>,
) -> Result<Spacing, Cancelled> {
    let mesh = meshes[own];
    let mut others: Vec<(f64, usize, Pair<'_>)> = (0..meshes.len())
        .filter(|&other| other != own && !meshes[other].surface.faces.is_empty())
        .map(|other| {
            let pair = Pair::scaled([mesh, meshes[other]], [scales[own], scales[other]]);
            let (low, high) = (boxes[other].min / pair.ratio, boxes[other].max / pair.ratio);
            let gap = (low - boxes[own].max).max(boxes[own].min - high).max_element();
            (gap, other, pair)
        })
        .collect();
    if others.is_empty() {
        return Ok(Spacing { distances: Vec::new(), complete: true, least: None });
    }
    // Nearest meshes first, so that the bounding boxes rule out most others.
    others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for (_, _, pair) in &others {
        pair.to.tree();
        context.check()?;
    }
    let unit = mesh.unit();
    let budget = BUDGET + BUDGET_PER_VERTEX * unit.len() as u64;
    let answers = run_queries(unit.len(), budget, context, |v, steps| {
        let mut best: Option<(f64, NearestFace)> = None;
        for &(_, other, pair) in &others {
            let bound = best.map_or(f64::INFINITY, |(distance, _)| distance * pair.ratio);
            if let Some(nearest) =
                pair.to.tree().nearest(unit[v] * pair.ratio, bound, steps, |f| pair.to.unit_corners(f))
            {
                best = Some((
                    nearest.distance / pair.ratio,
                    NearestFace { other, face: nearest.face, point: nearest.point },
                ));
            }
        }
        best
    })?;
    let scale = scales[own];
    let model = |p: DVec3, scale: f64| p.to_array().map(|x| finite(x / scale));
    let nearest_faces = || answers.values.iter().enumerate().filter_map(|(v, nearest)| Some((v, (*nearest)?)));
    let least = nearest_faces().min_by(|(_, a), (_, b)| a.0.total_cmp(&b.0)).map(|(v, (distance, nearest))| Nearest {
        distance: finite(distance / scale),
        from: model(unit[v], scale),
        to: model(nearest.point, scales[nearest.other]),
        #[expect(clippy::cast_possible_truncation, reason = "a list of files")]
        mesh: nearest.other as u32,
        face: meshes[nearest.other].surface.source[nearest.face as usize],
    });
    let distances = nearest_faces().map(|(_, (distance, _))| finite(distance / scale)).collect();
    Ok(Spacing { distances, complete: answers.complete, least })
}

#[derive(Clone, Copy)]
struct NearestFace {
    other: usize,
    face: u32,
    point: DVec3,
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use glam::DVec3;

    use super::*;
    use crate::context::NoProgress;

    #[test]
    fn only_meshes_with_overlapping_boxes_are_counted_in_order() {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let soups: Vec<Soup> = [2.0, 0.0, 0.5, 1.0, 9.0]
            .map(|x| Soup { positions: vec![DVec3::X * x, DVec3::X * (x + 1.0), DVec3::Y], faces: vec![[0, 1, 2]] })
            .to_vec();
        let meshes: Vec<Analysis<'_>> =
            soups.iter().map(|soup| Analysis::new(soup.into(), &context).unwrap()).collect();
        let mut calls = 0;
        let counts = SetIntersections::count(&meshes.iter().collect::<Vec<_>>(), &context, |a, b| {
            calls += 1;
            assert!(!std::ptr::eq(a, b));
            let near = (a.surface.positions[0].x - b.surface.positions[0].x).abs() < 0.6;
            Ok((u64::from(near) * 3, true))
        });
        let counts = counts.unwrap();
        // All triangles share the corner Y.
        assert_eq!(calls, 10);
        let pairs: Vec<[u32; 2]> = counts.between.iter().map(|pair| pair.meshes).collect();
        assert_eq!((counts.total, counts.complete, pairs), (6, true, vec![[1, 2], [2, 3]]));
    }

    #[test]
    fn separate_meshes_are_skipped_and_an_incomplete_count_is_reported() {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let at = |x: f64, y: f64| Soup {
            positions: [DVec3::ZERO, DVec3::X, DVec3::Y].map(|p| p + DVec3::new(x, y, 0.0)).to_vec(),
            faces: vec![[0, 1, 2]],
        };
        let soups = [at(0.0, 0.0), at(0.5, 5.0), at(3.0, 0.0), at(1.0, 0.5)];
        let meshes: Vec<Analysis<'_>> =
            soups.iter().map(|soup| Analysis::new(soup.into(), &context).unwrap()).collect();
        let mut calls = Vec::new();
        let counts = SetIntersections::count(&meshes.iter().collect::<Vec<_>>(), &context, |a, b| {
            calls.push([a.surface.positions[0].x, b.surface.positions[0].x]);
            Ok((0, false))
        });
        assert_eq!(calls, [[0.0, 1.0]]);
        let between = vec![MeshPair { meshes: [0, 3], pairs: 0, complete: false }];
        assert_eq!(counts.unwrap(), SetIntersections { total: 0, complete: false, between });
    }

    #[test]
    fn spacing_covers_each_mesh_and_all_together() {
        let nearest = Nearest { distance: 1.0, from: [0.0; 3], to: [1.0, 0.0, 0.0], mesh: 2, face: 7 };
        let spacing =
            SetSpacing::of([(vec![1.0, 3.0], true, Some(nearest)), (Vec::new(), true, None), (vec![8.0], false, None)]);
        assert_eq!((spacing.all.unwrap().mean, spacing.complete), (4.0, false));
        let means: Vec<Option<f64>> = spacing.of_mesh.iter().map(|of| of.distances.as_ref().map(|d| d.mean)).collect();
        assert_eq!(means, [Some(2.0), None, Some(8.0)]);
        assert_eq!((spacing.of_mesh[0].nearest, spacing.of_mesh[0].complete), (Some(nearest), true));
    }
}
