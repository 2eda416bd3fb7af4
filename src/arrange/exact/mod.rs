//! Our own arrangement: exact from the grid on.

mod cells;
mod complex;
mod contacts;
mod grid;
mod plane;
mod points;
mod triangulation;

use cells::{is_inside, windings};
use complex::Complex;

use super::{ArrangeError, Arrangement, Inside, Solid};
use crate::context::Context;
use crate::mesh::Surface;

/// An exact arrangement of faces, and the boundary of the cells that are inside.
///
/// Vertices are taken to a grid of 2^41 steps over the model. From there on all is exact: which faces meet, the points that they
/// have in common, how those stand to one another, and which cell is on which side of a wall. Faces that meet no other keep
/// their vertices bit for bit, and their order.
///
/// After Zhou, Grinspun, Zorin and Jacobson 2016, "Mesh Arrangements for Solid Geometry"; Attene 2020, "Indirect Predicates
/// for Geometric Constructions"; Cherchi, Livesu, Scateni and Attene 2020, "Fast and Robust Mesh Arrangements using
/// Floating-point Arithmetic".
#[derive(Debug, Clone, Copy, Default)]
pub struct Exact;

impl Arrangement for Exact {
    fn solid(&self, surface: &Surface, inside: Inside, context: &Context<'_>) -> Result<Solid, ArrangeError> {
        let complex = Complex::new(surface, context)?;
        let windings = windings(&complex, context)?;
        let solid = extract(&complex, &windings, inside, surface);
        if solid.surface.faces.is_empty() { Err(ArrangeError::Empty) } else { Ok(solid) }
    }
}

/// The walls with the inside on one side only, turned outward, in the order of the faces that they are cut from; and those that
/// nothing is on either side of.
fn extract(complex: &Complex, windings: &[[i32; 2]], inside: Inside, surface: &Surface) -> Solid {
    let (mut kept, mut flaps) = (Vec::new(), Vec::new());
    for (wall, &sides) in complex.walls.iter().zip(windings) {
        let [before, behind] = sides.map(|number| is_inside(inside, number));
        let [a, b, c] = wall.corners;
        if before != behind {
            kept.push((wall.faces[0], if behind { [a, b, c] } else { [a, c, b] }));
        } else if sides == [0, 0] {
            flaps.push((wall.faces[0], [a, b, c]));
        }
    }
    Solid { surface: surface_of(complex, kept, surface), flaps: surface_of(complex, flaps, surface) }
}

/// Walls, each with the face that it is cut from, as a surface.
fn surface_of(complex: &Complex, mut walls: Vec<(u32, [u32; 3])>, surface: &Surface) -> Surface {
    walls.sort_by_key(|&(face, _)| face);
    let position = |point: u32| match complex.vertices.get(point as usize).copied() {
        Some(vertex) => surface.positions[vertex as usize],
        None => complex.grid.to_model(complex.points.place(point)),
    };
    let mut made = Surface {
        positions: (0..complex.points.len() as u32).map(position).collect(),
        faces: walls.iter().map(|&(_, corners)| corners).collect(),
        source: walls.iter().map(|&(face, _)| surface.source[face as usize]).collect(),
    };
    made.drop_unreferenced();
    made
}
