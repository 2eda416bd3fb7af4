use super::intersections::materials_in;
use super::readers::{joined_faults, unshared_edges};
use super::{Analysis, BoundingBox, Measures, Volume, finite, group_faces, nesting_depths};
use crate::context::{Cancelled, Context};
use crate::mesh::{Edges, Soup, count_boundary_chains};

/// Measures a mesh as [`Measures`] says, after merging vertices at exactly equal positions, and counts the faces that
/// intersect.
///
/// O(n log n) in the number of faces and of pairs of faces whose boxes meet.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn measure(soup: &Soup, context: &Context<'_>) -> Result<Measures, Cancelled> {
    measure_analysis(&Analysis::new(soup.into(), context)?, context)
}

/// The same for a mesh whose structure is known.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn measure_analysis(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Measures, Cancelled> {
    let mut it = measures(analysis, context)?;
    it.self_intersections = analysis.intersections(context)?.counts;
    Ok(it)
}

/// Measures a mesh whose structure is known, but for [`Measures::self_intersections`], which are not checked.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn measures(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Measures, Cancelled> {
    analysis.measures(context).cloned()
}

/// Counts what [`Analysis::measures`] keeps.
pub(super) fn count(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Measures, Cancelled> {
    let Analysis { subject, surface, ingest, edges, parts, fans, solids, .. } = analysis;
    let mut it = Measures {
        faces: subject.soup.faces.len() as u64,
        vertices: surface.positions.len() as u64,
        unreferenced_vertices: ingest.unreferenced_vertices,
        nonfinite_faces: ingest.nonfinite_faces,
        unreadable_faces: subject.numbering.map_or(0, |numbering| numbering.faces_without_vertex),
        ..Measures::default()
    };
    if surface.faces.is_empty() {
        return Ok(it);
    }
    it.materials = subject.materials.map_or(0, |materials| materials_in(materials).len() as u64);
    it.faces_in_other_materials = analysis.faces_in_other_materials(context)?.len() as u64;
    it.edges = edges.len() as u64;
    it.parts = parts.count as u64;
    it.nonmanifold_vertices = fans.nonmanifold_vertices;
    it.boundary_loops = count_boundary_chains(edges, fans);
    let count_duplicate = || (surface.faces.len() - group_faces(&surface.faces).len()) as u64;
    let count_degenerate =
        || (0u32..).take(surface.faces.len()).filter(|&f| analysis.is_without_area(f)).count() as u64;
    (it.degenerate_faces, it.duplicate_faces) = rayon::join(count_degenerate, count_duplicate);
    it.unshared_edges = unshared_edges(analysis).count() as u64;
    it.near_coincident_faults = joined_faults(analysis);
    context.check()?;
    let mut balanced = true;
    it.consistent = true;
    for half_edges in edges.iter() {
        let forward = half_edges.iter().filter(|&&h| Edges::is_forward(&surface.faces, h)).count();
        match half_edges.len() {
            1 => it.boundary_edges += 1,
            2 => it.misoriented_edges += u64::from(forward != 1),
            _ => it.nonmanifold_edges += 1,
        }
        balanced &= 2 * forward == half_edges.len();
        it.consistent &= forward <= 1 && half_edges.len() - forward <= 1;
    }
    // Faces with a repeated vertex have no edges; a mesh of nothing else is not closed.
    it.closed = it.boundary_edges == 0 && !edges.is_empty();
    it.manifold = it.nonmanifold_edges == 0 && it.nonmanifold_vertices == 0;
    let negative: Vec<bool> = solids.iter().map(|s| s.volume < 0.0).collect();
    let depths = nesting_depths(surface, parts, solids, &negative, context)?;
    it.inverted_parts = depths.iter().filter(|d| d.is_some_and(|d| d % 2 == 0)).count() as u64;
    it.outward = it.closed && it.manifold && it.consistent && it.inverted_parts == 0;
    let bounds = surface.bounds();
    it.bounding_box = Some(BoundingBox { min: bounds.min.to_array(), max: bounds.max.to_array() });
    let about = bounds.centre();
    let tetrahedron = |f: usize| {
        let [a, b, c] = surface.corners(f).map(|p| p - about);
        a.dot(b.cross(c)) / 6.0
    };
    let area = || (0..surface.faces.len()).map(|f| surface.area_vector(f).length() / 2.0).sum();
    let (area, value): (f64, f64) = rayon::join(area, || (0..surface.faces.len()).map(tetrahedron).sum());
    // Surface that is written twice counts twice.
    it.volume = Volume { value: finite(value), reliable: it.closed && balanced && it.duplicate_faces == 0 };
    it.area = finite(area);
    Ok(it)
}
