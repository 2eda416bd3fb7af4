//! Counts how often a segment passes through faces, to tell inside from outside by parity or by sign.

use std::borrow::Cow;

use glam::DVec3;

use crate::inspect::Analysis;
use crate::math::{Crossing, Tree, crossing, to_unit_range};
use crate::mesh::Surface;

/// A set of faces and a search tree for segment queries with a common budget.
pub(super) struct RayCaster<'a> {
    /// The surface's positions in the range of [`to_unit_range`], in which segments are given.
    pub unit: Vec<DVec3>,
    faces: Cow<'a, [[u32; 3]]>,
    tree: Cow<'a, Tree>,
    spent: u64,
    budget: u64,
}

impl<'a> RayCaster<'a> {
    /// Prepares queries against `faces` of `surface`. All queries together may test `budget` faces.
    pub fn new(surface: &Surface, faces: Vec<[u32; 3]>, budget: u64) -> Self {
        let unit = to_unit_range(&surface.positions);
        Self { tree: Cow::Owned(Tree::new(&unit, &faces)), unit, faces: faces.into(), spent: 0, budget }
    }

    /// Prepares queries against all faces of `surface`. Uses the tree of `known`, if it has the same triangles.
    pub fn of_whole(surface: &'a Surface, known: Option<&'a Analysis<'_>>, budget: u64) -> Self {
        let (unit, faces) = (to_unit_range(&surface.positions), surface.faces.as_slice());
        let tree = match known.and_then(|known| known.tree_of(surface)) {
            Some(tree) => Cow::Borrowed(tree),
            None => Cow::Owned(Tree::new(&unit, faces)),
        };
        Self { unit, faces: faces.into(), tree, spent: 0, budget }
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
        self.each_passage(from, to, |f, _| Some(f) == ignored, |f, _| visit(f))
    }

    /// How often the faces enclose the start of a segment that ends outside all of them: faces that the segment leaves
    /// through, less those through which it enters, except those on the same three vertices as `own`. `None` where it
    /// touches an edge or the budget is spent.
    pub fn winding(&mut self, from: DVec3, to: DVec3, own: [u32; 3]) -> Option<i64> {
        let mut winding = 0;
        let is_own = |_: u32, face: [u32; 3]| face.iter().all(|v| own.contains(v));
        let is_clear = self.each_passage(from, to, is_own, |_, leaves| winding += if leaves { 1 } else { -1 });
        is_clear.then_some(winding)
    }

    /// Calls `visit` with every face that the segment crosses and that is not ignored, and whether the segment leaves
    /// through it. Returns `false` where the segment touches an edge or the budget is spent.
    fn each_passage(
        &mut self,
        from: DVec3,
        to: DVec3,
        is_ignored: impl Fn(u32, [u32; 3]) -> bool,
        mut visit: impl FnMut(u32, bool),
    ) -> bool {
        let Self { unit, faces, tree, spent, budget } = self;
        let mut clear = true;
        tree.along(from, to, |i| {
            *spent += 1;
            let face = faces[i as usize];
            if !is_ignored(i, face) {
                match crossing(from, to, face.map(|v| unit[v as usize])) {
                    Crossing::Miss => {}
                    Crossing::Touches => clear = false,
                    Crossing::Enters => visit(i, false),
                    Crossing::Leaves => visit(i, true),
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
