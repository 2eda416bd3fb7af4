//! Triangles, normals and numbering as a file gives them, before any cleanup.

use glam::DVec3;

use super::distinct::{Bits, Distinct, first_equal_by, number_by_first};
use crate::math::threads;

/// Triangles as a file gives them. The only guarantee is that face indices are in range.
///
/// Positions may be non-finite or repeated; faces may be degenerate, duplicated, flipped or intersecting. Readers
/// produce a soup and writers consume one; operators work on types with stronger guarantees.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Soup {
    /// Vertex positions, in the file's own unit.
    pub positions: Vec<DVec3>,
    /// Triangles as indices into `positions`, counter-clockwise seen from outside if the file is well oriented.
    pub faces: Vec<[u32; 3]>,
}

impl Soup {
    /// Faces given by the positions of their corners. Positions with the same bits become one vertex; vertices are
    /// numbered by first use, for any number of threads.
    pub fn from_corners(faces: usize, corners: impl Fn(usize) -> [DVec3; 3] + Sync) -> Self {
        let mut chunks = threads::map_chunks(faces, |range| {
            let mut distinct = Distinct::<Bits>::with_capacity_for(range.len() * 3 / 4);
            let mut numbers = Vec::with_capacity(3 * range.len());
            distinct.number_all(range.flat_map(&corners), |number| numbers.push(number));
            (distinct.into_positions(), numbers)
        });
        if chunks.len() < 2 {
            let (positions, numbers) = chunks.pop().unwrap_or_default();
            return Self { positions, faces: numbers.as_chunks::<3>().0.to_vec() };
        }
        let begins: Vec<usize> =
            chunks.iter().scan(0, |end, (positions, _)| Some(std::mem::replace(end, *end + positions.len()))).collect();
        let given: Vec<DVec3> = chunks.iter_mut().flat_map(|(positions, _)| std::mem::take(positions)).collect();
        // Each chunk's positions are in the order of their first use, so numbering them chunk by chunk keeps that order.
        let (numbers, firsts) = number_by_first(first_equal_by::<Bits>(&given));
        let positions = threads::map_cheap(firsts.len(), |number| given[firsts[number] as usize]);
        drop((given, firsts));
        let renumbered = threads::map(chunks.len(), 2, |chunk| {
            let (numbers, local) = (&numbers[begins[chunk]..], chunks[chunk].1.as_chunks::<3>().0);
            local.iter().map(|face| face.map(|number| numbers[number as usize])).collect::<Vec<_>>()
        });
        Self { positions, faces: renumbered.concat() }
    }

    /// The corner positions of face `face`.
    ///
    /// # Panics
    /// If `face` is not an index of `faces`.
    #[must_use]
    pub fn corners(&self, face: usize) -> [DVec3; 3] {
        self.faces[face].map(|v| self.positions[v as usize])
    }
}

/// Normals as a file gives them. They need not have unit length; a normal that is zero or not finite counts as absent.
#[derive(Debug, Clone, PartialEq)]
pub enum CornerNormals {
    /// One normal for each vertex of the soup.
    OfVertices(Vec<[f32; 3]>),
    /// A list of normals, and for each face of the soup the indices of its corners' normals.
    OfCorners {
        /// The normals.
        normals: Vec<[f32; 3]>,
        /// Indices into `normals`; an index out of range means no normal.
        faces: Vec<[u32; 3]>,
    },
    /// One normal for each face. Only normals opposed to the orientation of their face's corners are stored: they are
    /// rare, and all others carry no further information.
    OfFaces {
        /// Faces of the soup with their opposed normals, in ascending order.
        opposed: Vec<(u32, [f32; 3])>,
    },
}

impl CornerNormals {
    /// The normal at corner `k` (0 to 2) of a face of the soup with these vertices, if the file gives a usable one.
    ///
    /// # Panics
    /// If `k` is more than 2.
    #[must_use]
    pub fn at(&self, face: usize, vertices: [u32; 3], k: usize) -> Option<[f32; 3]> {
        let found = match self {
            Self::OfVertices(normals) => normals.get(vertices[k] as usize),
            Self::OfCorners { normals, faces } => faces.get(face).and_then(|corners| normals.get(corners[k] as usize)),
            Self::OfFaces { opposed } => {
                let at = opposed.binary_search_by(|(f, _)| (*f as usize).cmp(&face)).ok();
                at.map(|at| &opposed[at].1)
            }
        };
        found.copied().filter(|n| n.iter().all(|x| x.is_finite()) && *n != [0.0; 3])
    }
}

/// The explicit vertex and face numbers of a file, and the faults in them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Numbering {
    /// Whether vertices are numbered 1, 2, 3, ... in the order of the file.
    pub vertices_contiguous: bool,
    /// Whether faces are numbered 1, 2, 3, ... in the order of the file.
    pub faces_contiguous: bool,
    /// Vertex numbers that faces reference but the file does not define, each counted once.
    pub missing_vertices: u64,
    /// Faces that reference an undefined vertex; the soup does not contain them.
    pub faces_without_vertex: u64,
    /// The first of those faces, in the order of the file.
    pub omitted: Vec<OmittedFace>,
    /// The first of the undefined vertex numbers, in ascending order.
    pub missing: Vec<u32>,
    /// The number of each vertex of the soup; empty if the numbers are 1, 2, 3, ...
    pub vertex_numbers: Vec<u32>,
    /// The number of each face of the soup; empty if the numbers are 1, 2, 3, ...
    pub face_numbers: Vec<u32>,
}

/// A face that references a vertex which the file does not define.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OmittedFace {
    /// The face's number in the file.
    pub number: u32,
    /// The centre of the face's defined corners; for a face without any, the location of the previous such face.
    pub at: [f64; 3],
}

impl Numbering {
    /// The number in the file of a face of the soup.
    #[must_use]
    pub fn face(&self, index: u32) -> u32 {
        self.face_numbers.get(index as usize).copied().unwrap_or(index.saturating_add(1))
    }

    /// The number in the file of a vertex of the soup.
    #[must_use]
    pub fn vertex(&self, index: u32) -> u32 {
        self.vertex_numbers.get(index as usize).copied().unwrap_or(index.saturating_add(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vertices_of_many_faces_are_numbered_by_first_use() {
        // More faces than one thread numbers together. Every sixth number is used again and again, in both signs of zero.
        let corner = |i: usize| {
            let number = if i.is_multiple_of(6) { i % 600 } else { i / 16 };
            #[expect(clippy::cast_precision_loss, reason = "a small number")]
            DVec3::new(number as f64, if i.is_multiple_of(2) { 0.0 } else { -0.0 }, 1.0)
        };
        let faces = 100_000;
        let soup = Soup::from_corners(faces, |face| [0, 1, 2].map(|k| corner(3 * face + k)));
        let mut first_use: Vec<DVec3> = Vec::new();
        let mut numbers = std::collections::HashMap::new();
        for (face, vertices) in soup.faces.iter().enumerate() {
            for (k, &vertex) in vertices.iter().enumerate() {
                let position = corner(3 * face + k);
                let next = u32::try_from(numbers.len()).expect("few vertices");
                let expected = *numbers.entry(position.to_array().map(f64::to_bits)).or_insert_with(|| {
                    first_use.push(position);
                    next
                });
                assert_eq!(vertex, expected, "corner {k} of face {face}");
            }
        }
        assert_eq!(soup.positions, first_use);
        assert!(soup.positions.len() < faces);
    }

    #[test]
    fn a_soup_of_no_faces_is_empty() {
        assert_eq!(Soup::from_corners(0, |_| [DVec3::ZERO; 3]), Soup::default());
    }
}
