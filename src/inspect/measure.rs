//! Computes [`Measures`]: counts and sizes of a mesh, and defects that only some readers see. Such readers join
//! vertices by index alone, or join vertices that are almost equal.

use glam::DVec3;

use super::analysis::get_or_try_init;
use super::intersections::materials_in;
use super::{Analysis, BoundingBox, FileFacts, Measures, Volume, duplicate_faces, finite, nesting_depths};
use crate::context::{Cancelled, Context};
use crate::math::threads;
use crate::mesh::{Edges, Soup, Surface, are_distinct, count_boundary_chains, weld_exactly};
use crate::scene::{Unit, UnitSource};

/// trimesh merges vertices whose positions agree when multiplied by this factor and rounded; its `tol.merge` is 1e-8.
const DECIMALS: f64 = 1e8;
/// Steps per diagonal for models so small that eight decimals would not resolve their features.
const OF_DIAGONAL: f64 = 1e7;

/// Measures a mesh and counts its self-intersections. Vertices at exactly equal positions are merged first.
///
/// O(n log n) in the number of faces and of face pairs whose boxes overlap.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn measure(soup: &Soup, context: &Context<'_>) -> Result<Measures, Cancelled> {
    measure_analysis(&Analysis::new(soup.into(), context)?, context)
}

/// Measures a mesh whose structure is already analysed, and counts its self-intersections.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn measure_analysis(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Measures, Cancelled> {
    let mut counts = measures(analysis, context)?;
    counts.self_intersections = analysis.intersections(context)?.counts;
    Ok(counts)
}

/// Measures a mesh whose structure is already analysed. [`Measures::self_intersections`] stays unchecked.
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn measures(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Measures, Cancelled> {
    analysis.measures(context).cloned()
}

impl Analysis<'_> {
    /// The cached measures, without self-intersections.
    fn measures(&self, context: &Context<'_>) -> Result<&Measures, Cancelled> {
        get_or_try_init(&self.measures, || count(self, context))
    }
}

/// How many edges of a surface are defective.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct EdgeCounts {
    /// Edges with one face.
    pub boundary: u64,
    /// Edges with two faces that traverse them in the same direction.
    pub misoriented: u64,
    /// Edges with more than two faces.
    pub non_manifold: u64,
    /// Edges that are not traversed equally often in both directions.
    pub unbalanced: u64,
    /// Edges that more than one face traverses in the same direction.
    pub inconsistent: u64,
}

impl EdgeCounts {
    /// Counts the edges of a surface, in parallel if they are many.
    #[must_use]
    pub fn of(surface: &Surface, edges: &Edges) -> Self {
        let mut counts = Self::default();
        for of_chunk in threads::map_chunks(edges.len(), |range| {
            let mut counts = Self::default();
            range.for_each(|edge| counts.add(edges.half_edges(edge), &surface.faces));
            counts
        }) {
            counts.boundary += of_chunk.boundary;
            counts.misoriented += of_chunk.misoriented;
            counts.non_manifold += of_chunk.non_manifold;
            counts.unbalanced += of_chunk.unbalanced;
            counts.inconsistent += of_chunk.inconsistent;
        }
        counts
    }

    fn add(&mut self, half_edges: &[u32], faces: &[[u32; 3]]) {
        let forward = half_edges.iter().filter(|&&h| Edges::is_forward(faces, h)).count();
        match half_edges.len() {
            1 => self.boundary += 1,
            2 => self.misoriented += u64::from(forward != 1),
            _ => self.non_manifold += 1,
        }
        self.unbalanced += u64::from(2 * forward != half_edges.len());
        self.inconsistent += u64::from(forward > 1 || half_edges.len() - forward > 1);
    }
}

