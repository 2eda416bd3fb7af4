use glam::DVec3;

use crate::math::{Crossing, Tree, crossing, to_unit_range};
use crate::mesh::Surface;

/// Faces through which segments are followed, to tell inside from outside by whether they go through an odd number.
pub(super) struct Walls {
    /// The surface's positions in the range of [`to_unit_range`], in which segments are given.
    pub unit: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    tree: Tree,
    spent: u64,
    budget: u64,
}

impl Walls {
    /// Walls are `faces` of `surface`. All segments together may look at `budget` of them.
    pub fn new(surface: &Surface, faces: Vec<[u32; 3]>, budget: u64) -> Self {
        let unit = to_unit_range(&surface.positions);
        Self { tree: Tree::new(&unit, &faces), unit, faces, spent: 0, budget }
    }

    /// The middle of a face, from which segments begin.
    pub fn middle(&self, face: [u32; 3]) -> DVec3 {
        let [a, b, c] = face.map(|v| self.unit[v as usize]);
        (a + b + c) / 3.0
    }

    /// How often the segment goes through the walls, but for the one of number `but`; none where it touches an edge or the
    /// budget is spent.
    pub fn crossings(&mut self, from: DVec3, to: DVec3, but: Option<u32>) -> Option<u64> {
        let mut count = 0;
        self.each_crossing(from, to, but, |_| count += 1).then_some(count)
    }

    /// Calls `visit` with every wall that the segment goes through, but for the one of number `but`. Answers `false` where it
    /// touches an edge or the budget is spent, and then need not have met all.
    pub fn each_crossing(&mut self, from: DVec3, to: DVec3, but: Option<u32>, mut visit: impl FnMut(u32)) -> bool {
        let Self { unit, faces, tree, spent, budget } = self;
        let mut clear = true;
        tree.along(from, to, |i| {
            *spent += 1;
            if Some(i) != but {
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

    /// Whether all that segments may look at was looked at.
    pub fn is_spent(&self) -> bool {
        self.spent >= self.budget
    }
}
