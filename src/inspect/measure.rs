//! Counting and measuring a mesh, also as other programs read it: those that take vertices by index alone, and those that join
//! vertices which are nearly equal.

use glam::DVec3;

use super::analysis::get_or_find;
use super::intersections::materials_in;
use super::{Analysis, BoundingBox, Measures, Subject, Volume, finite, group_faces, nesting_depths};
use crate::context::{Cancelled, Context};
use crate::mesh::{Edges, Soup, Surface, count_boundary_chains, weld_exactly};
use crate::scene::{Unit, UnitSource};

/// Positions that agree when multiplied by this and rounded are one vertex to trimesh, whose `tol.merge` is 1e-8.
const DECIMALS: f64 = 1e8;
/// The same as a share of the diagonal, for models so small that eight decimals would not tell their features apart.
const OF_DIAGONAL: f64 = 1e7;

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

impl Analysis<'_> {
    /// The measures, but for self-intersections.
    fn measures(&self, context: &Context<'_>) -> Result<&Measures, Cancelled> {
        get_or_find(&self.measures, || count(self, context))
    }
}

/// Counts what [`Analysis::measures`] keeps.
fn count(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Measures, Cancelled> {
    let Analysis { subject, surface, ingest, edges, parts, fans, solids, .. } = analysis;
    let mut it = Measures {
        faces: subject.soup.faces.len() as u64,
        vertices: surface.positions.len() as u64,
        unreferenced_vertices: ingest.unreferenced_vertices,
        non_finite_faces: ingest.non_finite_faces,
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
    it.non_manifold_vertices = fans.non_manifold_vertices;
    it.boundary_loops = count_boundary_chains(edges, fans);
    let count_duplicate = || (surface.faces.len() - group_faces(&surface.faces).len()) as u64;
    let count_degenerate =
        || (0u32..).take(surface.faces.len()).filter(|&f| analysis.is_without_area(f)).count() as u64;
    (it.degenerate_faces, it.duplicate_faces) = rayon::join(count_degenerate, count_duplicate);
    it.unshared_edges = unshared_edges(analysis).count() as u64;
    it.near_coincident_defects = joined_faults(analysis);
    context.check()?;
    let mut balanced = true;
    it.consistent = true;
    for half_edges in edges.iter() {
        let forward = half_edges.iter().filter(|&&h| Edges::is_forward(&surface.faces, h)).count();
        match half_edges.len() {
            1 => it.boundary_edges += 1,
            2 => it.misoriented_edges += u64::from(forward != 1),
            _ => it.non_manifold_edges += 1,
        }
        balanced &= 2 * forward == half_edges.len();
        it.consistent &= forward <= 1 && half_edges.len() - forward <= 1;
    }
    // Faces with a repeated vertex have no edges; a mesh of nothing else is not closed.
    it.closed = it.boundary_edges == 0 && !edges.is_empty();
    it.manifold = it.non_manifold_edges == 0 && it.non_manifold_vertices == 0;
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

/// The edges of two faces that have different vertices there in the file, though at the same positions. None in formats whose readers
/// join vertices by position.
pub(super) fn unshared_edges<'a>(analysis: &'a Analysis<'_>) -> impl Iterator<Item = usize> + 'a {
    let (surface, soup) = (&analysis.surface, analysis.subject.soup);
    let ends = move |half_edge: u32| {
        let [face, corner] = [half_edge as usize / 3, half_edge as usize % 3];
        let face = soup.faces[surface.source[face] as usize];
        let [a, b] = [face[corner], face[(corner + 1) % 3]];
        [a.min(b), a.max(b)]
    };
    let edges = analysis.edges.iter().enumerate().filter(|_| analysis.subject.is_indexed);
    edges.filter(move |(_, half_edges)| matches!(half_edges, [x, y] if ends(*x) != ends(*y))).map(|(edge, _)| edge)
}

/// How readers that round positions to eight decimals tell vertices apart.
#[derive(Debug, Clone, Copy)]
pub struct Decimals {
    scale: f64,
}

impl Decimals {
    /// For a model; none where its size says nothing.
    #[must_use]
    pub fn of(surface: &Surface) -> Option<Self> {
        let scale = (OF_DIAGONAL / surface.bounds().diagonal()).max(DECIMALS);
        scale.is_finite().then_some(Self { scale })
    }

    /// The position in whole numbers: vertices for which it is the same are one to such a reader. Not finite where it is too large.
    #[must_use]
    pub fn round(self, p: DVec3) -> DVec3 {
        DVec3::from_array((p * self.scale).to_array().map(f64::round_ties_even))
    }

    /// The least length that such a reader tells along an axis, in the model's unit, so many times.
    #[must_use]
    pub fn steps(self, count: f64) -> f64 {
        count / self.scale
    }
}

/// The surface with vertices joined as readers join them that round positions to eight decimals; none where that joins none. Its
/// positions are no lengths. Linear.
#[must_use]
pub fn joined_by_decimals(surface: &Surface) -> Option<Surface> {
    let decimals = Decimals::of(surface)?;
    let positions: Vec<DVec3> = surface.positions.iter().map(|&p| decimals.round(p)).collect();
    if !positions.iter().all(|p| p.is_finite()) {
        return None;
    }
    let mut joined = Surface { positions, faces: surface.faces.clone(), source: Vec::new() };
    (weld_exactly(&mut joined) > 0).then_some(joined)
}

/// Faces that lose a corner, and edges that have other than two opposite faces, only when vertices are joined as by
/// [`joined_by_decimals`].
fn joined_faults(analysis: &Analysis<'_>) -> u64 {
    let Subject { materials, unit, .. } = analysis.subject;
    // Bodies of different materials may touch, and are not joined. Metres, as in glTF, are placed numbers: a glTF file has its vertices in
    // other numbers below a transform, which is what a reader rounds.
    if materials.is_some() || unit.is_some_and(|unit| unit.used == Unit::Metre && unit.source == UnitSource::File) {
        return 0;
    }
    let Some(joined) = joined_by_decimals(&analysis.surface) else { return 0 };
    let collapsed = |faces: &[[u32; 3]]| faces.iter().filter(|[a, b, c]| a == b || b == c || c == a).count() as u64;
    let unpaired = |edges: &Edges, faces: &[[u32; 3]]| {
        let paired = |half_edges: &[u32]| matches!(half_edges, [x, y] if Edges::is_forward(faces, *x) != Edges::is_forward(faces, *y));
        edges.iter().filter(|half_edges| !paired(half_edges)).count() as u64
    };
    let faces = &analysis.surface.faces;
    let edges = Edges::new(&joined.faces);
    collapsed(&joined.faces).saturating_sub(collapsed(faces))
        + unpaired(&edges, &joined.faces).saturating_sub(unpaired(&analysis.edges, faces))
}
