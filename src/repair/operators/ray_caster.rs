//! Counts how often a segment passes through faces, to tell inside from outside by parity or by sign.

use glam::DVec3;

use crate::math::{Crossing, Tree, crossing, to_unit_range};
use crate::mesh::Surface;

/// A set of faces and a search tree for segment queries with a common budget.
pub(super) struct RayCaster {
    /// The surface's positions in the range of [`to_unit_range`], in which segments are given.
    pub unit: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    tree: Tree,
    spent: u64,
    budget: u64,
}

impl RayCaster {
    /// Prepares queries against `faces` of `surface`. All queries together may test `budget` faces.
    pub fn new(surface: &Surface, faces: Vec<[u32; 3]>, budget: u64) -> Self {
        let unit = to_unit_range(&surface.positions);
        Self { tree: Tree::new(&unit, &faces), unit, faces, spent: 0, budget }
    }

    /// The centroid of a face, from which segments start.
    pub fn centroid(&self, face: [u32; 3]) -> DVec3 {
        let [a, b, c] = face.map(|v| self.unit[v as usize]);
        (a + b + c) / 3.0
    }

    /// The number of faces that the segment crosses, except face number `ignored`; `None` where the segment touches an edge
    /// or the budget is spent.
    pub fn crossings(&mut self, from: DVec3, to: DVec3, ignored: Option<u32>) -> Option<u64> {
        let mut count = 0;
        self.each_crossing(from, to, ignored, |_| count += 1).then_some(count)
    }

    /// Calls `visit` with every face that the segment crosses, except face number `ignored`. Returns `false` where the segment
    /// touches an edge or the budget is spent; some faces are then not visited.
    pub fn each_crossing(&mut self, from: DVec3, to: DVec3, ignored: Option<u32>, mut visit: impl FnMut(u32)) -> bool {
        let Self { unit, faces, tree, spent, budget } = self;
        let mut clear = true;
        tree.along(from, to, |i| {
            *spent += 1;
            if Some(i) != ignored {
                match crossing(from, to, faces[i as usize].map(|v| unit[v as usize])) {
                    Crossing::Miss => {}
                    Crossing::Touches => clear = false,
                    Crossing::Enters | Crossing::Leaves => visit(i),
                }
            }
            clear && spent < budget
        });
        clear && spent < budget
    }

    /// Whether the budget is spent.
    pub fn is_spent(&self) -> bool {
        self.spent >= self.budget
    }
}
