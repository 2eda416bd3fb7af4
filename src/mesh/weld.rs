//! Merges vertices at exactly equal positions: when a surface is built from a file's triangles, and on later demand.
//! Welding takes linear time for ordinary meshes, and O(n log n) for positions crafted to collide in the hash table.

use glam::DVec3;

use super::distinct::{BATCH, Distinct, EMPTY, Number, first_equal};
use super::soup::Soup;
use super::surface::{Ingest, Surface};

/// A vertex that no face has used yet.
const UNUSED: u32 = u32::MAX;
/// A vertex used only by omitted faces.
const OMITTED: u32 = u32::MAX - 1;
/// Positions from which equal ones are found in parallel, before the vertices are numbered.
const MANY: usize = 1 << 17;

/// Numbers vertices by first use; vertices at equal positions get the same number.
struct Welder<'a> {
    given: &'a [DVec3],
    /// For each given vertex its new number, [`UNUSED`] or [`OMITTED`].
    number: Vec<u32>,
    equal: Equal,
    /// Used vertices at the position of another vertex.
    merged: u64,
}

/// How a vertex finds the vertices at its position.
enum Equal {
    /// Each is looked up.
    LookUp(Distinct<Number>),
    /// For each given vertex, the first one at its position, the new number of that one, and the positions of the new
    /// vertices.
    Known { first: Vec<u32>, number: Vec<u32>, positions: Vec<DVec3> },
}

impl<'a> Welder<'a> {
    fn new(given: &'a [DVec3]) -> Self {
        let number = vec![UNUSED; given.len()];
        let equal = if given.len() < MANY {
            Equal::LookUp(Distinct::with_capacity_for(given.len() / 4))
        } else {
            Equal::Known { first: first_equal(given), number: number.clone(), positions: Vec::new() }
        };
        Self { given, number, equal, merged: 0 }
    }

    /// Replaces the vertices of faces by their new numbers. The vertices must exist and be finite.
    fn number(&mut self, faces: &mut [[u32; 3]]) {
        let mut guesses = [EMPTY; 3 * BATCH];
        for batch in faces.chunks_mut(BATCH) {
            let vertices = batch.as_flattened_mut();
            if let Equal::LookUp(distinct) = &self.equal {
                distinct.guess(vertices.iter().map(|&v| self.given[v as usize]), &mut guesses);
            }
            for (v, &guess) in vertices.iter_mut().zip(&guesses) {
                *v = self.number_of(*v, guess);
            }
        }
    }

    fn number_of(&mut self, v: u32, guess: u32) -> u32 {
        let known = self.number[v as usize];
        if known < OMITTED {
            return known;
        }
        let (number, is_new) = self.equal.number(v, self.given[v as usize], guess);
        self.merged += u64::from(!is_new);
        self.number[v as usize] = number;
        number
    }

    /// The positions of the new vertices.
    fn into_positions(self) -> Vec<DVec3> {
        match self.equal {
            Equal::LookUp(distinct) => distinct.into_positions(),
            Equal::Known { mut positions, .. } => {
                positions.shrink_to_fit();
                positions
            }
        }
    }

    /// Records that an omitted face uses a vertex, if the vertex exists.
    fn omit(&mut self, v: u32) {
        if let Some(number) = self.number.get_mut(v as usize)
            && *number == UNUSED
        {
            *number = OMITTED;
        }
    }

    /// The number of given vertices that no face uses.
    fn unused(&self) -> u64 {
        self.number.iter().filter(|&&n| n == UNUSED).count() as u64
    }
}

impl Equal {
    /// The new number of a vertex, and whether it is the first at its position that is used.
    fn number(&mut self, v: u32, position: DVec3, guess: u32) -> (u32, bool) {
        match self {
            Self::LookUp(distinct) => distinct.number(position, guess),
            Self::Known { first, number, positions } => {
                let number = &mut number[first[v as usize] as usize];
                let is_new = *number == UNUSED;
                if is_new {
                    #[expect(clippy::cast_possible_truncation, reason = "no more than there were indices")]
                    let next = positions.len() as u32;
                    *number = next;
                    positions.push(position);
                }
                (*number, is_new)
            }
        }
    }
}

impl Surface {
    /// Drops non-finite faces and merges vertices at exactly equal positions; `-0.0` equals `0.0`.
    #[must_use]
    pub fn from_soup(soup: &Soup) -> (Self, Ingest) {
        let mut ingest = Ingest::default();
        let mut welder = Welder::new(&soup.positions);
        let mut faces = Vec::with_capacity(soup.faces.len());
        let mut source = Vec::with_capacity(soup.faces.len());
        for (batch, first) in soup.faces.chunks(BATCH).zip((0u32..).step_by(BATCH)) {
            let begin = faces.len();
            for (&face, index) in batch.iter().zip(first..) {
                if face.iter().all(|&v| soup.positions.get(v as usize).is_some_and(|p| p.is_finite())) {
                    faces.push(face);
                    source.push(index);
                } else {
                    face.iter().for_each(|&v| welder.omit(v));
                    ingest.non_finite_faces += 1;
                }
            }
            welder.number(&mut faces[begin..]);
        }
        ingest.unreferenced_vertices = welder.unused();
        ingest.merged_vertices = welder.merged;
        (Self { positions: welder.into_positions(), faces, source }, ingest)
    }

