//! Intersections of a repaired mesh that follow from those of the mesh before the repair.
//!
//! Whether two faces intersect depends only on their positions. If an already searched mesh has two faces at bit for bit the same
//! positions, the pair needs no second test: it is among the known intersections, or the faces do not intersect.

use std::borrow::Cow;

use super::analysis::KnownPairs;
use super::intersections::intersections_near_changed;
use super::matching::{FaceHashes, KeyedFaces, NO_FACE, matched};
use super::{Analysis, IntersectingPair, Intersections, Subject, group_faces, intersections};
use crate::context::{Cancelled, Context};
use crate::mesh::Surface;

impl Analysis<'_> {
    /// Reuses the known intersections between faces that `earlier` has at the same positions. The search for intersecting faces
    /// then tests only pairs with a changed face.
    ///
    /// Reuses nothing if the intersections of `earlier` are unknown or incomplete. Reuses nothing either if one of the meshes is an
    /// assembly of several materials, because other pairs count as intersections there.
    pub fn reuse_intersections(&mut self, earlier: Option<KnownIntersections<'_>>) {
        let known = earlier.filter(|_| self.facts.materials.is_none());
        self.known_pairs = known.map(|known| KnownPairs::new(self, &known));
    }

    /// The intersections of this mesh for the search of a later mesh. None if they are unknown or incomplete, or if the mesh is an
    /// assembly of several materials.
    #[must_use]
    pub fn known_intersections(&self) -> Option<KnownIntersections<'_>> {
        let is_known = |known: &&Intersections| self.facts.materials.is_none() && known.lists_all_pairs();
        self.intersections.get().filter(is_known).map(|intersections| {
            let faces = self.keyed_faces(self.scale());
            KnownIntersections { intersections, faces, file_faces: self.file_faces().len() }
        })
    }
}

/// All intersecting faces of a mesh that was searched before.
pub struct KnownIntersections<'a> {
    intersections: &'a Intersections,
    faces: KeyedFaces<'a>,
    /// The number of faces before faces were omitted.
    file_faces: usize,
}

/// A mesh with its intersecting faces. The search of a later mesh tests only pairs with a face that this mesh does not have.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchedMesh {
    /// The intersections of the mesh.
    pub intersections: Intersections,
    /// Whether most faces were tested, because no earlier mesh had them.
    pub is_mostly_new: bool,
    surface: Surface,
    hashes: FaceHashes,
    file_faces: usize,
}

impl SearchedMesh {
    /// Finds the intersecting faces of a mesh. Takes over those between faces of an earlier mesh.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn search<'a>(
        mesh: impl Into<Subject<'a>>,
        earlier: Option<KnownIntersections<'_>>,
        context: &Context<'_>,
    ) -> Result<Self, Cancelled> {
        let analysis = Analysis::new(mesh.into(), context)?;
        let known = earlier.map(|known| KnownPairs::new(&analysis, &known));
        let intersections = match &known {
            Some(known) => intersections_near_changed(&analysis, known, context)?,
            None => intersections(&analysis, context)?,
        };
        let is_mostly_new = known.is_none_or(|known| {
            2 * known.changed.iter().filter(|is_changed| **is_changed).count() > known.changed.len()
        });
        let hashes = analysis.keyed_faces(analysis.scale()).hashes.into_owned();
        let file_faces = analysis.file_faces().len();
        Ok(Self { intersections, is_mostly_new, surface: analysis.surface, hashes, file_faces })
    }

    /// The intersections of this mesh for the search of a later mesh. None if they are incomplete.
    #[must_use]
    pub fn known_intersections(&self) -> Option<KnownIntersections<'_>> {
        let &Self { ref intersections, ref surface, ref hashes, file_faces, .. } = self;
        let faces = KeyedFaces { surface, hashes: Cow::Borrowed(hashes) };
        let known = KnownIntersections { intersections, faces, file_faces };
        intersections.lists_all_pairs().then_some(known)
    }

    /// All pairs of faces that have more in common than corners and edges, as indices into the searched soup. None if some are
    /// not listed, or if two faces have the same corners: such faces are no listed pair.
    #[must_use]
    pub fn meeting_pairs(&self) -> Option<&[IntersectingPair]> {
        let has_same_corners = || group_faces(&self.surface.faces).len() < self.surface.faces.len();
        (self.intersections.lists_all_pairs() && !has_same_corners()).then_some(&self.intersections.pairs)
    }

    /// Whether two faces have the same corners and the same winding, as where a part of a solid was written twice. Linear
    /// time.
    #[must_use]
    pub fn has_faces_twice(&self) -> bool {
        let groups = group_faces(&self.surface.faces);
        // Of three faces on the same corners, two have the same winding.
        let is_twice = |group: &[u32]| match *group {
            [_] => false,
            [f, g] => self.surface.face_key(f as usize) == self.surface.face_key(g as usize),
            _ => true,
        };
        groups.len() < self.surface.faces.len() && groups.iter().any(is_twice)
    }
}

