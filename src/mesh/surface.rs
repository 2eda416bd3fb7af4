//! The indexed surface that every operator works on, and the checked closed surface.

use std::ops::Deref;

use glam::DVec3;

use super::adjacency::Edges;
use super::distinct::position_key;
use super::soup::Soup;
use crate::math::Box3;

/// The source of a face without an input face, such as a face of a patch.
pub const NO_SOURCE: u32 = u32::MAX;

/// The source of faces that give thickness to an open sheet: the second skin and the rim.
pub const SKIN_SOURCE: u32 = u32::MAX - 1;

/// Like [`SKIN_SOURCE`], around a region that was left open because its inside is visible through a hole.
pub const OPENED_SKIN_SOURCE: u32 = u32::MAX - 2;

/// The source of the walls and the bottom of an added base.
pub const BASE_SOURCE: u32 = u32::MAX - 3;

/// The source of surface that the options ask for: thickened walls, bores and struts.
pub const REQUESTED_SOURCE: u32 = u32::MAX - 4;

/// Whether a source marks a face without an input face.
#[must_use]
pub const fn is_generated(source: u32) -> bool {
    source >= REQUESTED_SOURCE
}

/// An indexed triangle surface. On construction positions are finite and pairwise different, and every index is in
/// range.
///
/// Vertices are in the order of their first use by a face, faces in the order of the input. Faces may be degenerate
/// (even with a repeated vertex), duplicated, intersecting or flipped; edges may have any number of faces.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Surface {
    /// Vertex positions.
    pub positions: Vec<DVec3>,
    /// Faces as indices into `positions`.
    pub faces: Vec<[u32; 3]>,
    /// For each face, the index of the input face that it comes from, or a constant for its purpose if it has none
    /// ([`is_generated`]).
    pub source: Vec<u32>,
}

/// Counts of what was omitted or merged when a [`Surface`] was built from a [`Soup`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Ingest {
    /// Omitted faces: a corner is not finite, or its index has no vertex.
    pub non_finite_faces: u64,
    /// Vertices that no face references, omitted faces included.
    pub unreferenced_vertices: u64,
    /// Used vertices that were merged into another one at the same position.
    pub merged_vertices: u64,
}

impl Surface {
    /// The positions and triangles alone, without sources.
    #[must_use]
    pub fn to_soup(&self) -> Soup {
        Soup { positions: self.positions.clone(), faces: self.faces.clone() }
    }

    /// The bounding box of all positions.
    #[must_use]
    pub fn bounds(&self) -> Box3 {
        Box3::of(self.positions.iter().copied())
    }

    /// The corner positions of face `face`.
    ///
    /// # Panics
    /// If `face` is not an index of `faces`.
    #[must_use]
    pub fn corners(&self, face: usize) -> [DVec3; 3] {
        let [a, b, c] = self.faces[face];
        [self.positions[a as usize], self.positions[b as usize], self.positions[c as usize]]
    }

    /// A key that is equal exactly for faces with equal corner positions in the same winding.
    ///
    /// # Panics
    /// If `face` is not an index of `faces`.
    #[must_use]
    pub fn face_key(&self, face: usize) -> [[u64; 3]; 3] {
        let mut keys = self.corners(face).map(position_key);
        let first = (0..3).min_by_key(|&i| keys[i]).unwrap_or(0);
        keys.rotate_left(first);
        keys
    }

    /// Twice the area of a face times its unit normal.
    ///
    /// # Panics
    /// If `face` is not an index of `faces`.
    #[must_use]
    pub fn area_vector(&self, face: usize) -> DVec3 {
        let [a, b, c] = self.corners(face);
        (b - a).cross(c - a)
    }

    /// The Euler characteristic: vertices in use, less edges, plus faces. `edges` are those of the faces.
    #[must_use]
    pub fn euler_characteristic(&self, edges: &Edges) -> i64 {
        let mut used = vec![false; self.positions.len()];
        self.faces.iter().flatten().for_each(|&v| used[v as usize] = true);
        let vertices = used.iter().filter(|used| **used).count();
        #[expect(clippy::cast_possible_wrap, reason = "elements are counted in u32")]
        let [vertices, edges, faces] = [vertices, edges.len(), self.faces.len()].map(|count| count as i64);
        vertices - edges + faces
    }

    /// Adds a face with [`NO_SOURCE`].
    pub fn push_patch(&mut self, face: [u32; 3]) {
        self.push_generated(face, NO_SOURCE);
    }

    /// Adds a face without an input face, with the source constant of its purpose.
    pub fn push_generated(&mut self, face: [u32; 3], source: u32) {
        self.faces.push(face);
        self.source.push(source);
    }

    /// Adds a prism between two polygons with as many corners, counter-clockwise as seen from the second one. Its faces are
    /// oriented outward, or inward, with [`NO_SOURCE`].
    pub fn push_prism(&mut self, [low, high]: [&[DVec3]; 2], is_inward: bool) {
        #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
        let (first, sides) = (self.positions.len() as u32, low.len() as u32);
        self.positions.extend(low.iter().chain(high));
        let (low, high) = (|i: u32| first + i % sides, |i: u32| first + sides + i % sides);
        let mut push = |[a, b, c]: [u32; 3]| self.push_patch(if is_inward { [a, c, b] } else { [a, b, c] });
        for i in 0..sides {
            push([low(i), low(i + 1), high(i + 1)]);
            push([low(i), high(i + 1), high(i)]);
        }
        for i in 1..sides.saturating_sub(1) {
            push([low(0), low(i + 1), low(i)]);
            push([high(0), high(i), high(i + 1)]);
        }
    }