    /// Like [`Surface::from_soup`] for an assembly: merges only vertices of faces with the same material. `materials`
    /// gives the material of each face of the soup.
    #[must_use]
    pub fn from_assembly(soup: &Soup, materials: &[u32]) -> (Self, Ingest) {
        let material_of = |face: &u32| materials.get(*face as usize).copied().unwrap_or(0);
        let mut order: Vec<u32> = (0u32..).take(soup.faces.len()).collect();
        order.sort_by_key(material_of);
        let (mut whole, mut ingest) = (Self::default(), Ingest::default());
        // The index of each vertex among those of its material.
        let mut slots = vec![u32::MAX; soup.positions.len()];
        let mut used = vec![false; soup.positions.len()];
        let mut faces: Vec<(u32, [u32; 3])> = Vec::with_capacity(soup.faces.len());
        for group in order.chunk_by(|a, b| material_of(a) == material_of(b)) {
            let mut part = Soup::default();
            let mut vertices = Vec::new();
            for &face in group {
                part.faces.push(soup.faces[face as usize].map(|v| {
                    let Some(slot) = slots.get_mut(v as usize) else { return u32::MAX };
                    if *slot == u32::MAX {
                        used[v as usize] = true;
                        *slot = u32::try_from(vertices.len()).unwrap_or(u32::MAX);
                        vertices.push(v);
                        part.positions.push(soup.positions[v as usize]);
                    }
                    *slot
                }));
            }
            vertices.into_iter().for_each(|v| slots[v as usize] = u32::MAX);
            let (part, found) = Self::from_soup(&part);
            ingest.non_finite_faces += found.non_finite_faces;
            ingest.merged_vertices += found.merged_vertices;
            #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
            let first = whole.positions.len() as u32;
            whole.positions.extend(part.positions);
            let sources = part.source.iter().map(|&source| group[source as usize]);
            faces.extend(sources.zip(part.faces).map(|(source, face)| (source, face.map(|v| v + first))));
        }
        ingest.unreferenced_vertices = used.iter().filter(|used| !**used).count() as u64;
        faces.sort_unstable_by_key(|&(source, _)| source);
        (whole.source, whole.faces) = faces.into_iter().unzip();
        (whole, ingest)
    }
}

/// Merges vertices at exactly equal positions, keeping the one used first, and removes vertices that no face uses.
/// Returns the number of used vertices that were merged into another.
pub fn weld_exactly(surface: &mut Surface) -> u64 {
    let mut welder = Welder::new(&surface.positions);
    welder.number(&mut surface.faces);
    let merged = welder.merged;
    surface.positions = welder.into_positions();
    merged
}

#[cfg(test)]
mod tests {
    use super::*;

    fn soup() -> Soup {
        Soup {
            positions: vec![
                DVec3::X,
                DVec3::new(9.0, 9.0, 9.0),
                DVec3::Y,
                DVec3::new(-0.0, 0.0, 0.0),
                DVec3::new(0.0, -0.0, 0.0),
                DVec3::X,
                DVec3::NAN,
            ],
            faces: vec![[3, 0, 2], [5, 4, 2], [0, 2, 6]],
        }
    }

    #[test]
    fn equal_positions_become_one_vertex_and_minus_zero_equals_zero() {
        let (surface, ingest) = Surface::from_soup(&soup());
        assert_eq!(surface.positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
        assert_eq!(surface.faces, [[0, 1, 2], [1, 0, 2]]);
        assert_eq!(ingest.merged_vertices, 2);
        surface.check().unwrap();
    }

    #[test]
    fn many_vertices_are_merged_like_few() {
        let shifted = |by: f64| soup().positions.into_iter().map(move |p| p + by);
        let copies = MANY / 7 + 1;
        let positions: Vec<DVec3> = (0..copies).flat_map(|copy| shifted((copy % 50) as f64)).collect();
        let faces =
            (0u32..).take(copies).flat_map(|copy| soup().faces.into_iter().map(move |f| f.map(|v| v + 7 * copy)));
        let many = Soup { positions, faces: faces.collect() };
        let (surface, ingest) = Surface::from_soup(&many);
        let mut few = Welder { equal: Equal::LookUp(Distinct::with_capacity_for(9)), ..Welder::new(&many.positions) };
        let mut faces: Vec<[u32; 3]> = many.faces.chunks(3).flat_map(|of_copy| [of_copy[0], of_copy[1]]).collect();
        few.number(&mut faces);
        assert!(surface.faces == faces && ingest.merged_vertices == few.merged);
        assert_eq!((ingest.unreferenced_vertices, ingest.non_finite_faces), (copies as u64, copies as u64));
        assert!(surface.positions == few.into_positions());
    }

    #[test]
    fn non_finite_faces_are_dropped_and_counted() {
        let (surface, ingest) = Surface::from_soup(&soup());
        assert_eq!(surface.source, [0, 1]);
        assert_eq!(ingest.non_finite_faces, 1);
        assert_eq!(ingest.unreferenced_vertices, 1);
    }

    #[test]
    fn an_index_out_of_range_does_not_panic() {
        let soup = Soup { positions: vec![DVec3::ZERO], faces: vec![[0, 7, 0]] };
        let (_, ingest) = Surface::from_soup(&soup);
        assert_eq!((ingest.non_finite_faces, ingest.unreferenced_vertices), (1, 0));
    }

    #[test]
    fn a_vertex_of_a_dropped_face_is_still_welded_when_a_later_face_uses_it() {
        let mut soup = soup();
        soup.faces.rotate_right(1);
        let (surface, ingest) = Surface::from_soup(&soup);
        assert_eq!(surface.positions, [DVec3::ZERO, DVec3::X, DVec3::Y]);
        assert_eq!((ingest.merged_vertices, ingest.unreferenced_vertices), (2, 1));
        assert_eq!(surface.source, [1, 2]);
    }
}
