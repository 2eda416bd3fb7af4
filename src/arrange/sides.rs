//! The facets of any surface, whatever its winding, with the sides that bound the same space around each edge.

use glam::DVec3;

use super::cells::order_around;
use super::complex::{ArrangeError, Complex};
use crate::context::Context;
use crate::mesh::{Edges, Surface};

/// The facets of a surface: pieces of faces that share only whole edges and corners. Side `2 f` of facet `f` is in
/// front of it, where its normal points; side `2 f + 1` is behind it.
pub(crate) struct FacetSides {
    /// The positions of all points; exact for points at vertices of the surface.
    pub positions: Vec<DVec3>,
    /// The corners of each facet, counter-clockwise seen against its normal.
    pub corners: Vec<[u32; 3]>,
    /// For each facet, the first face of the surface that covers it.
    pub face: Vec<u32>,
    /// For each edge, the sides that face each other across the space around the edge. A boundary edge joins both sides
    /// of its facet.
    pub links: Vec<SideLink>,
}

/// Two sides that bound the same space at an edge.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SideLink {
    /// The two sides.
    pub sides: [u32; 2],
    /// The length of the edge.
    pub length: f64,
}

impl FacetSides {
    /// Splits the faces of a surface where they meet, and orders the facets around each edge exactly.
    ///
    /// # Errors
    /// [`ArrangeError`] if too many faces meet or the work was cancelled.
    pub fn new(surface: &Surface, context: &Context<'_>) -> Result<Self, ArrangeError> {
        let complex = Complex::new(surface, None, context)?;
        let position = |point: u32| match complex.vertices.get(point as usize) {
            Some(&vertex) => surface.positions[vertex as usize],
            None => complex.grid.to_model(complex.points.place(point)),
        };
        let positions: Vec<DVec3> = (0..index(complex.points.len())).map(position).collect();
        let corners: Vec<[u32; 3]> = complex.facets.iter().map(|facet| facet.corners).collect();
        let edges = Edges::new(&corners);
        let mut links = Vec::with_capacity(2 * edges.len());
        for edge in 0..edges.len() {
            if edge % 4096 == 0 {
                context.check()?;
            }
            let [a, b] = edges.vertices(edge).map(|v| positions[v as usize]);
            let length = a.distance(b);
            let around = order_around(&complex, edges.half_edges(edge), &corners);
            for (k, &(facet, forward)) in around.iter().enumerate() {
                let (next, next_forward) = around[(k + 1) % around.len()];
                // The space counter-clockwise of a forward facet is in front of it.
                let sides = [2 * facet + u32::from(!forward), 2 * next + u32::from(next_forward)];
                links.push(SideLink { sides, length });
            }
        }
        let face = complex.facets.iter().map(|facet| facet.faces[0]).collect();
        Ok(Self { positions, corners, face, links })
    }

    /// The corner positions of a facet.
    pub fn triangle(&self, facet: u32) -> [DVec3; 3] {
        self.corners[facet as usize].map(|c| self.positions[c as usize])
    }

    /// Twice the area of a facet times its unit normal.
    pub fn area_vector(&self, facet: u32) -> DVec3 {
        let [a, b, c] = self.triangle(facet);
        (b - a).cross(c - a)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "points and facets are counted in u32")]
fn index(count: usize) -> u32 {
    count as u32
}
