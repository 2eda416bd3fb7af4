//! Merges vertices at exactly equal positions: when a surface is built from a file's triangles, and on later demand.
//! Welding takes linear time for ordinary meshes, and O(n log n) for positions crafted to collide in the hash table.

use std::collections::BTreeMap;

use glam::DVec3;

use super::soup::Soup;
use super::surface::{Ingest, Surface, position_key};

/// A vertex that no face has used yet.
const UNUSED: u32 = u32::MAX;
/// A vertex used only by omitted faces.
const OMITTED: u32 = u32::MAX - 1;
/// An empty slot of the hash table.
const EMPTY: u32 = u32::MAX;
/// Average number of slots that one lookup may probe. At a load of 3/4, linear probing visits 7.5 slots for an absent
/// position and far fewer for a present one (Knuth, The Art of Computer Programming 3, 6.4).
const PROBES_PER_LOOKUP: u64 = 24;
/// Additional probes, so that a few clusters in a small mesh do not matter.
const BASE_PROBES: u64 = 1 << 16;

/// Faces whose vertices are looked up as a batch. Starting the lookups together overlaps their memory latency.
const BATCH: usize = 64;

/// Numbers vertices by first use; vertices at equal positions get the same number.
struct Welder<'a> {
    given: &'a [DVec3],
    /// For each given vertex its new number, [`UNUSED`] or [`OMITTED`].
    number: Vec<u32>,
    index: Index,
    /// The positions of the new vertices.
    positions: Vec<DVec3>,
    /// Used vertices at the position of another vertex.
    merged: u64,
}

impl<'a> Welder<'a> {
    fn new(given: &'a [DVec3]) -> Self {
        let index = Index::Hash(Table::with_capacity_for(given.len() / 4));
        Self { given, number: vec![UNUSED; given.len()], index, positions: Vec::new(), merged: 0 }
    }

    /// Replaces the vertices of faces by their new numbers. The vertices must exist and be finite.
    fn number(&mut self, faces: &mut [[u32; 3]]) {
        let mut guesses = [EMPTY; 3 * BATCH];
        for batch in faces.chunks_mut(BATCH) {
            let vertices = batch.as_flattened_mut();
            self.guess(vertices, &mut guesses);
            for (v, &guess) in vertices.iter_mut().zip(&guesses) {
                *v = self.number_of(*v, guess);
            }
        }
    }

    /// Reads the first hash table slot of each vertex. A guess other than [`EMPTY`] is correct.
    fn guess(&self, vertices: &[u32], guesses: &mut [u32]) {
        let Index::Hash(table) = &self.index else { return guesses.fill(EMPTY) };
        for (&v, guess) in vertices.iter().zip(&mut *guesses) {
            *guess = table.slots[table.first_slot(self.given[v as usize])];
        }
        for (&v, guess) in vertices.iter().zip(guesses) {
            if self.positions.get(*guess as usize) != Some(&self.given[v as usize]) {
                *guess = EMPTY;
            }
        }
    }