    /// Adds the vertices and faces of another surface after the own ones.
    pub fn append(&mut self, other: Self) {
        #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions);
        self.faces.extend(other.faces.iter().map(|face| face.map(|v| v + first)));
        self.source.extend(other.source);
    }

    /// Keeps the faces for which `keep` (one entry for each face) is true. Returns the number of removed faces.
    pub fn retain_faces(&mut self, keep: &[bool]) -> u64 {
        let before = self.faces.len();
        let mut flags = keep.iter();
        self.faces.retain(|_| flags.next().is_some_and(|&k| k));
        let mut flags = keep.iter();
        self.source.retain(|_| flags.next().is_some_and(|&k| k));
        (before - self.faces.len()) as u64
    }

    /// Removes vertices that no face uses and renumbers the others by first use. Returns the number of removed
    /// vertices.
    pub fn drop_unreferenced(&mut self) -> u64 {
        let before = self.positions.len();
        let mut new_index = vec![u32::MAX; before];
        let mut positions = Vec::with_capacity(before);
        for v in self.faces.iter_mut().flatten() {
            let slot = &mut new_index[*v as usize];
            if *slot == u32::MAX {
                #[expect(clippy::cast_possible_truncation, reason = "no more than there were indices")]
                {
                    *slot = positions.len() as u32;
                }
                positions.push(self.positions[*v as usize]);
            }
            *v = *slot;
        }
        positions.shrink_to_fit();
        self.positions = positions;
        (before - self.positions.len()) as u64
    }

    /// Returns memory that is reserved for more elements.
    pub fn shrink_to_fit(&mut self) {
        self.positions.shrink_to_fit();
        self.faces.shrink_to_fit();
        self.source.shrink_to_fit();
    }

    /// Checks the type's invariants; for tests.
    ///
    /// # Errors
    /// A description of the first broken invariant.
    pub fn check(&self) -> Result<(), String> {
        if self.source.len() != self.faces.len() {
            return Err(format!("{} sources for {} faces", self.source.len(), self.faces.len()));
        }
        if let Some(p) = self.positions.iter().find(|p| !p.is_finite()) {
            return Err(format!("position {p} is not finite"));
        }
        if let Some(f) = self.faces.iter().find(|f| f.iter().any(|&v| v as usize >= self.positions.len())) {
            return Err(format!("face {f:?} references a missing vertex"));
        }
        let mut keys: Vec<_> = self.positions.iter().map(|&p| position_key(p)).collect();
        keys.sort_unstable();
        if keys.windows(2).any(|w| w[0] == w[1]) {
            return Err("two vertices have the same position".to_owned());
        }
        Ok(())
    }
}

/// A surface in which every edge is used equally often in both directions, so its winding number around every point is
/// an integer. Faces may intersect and overlap, and more than two may share an edge.
///
/// An arrangement labels its cells by this winding number (Jacobson, Kavan and Sorkine-Hornung 2013, "Robust
/// Inside-Outside Segmentation using Generalized Winding Numbers").
#[derive(Debug, Clone, Copy)]
pub struct ClosedSurface<'a>(&'a Surface);

/// The surface is not closed: some edge is not used equally often in both directions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the surface is not closed and consistently wound, so its interior is undefined")]
pub struct NotClosed;

impl<'a> ClosedSurface<'a> {
    /// Checks every edge of the surface; `edges` must be the edges of its faces. Linear time.
    ///
    /// # Errors
    /// [`NotClosed`] if some edge is not used equally often in both directions.
    pub fn new(surface: &'a Surface, edges: &Edges) -> Result<Self, NotClosed> {
        let is_forward = |&&half_edge: &&u32| Edges::is_forward(&surface.faces, half_edge);
        let is_closed = edges.iter().all(|of_edge| 2 * of_edge.iter().filter(is_forward).count() == of_edge.len());
        if is_closed { Ok(Self(surface)) } else { Err(NotClosed) }
    }

    /// The surface, for as long as it is borrowed.
    #[must_use]
    pub fn get(self) -> &'a Surface {
        self.0
    }
}

impl<'a> TryFrom<&'a Surface> for ClosedSurface<'a> {
    type Error = NotClosed;

    /// Builds the edges and checks them, in O(n log n) for n faces.
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
mod tests {
    use super::*;

    #[test]
    fn dropping_unreferenced_vertices_keeps_the_order_of_first_use() {
        let mut surface = Surface {
            positions: vec![DVec3::X, DVec3::Y, DVec3::Z, DVec3::ONE],
            faces: vec![[3, 0, 2]],
            source: vec![0],
        };
        assert_eq!(surface.drop_unreferenced(), 1);
        assert_eq!(surface.positions, [DVec3::ONE, DVec3::X, DVec3::Z]);
        assert_eq!(surface.faces, [[0, 1, 2]]);
    }

    fn surface(faces: &[[u32; 3]]) -> Surface {
        let positions = (0..6).map(|i| DVec3::splat(f64::from(i))).collect();
        Surface { positions, faces: faces.to_vec(), source: vec![0; faces.len()] }
    }

    #[test]
    fn a_surface_is_closed_if_each_edge_is_used_equally_often_both_ways() {
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
