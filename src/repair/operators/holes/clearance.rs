//! Tests exactly whether a patch intersects the surface, other patches or itself.

use std::cell::OnceCell;

use glam::DVec3;

use super::group::Hole;
use super::patch::Faults;
use crate::math::{Box3, Frame, Tree, collinear, contact, threads, to_unit_range, unit_scale};

/// The steps that all queries together may take: pairs of triangles tested, plus a surcharge for slow exact predicates. A
/// constant plus a number for each face: holes in a surface that does not intersect itself take less than a tenth of that.
const STEP_BUDGET: u64 = 5_000_000;
const STEPS_PER_FACE: u64 = 50;
const STEPS_PER_SLOW_PREDICATE: u64 = 8;
/// The number of patch faces that are tested one by one before they get a tree.
const BLOCK_SIZE: usize = 64;

/// How far a hole's region reaches beyond the box of the hole, as a share of the box's diagonal. Smoothed patches bulge out of the box.
const REGION_MARGIN: f64 = 0.5;

/// The surface around the holes and the patches so far, in search trees for intersection tests.
///
/// Most patches stay near their holes, so only the faces there get a tree, and the whole surface only if a patch leaves its hole.
///
/// Patches arrive one after another: each tree holds a block of patch faces, and two blocks of similar size are merged (Bentley and
/// Saxe 1980), so that a query visits logarithmically many trees.
pub(super) struct Clearance<'a> {
    unit: Vec<DVec3>,
    scale: f64,
    faces: &'a [[u32; 3]],
    frame: Frame,
    /// The region of the hole that is being filled.
    region: Box3,
    /// The faces that meet the region of a hole, and their tree.
    near: Vec<u32>,
    near_tree: Tree,
    /// The tree of all faces.
    tree: OnceCell<Tree>,
    patches: Vec<[u32; 3]>,
    blocks: Vec<(usize, Tree)>,
    steps: u64,
}

