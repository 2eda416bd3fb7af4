//! Arrangements: the boundary of the solid that a self-intersecting surface encloses. Holds the trait and the exact
//! implementation.
//!
//! After Zhou, Grinspun, Zorin and Jacobson 2016, "Mesh Arrangements for Solid Geometry". Every face is split where it
//! meets other faces. The resulting facets divide space into cells, and each cell has a winding number. Facets with the
//! inside on exactly one side are the boundary.

mod cells;
mod complex;
mod contacts;
mod grid;
mod openings;
mod points;
mod sides;
mod triangulation;

use cells::Cells;
use complex::Complex;
use glam::DVec3;

use crate::context::Context;
use crate::mesh::{ClosedSurface, Surface, is_generated};

pub use crate::math::WindingRule;
pub use complex::ArrangeError;
pub use contacts::MeetingFaces;
pub(crate) use sides::{FacetSides, SideLink};

/// How an arrangement classifies its cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Rule {
    /// The rule for winding numbers.
    pub winding_rule: WindingRule,
    /// Whether to reopen patches. A patch is a face that was added to close a hole. If only patches close a region, and
    /// they would hide surface that is visible through the open holes, the region counts as outside.
    pub reopens_patches: bool,
}

impl From<WindingRule> for Rule {
    fn from(winding_rule: WindingRule) -> Self {
        Self { winding_rule, reopens_patches: false }
    }
}

/// The result of an arrangement.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Solid {
    /// The boundary of the inside.
    pub surface: Surface,
    /// Facets in outside space where two layers of opposite orientation coincide. They enclose nothing, so the boundary
    /// does not contain them.
    pub zero_thickness: Surface,
    /// The skin of reopened regions: faces of the input that bounded these regions and now have outside on both sides.
    /// In ascending order of the face, oriented so that the former inside is behind them.
    pub opened: Surface,
}

/// Computes the boundary of the solid that a surface encloses.
pub trait Arrangement {
    /// The boundary of the solid that `surface` encloses: closed and oriented outward. Positions are f64; rounding them
    /// may reintroduce intersections. Each face has the source of the face that it was split from. The boundary is
    /// empty only if the whole inside was reopened.
    ///
    /// `known`, from an earlier search, has every pair of faces that have more in common than corners and edges, apart from
    /// faces without area. Without it, an implementation that needs the pairs searches them.
    ///
    /// # Errors
    /// [`ArrangeError`], which lists the reasons.
    fn solid(
        &self,
        surface: ClosedSurface<'_>,
        known: Option<&[MeetingFaces]>,
        rule: Rule,
        context: &Context<'_>,
    ) -> Result<Solid, ArrangeError>;
}

/// An exact arrangement of faces, and the boundary of its inside cells.
///
/// Vertices are rounded to a grid with 2^41 steps across the model. After that every decision is exact: which faces
/// meet, where they meet, how those points lie relative to each other, and which cell is on each side of a facet.
/// Faces that meet no other face keep their order and the exact positions of their vertices.
///
/// After Zhou, Grinspun, Zorin and Jacobson 2016, "Mesh Arrangements for Solid Geometry"; Attene 2020, "Indirect
/// Predicates for Geometric Constructions"; Cherchi, Livesu, Scateni and Attene 2020, "Fast and Robust Mesh
/// Arrangements using Floating-point Arithmetic".
#[derive(Debug, Clone, Copy, Default)]
pub struct Exact;

impl Arrangement for Exact {
    fn solid(
        &self,
        surface: ClosedSurface<'_>,
        known: Option<&[MeetingFaces]>,
        rule: Rule,
        context: &Context<'_>,
    ) -> Result<Solid, ArrangeError> {
        let complex = Complex::new(&surface, known, context)?;
        let cells = Cells::new(&complex, context)?;
        let inside: Vec<bool> = cells.winding.iter().map(|&w| is_inside(rule.winding_rule, w)).collect();
        let opened = if rule.reopens_patches {
            openings::cells_to_reopen(&complex, &cells, &inside, |f| is_generated(surface.source[f as usize]), context)?
        } else {
            None
        };
        let solid = extract(complex, cells, &inside, opened.as_deref(), &surface);
        if solid.surface.faces.is_empty() && solid.opened.faces.is_empty() {
            return Err(ArrangeError::Empty);
        }
        Ok(solid)
    }
}

