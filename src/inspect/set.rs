use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::analysis::Pair;
use super::sampling::ask;
use super::{Analysis, Bins, Distribution, Histogram, finite, intersections_between};
use crate::context::{Cancelled, Context};
use crate::math::Box3;
use crate::mesh::Soup;

/// Boxes and triangles that the searches from one mesh may look at: so many, and so many more for each vertex.
const BUDGET: u64 = 50_000_000;
const BUDGET_A_VERTEX: u64 = 1000;

/// What is measured of a set of meshes beyond each one: characteristics 13 and 14 of meshalyzer (seed 004).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SetReport {
    /// Intersections between meshes, where they were asked for.
    pub intersections: Option<SetIntersections>,
    /// Distances from each mesh to the others, where they were asked for.
    pub spacing: Option<SetSpacing>,
}

/// Faces of different meshes that intersect.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SetIntersections {
    /// Pairs of intersecting faces in all pairs of meshes.
    pub total: u64,
    /// Whether every pair of meshes was counted to the end; otherwise there may be more.
    pub complete: bool,
    /// The pairs of meshes of which faces intersect.
    pub between: Vec<MeshPair>,
}

/// Two meshes that intersect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MeshPair {
    /// The two meshes, by place in the list of files from 0, the smaller first.
    pub meshes: [u32; 2],
    /// Pairs of faces, one of each mesh, that intersect.
    pub pairs: u64,
    /// Whether all were counted.
    pub complete: bool,
}

/// Distances from the vertices of each mesh to the nearest point of any other mesh.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SetSpacing {
    /// Over the vertices of all meshes.
    pub all: Option<Distribution>,
    /// Whether every vertex was measured.
    pub complete: bool,
    /// Of each mesh in the list of files.
    pub of_mesh: Vec<MeshSpacing>,
}

/// Distances from the vertices of one mesh to the nearest point of any other mesh of the set.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct MeshSpacing {
    /// How the distances are distributed; none where it has no vertex or there is no other mesh.
    pub distances: Option<Distribution>,
    /// Whether every vertex was measured.
    pub complete: bool,
    /// Where the mesh comes nearest to another.
    pub nearest: Option<Nearest>,
}

/// The shortest way from a vertex to another mesh.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Nearest {
    /// How long it is.
    pub distance: f64,
    /// The vertex.
    pub from: [f64; 3],
    /// The nearest point of the other mesh.
    pub to: [f64; 3],
    /// The other mesh, by place in the list of files from 0.
    pub mesh: u32,
    /// The face of its file that the point is on, by index from 0.
    pub face: u32,
}

impl SetReport {
    /// Shortens the list of pairs to its first `most` and leaves out histograms.
    pub fn abridge(&mut self, most: usize) {
        self.intersections.iter_mut().for_each(|it| it.between.truncate(most));
        if let Some(spacing) = &mut self.spacing {
            let of_meshes = spacing.of_mesh.iter_mut().map(|mesh| &mut mesh.distances);
            for distribution in of_meshes.chain([&mut spacing.all]).flatten() {
                distribution.histogram = Histogram::default();
            }
        }
    }

    /// Measures what is asked for between meshes; none where there are fewer than two or nothing is asked for.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
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
        let mut it = Self::default();
        if intersections {
            it.intersections = Some(SetIntersections::count(&all, context, |a, b| {
                let counts = intersections_between(a, b, context)?.counts;
                Ok((counts.pairs.unwrap_or(0), counts.complete))
            })?);
        }
        if distances {
            let measured = spacing(&all, context)?.into_iter();
            it.spacing =
                Some(SetSpacing::of(measured.map(|of_mesh| (of_mesh.distances, of_mesh.complete, of_mesh.least))));
        }
        Ok(Some(it))
    }
}

impl SetIntersections {
    /// Counts with `between`, which answers how many pairs of faces of two meshes intersect and whether it counted all.
    /// It is only asked about meshes whose boxes meet.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn count(
        meshes: &[&Analysis<'_>],
        context: &Context<'_>,
        mut between: impl FnMut(&Analysis<'_>, &Analysis<'_>) -> Result<(u64, bool), Cancelled>,
    ) -> Result<Self, Cancelled> {
        let mut it = Self { complete: true, ..Self::default() };
        let boxes: Vec<Box3> = meshes.iter().map(|mesh| mesh.surface.bounds()).collect();
        // Swept along x, so that a thousand meshes in a row are not a million pairs.
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
            it.total += pairs;
            it.complete &= complete;
            if pairs > 0 || !complete {
                #[expect(clippy::cast_possible_truncation, reason = "a list of files")]
                it.between.push(MeshPair { meshes: [i as u32, j as u32], pairs, complete });
            }
        }
        Ok(it)
    }
}

impl SetSpacing {
    /// Describes, for each mesh, the distances of its vertices in the unit of the files, whether they are complete, and
    /// the shortest.
    #[must_use]
    pub fn of(measured: impl IntoIterator<Item = (Vec<f64>, bool, Option<Nearest>)>) -> Self {
        let (mut every, mut it) = (Vec::new(), Self { complete: true, ..Self::default() });
        for (distances, complete, nearest) in measured {
            let distances: Vec<f64> = distances.into_iter().map(finite).collect();
            every.extend(&distances);
            it.complete &= complete;
            it.of_mesh.push(MeshSpacing { distances: Distribution::of(distances, Bins::ByRange), complete, nearest });
        }
        it.all = Distribution::of(every, Bins::ByRange);
        it
    }
}