impl Intersections {
    /// Whether the search was complete and every pair is listed.
    fn lists_all_pairs(&self) -> bool {
        self.counts.complete && self.counts.pairs == Some(self.pairs.len() as u64)
    }
}

impl KnownPairs {
    fn new(mesh: &Analysis<'_>, earlier: &KnownIntersections<'_>) -> Self {
        let faces = mesh.keyed_faces(earlier.faces.hashes.scale());
        let counterparts = matched(&faces, &earlier.faces);
        let is_exact = faces.is_exact() && earlier.faces.is_exact();
        let mut changed = vec![true; counterparts.len()];
        // For each face of the earlier file, which the known pairs name, the face of this mesh at the same positions.
        let mut counterpart_of = vec![NO_FACE; earlier.file_faces];
        for ((&other, face), changed) in counterparts.iter().zip(0u32..).zip(&mut changed) {
            if other != NO_FACE && (is_exact || is_same(&mesh.surface, face, earlier.faces.surface, other)) {
                *changed = false;
                counterpart_of[earlier.faces.surface.source[other as usize] as usize] = face;
            }
        }
        let pairs = earlier
            .intersections
            .pairs
            .iter()
            .map(|pair| (pair.faces.map(|face| counterpart_of[face as usize]), pair.meeting));
        let present = pairs.filter(|(faces, _)| !faces.contains(&NO_FACE));
        let hits = present.map(|([f, g], meeting)| ([f.min(g), f.max(g)], meeting)).collect();
        Self { changed, hits }
    }
}

/// Whether two faces of two meshes have exactly the same corners, in any order. Equal keys prove only that the corners agree in f32,
/// which suffices where f32 holds all positions.
fn is_same(surface: &Surface, face: u32, earlier: &Surface, other: u32) -> bool {
    let (corners, others) = (surface.corners(face as usize), earlier.corners(other as usize));
    corners.iter().all(|corner| others.contains(corner)) && others.iter().all(|corner| corners.contains(corner))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use glam::DVec3;

    use super::*;
    use crate::context::NoProgress;
    use crate::mesh::Soup;

    /// Two crossing squares of two faces each, the second moved by `shift`.
    fn squares(shift: f64) -> Soup {
        let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let flat = corners.map(|(x, y)| DVec3::new(x, y, 0.0));
        let upright = corners.map(|(x, z)| DVec3::new(x, 0.5 + shift, z - 0.5));
        let positions = flat.into_iter().chain(upright).collect();
        Soup { positions, faces: vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]] }
    }

    fn known(mesh: &Soup, earlier: &Soup, is_searched: bool) -> Option<(Vec<bool>, usize)> {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
        let earlier = Analysis::new(earlier.into(), &context).expect("not cancelled");
        if is_searched {
            earlier.intersections(&context).expect("not cancelled");
        }
        let mut mesh = Analysis::new(mesh.into(), &context).expect("not cancelled");
        mesh.reuse_intersections(earlier.known_intersections());
        mesh.known_pairs.map(|known| (known.changed, known.hits.len()))
    }

    #[test]
    fn unchanged_faces_are_those_at_equal_positions_in_a_searched_mesh() {
        let (still, moved) = (squares(0.0), squares(1e-12));
        let (changed, hits) = known(&still, &still, true).expect("the mesh was searched");
        assert_eq!(changed, [false; 4]);
        assert!(hits > 0);
        // In f32 the moved square is at the same place.
        assert_eq!(known(&moved, &still, true), Some((vec![false, false, true, true], 0)));
        assert_eq!(known(&still, &still, false), None);
    }

    #[test]
    fn a_search_after_an_earlier_one_finds_what_a_full_search_finds() {
        let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
        let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(60));
        let search = |mesh: &Soup, known: Option<KnownIntersections<'_>>| {
            SearchedMesh::search(mesh, known, &context).expect("not cancelled")
        };
        let still = squares(0.0);
        let first = search(&still, None);
        let inspected = Analysis::new((&still).into(), &context).expect("not cancelled");
        assert!(inspected.known_intersections().is_none());
        inspected.intersections(&context).expect("not cancelled");
        for shift in [0.0, 1e-12, 0.25, 2.0] {
            let full = search(&squares(shift), None).intersections;
            for known in [first.known_intersections(), inspected.known_intersections()] {
                assert!(known.is_some());
                let again = search(&squares(shift), known).intersections;
                assert_eq!(again.counts, full.counts, "{shift}");
                assert_eq!(again.takes_part, full.takes_part, "{shift}");
            }
        }
    }
}