    fn number_of(&mut self, v: u32, guess: u32) -> u32 {
        let known = self.number[v as usize];
        if known < OMITTED {
            return known;
        }
        let position = self.given[v as usize];
        let (number, is_new) =
            if guess == EMPTY { self.index.find_or_add(position, &self.positions) } else { (guess, false) };
        if is_new {
            self.positions.push(position);
        } else {
            self.merged += 1;
        }
        self.number[v as usize] = number;
        number
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

/// Maps known positions to numbers. The hash function is fixed, so a crafted file can make all positions collide. If
/// lookups take more probes than chance explains, a tree replaces the table: O(log n) in every case.
enum Index {
    Hash(Table),
    Tree(BTreeMap<[u64; 3], u32>),
}

impl Index {
    /// The number of a position, and whether it is new; new positions get the next number. `known` has the position of
    /// each number.
    fn find_or_add(&mut self, position: DVec3, known: &[DVec3]) -> (u32, bool) {
        #[expect(clippy::cast_possible_truncation, reason = "no more than there were indices")]
        let next = known.len() as u32;
        if let Self::Hash(table) = self {
            if let Some(found) = table.find_or_add(position, known, next) {
                return (found, found == next);
            }
            *self = Self::Tree(known.iter().map(|&p| position_key(p)).zip(0..).collect());
        }
        let Self::Tree(tree) = self else { unreachable!("the table was replaced") };
        let found = *tree.entry(position_key(position)).or_insert(next);
        (found, found == next)
    }
}

/// A hash table of position numbers with open addressing and linear probing; the positions themselves are the keys.
struct Table {
    slots: Vec<u32>,
    /// Right shift of a hash that leaves as many high bits as a slot index has.
    shift: u32,
    used: usize,
    /// Remaining probes, see [`PROBES_PER_LOOKUP`].
    probes_left: u64,
}

impl Table {
    fn with_capacity_for(positions: usize) -> Self {
        let bits = positions.next_power_of_two().trailing_zeros().max(4);
        Self { slots: vec![EMPTY; 1 << bits], shift: 64 - bits, used: 0, probes_left: BASE_PROBES }
    }

    /// None if the probes run out; the table is then unchanged.
    fn find_or_add(&mut self, position: DVec3, known: &[DVec3], next: u32) -> Option<u32> {
        if self.used * 4 >= self.slots.len() * 3 {
            self.grow(known)?;
        }
        self.probes_left += PROBES_PER_LOOKUP;
        let mut at = self.first_slot(position);
        loop {
            let found = self.slots[at];
            if found == EMPTY {
                self.slots[at] = next;
                self.used += 1;
                return Some(next);
            }
            if known[found as usize] == position {
                return Some(found);
            }
            at = self.next_slot(at)?;
        }
    }

    fn grow(&mut self, known: &[DVec3]) -> Option<()> {
        self.shift -= 1;
        let slots = self.slots.len() * 2;
        // Frees the old table before allocating the new one, so that they are never in memory together.
        self.slots = Vec::new();
        self.slots = vec![EMPTY; slots];
        self.probes_left += PROBES_PER_LOOKUP * known.len() as u64;
        for (&position, number) in known.iter().zip(0u32..) {
            let mut at = self.first_slot(position);
            while self.slots[at] != EMPTY {
                at = self.next_slot(at)?;
            }
            self.slots[at] = number;
        }
        Some(())
    }

    fn first_slot(&self, position: DVec3) -> usize {
        #[expect(clippy::cast_possible_truncation, reason = "as many bits as the table has")]
        {
            (hash(position) >> self.shift) as usize
        }
    }

    fn next_slot(&mut self, at: usize) -> Option<usize> {
        self.probes_left = self.probes_left.checked_sub(1)?;
        Some((at + 1) & (self.slots.len() - 1))
    }
}

/// Folded multiplication of each coordinate (as in wyhash, Wang Yi 2019); the constants are digits of pi.
fn hash(position: DVec3) -> u64 {
    let [x, y, z] = position_key(position);
    let fold = |a: u64, b: u64| {
        let product = u128::from(a) * u128::from(b);
        #[expect(clippy::cast_possible_truncation, reason = "two halves of a product")]
        {
            (product as u64) ^ ((product >> 64) as u64)
        }
    };
    let h = fold(x ^ 0x243f_6a88_85a3_08d3, 0x1319_8a2e_0370_7345);
    let h = fold(h ^ y, 0xa409_3822_299f_31d1);
    fold(h ^ z, 0x082e_fa98_ec4e_6c89)
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
        let mut positions = welder.positions;
        positions.shrink_to_fit();
        (Self { positions, faces, source }, ingest)
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
    let (positions, merged) = (welder.positions, welder.merged);
    surface.positions = positions;
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

    /// Positions on a small grid, so that many are equal.
    fn crowded(count: u32) -> Vec<DVec3> {
        let number = |i: u32| f64::from(i.wrapping_mul(2_654_435_761) >> 22);
        (0..count).map(|i| DVec3::new(number(i) % 9.0, number(i + 7) % 9.0, number(i + 13) % 9.0)).collect()
    }

    /// The numbers of positions used one after another, and whether the tree replaced the table.
    fn numbers(given: &[DVec3], table: Option<Table>) -> (Vec<u32>, bool) {
        let mut welder = Welder::new(given);
        if let Some(table) = table {
            welder.index = Index::Hash(table);
        }
        let uses: Vec<u32> = (0u32..).zip(given).map(|(v, _)| v).collect();
        let mut faces = uses.as_chunks::<3>().0.to_vec();
        welder.number(&mut faces);
        (faces.into_flattened(), matches!(welder.index, Index::Tree(_)))
    }

    #[test]
    fn numbers_agree_with_comparing_each_position_with_all_before() {
        let given = crowded(2001);
        let mut known: Vec<DVec3> = Vec::new();
        let slow: Vec<u32> = given
            .iter()
            .map(|p| {
                let found = known.iter().position(|k| k == p).unwrap_or(known.len());
                if found == known.len() {
                    known.push(*p);
                }
                u32::try_from(found).unwrap()
            })
            .collect();
        assert_eq!(numbers(&given, None), (slow.clone(), false));
        assert_eq!(numbers(&given, Some(Table::with_capacity_for(1))), (slow, false), "grown from the least table");
    }

    #[test]
    fn positions_crafted_to_collide_are_welded_by_the_tree_correctly() {
        // The hashes of these positions share their ten highest bits, which select the slot.
        let hostile = (0u32..).map(|i| DVec3::new(f64::from(i), 0.5, 0.25)).filter(|&p| hash(p) >> 54 == 0);
        let mut given: Vec<DVec3> = hostile.take(3000).collect();
        given.extend_from_within(..);
        let (attacked, by_tree) = numbers(&given, None);
        assert!(by_tree, "the probes should have been spent");
        assert!(attacked.into_iter().eq((0..3000).chain(0..3000)));
    }
}
