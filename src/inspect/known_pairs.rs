//! Intersections of a repaired mesh that follow from those of the mesh before the repair.
//!
//! Two faces intersect or not by their positions alone. So two faces that stand at bit for bit the same positions in a checked
//! mesh need no second test: their pair is among the known intersections, or they do not intersect.

use super::analysis::KnownPairs;
use super::matching::{NO_FACE, matched};
use super::{Analysis, Intersections};

impl Analysis<'_> {
    /// Takes over the intersections of faces that `earlier` has at the same positions, so that the search for intersecting
    /// faces tests only pairs with a changed face. Takes over nothing if the intersections of `earlier` are not known or not
    /// complete, or if a mesh is an assembly of several materials, in which other pairs count.
    pub fn reuse_intersections(&mut self, earlier: &Analysis<'_>) {
        let is_assembly = self.subject.materials.is_some() || earlier.subject.materials.is_some();
        let known = earlier.intersections.get().filter(|known| !is_assembly && known.lists_all_pairs());
        self.known_pairs = known.map(|known| KnownPairs::new(self, earlier, known));
    }
}

impl Intersections {
    /// Whether the search was complete and every pair is listed.
    fn lists_all_pairs(&self) -> bool {
        self.counts.complete && self.counts.pairs == Some(self.pairs.len() as u64)
    }
}

impl KnownPairs {
    fn new(mesh: &Analysis<'_>, earlier: &Analysis<'_>, known: &Intersections) -> Self {
        let scale = earlier.scale();
        let counterparts = matched(&mesh.keys(scale), &earlier.keys(scale));
        let mut changed = vec![true; counterparts.len()];
        // The pairs are listed by the faces of the earlier file.
        let mut of_file = vec![NO_FACE; earlier.subject.soup.faces.len()];
        for ((&other, face), changed) in counterparts.iter().zip(0u32..).zip(&mut changed) {
            if other != NO_FACE && is_same(mesh, face, earlier, other) {
                *changed = false;
                of_file[earlier.surface.source[other as usize] as usize] = face;
            }
        }
        let pairs = known.pairs.iter().map(|pair| (pair.faces.map(|face| of_file[face as usize]), pair.meeting));
        let present = pairs.filter(|(faces, _)| !faces.contains(&NO_FACE));
        let hits = present.map(|([f, g], meeting)| ([f.min(g), f.max(g)], meeting)).collect();
        Self { changed, hits }
    }
}

/// Whether two faces of two meshes have exactly the same corners, in any order. Equal keys show only that they agree in f32.
fn is_same(mesh: &Analysis<'_>, face: u32, earlier: &Analysis<'_>, other: u32) -> bool {
    let (corners, others) = (mesh.surface.corners(face as usize), earlier.surface.corners(other as usize));
    corners.iter().all(|corner| others.contains(corner)) && others.iter().all(|corner| corners.contains(corner))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;
    use std::time::Duration;

    use glam::DVec3;

    use super::*;
    use crate::context::{Context, NoProgress};
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
        mesh.reuse_intersections(&earlier);
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
}
