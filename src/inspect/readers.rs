//! How other programs read a closed mesh: those that take vertices by index alone, and those that join vertices which are nearly equal.

use glam::DVec3;

use super::{Analysis, Subject};
use crate::mesh::{Edges, Surface, weld_exactly};
use crate::scene::{Unit, UnitSource};

/// Positions that agree when multiplied by this and rounded are one vertex to trimesh, whose `tol.merge` is 1e-8.
const DECIMALS: f64 = 1e8;
/// The same as a share of the diagonal, for models so small that eight decimals would not tell their features apart.
const OF_DIAGONAL: f64 = 1e7;

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
pub(super) fn joined_faults(analysis: &Analysis<'_>) -> u64 {
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
