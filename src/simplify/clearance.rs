use super::complex::Complex;
use crate::math::{Box3, GrowingTree, Tree, contact};

/// Faces near new ones, for each face at the start and in all, that may be looked at: many times what a usual model needs.
const NEAR_A_FACE: u64 = 400;
const NEAR: u64 = 10_000_000;

/// The faces as a tree, to find those that new faces may intersect.
pub(super) struct Clearance {
    tree: GrowingTree,
    /// The face of each triangle of the tree, and the other way round.
    face: Vec<u32>,
    triangle: Vec<u32>,
    stack: Vec<u32>,
    near: Vec<u32>,
    /// Faces that may still be looked at.
    pub near_left: u64,
}

impl Clearance {
    pub fn new(it: &Complex) -> Self {
        let (tree, face) = tree_of(it);
        let triangle = face.clone();
        let near_left = NEAR + NEAR_A_FACE * face.len() as u64;
        Self { tree, face, triangle, stack: Vec::new(), near: Vec::new(), near_left }
    }

    /// Builds a new tree where half of the faces are gone.
    pub fn refresh(&mut self, it: &Complex) {
        if it.alive * 2 < self.face.len() {
            (self.tree, self.face) = tree_of(it);
            for (&f, triangle) in self.face.iter().zip(0u32..) {
                self.triangle[f as usize] = triangle;
            }
        }
    }

    /// Makes room for a face that has changed.
    pub fn grow(&mut self, it: &Complex, face: u32) {
        self.tree.grow(self.triangle[face as usize], it.corners(face as usize));
    }

    /// Whether new faces meet no other face, exactly, but in the vertices and edges that they share, and neither one another.
    /// Faces that `passes_over` names are not asked. Faces without area have no inside and are not asked either.
    pub fn is_clear(&mut self, it: &Complex, new: &[[u32; 3]], passes_over: impl Fn(u32) -> bool) -> bool {
        let mut slow = 0;
        let mut apart = |a: [u32; 3], b: [u32; 3]| contact(&it.at, a, b, &mut slow).is_apart();
        for (i, &a) in new.iter().enumerate() {
            if !new[i + 1..].iter().all(|&b| apart(a, b)) {
                return false;
            }
        }
        let bounds = Box3::of(new.iter().flatten().map(|&v| it.at[v as usize]));
        let (near, face) = (&mut self.near, &self.face);
        near.clear();
        self.tree.overlapping(&bounds, &mut self.stack, |triangle| near.push(face[triangle as usize]));
        self.near_left = self.near_left.saturating_sub(near.len() as u64);
        near.retain(|&f| it.is_alive(f as usize) && !it.flat[f as usize] && !passes_over(f));
        let boxed = |face: [u32; 3]| Box3::of(face.map(|v| it.at[v as usize]));
        let boxes: Vec<([u32; 3], Box3)> = new.iter().map(|&a| (a, boxed(a))).collect();
        for &f in &*near {
            let face = it.faces[f as usize];
            let around = boxed(face);
            for (a, own) in &boxes {
                if own.meets(&around) && !apart(*a, face) {
                    return false;
                }
            }
        }
        true
    }
}

fn tree_of(it: &Complex) -> (GrowingTree, Vec<u32>) {
    let face: Vec<u32> = (0u32..).take(it.faces.len()).filter(|&f| it.is_alive(f as usize)).collect();
    let corners: Vec<[u32; 3]> = face.iter().map(|&f| it.faces[f as usize]).collect();
    (GrowingTree::new(Tree::new(&it.at, &corners)), face)
}
