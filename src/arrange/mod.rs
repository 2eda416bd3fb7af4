//! Surfaces that intersect resolved into the boundary of what they enclose: the trait, and our exact arrangement behind it.
//!
//! After Zhou, Grinspun, Zorin and Jacobson 2016, "Mesh Arrangements for Solid Geometry": every face is cut where it meets
//! others, the cells between the pieces are labelled by winding number, and the facets with the inside on one side only
//! are kept.

mod cells;
mod complex;
mod contacts;
mod grid;
mod openings;
mod points;
mod triangulation;

use cells::Cells;
use complex::Complex;

use crate::context::Context;
use crate::mesh::{ClosedSurface, Surface, is_made};

pub use complex::ArrangeError;

/// Which cells are inside, by their winding number `w`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum WindingRule {
    /// `w >= 1`: what the surface winds around outward. An inverted part is no material.
    #[default]
    Positive,
    /// `w != 0`: inverted parts are solid as well.
    Nonzero,
    /// `w` odd: what is wound around twice is outside again, whichever way its facets are turned.
    Odd,
}

/// What becomes of the cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Rule {
    /// Which are inside.
    pub winding_rule: WindingRule,
    /// Whether patches are doubted: faces without a source. What is inside only because holes were closed, and would hide
    /// surface that can be seen through those holes, is outside then.
    pub doubts_patches: bool,
}

impl From<WindingRule> for Rule {
    fn from(winding_rule: WindingRule) -> Self {
        Self { winding_rule, doubts_patches: false }
    }
}

/// What comes of an arrangement.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Solid {
    /// The boundary of what is inside.
    pub surface: Surface,
    /// Facets of no thickness outside, where surface lies on surface that looks the other way: they enclose nothing, so the
    /// boundary has nothing of them.
    pub flaps: Surface,
    /// The faces with the outside on either side, since patches were taken for wrong: what they were the skin of is open. In
    /// order, turned so that what was inside is behind them.
    pub opened: Surface,
}

/// Resolves intersections.
pub trait Arrangement {
    /// The boundary of what `surface` encloses: closed, and oriented outward. Its positions are f64; rounding them may
    /// make faces intersect again. Each face's source is that of the face that it was cut from. It is empty only where what was
    /// inside is all `opened`.
    ///
    /// # Errors
    /// [`ArrangeError`].
    fn solid(&self, surface: ClosedSurface<'_>, rule: Rule, context: &Context<'_>) -> Result<Solid, ArrangeError>;
}

/// An exact arrangement of faces, and the boundary of the cells that are inside.
///
/// Vertices are taken to a grid of 2^41 steps over the model. From there on all is exact: which faces meet, the points that they
/// have in common, how those stand to one another, and which cell is on which side of a facet. Faces that meet no other keep
/// their vertices bit for bit, and their order.
///
/// After Zhou, Grinspun, Zorin and Jacobson 2016, "Mesh Arrangements for Solid Geometry"; Attene 2020, "Indirect Predicates
/// for Geometric Constructions"; Cherchi, Livesu, Scateni and Attene 2020, "Fast and Robust Mesh Arrangements using
/// Floating-point Arithmetic".
#[derive(Debug, Clone, Copy, Default)]
pub struct Exact;

impl Arrangement for Exact {
    fn solid(&self, surface: ClosedSurface<'_>, rule: Rule, context: &Context<'_>) -> Result<Solid, ArrangeError> {
        let complex = Complex::new(&surface, context)?;
        let cells = Cells::new(&complex, context)?;
        let inside: Vec<bool> = cells.number.iter().map(|&number| is_inside(rule.winding_rule, number)).collect();
        let opened = if rule.doubts_patches {
            openings::seen_into(&complex, &cells, &inside, |f| is_made(surface.source[f as usize]), context)?
        } else {
            None
        };
        let solid = extract(&complex, &cells, &inside, opened.as_deref(), &surface);
        if solid.surface.faces.is_empty() && solid.opened.faces.is_empty() {
            return Err(ArrangeError::Empty);
        }
        Ok(solid)
    }
}

/// Whether a winding number is one of the inside.
fn is_inside(winding_rule: WindingRule, number: i32) -> bool {
    match winding_rule {
        WindingRule::Positive => number > 0,
        WindingRule::Nonzero => number != 0,
        WindingRule::Odd => number % 2 != 0,
    }
}

/// The facets with the inside on one side only, turned outward, in the order of the faces that they are cut from; those that
/// nothing is on either side of; and the faces between cells that were `opened`.
fn extract(complex: &Complex, cells: &Cells, inside: &[bool], opened: Option<&[bool]>, surface: &Surface) -> Solid {
    let is_open = |cell: usize| opened.is_some_and(|opened| opened[cell]);
    let (mut kept, mut flaps, mut skins) = (Vec::new(), Vec::new(), Vec::new());
    for (at, facet) in complex.facets.iter().enumerate() {
        let sides = cells.beside(at);
        let were = sides.map(|cell| inside[cell]);
        let [before, behind] = sides.map(|cell| inside[cell] && !is_open(cell));
        let [a, b, c] = facet.corners;
        if before != behind {
            kept.push((facet.faces[0], if behind { [a, b, c] } else { [a, c, b] }));
        } else if sides.map(|cell| cells.number[cell]) == [0, 0] {
            flaps.push((facet.faces[0], [a, b, c]));
        } else if !before
            && sides.into_iter().any(is_open)
            && let Some(&face) = facet.faces.iter().find(|&&face| !is_made(surface.source[face as usize]))
        {
            let [p, q, r] = facet.corners.map(|point| complex.points.place(point));
            let looks_the_same_way = (q - p).cross(r - p).dot(surface.area_vector(face as usize)) > 0.0;
            let was_inside_before = were[0] && !were[1];
            skins.push((face, looks_the_same_way == was_inside_before));
        }
    }
    Solid {
        surface: surface_of(complex, kept, surface),
        flaps: surface_of(complex, flaps, surface),
        opened: faces_of(skins, surface),
    }
}

/// Faces of the surface, each once and some turned over, as a surface.
fn faces_of(mut faces: Vec<(u32, bool)>, surface: &Surface) -> Surface {
    faces.sort_unstable();
    faces.dedup_by_key(|it| it.0);
    let turned = |&(face, turned): &(u32, bool)| {
        let [a, b, c] = surface.faces[face as usize];
        if turned { [a, c, b] } else { [a, b, c] }
    };
    let mut made = Surface {
        positions: surface.positions.clone(),
        faces: faces.iter().map(turned).collect(),
        source: faces.iter().map(|&(face, _)| surface.source[face as usize]).collect(),
    };
    made.drop_unreferenced();
    made
}

/// Facets, each with the face that it is cut from, as a surface.
fn surface_of(complex: &Complex, mut facets: Vec<(u32, [u32; 3])>, surface: &Surface) -> Surface {
    facets.sort_by_key(|&(face, _)| face);
    let position = |point: u32| match complex.vertices.get(point as usize).copied() {
        Some(vertex) => surface.positions[vertex as usize],
        None => complex.grid.to_model(complex.points.place(point)),
    };
    let mut made = Surface {
        positions: (0..complex.points.len() as u32).map(position).collect(),
        faces: facets.iter().map(|&(_, corners)| corners).collect(),
        source: facets.iter().map(|&(face, _)| surface.source[face as usize]).collect(),
    };
    made.drop_unreferenced();
    made
}