impl<'a> Clearance<'a> {
    /// Builds the search tree of the surface around `holes`.
    pub fn new<'h>(positions: &[DVec3], faces: &'a [[u32; 3]], holes: impl Iterator<Item = &'h Hole>) -> Self {
        let unit = to_unit_range(positions);
        let frame = Frame::around(&unit, faces);
        let regions: Vec<Box3> = holes.map(|hole| region_of(hole, &unit)).collect();
        let near = faces_near(&regions, &unit, faces);
        let corners: Vec<[u32; 3]> = near.iter().map(|&f| faces[f as usize]).collect();
        let near_tree = Tree::in_frame(frame, &unit, &corners);
        Self {
            scale: unit_scale(positions),
            steps: STEP_BUDGET + STEPS_PER_FACE * faces.len() as u64,
            unit,
            faces,
            frame,
            region: Box3::EMPTY,
            near,
            near_tree,
            tree: OnceCell::new(),
            patches: Vec::new(),
            blocks: Vec::new(),
        }
    }

    /// Prepares for the patches of one of the holes, or of a part of its loops.
    pub fn enter(&mut self, hole: &Hole) {
        self.region = region_of(hole, &self.unit);
    }

    /// The positions in the range of the exact predicates.
    pub fn unit(&self) -> &[DVec3] {
        &self.unit
    }

    /// The steps that queries may still take.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Appends vertices at `positions`, in the model's unit.
    pub fn add_vertices(&mut self, positions: &[DVec3]) {
        self.unit.extend(positions.iter().map(|&p| p * self.scale));
    }

    /// Removes the vertices from index `from` on; no patch may use them.
    pub fn drop_vertices(&mut self, from: usize) {
        self.unit.truncate(from);
    }

    /// The patch faces so far.
    pub fn patches(&self) -> &[[u32; 3]] {
        &self.patches
    }

    /// Adds the faces of a patch.
    pub fn add(&mut self, patch: &[[u32; 3]]) {
        self.patches.extend_from_slice(patch);
        let covered = self.covered();
        if self.patches.len() - covered < BLOCK_SIZE {
            return;
        }
        let mut start = covered;
        while let Some(&(end, _)) = self.blocks.last() {
            let begin = self.blocks.len().checked_sub(2).map_or(0, |i| self.blocks[i].0);
            if end - begin > self.patches.len() - start {
                break;
            }
            start = begin;
            self.blocks.pop();
        }
        let tree = Tree::in_frame(self.frame, &self.unit, &self.patches[start..]);
        self.blocks.push((self.patches.len(), tree));
    }

    /// Removes the patch faces from index `from` on.
    pub fn truncate_patches(&mut self, from: usize) {
        self.patches.truncate(from);
        while self.covered() > from {
            self.blocks.pop();
        }
    }

    /// The number of patch faces in blocks.
    fn covered(&self) -> usize {
        self.blocks.last().map_or(0, |b| b.0)
    }

    /// Counts the faults of a patch, and stops above `max_crossings` pairs. With `is_simple` the patch is known not to
    /// intersect itself. `None` where the budget is spent.
    pub fn faults(&mut self, patch: &[[u32; 3]], is_simple: bool, max_crossings: u64) -> Option<Faults> {
        let mut faults = Faults::default();
        let is_near = self.region.contains(&Box3::of(patch.iter().flatten().map(|&v| self.unit[v as usize])));
        let own = (!is_simple && patch.len() > BLOCK_SIZE).then(|| Tree::in_frame(self.frame, &self.unit, patch));
        for (i, &face) in patch.iter().enumerate() {
            let corners = face.map(|v| self.unit[v as usize]);
            if collinear(corners[0], corners[1], corners[2]) {
                faults.degenerate += 1;
                continue;
            }
            let mut tested = 0;
            let bounds = Box3::of(corners);
            let mut test_face = |other: [u32; 3]| {
                tested += 1;
                faults.crossings += u64::from(self.intersects(&corners, &bounds, other, &mut tested));
                faults.crossings <= max_crossings && tested < self.steps
            };
            if is_near {
                self.near_tree.overlapping(&bounds, |f| test_face(self.faces[self.near[f as usize] as usize]));
            } else {
                let tree = self.tree.get_or_init(|| Tree::in_frame(self.frame, &self.unit, self.faces));
                tree.overlapping(&bounds, |f| test_face(self.faces[f as usize]));
            }
            let mut start = 0;
            for (end, tree) in &self.blocks {
                tree.overlapping(&bounds, |f| test_face(self.patches[start + f as usize]));
                start = *end;
            }
            for &other in &self.patches[start..] {
                test_face(other);
            }
            match &own {
                // Each pair is tested from its second face.
                Some(tree) => tree.overlapping(&bounds, |f| (f as usize) >= i || test_face(patch[f as usize])),
                None if is_simple => {}
                None => patch[..i].iter().for_each(|&other| {
                    test_face(other);
                }),
            }
            self.steps = self.steps.saturating_sub(tested);
            if self.steps == 0 {
                return None;
            }
            if faults.crossings > max_crossings {
                break;
            }
        }
        Some(faults)
    }

    /// Whether a triangle and a face have more in common than a shared vertex or edge. Vertices at one position count as one,
    /// since a position-based file will merge them.
    fn intersects(&self, corners: &[DVec3; 3], bounds: &Box3, face: [u32; 3], steps: &mut u64) -> bool {
        let other = face.map(|v| self.unit[v as usize]);
        let face_bounds = Box3::of(other);
        if face_bounds.min.cmpgt(bounds.max).any() || face_bounds.max.cmplt(bounds.min).any() {
            return false;
        }
        let [a, b, c] = *corners;
        let [d, e, f] = other;
        // A face with a repeated position, as in closed cracks, has no defined contact.
        if d == e || e == f || f == d {
            return false;
        }
        let number = |q: DVec3, own: u32| (0u32..).zip(corners).find(|(_, p)| **p == q).map_or(own, |(i, _)| i);
        let numbers = [number(d, 3), number(e, 4), number(f, 5)];
        let mut slow = 0;
        let result = contact(&[a, b, c, d, e, f], [0, 1, 2], numbers, &mut slow);
        *steps += slow * STEPS_PER_SLOW_PREDICATE;
        // For a collinear face the result is meaningless. Testing that first would be the most expensive step.
        !result.is_apart() && !collinear(d, e, f)
    }
}