/// Whether a cell with the winding number `w` is inside.
fn is_inside(winding_rule: WindingRule, w: i32) -> bool {
    match winding_rule {
        WindingRule::Positive => w > 0,
        WindingRule::Nonzero => w != 0,
        WindingRule::Odd => w % 2 != 0,
    }
}

/// Collects the boundary, the zero-thickness facets, and the skin of the cells that were `opened`. Boundary facets are
/// oriented outward, in the order of the faces they were split from. Zero-thickness facets have winding number 0 on both
/// sides.
fn extract(complex: Complex, cells: Cells, inside: &[bool], opened: Option<&[bool]>, surface: &Surface) -> Solid {
    let Complex { grid, points, facets, solid_faces, vertices } = complex;
    drop(solid_faces);
    let is_open = |cell: usize| opened.is_some_and(|opened| opened[cell]);
    let is_solid_beside = |facet: usize| cells.beside(facet).map(|cell| inside[cell] && !is_open(cell));
    let is_boundary = |&facet: &usize| matches!(is_solid_beside(facet), [in_front, behind] if in_front != behind);
    let mut boundary = Vec::with_capacity((0..facets.len()).filter(is_boundary).count());
    let (mut zero_thickness, mut skin) = (Vec::new(), Vec::new());
    for (index, facet) in facets.iter().enumerate() {
        let sides = cells.beside(index);
        let was_inside = sides.map(|cell| inside[cell]);
        let [in_front, behind] = is_solid_beside(index);
        let [a, b, c] = facet.corners;
        if in_front != behind {
            boundary.push((facet.faces[0], if behind { [a, b, c] } else { [a, c, b] }));
        } else if sides.map(|cell| cells.winding[cell]) == [0, 0] {
            zero_thickness.push((facet.faces[0], [a, b, c]));
        } else if !in_front
            && sides.into_iter().any(is_open)
            && let Some(&face) = facet.faces.iter().find(|&&face| !is_generated(surface.source[face as usize]))
        {
            let [p, q, r] = facet.corners.map(|point| points.place(point));
            let has_same_orientation = (q - p).cross(r - p).dot(surface.area_vector(face as usize)) > 0.0;
            // Flip the face if the former inside is in front of it.
            let was_inside_in_front = was_inside[0] && !was_inside[1];
            skin.push((face, has_same_orientation == was_inside_in_front));
        }
    }
    // Large arrays that are no longer needed make room for the result.
    drop((facets, cells));
    let position = |point: u32| match vertices.get(point as usize).copied() {
        Some(vertex) => surface.positions[vertex as usize],
        None => grid.to_model(points.place(point)),
    };
    let surface_of = |facets| surface_of(facets, (points.len(), &position), surface);
    Solid { surface: surface_of(boundary), zero_thickness: surface_of(zero_thickness), opened: faces_of(skin, surface) }
}

/// Makes a surface of selected faces, each with whether to flip it. A face that is selected several times appears once.
fn faces_of(mut faces: Vec<(u32, bool)>, surface: &Surface) -> Surface {
    if faces.is_empty() {
        return Surface::default();
    }
    faces.sort_unstable();
    faces.dedup_by_key(|(face, _)| *face);
    let oriented = |&(face, is_flipped): &(u32, bool)| {
        let [a, b, c] = surface.faces[face as usize];
        if is_flipped { [a, c, b] } else { [a, b, c] }
    };
    let mut result = Surface {
        positions: surface.positions.clone(),
        faces: faces.iter().map(oriented).collect(),
        source: faces.iter().map(|&(face, _)| surface.source[face as usize]).collect(),
    };
    result.drop_unreferenced();
    result
}

/// Makes a surface of facets, each with the face it was split from. Their corners are points, given by their number and positions.
fn surface_of(
    mut facets: Vec<(u32, [u32; 3])>,
    (points, position): (usize, &dyn Fn(u32) -> DVec3),
    surface: &Surface,
) -> Surface {
    if facets.is_empty() {
        return Surface::default();
    }
    facets.sort_by_key(|&(face, _)| face);
    let mut result = Surface {
        positions: (0..points as u32).map(position).collect(),
        faces: facets.iter().map(|&(_, corners)| corners).collect(),
        source: facets.iter().map(|&(face, _)| surface.source[face as usize]).collect(),
    };
    result.drop_unreferenced();
    result
}