/// How far one mesh of a set is from the others: characteristic 14 of meshalyzer (seed 004).
#[derive(Debug, Clone, PartialEq)]
pub struct Spacing {
    /// For each vertex, in order, the distance to the nearest point of another mesh's surface, in the model's unit. Empty
    /// where no other mesh has a face.
    pub distances: Vec<f64>,
    /// Whether every vertex was measured to the end; not on meshes made to be slow, where some are left out.
    pub complete: bool,
    /// Where the mesh comes nearest to another.
    pub least: Option<Nearest>,
}

/// Measures the distance from every vertex of every mesh to the nearest surface of the other meshes. All are taken to be in
/// the same unit and place.
///
/// # Errors
/// [`Cancelled`] when the context says stop.
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
    // The nearest first, so that the others are mostly ruled out by their boxes.
    others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    for (_, _, pair) in &others {
        pair.to.tree();
        context.check()?;
    }
    let unit = mesh.unit();
    let budget = BUDGET + BUDGET_A_VERTEX * unit.len() as u64;
    let answers = ask(unit.len(), budget, context, |v, steps| {
        let mut best: Option<(f64, Found)> = None;
        for &(_, other, pair) in &others {
            let bound = best.map_or(f64::INFINITY, |(distance, _)| distance * pair.ratio);
            if let Some(nearest) =
                pair.to.tree().nearest(unit[v] * pair.ratio, bound, steps, |f| pair.to.unit_corners(f))
            {
                best = Some((nearest.distance / pair.ratio, Found { other, face: nearest.face, point: nearest.point }));
            }
        }
        best
    })?;
    let scale = scales[own];
    let model = |p: DVec3, scale: f64| p.to_array().map(|x| finite(x / scale));
    let found = || answers.values.iter().enumerate().filter_map(|(v, found)| Some((v, (*found)?)));
    let least = found().min_by(|(_, a), (_, b)| a.0.total_cmp(&b.0)).map(|(v, (distance, it))| Nearest {
        distance: finite(distance / scale),
        from: model(unit[v], scale),
        to: model(it.point, scales[it.other]),
        #[expect(clippy::cast_possible_truncation, reason = "a list of files")]
        mesh: it.other as u32,
        face: meshes[it.other].surface.source[it.face as usize],
    });
    let distances = found().map(|(_, (distance, _))| finite(distance / scale)).collect();
    Ok(Spacing { distances, complete: answers.complete, least })
}

#[derive(Clone, Copy)]
struct Found {
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
    fn only_meshes_whose_boxes_meet_are_asked_about_and_named_in_order() {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let soups: Vec<Soup> = [2.0, 0.0, 0.5, 1.0, 9.0]
            .map(|x| Soup { positions: vec![DVec3::X * x, DVec3::X * (x + 1.0), DVec3::Y], faces: vec![[0, 1, 2]] })
            .to_vec();
        let meshes: Vec<Analysis<'_>> =
            soups.iter().map(|soup| Analysis::new(soup.into(), &context).unwrap()).collect();
        let mut asked = 0;
        let it = SetIntersections::count(&meshes.iter().collect::<Vec<_>>(), &context, |a, b| {
            asked += 1;
            assert!(!std::ptr::eq(a, b));
            let near = (a.surface.positions[0].x - b.surface.positions[0].x).abs() < 0.6;
            Ok((u64::from(near) * 3, true))
        });
        let it = it.unwrap();
        // All have the corner Y in common.
        assert_eq!(asked, 10);
        let pairs: Vec<[u32; 2]> = it.between.iter().map(|pair| pair.meshes).collect();
        assert_eq!((it.total, it.complete, pairs), (6, true, vec![[1, 2], [2, 3]]));
    }

    #[test]
    fn meshes_apart_are_not_asked_about_and_an_unfinished_count_is_said() {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
        let at = |x: f64, y: f64| Soup {
            positions: [DVec3::ZERO, DVec3::X, DVec3::Y].map(|p| p + DVec3::new(x, y, 0.0)).to_vec(),
            faces: vec![[0, 1, 2]],
        };
        let soups = [at(0.0, 0.0), at(0.5, 5.0), at(3.0, 0.0), at(1.0, 0.5)];
        let meshes: Vec<Analysis<'_>> =
            soups.iter().map(|soup| Analysis::new(soup.into(), &context).unwrap()).collect();
        let mut asked = Vec::new();
        let it = SetIntersections::count(&meshes.iter().collect::<Vec<_>>(), &context, |a, b| {
            asked.push([a.surface.positions[0].x, b.surface.positions[0].x]);
            Ok((0, false))
        });
        assert_eq!(asked, [[0.0, 1.0]]);
        let between = vec![MeshPair { meshes: [0, 3], pairs: 0, complete: false }];
        assert_eq!(it.unwrap(), SetIntersections { total: 0, complete: false, between });
    }

    #[test]
    fn spacing_is_told_for_each_mesh_and_for_all() {
        let nearest = Nearest { distance: 1.0, from: [0.0; 3], to: [1.0, 0.0, 0.0], mesh: 2, face: 7 };
        let it =
            SetSpacing::of([(vec![1.0, 3.0], true, Some(nearest)), (Vec::new(), true, None), (vec![8.0], false, None)]);
        assert_eq!((it.all.unwrap().mean, it.complete), (4.0, false));
        let means: Vec<Option<f64>> = it.of_mesh.iter().map(|of| of.distances.as_ref().map(|d| d.mean)).collect();
        assert_eq!(means, [Some(2.0), None, Some(8.0)]);
        assert_eq!((it.of_mesh[0].nearest, it.of_mesh[0].complete), (Some(nearest), true));
    }
}
