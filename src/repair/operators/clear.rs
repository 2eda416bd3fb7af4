//! Whether faces whose vertices are moved meet others, exactly.

use glam::DVec3;
use rustc_hash::FxHashMap;

use crate::math::{Box3, Contact, Tree, collinear, contact, unit_scale};
use crate::mesh::Surface;

/// Pairs of faces that all questions together may look at: so many for each face, ...
const MOST_PER_FACE: u64 = 1000;
/// ... at least, ...
const LEAST: u64 = 200_000;
/// ... and at most.
const MOST: u64 = 30_000_000;

/// Stands for the new position in faces that are asked about.
pub(super) const NEW: u32 = u32::MAX;

/// The surface as its positions say it: vertices at one position are one, until one of them is moved.
pub(super) struct Clear {
    /// Positions in the range of the exact predicates, by slot.
    unit: Vec<DVec3>,
    scale: f64,
    /// For each vertex where its position stands in `unit`; vertices at one position share one.
    slot: Vec<u32>,
    tree: Tree,
    /// Faces that were cut off others since the tree was built, by those.
    pieces: FxHashMap<u32, Vec<u32>>,
    /// How far faces may reach out of their boxes in the tree, in the range of the predicates.
    grown: f64,
    left: u64,
}

impl Clear {
    pub fn new(surface: &Surface) -> Self {
        let scale = unit_scale(&surface.positions);
        let unit: Vec<DVec3> = surface.positions.iter().map(|&p| p * scale).collect();
        let mut first: FxHashMap<[u64; 3], u32> = FxHashMap::default();
        let slot = (0u32..)
            .zip(&surface.positions)
            .map(|(v, p)| *first.entry(p.to_array().map(|x| (x + 0.0).to_bits())).or_insert(v))
            .collect();
        let tree = Tree::new(&unit, &surface.faces);
        let left = (MOST_PER_FACE * surface.faces.len() as u64).clamp(LEAST, MOST);
        Self { unit, scale, slot, tree, pieces: FxHashMap::default(), grown: 0.0, left }
    }

    /// Whether new faces, in which [`NEW`] stands at `q`, meet no other face and not one another but in shared vertices and edges.
    /// Each comes with the face that it is made from; what those intersected already is passed over, and so are faces that will
    /// be `gone`.
    pub fn is_clear(&mut self, surface: &Surface, new: &[([u32; 3], u32)], gone: &[u32], q: DVec3) -> bool {
        let at_new = self.unit.len();
        self.unit.push(q * self.scale);
        let clear = self.look(surface, new, gone, at_new);
        self.unit.truncate(at_new);
        clear
    }

    fn look(&mut self, surface: &Surface, new: &[([u32; 3], u32)], gone: &[u32], at_new: usize) -> bool {
        // Those of the new faces with one another, which are many around a vertex of many faces.
        let pairs = new.len() as u64 * new.len() as u64 / 2;
        self.left = self.left.saturating_sub(pairs);
        if self.left == 0 {
            return false;
        }
        #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
        let slots = |face: [u32; 3]| face.map(|v| if v == NEW { at_new as u32 } else { self.slot[v as usize] });
        let is_flat =
            |[a, b, c]: [u32; 3]| collinear(self.unit[a as usize], self.unit[b as usize], self.unit[c as usize]);
        let mut slow = 0;
        let faces: Vec<[u32; 3]> = new.iter().map(|&(face, _)| slots(face)).collect();
        if faces.iter().any(|&face| is_flat(face)) {
            return false;
        }
        let mut apart = |a: [u32; 3], b: [u32; 3]| {
            matches!(contact(&self.unit, a, b, &mut slow), Contact::Disjoint | Contact::Neighbours)
        };
        for (i, &a) in faces.iter().enumerate() {
            for (j, &b) in faces.iter().enumerate().skip(i + 1) {
                let before = [i, j].map(|k| new[k].1).map(|f| slots(surface.faces[f as usize]));
                if !apart(a, b)
                    && (new[i].1 == new[j].1 || is_flat(before[0]) || is_flat(before[1]) || apart(before[0], before[1]))
                {
                    return false;
                }
            }
        }
        for (&face, &(_, parent)) in faces.iter().zip(new) {
            let mut bounds = Box3::of(face.map(|s| self.unit[s as usize]));
            bounds.min -= DVec3::splat(self.grown);
            bounds.max += DVec3::splat(self.grown);
            let mut near: Vec<u32> = Vec::new();
            self.tree.overlapping(&bounds, |f| {
                near.push(f);
                near.extend(self.pieces.get(&f).into_iter().flatten());
                true
            });
            self.left = self.left.saturating_sub(near.len() as u64 + 1);
            if self.left == 0 {
                return false;
            }
            let old = slots(surface.faces[parent as usize]);
            for f in near {
                if gone.contains(&f) || new.iter().any(|&(_, replaced)| replaced == f) {
                    continue;
                }
                let other = slots(surface.faces[f as usize]);
                if is_flat(other) || apart(face, other) {
                    continue;
                }
                let met_before = !is_flat(old)
                    && matches!(
                        contact(&self.unit, old, other, &mut 0),
                        Contact::Touching | Contact::Crossing | Contact::Coplanar
                    );
                if !met_before {
                    return false;
                }
            }
        }
        true
    }

    /// A vertex was moved to `q`.
    pub fn moved(&mut self, v: u32, q: DVec3) {
        let q = q * self.scale;
        self.grown = self.grown.max(self.unit[self.slot[v as usize] as usize].distance(q));
        self.slot[v as usize] = self.push(q);
    }

    /// A vertex was added at `q`, at most `off` from the faces that now have it.
    pub fn added(&mut self, q: DVec3, off: f64) {
        self.grown = self.grown.max(off * self.scale);
        let slot = self.push(q * self.scale);
        self.slot.push(slot);
    }

    /// A face was cut off another.
    pub fn cut(&mut self, from: u32, piece: u32) {
        self.pieces.entry(from).or_default().push(piece);
    }

    fn push(&mut self, unit: DVec3) -> u32 {
        self.unit.push(unit);
        #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
        {
            self.unit.len() as u32 - 1
        }
    }
}
