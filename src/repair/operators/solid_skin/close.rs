//! Builds the outer surface from the facets that have air on one side, closes its openings, and drops what is left.

use glam::DVec3;

use crate::arrange::Exact;
use crate::context::{Cancelled, Context};
use crate::math::{Precision, nearest_on_segment};
use crate::mesh::{ClosedSurface, Edges, NO_SOURCE, Parts, Surface, is_generated};
use crate::repair::operators::holes::FillHoles;
use crate::repair::operators::self_union::SelfUnionRounds;
use crate::repair::operators::split_non_manifold::{Pairing, Pinches, split_non_manifold};

/// A place where the outer surface was closed.
#[derive(Debug, Clone, PartialEq)]
pub struct SealedPlace {
    /// The patch's centre.
    pub at: DVec3,
    /// Width of the opening at the patch's widest place: the diameter of the largest ball there, estimated from the
    /// centres of the patch's triangles. In the model's unit.
    pub width: f64,
    /// Number of edges around the patch.
    pub edges: u32,
}

/// The outer surface, with its openings closed.
pub struct Closed {
    /// The surface.
    pub surface: Surface,
    /// The patches.
    pub sealed: Vec<SealedPlace>,
    /// Faces of the surface with air on both sides, or around openings that could not be closed.
    pub sheets: Vec<u32>,
    /// The share of the area in such faces, in percent.
    pub open_pct: f64,
}

/// Closes the openings of an outer surface. Parts that cannot be closed are dropped and listed.
pub fn close(mut surface: Surface, precision: Precision, context: &Context<'_>) -> Result<Closed, Cancelled> {
    let before = surface.faces.len();
    if has_odd_edge(&surface) {
        // The rim of a hole at an edge of several faces is a closed loop only where these are separate.
        split_non_manifold(&mut surface, Pairing::Angular, Pinches::KeepAtBoundaries, context)?;
    }
    FillHoles { precision, ..FillHoles::default() }.apply(&mut surface, context)?;
    let sealed = sealed_places(&surface, before);
    let edges = Edges::new(&surface.faces);
    let (mut sheets, mut open_area, mut area) = (Vec::new(), 0.0, 0.0);
    if ClosedSurface::new(&surface, &edges).is_err() {
        let parts = Parts::new(&surface, &edges);
        let is_open: Vec<bool> = balanced(&surface, &edges, &parts).into_iter().map(|balanced| !balanced).collect();
        for (face, &part) in parts.of_face.iter().enumerate() {
            let of_face = surface.area_vector(face).length();
            area += of_face;
            if part == Parts::NONE || is_open[part as usize] {
                sheets.push(surface.source[face]);
                open_area += of_face;
            }
        }
        sheets.retain(|&source| !is_generated(source));
        parts.remove(&is_open, &mut surface);
    }
    let open_pct = if area > 0.0 { 100.0 * open_area / area } else { 0.0 };
    Ok(Closed { surface, sealed, sheets, open_pct })
}

/// Whether an edge has three, five or more faces.
fn has_odd_edge(surface: &Surface) -> bool {
    Edges::new(&surface.faces).iter().any(|half_edges| half_edges.len() > 2 && !half_edges.len().is_multiple_of(2))
}

/// For each part whether each of its edges is used equally often in both directions.
fn balanced(surface: &Surface, edges: &Edges, parts: &Parts) -> Vec<bool> {
    let mut balanced = vec![true; parts.count];
    for of_edge in edges.iter() {
        let forward = of_edge.iter().filter(|&&h| Edges::is_forward(&surface.faces, h)).count();
        if 2 * forward != of_edge.len() {
            balanced[parts.of_face[of_edge[0] as usize / 3] as usize] = false;
        }
    }
    balanced
}

/// Resolves intersections that patches or rounding caused. Returns whether the surface is then free of them.
pub fn resolve(surface: &mut Surface, context: &Context<'_>) -> Result<bool, Cancelled> {
    let max_deviation = surface.bounds().diagonal() * 1e-4;
    let rounds = SelfUnionRounds {
        winding_rule: crate::arrange::WindingRule::Positive,
        max_deviation,
        sheets: None,
        always: false,
    };
    let done = rounds.apply(surface, &Exact, context)?;
    Ok(done.error.is_none() && done.pairs_left == 0)
}

/// The patches from face number `start` on, grouped into places.
fn sealed_places(surface: &Surface, start: usize) -> Vec<SealedPlace> {
    let patches = Surface {
        positions: surface.positions.clone(),
        faces: surface.faces[start..].to_vec(),
        source: vec![NO_SOURCE; surface.faces.len() - start],
    };
    let edges = Edges::new(&patches.faces);
    let parts = Parts::new(&patches, &edges);
    let mut rims: Vec<Vec<[u32; 2]>> = vec![Vec::new(); parts.count];
    for (edge, of_edge) in edges.iter().enumerate().filter(|(_, of_edge)| of_edge.len() == 1) {
        rims[parts.of_face[of_edge[0] as usize / 3] as usize].push(edges.vertices(edge));
    }
    let place = |(faces, rim): (Vec<u32>, &Vec<[u32; 2]>)| {
        let middle = |f: &u32| patches.corners(*f as usize).into_iter().sum::<DVec3>() / 3.0;
        let area: f64 = faces.iter().map(|&f| patches.area_vector(f as usize).length()).sum();
        let centre = faces.iter().map(|f| middle(f) * patches.area_vector(*f as usize).length()).sum::<DVec3>();
        let corner = patches.corners(faces[0] as usize)[0];
        let width = width(&patches, &faces, rim);
        SealedPlace {
            at: if area > 0.0 { centre / area } else { corner },
            width,
            edges: u32::try_from(rim.len()).unwrap_or(u32::MAX),
        }
    };
    parts.faces().into_iter().zip(&rims).map(place).collect()
}

/// The largest distance of a patch triangle's inner point from the rim, doubled.
fn width(patches: &Surface, faces: &[u32], rim: &[[u32; 2]]) -> f64 {
    const MAX_TESTS: usize = 1 << 20;
    let segments: Vec<[DVec3; 2]> = rim.iter().map(|ends| ends.map(|v| patches.positions[v as usize])).collect();
    let samples = (MAX_TESTS / segments.len().max(1)).max(1);
    let stride = faces.len().div_ceil(samples);
    let inner = |f: &u32| {
        let [a, b, c] = patches.corners(*f as usize);
        // The centre of the inscribed circle.
        let [x, y, z] = [b.distance(c), c.distance(a), a.distance(b)];
        let sum = x + y + z;
        if sum > 0.0 { (a * x + b * y + c * z) / sum } else { a }
    };
    let to_rim = |p: DVec3| {
        segments.iter().map(|&s| nearest_on_segment(p, s).distance_squared(p)).fold(f64::INFINITY, f64::min).sqrt()
    };
    let widest = faces.iter().step_by(stride).map(|f| to_rim(inner(f))).filter(|d| d.is_finite()).fold(0.0, f64::max);
    2.0 * widest
}
