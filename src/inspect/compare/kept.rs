use rayon::prelude::*;

use crate::inspect::Analysis;
use crate::math::Box3;

/// Diagonals that a mesh may be away from the origin for f32 to tell its faces apart by less than a millionth of the
/// diagonal.
const NEAR: f64 = 16.0;

/// No face of the other mesh.
pub(super) const NO_FACE: u32 = u32::MAX;

/// The faces of a mesh by where they are, to find them in another.
#[derive(Clone)]
pub(in crate::inspect) struct FaceKeys {
    /// The corners as f32 and sorted, with the face of the surface; sorted.
    sorted: Vec<([[u32; 3]; 3], u32)>,
    /// Whether f32 tells the mesh's faces apart.
    fine: bool,
}

impl FaceKeys {
    /// Sorts the faces. O(n log n). `scale` is a power of two, the same for both meshes, so that f32 holds their numbers
    /// however large or small they are; it changes no mantissa.
    #[expect(clippy::cast_possible_truncation, reason = "compared as an STL file would hold them")]
    pub fn new(analysis: &Analysis<'_>, scale: f64) -> Self {
        let surface = &analysis.surface;
        let mut sorted: Vec<_> = (0..surface.faces.len())
            .into_par_iter()
            .map(|f| {
                let mut key = surface.corners(f).map(|p| p.to_array().map(|x| ((x * scale) as f32 + 0.0).to_bits()));
                key.sort_unstable();
                (key, f as u32)
            })
            .collect();
        sorted.par_sort_unstable();
        let bounds = Box3::of(analysis.unit().iter().copied());
        // Unit coordinates reach 2.
        Self { sorted, fine: bounds.diagonal() * NEAR >= 2.0 }
    }
}

/// For each face of one mesh the face of another that stands at the same three positions as f32, or [`NO_FACE`]. Of faces at
/// one place the first ones are matched, as many as the other mesh has there. Linear.
pub(super) fn matched(a: &FaceKeys, b: &FaceKeys) -> Vec<u32> {
    let mut matched = vec![NO_FACE; a.sorted.len()];
    let mut at = 0;
    for &(key, face) in &a.sorted {
        while b.sorted.get(at).is_some_and(|(other, _)| *other < key) {
            at += 1;
        }
        if let Some(&(_, other)) = b.sorted.get(at).filter(|(other, _)| *other == key) {
            matched[face as usize] = other;
            at += 1;
        }
    }
    matched
}

/// What two meshes have in common.
pub(super) struct Common {
    /// Of each face of one, whether it stands in the other at the same three positions as f32, whatever its direction.
    pub first: Vec<bool>,
    /// The same for the faces of the other.
    pub second: Vec<bool>,
    /// Whether a face that stands is nowhere farther from the other mesh than can be measured.
    pub fine: bool,
}

impl Common {
    /// What a mesh of so many faces has in common with itself.
    pub fn whole(faces: usize) -> Self {
        Self { first: vec![true; faces], second: vec![true; faces], fine: true }
    }

    /// Finds the faces of each mesh in the other. Linear.
    pub fn new(a: &FaceKeys, b: &FaceKeys) -> Self {
        let mut common =
            Self { first: vec![false; a.sorted.len()], second: vec![false; b.sorted.len()], fine: a.fine && b.fine };
        let mut at = 0;
        for group in a.sorted.chunk_by(|x, y| x.0 == y.0) {
            let key = group[0].0;
            while b.sorted.get(at).is_some_and(|(other, _)| *other < key) {
                at += 1;
            }
            if b.sorted.get(at).is_none_or(|(other, _)| *other != key) {
                continue;
            }
            for &(_, face) in group {
                common.first[face as usize] = true;
            }
            while let Some(&(_, face)) = b.sorted.get(at).filter(|(other, _)| *other == key) {
                common.second[face as usize] = true;
                at += 1;
            }
        }
        common
    }
}