/// The region in which the patches of a hole usually stay. The region of a part of the hole's loops lies in it.
fn region_of(hole: &Hole, unit: &[DVec3]) -> Box3 {
    let bounds = Box3::of(hole.loops.iter().flatten().map(|&v| unit[v as usize]));
    bounds.grown(REGION_MARGIN * bounds.diagonal())
}

/// The faces whose boxes meet a region, in ascending order.
fn faces_near(regions: &[Box3], unit: &[DVec3], faces: &[[u32; 3]]) -> Vec<u32> {
    // A triangle whose box is the region.
    let corners: Vec<DVec3> = regions.iter().flat_map(|region| [region.min, region.max]).collect();
    let triangles: Vec<[u32; 3]> = (0u32..).step_by(2).take(regions.len()).map(|low| [low, low + 1, low + 1]).collect();
    let tree = Tree::new(&corners, &triangles);
    threads::filter_map(faces.len(), |face| {
        let bounds = Box3::of(faces[face].map(|v| unit[v as usize]));
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        tree.any_overlapping(&bounds, |_| true).then_some(face as u32)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat grid of squares of side 1 in the plane z = 0, each of two faces, but for a square hole in the middle; and a hole with that
    /// rim.
    fn grid_with_hole() -> (Vec<DVec3>, Vec<[u32; 3]>, Hole) {
        let (side, middle) = (9u32, 4);
        let positions = (0..=side).flat_map(|y| (0..=side).map(move |x| DVec3::new(f64::from(x), f64::from(y), 0.0)));
        let at = |x: u32, y: u32| y * (side + 1) + x;
        let squares =
            (0..side).flat_map(|y| (0..side).map(move |x| (x, y))).filter(|&square| square != (middle, middle));
        let faces = squares.flat_map(|(x, y)| {
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            [[a, b, c], [a, c, d]]
        });
        let rim = vec![at(middle, middle), at(middle + 1, middle), at(middle + 1, middle + 1), at(middle, middle + 1)];
        (positions.collect(), faces.collect(), Hole { loops: vec![rim], parts: vec![0], extent: 2f64.sqrt() })
    }

    #[test]
    fn only_faces_around_a_hole_are_near_it() {
        let (positions, faces, hole) = grid_with_hole();
        let clearance = Clearance::new(&positions, &faces, [&hole].into_iter());
        assert!((16..=24).contains(&clearance.near.len()), "{}", clearance.near.len());
    }

    #[test]
    fn a_patch_is_tested_against_the_surface_near_its_hole_and_beyond() {
        let (positions, faces, hole) = grid_with_hole();
        let mut clearance = Clearance::new(&positions, &faces, [&hole].into_iter());
        clearance.enter(&hole);
        let rim = &hole.loops[0];
        let apex = u32::try_from(positions.len()).unwrap();
        let mut crossings = |at: DVec3| {
            clearance.add_vertices(&[at]);
            let patch = [[rim[0], rim[1], apex], [rim[2], rim[3], apex]];
            let found = clearance.faults(&patch, false, u64::MAX).unwrap().crossings;
            clearance.drop_vertices(apex as usize);
            found
        };
        assert_eq!(crossings(DVec3::new(4.5, 4.5, -0.3)), 0, "in the hole");
        assert_ne!(crossings(DVec3::new(4.5, 3.9, 0.0)), 0, "on the faces beside the hole");
        let beyond = crossings(DVec3::new(4.5, 8.5, 0.0));
        assert!(beyond > 8, "{beyond} faces beyond the hole");
        assert!(clearance.tree.get().is_some());
    }
}
