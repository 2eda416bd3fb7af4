use glam::DVec3;

use super::compare::Pair;
use super::queries::ask;
use super::{Analysis, finite};
use crate::context::{Cancelled, Context};
use crate::math::Box3;

/// Boxes and triangles that the searches from one mesh may look at: so many, and so many more for each vertex.
const BUDGET: u64 = 50_000_000;
const BUDGET_A_VERTEX: u64 = 1000;

/// How far one mesh of a set is from the others: characteristic 14 of meshalyzer (seed 004).
#[derive(Debug, Clone, PartialEq)]
pub struct Spacing {
    /// For each vertex, in order, the distance to the nearest point of another mesh's surface, in the model's unit. Empty
    /// where no other mesh has a face.
    pub distances: Vec<f64>,
    /// Whether every vertex was measured to the end; not on meshes made to be slow, where some are left out.
    pub complete: bool,
    /// Where the mesh comes nearest to another.
    pub least: Option<Gap>,
}

/// The shortest way from a vertex to another mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gap {
    /// How long it is.
    pub distance: f64,
    /// The vertex.
    pub from: [f64; 3],
    /// The nearest point of the other mesh.
    pub to: [f64; 3],
    /// The other mesh, by its place in the set.
    pub mesh: usize,
    /// The face of its file that the point is on.
    pub face: u32,
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
            let (theirs, faces) = (pair.to.unit(), &pair.to.surface.faces);
            let corners = |f: u32| faces[f as usize].map(|v| theirs[v as usize]);
            let bound = best.map_or(f64::INFINITY, |(distance, _)| distance * pair.ratio);
            if let Some(nearest) = pair.to.tree().nearest(unit[v] * pair.ratio, bound, steps, corners) {
                best = Some((nearest.distance / pair.ratio, Found { other, face: nearest.face, point: nearest.point }));
            }
        }
        best
    })?;
    let scale = scales[own];
    let model = |p: DVec3, scale: f64| p.to_array().map(|x| finite(x / scale));
    let found = || answers.values.iter().enumerate().filter_map(|(v, found)| Some((v, (*found)?)));
    let least = found().min_by(|(_, a), (_, b)| a.0.total_cmp(&b.0)).map(|(v, (distance, it))| Gap {
        distance: finite(distance / scale),
        from: model(unit[v], scale),
        to: model(it.point, scales[it.other]),
        mesh: it.other,
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
