use std::ops::Deref;

use super::{Edges, Surface};

/// A surface of which every edge is used as often in one direction as in the other, so that it winds a whole number of times around
/// every point. Its faces may intersect and overlap, and more than two may meet in an edge.
///
/// The winding number is what an arrangement labels cells by (Jacobson, Kavan and Sorkine-Hornung 2013, "Robust Inside-Outside
/// Segmentation using Generalized Winding Numbers").
#[derive(Debug, Clone, Copy)]
pub struct ClosedSurface<'a>(&'a Surface);

/// An edge is not used as often in one direction as in the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the surface is not closed and consistently wound, so what it encloses is not defined")]
pub struct NotClosed;

impl<'a> ClosedSurface<'a> {
    /// Checks every edge of the surface, whose `edges` they are. Linear.
    ///
    /// # Errors
    /// [`NotClosed`].
    pub fn new(surface: &'a Surface, edges: &Edges) -> Result<Self, NotClosed> {
        let is_forward = |&&half_edge: &&u32| Edges::is_forward(&surface.faces, half_edge);
        let is_closed = edges.iter().all(|of_edge| 2 * of_edge.iter().filter(is_forward).count() == of_edge.len());
        if is_closed { Ok(Self(surface)) } else { Err(NotClosed) }
    }
}

impl<'a> TryFrom<&'a Surface> for ClosedSurface<'a> {
    type Error = NotClosed;

    /// Finds the edges and checks them. O(n log n) in the faces.
    fn try_from(surface: &'a Surface) -> Result<Self, NotClosed> {
        Self::new(surface, &Edges::new(&surface.faces))
    }
}

impl Deref for ClosedSurface<'_> {
    type Target = Surface;

    fn deref(&self) -> &Surface {
        self.0
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;
    use glam::DVec3;

    fn surface(faces: &[[u32; 3]]) -> Surface {
        let positions = (0..6).map(|i| DVec3::splat(f64::from(i))).collect();
        Surface { positions, faces: faces.to_vec(), source: vec![0; faces.len()] }
    }

    #[test]
    fn a_surface_is_closed_where_every_edge_is_used_as_often_in_either_direction() {
        let tetrahedron = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]];
        assert_eq!(ClosedSurface::try_from(&surface(&tetrahedron)).unwrap().faces.len(), 4);
        let twice = [tetrahedron, tetrahedron].concat();
        assert!(ClosedSurface::try_from(&surface(&twice)).is_ok(), "edges of four faces");
        assert!(ClosedSurface::try_from(&Surface::default()).is_ok());
        assert_eq!(ClosedSurface::try_from(&surface(&tetrahedron[..3])).unwrap_err(), NotClosed);
        let turned = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 2, 3]];
        assert_eq!(ClosedSurface::try_from(&surface(&turned)).unwrap_err(), NotClosed);
    }
}
