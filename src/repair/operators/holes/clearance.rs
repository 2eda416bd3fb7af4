//! Whether a patch intersects the surface, other patches or itself, exactly.

use glam::DVec3;

use crate::math::{Box3, Frame, Tree, collinear, contact, to_unit_range, unit_scale};

/// Steps that all questions together may take: pairs of triangles looked at, and what slow signs count.
const STEPS: u64 = 60_000_000;
const STEPS_A_SLOW_SIGN: u64 = 8;
/// Patch faces that are looked through one by one before they get a tree.
const BLOCK: usize = 64;

/// What is wrong with a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Faults {
    /// Pairs of faces that intersect, of which at least one is the patch's.
    pub crossings: u64,
    /// Faces whose corners lie on a line.
    pub flat: u64,
}

impl Faults {
    pub fn none(self) -> bool {
        self == Self::default()
    }
}

/// The surface around the holes and the patches so far, in trees, for the exact predicates.
///
/// The surface gets its tree once. Patches come one after another: a tree holds a block of them, and of blocks of one size
/// two are joined (Bentley and Saxe 1980), so that a question looks at logarithmically many trees.
pub(super) struct Clearance<'a> {
    unit: Vec<DVec3>,
    scale: f64,
    faces: &'a [[u32; 3]],
    frame: Frame,
    tree: Tree,
    patches: Vec<[u32; 3]>,
    blocks: Vec<(usize, Tree)>,
    steps: u64,
}

impl<'a> Clearance<'a> {
    pub fn new(positions: &[DVec3], faces: &'a [[u32; 3]]) -> Self {
        let unit = to_unit_range(positions);
        let frame = Frame::around(&unit, faces);
        let tree = Tree::in_frame(frame, &unit, faces);
        let scale = unit_scale(positions);
        Self { unit, scale, faces, frame, tree, patches: Vec::new(), blocks: Vec::new(), steps: STEPS }
    }

    /// Positions in the range of the exact predicates.
    pub fn unit(&self) -> &[DVec3] {
        &self.unit
    }

    /// Steps that questions may still take.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Adds vertices after those that are there.
    pub fn add_vertices(&mut self, positions: &[DVec3]) {
        self.unit.extend(positions.iter().map(|&p| p * self.scale));
    }

    /// Drops all vertices from a number on; no patch must use them.
    pub fn drop_vertices(&mut self, from: usize) {
        self.unit.truncate(from);
    }

    /// The patches that were put in.
    pub fn patches(&self) -> &[[u32; 3]] {
        &self.patches
    }

    /// Puts in a patch.
    pub fn put(&mut self, patch: &[[u32; 3]]) {
        self.patches.extend_from_slice(patch);
        let covered = self.covered();
        if self.patches.len() - covered < BLOCK {
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

    /// Takes out all patch faces from a number on.
    pub fn take_out(&mut self, from: usize) {
        self.patches.truncate(from);
        while self.covered() > from {
            self.blocks.pop();
        }
    }

    /// How many patch faces are in blocks.
    fn covered(&self) -> usize {
        self.blocks.last().map_or(0, |b| b.0)
    }

    /// What is wrong with a patch, counted until it is more than `most` pairs; `flat_picture` where it is known not to
    /// intersect itself. None where the steps were spent.
    pub fn faults(&mut self, patch: &[[u32; 3]], flat_picture: bool, most: u64) -> Option<Faults> {
        let mut faults = Faults::default();
        let own = (!flat_picture && patch.len() > BLOCK).then(|| Tree::in_frame(self.frame, &self.unit, patch));
        for (i, &face) in patch.iter().enumerate() {
            let corners = face.map(|v| self.unit[v as usize]);
            if collinear(corners[0], corners[1], corners[2]) {
                faults.flat += 1;
                continue;
            }
            let mut looked = 0;
            let bounds = Box3::of(corners);
            let mut see = |other: [u32; 3]| {
                looked += 1;
                faults.crossings += u64::from(self.meet(&corners, &bounds, other, &mut looked));
                faults.crossings <= most && looked < self.steps
            };
            self.tree.overlapping(&bounds, |f| see(self.faces[f as usize]));
            let mut start = 0;
            for (end, tree) in &self.blocks {
                tree.overlapping(&bounds, |f| see(self.patches[start + f as usize]));
                start = *end;
            }
            for &other in &self.patches[start..] {
                see(other);
            }
            match &own {
                // Each pair is seen from its second face.
                Some(tree) => tree.overlapping(&bounds, |f| (f as usize) >= i || see(patch[f as usize])),
                None if flat_picture => {}
                None => patch[..i].iter().for_each(|&other| {
                    see(other);
                }),
            }
            self.steps = self.steps.saturating_sub(looked);
            if self.steps == 0 {
                return None;
            }
            if faults.crossings > most {
                break;
            }
        }
        Some(faults)
    }

    /// Whether a triangle has more in common with a face than a vertex or an edge of both. Vertices at one position
    /// are one here, as they will be in a file.
    fn meet(&self, corners: &[DVec3; 3], bounds: &Box3, face: [u32; 3], steps: &mut u64) -> bool {
        let other = face.map(|v| self.unit[v as usize]);
        let about = Box3::of(other);
        if about.min.cmpgt(bounds.max).any() || about.max.cmplt(bounds.min).any() {
            return false;
        }
        let [a, b, c] = *corners;
        let [d, e, f] = other;
        // A face without area, as cracks are closed with, and of which nothing can be asked.
        if d == e || e == f || f == d {
            return false;
        }
        let number = |q: DVec3, own: u32| (0u32..).zip(corners).find(|(_, p)| **p == q).map_or(own, |(i, _)| i);
        let numbers = [number(d, 3), number(e, 4), number(f, 5)];
        let mut slow = 0;
        let found = contact(&[a, b, c, d, e, f], [0, 1, 2], numbers, &mut slow);
        *steps += slow * STEPS_A_SLOW_SIGN;
        // Of a face on a line the answer means nothing; to ask that first would take longer than all else.
        !found.is_apart() && !collinear(d, e, f)
    }
}