/// Computes the measures that [`Analysis::measures`] caches.
fn count(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<Measures, Cancelled> {
    let Analysis { facts, surface, ingest, edges, parts, fans, solids, .. } = analysis;
    let mut counts = Measures {
        faces: analysis.file_faces().len() as u64,
        vertices: surface.positions.len() as u64,
        unreferenced_vertices: ingest.unreferenced_vertices,
        non_finite_faces: ingest.non_finite_faces,
        unreadable_faces: facts.numbering.map_or(0, |numbering| numbering.faces_without_vertex),
        ..Measures::default()
    };
    if surface.faces.is_empty() {
        return Ok(counts);
    }
    counts.materials = facts.materials.map_or(0, |materials| materials_in(materials).len() as u64);
    counts.faces_in_other_materials = analysis.faces_in_other_materials(context)?.len() as u64;
    counts.edges = edges.len() as u64;
    counts.parts = parts.count as u64;
    counts.non_manifold_vertices = fans.non_manifold_vertices;
    counts.boundary_loops = count_boundary_chains(&surface.faces, edges, fans);
    let count_in_faces = || degenerate_and_duplicate(analysis);
    let count_for_readers = || (unshared_edges(analysis).count() as u64, near_coincident_defects(analysis));
    ((counts.degenerate_faces, counts.duplicate_faces), (counts.unshared_edges, counts.near_coincident_defects)) =
        threads::join(surface.faces.len(), count_in_faces, count_for_readers);
    context.check()?;
    let EdgeCounts { boundary, misoriented, non_manifold, unbalanced, inconsistent } = EdgeCounts::of(surface, edges);
    (counts.boundary_edges, counts.misoriented_edges, counts.non_manifold_edges) =
        (boundary, misoriented, non_manifold);
    let balanced = unbalanced == 0;
    counts.consistent = inconsistent == 0;
    // A face with a repeated vertex has no edges; a mesh of only such faces is not closed.
    counts.closed = counts.boundary_edges == 0 && !edges.is_empty();
    counts.manifold = counts.non_manifold_edges == 0 && counts.non_manifold_vertices == 0;
    let negative: Vec<bool> = solids.iter().map(|s| s.volume < 0.0).collect();
    let depths = nesting_depths(surface, parts, solids, &negative, context)?;
    counts.inverted_parts = depths.iter().filter(|d| d.is_some_and(|d| d % 2 == 0)).count() as u64;
    counts.outward = counts.closed && counts.manifold && counts.consistent && counts.inverted_parts == 0;
    let bounds = surface.bounds();
    counts.bounding_box = Some(BoundingBox { min: bounds.min.to_array(), max: bounds.max.to_array() });
    let about = bounds.centre();
    let tetrahedron = |f: usize| {
        let [a, b, c] = surface.corners(f).map(|p| p - about);
        a.dot(b.cross(c)) / 6.0
    };
    let area = || (0..surface.faces.len()).map(|f| surface.area_vector(f).length() / 2.0).sum();
    let (area, value): (f64, f64) =
        threads::join(surface.faces.len(), area, || (0..surface.faces.len()).map(tetrahedron).sum());
    // A duplicate face counts twice in the volume.
    counts.volume = Volume { value: finite(value), reliable: counts.closed && balanced && counts.duplicate_faces == 0 };
    counts.area = finite(area);
    Ok(counts)
}

/// Number of degenerate faces, and of faces with the same vertices as an earlier one.
fn degenerate_and_duplicate(analysis: &Analysis<'_>) -> (u64, u64) {
    let faces = &analysis.surface.faces;
    // Computed here, before several threads need it.
    analysis.flat();
    #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
    let count_degenerate = || threads::count(faces.len(), |f| analysis.is_without_area(f as u32));
    threads::join(faces.len(), count_degenerate, || duplicate_faces(faces, &analysis.edges))
}

/// Edges whose two faces share positions but not vertex indices in the file. Empty for formats whose readers join
/// vertices by position.
pub(super) fn unshared_edges<'a>(analysis: &'a Analysis<'_>) -> impl Iterator<Item = usize> + 'a {
    let (surface, file_faces) = (&analysis.surface, analysis.file_faces());
    let ends = move |half_edge: u32| {
        let [face, corner] = [half_edge as usize / 3, half_edge as usize % 3];
        let face = file_faces[surface.source[face] as usize];
        let [a, b] = [face[corner], face[(corner + 1) % 3]];
        [a.min(b), a.max(b)]
    };
    let edges = analysis.edges.iter().enumerate().filter(|_| analysis.facts.is_indexed);
    edges.filter(move |(_, half_edges)| matches!(half_edges, [x, y] if ends(*x) != ends(*y))).map(|(edge, _)| edge)
}

/// The grid to which some readers round positions: eight decimals, or 1e-7 of the diagonal if that is finer.
#[derive(Debug, Clone, Copy)]
pub struct Decimals {
    scale: f64,
}

impl Decimals {
    /// The grid for a surface; `None` if the step would not be finite.
    #[must_use]
    pub fn of(surface: &Surface) -> Option<Self> {
        let scale = (OF_DIAGONAL / surface.bounds().diagonal()).max(DECIMALS);
        scale.is_finite().then_some(Self { scale })
    }

    /// The position in whole grid steps. Vertices with equal results are one vertex to such a reader. Not finite on
    /// overflow.
    #[must_use]
    pub fn round(self, p: DVec3) -> DVec3 {
        DVec3::from_array((p * self.scale).to_array().map(f64::round_ties_even))
    }

    /// Whether all positions have different places on the grid. O(n).
    #[must_use]
    pub fn tell_apart(self, positions: &[DVec3]) -> bool {
        are_distinct(positions.len(), |number| self.round(positions[number]))
    }

    /// The length of `count` grid steps, in the model's unit.
    #[must_use]
    pub fn steps(self, count: f64) -> f64 {
        count / self.scale
    }
}

/// Joins vertices that round to the same grid position (see [`Decimals`]). Returns `None` if no vertices join.
/// Positions of the returned surface are grid steps, not lengths. O(n).
#[must_use]
pub fn joined_by_decimals(surface: &Surface) -> Option<Surface> {
    let decimals = Decimals::of(surface)?;
    if decimals.tell_apart(&surface.positions) {
        return None;
    }
    let positions: Vec<DVec3> = surface.positions.iter().map(|&p| decimals.round(p)).collect();
    if !positions.iter().all(|p| p.is_finite()) {
        return None;
    }
    let mut joined = Surface { positions, faces: surface.faces.clone(), source: Vec::new() };
    (weld_exactly(&mut joined) > 0).then_some(joined)
}

/// Number of faces that collapse and edges that lose their opposite face when [`joined_by_decimals`] joins vertices.
fn near_coincident_defects(analysis: &Analysis<'_>) -> u64 {
    let FileFacts { materials, unit, .. } = analysis.facts;
    // Bodies of different materials may touch and are not joined. A glTF file (unit metre) stores its coordinates
    // below a transform, and readers round those stored coordinates, not the transformed ones.
    if materials.is_some() || unit.is_some_and(|unit| unit.used == Unit::Metre && unit.source == UnitSource::File) {
        return 0;
    }
    let Some(joined) = joined_by_decimals(&analysis.surface) else { return 0 };
    let collapsed = |faces: &[[u32; 3]]| faces.iter().filter(|[a, b, c]| a == b || b == c || c == a).count() as u64;
    let unpaired = |edges: &Edges, faces: &[[u32; 3]]| {
        let paired = |half_edges: &[u32]| match half_edges {
            [x, y] => Edges::is_forward(faces, *x) != Edges::is_forward(faces, *y),
            _ => false,
        };
        edges.iter().filter(|half_edges| !paired(half_edges)).count() as u64
    };
    let faces = &analysis.surface.faces;
    let edges = Edges::new(&joined.faces);
    collapsed(&joined.faces).saturating_sub(collapsed(faces))
        + unpaired(&edges, &joined.faces).saturating_sub(unpaired(&analysis.edges, faces))
}
