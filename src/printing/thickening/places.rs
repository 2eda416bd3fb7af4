//! Thin places: connected groups of thin faces on both sides of their walls.

use glam::DVec3;

use crate::math::Tree;
use crate::mesh::{Edges, Surface, UnionFind};

use super::walls::Opposed;

/// The groups of thin faces.
pub struct Places {
    /// For each face, the number of its place; none for a face that is not thin.
    pub of_face: Vec<Option<u32>>,
    /// The number of places.
    pub count: u32,
    /// The thin faces, and a tree over them.
    thin: (Vec<u32>, Tree),
}

impl Places {
    /// Groups thin faces that share a vertex or oppose each other.
    pub fn new(surface: &Surface, thin: &[Vec<Opposed>]) -> Self {
        let mut groups = UnionFind::new(surface.faces.len());
        let is_thin = |face: u32| !thin[face as usize].is_empty();
        let edges = Edges::new(&surface.faces);
        for half_edges in edges.iter() {
            for pair in half_edges.windows(2) {
                let [f, g] = [pair[0] / 3, pair[1] / 3];
                if is_thin(f) && is_thin(g) {
                    groups.unite(f, g);
                }
            }
        }
        for (face, walls) in (0u32..).zip(thin) {
            walls.iter().filter(|wall| is_thin(wall.face)).for_each(|wall| groups.unite(face, wall.face));
        }
        let mut of_face: Vec<Option<u32>> = vec![None; surface.faces.len()];
        let mut count = 0;
        for (face, root) in (0u32..).zip(groups.into_roots()).filter(|&(face, _)| is_thin(face)) {
            // The root is the smallest face of its group, and a group with a thin face has thin faces only.
            if root == face {
                of_face[face as usize] = Some(count);
                count += 1;
            } else {
                of_face[face as usize] = of_face[root as usize];
            }
        }
        let faces: Vec<u32> = (0u32..).take(surface.faces.len()).filter(|&face| is_thin(face)).collect();
        let corners: Vec<[u32; 3]> = faces.iter().map(|&face| surface.faces[face as usize]).collect();
        let tree = Tree::new(&surface.positions, &corners);
        Self { of_face, count, thin: (faces, tree) }
    }

    /// The place whose thin face is nearest to a point. `surface` must be that of [`Places::new`].
    pub fn nearest(&self, surface: &Surface, point: DVec3) -> Option<u32> {
        let (faces, tree) = &self.thin;
        let corners = |face: u32| surface.corners(faces[face as usize] as usize);
        let nearest = tree.nearest(point, f64::INFINITY, &mut u64::MAX.clone(), corners)?;
        self.of_face[faces[nearest.face as usize] as usize]
    }
}
