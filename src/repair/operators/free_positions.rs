//! Finds positions to which a vertex may move.
//!
//! [`FreePositions`] finds representable positions that no vertex has yet. [`MoveClearance`] tests whether the moved faces
//! would meet other faces.

use std::collections::HashSet;

use glam::DVec3;
use rustc_hash::FxHashMap;

use crate::math::{Box3, Contact, Precision, Tree, area_vanishes, collinear, contact, unit_scale};
use crate::mesh::{Surface, position_key, weld_exactly};

/// The least step between positions that readers with eight decimals distinguish: a power of two above 1e-8.
pub(super) const DISTINCT_STEP: f64 = 1.0 / (1 << 26) as f64;

/// The directions from the centre of a cube to its corners, edges and sides.
pub(super) const NEIGHBOUR_DIRECTIONS: [DVec3; 26] = {
    let mut all = [DVec3::ZERO; 26];
    let (mut at, mut i) = (0, 0);
    while i < 27 {
        if i != 13 {
            all[at] = DVec3::new((i / 9) as f64 - 1.0, (i / 3 % 3) as f64 - 1.0, (i % 3) as f64 - 1.0);
            at += 1;
        }
        i += 1;
    }
    all
};

/// Rounds every position to the nearest f32 and merges vertices that then coincide, so that later operators work on the
/// coordinates that an STL file will hold. Returns the number of moved vertices.
///
/// Coordinates beyond the range of f32 stay unchanged: the writer rejects them with their index.
pub fn round_to_f32(surface: &mut Surface) -> u64 {
    let mut moved = 0;
    for p in &mut surface.positions {
        let rounded = Precision::F32.round(*p);
        if rounded != *p {
            *p = rounded;
            moved += 1;
        }
    }
    if moved > 0 {
        weld_exactly(surface);
    }
    moved
}

/// The number of step lengths that are tried. Each is twice the one before; the first is the spacing of f32 at the position.
const STEPS: i32 = 12;

/// Positions that no vertex has, as f32.
pub(super) struct FreePositions {
    /// The positions in use, which are collected for the first search.
    taken: Option<HashSet<[u32; 3]>>,
    /// The precision to which new positions are rounded.
    precision: Precision,
    /// The least step length.
    least: f64,
    /// The largest distance to a position found so far.
    pub moved: f64,
}

impl FreePositions {
    /// Prepares the search for the vertices of a surface, before any of them moves.
    pub fn new(surface: &Surface, precision: Precision) -> Self {
        let largest = surface.positions.iter().fold(DVec3::ZERO, |most, p| most.max(p.abs()));
        // The factor keeps a step in a diagonal direction above 1e-8 along one axis.
        let least = (2.0 * DISTINCT_STEP).min(spacing(largest));
        Self { taken: None, precision, least, moved: 0.0 }
    }

    /// Finds and takes the nearest free position from `p` in a direction, within `most`, for which `fits` holds.
    pub fn find(
        &mut self,
        surface: &Surface,
        (p, direction): (DVec3, DVec3),
        most: f64,
        mut fits: impl FnMut(DVec3) -> bool,
    ) -> Option<DVec3> {
        let taken = self.taken.get_or_insert_with(|| surface.positions.iter().map(|&p| key(p)).collect());
        let least = spacing(p).max(self.least);
        for k in 0..STEPS {
            let q = self.precision.round(p + direction * (least * 2f64.powi(k)));
            let free = q.is_finite() && p.distance(q) <= most && !taken.contains(&key(q));
            if free && fits(q) {
                taken.insert(key(q));
                self.moved = self.moved.max(p.distance(q));
                return Some(q);
            }
        }
        None
    }
}

/// The key of a position for comparison at f32 precision.
#[expect(clippy::cast_possible_truncation, reason = "compared as an STL file would hold them")]
pub(super) fn key(p: DVec3) -> [u32; 3] {
    p.to_array().map(|x| (x as f32 + 0.0).to_bits())
}

/// The spacing of f32 numbers at the largest coordinate, clamped to the range of f32.
#[expect(clippy::cast_possible_truncation, reason = "the spacing of f32 is the purpose")]
pub(super) fn spacing(p: DVec3) -> f64 {
    let largest = (p.abs().max_element() as f32).clamp(f32::MIN_POSITIVE, f32::MAX.next_down());
    f64::from(largest.next_up() - largest)
}

/// The most faces that all queries together may test: a constant plus a number for each face.
const WORK: u64 = 5_000_000;
const WORK_PER_FACE: u64 = 100;
/// The number of obstacles that are remembered between queries.
const MAX_RECENT: usize = 4;
/// The number of pairs of adjacent new faces whose test costs as much as that of one nearby face.
const NEIGHBOUR_PAIRS_PER_STEP: u64 = 4;

/// The placeholder for the new position in the faces of a query.
pub(super) const NEW: u32 = u32::MAX;

/// Tests whether moving a vertex would make faces meet. Vertices at one position count as one until one of them moves.
pub(super) struct MoveClearance {
    /// Positions in the range of the exact predicates, by slot.
    unit: Vec<DVec3>,
    scale: f64,
    /// For each vertex the slot of its position in `unit`; vertices at one position share a slot.
    slot: Vec<u32>,
    tree: Tree,
    /// For each face the faces that were split off since the tree was built.
    pieces: FxHashMap<u32, Vec<u32>>,
    /// How far faces may extend beyond their boxes in the tree, in the range of the predicates.
    max_growth: f64,
    budget: u64,
    /// The obstacles of the latest queries, latest first.
    recent_obstacles: Vec<Obstacle>,
}

/// A query: may these new faces replace old ones?
struct MoveQuery<'a> {
    surface: &'a Surface,
    /// The new faces, each with the face that it replaces.
    new: &'a [([u32; 3], u32)],
    removed: &'a [u32],
    /// The new faces, as slots.
    faces: Vec<[u32; 3]>,
}

/// Two faces that meet: a new face, by its index in the query, and another face.
#[derive(Clone, Copy)]
struct Obstacle {
    face: usize,
    other: OtherFace,
}

/// The face that a new face meets.
#[derive(Clone, Copy)]
enum OtherFace {
    /// A new face, by its index in the query.
    New(usize),
    /// A face of the surface.
    Old(u32),
}

impl MoveClearance {
    /// Builds the search tree for `surface`.
    pub fn new(surface: &Surface) -> Self {
        let scale = unit_scale(&surface.positions);
        let unit: Vec<DVec3> = surface.positions.iter().map(|&p| p * scale).collect();
        let slot = first_at_position(&surface.positions);
        let tree = Tree::new(&unit, &surface.faces);
        let budget = WORK + WORK_PER_FACE * surface.faces.len() as u64;
        Self {
            unit,
            scale,
            slot,
            tree,
            pieces: FxHashMap::default(),
            max_growth: 0.0,
            budget,
            recent_obstacles: Vec::new(),
        }
    }

    /// Whether the new faces meet no other face and not each other, except in shared vertices and edges. [`NEW`] in a face
    /// stands for a vertex at `q`. Each new face comes with the face that it replaces. Contacts that the replaced face had
    /// already do not count, nor do contacts with faces in `removed`.
    pub fn is_clear(&mut self, surface: &Surface, new: &[([u32; 3], u32)], removed: &[u32], q: DVec3) -> bool {
        let at_new = self.unit.len();
        self.unit.push(q * self.scale);
        let clear = self.check(surface, new, removed, at_new);
        self.unit.truncate(at_new);
        clear
    }

    /// Whether the budget is spent. Every query then reports an obstacle.
    pub fn is_spent(&self) -> bool {
        self.budget == 0
    }

    /// The query of [`MoveClearance::is_clear`], with the new position in slot `at_new`.
    fn check(&mut self, surface: &Surface, new: &[([u32; 3], u32)], removed: &[u32], at_new: usize) -> bool {
        if self.budget == 0 {
            return false;
        }
        #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
        let at_new = at_new as u32;
        let faces: Vec<[u32; 3]> = new.iter().map(|&(face, _)| self.slots(face, at_new)).collect();
        if faces.iter().any(|&face| self.area_vanishes(face) || self.is_collinear(face)) {
            return false;
        }
        let query = MoveQuery { surface, new, removed, faces };
        // An obstacle of one position is mostly an obstacle of the next.
        let mut work = self.recent_obstacles.len() as u64 + 1;
        let known = self.recent_obstacles.iter().position(|&obstacle| self.is_obstacle(&query, obstacle));
        let obstacle = known.map(|at| self.recent_obstacles[at]).or_else(|| self.find_obstacle(&query, &mut work));
        self.budget = self.budget.saturating_sub(work);
        if let Some(obstacle) = obstacle {
            let last = self.recent_obstacles.len().min(MAX_RECENT - 1);
            match known {
                Some(at) => self.recent_obstacles[..=at].rotate_right(1),
                None => {
                    self.recent_obstacles.truncate(last);
                    self.recent_obstacles.insert(0, obstacle);
                }
            }
        }
        obstacle.is_none() && self.budget > 0
    }

    /// The first face that a new face meets. Adds the number of tested faces to `work`.
    fn find_obstacle(&self, query: &MoveQuery<'_>, work: &mut u64) -> Option<Obstacle> {
        let MoveQuery { new, faces, .. } = query;
        for i in 0..faces.len() {
            for j in i + 1..faces.len() {
                let obstacle = Obstacle { face: i, other: OtherFace::New(j) };
                if self.is_obstacle(query, obstacle) {
                    return Some(obstacle);
                }
            }
            *work += (faces.len() - i) as u64 / NEIGHBOUR_PAIRS_PER_STEP;
            if *work > self.budget {
                return None;
            }
        }
        let mut near: Vec<u32> = Vec::new();
        for (i, face) in faces.iter().enumerate() {
            let mut bounds = Box3::of(self.corners(*face));
            bounds.min -= DVec3::splat(self.max_growth);
            bounds.max += DVec3::splat(self.max_growth);
            near.clear();
            self.tree.overlapping(&bounds, |f| {
                near.push(f);
                near.extend(self.pieces.get(&f).into_iter().flatten());
                *work + (near.len() as u64) < self.budget
            });
            *work += near.len() as u64 + 1;
            if *work >= self.budget {
                return None;
            }
            let replaced = |f: u32| new.iter().any(|&(_, replaced)| replaced == f);
            for &f in near.iter().filter(|&&f| !replaced(f)) {
                let obstacle = Obstacle { face: i, other: OtherFace::Old(f) };
                if self.is_obstacle(query, obstacle) {
                    return Some(obstacle);
                }
            }
        }
        None
    }

    /// Whether a new face meets another face that the replaced face did not meet.
    fn is_obstacle(&self, query: &MoveQuery<'_>, obstacle: Obstacle) -> bool {
        let &MoveQuery { surface, new, removed, ref faces } = query;
        let old = |f: u32| self.slots(surface.faces[f as usize], NEW);
        let Obstacle { face: i, other } = obstacle;
        let (Some(&face), Some(&(_, parent))) = (faces.get(i), new.get(i)) else { return false };
        match other {
            OtherFace::New(j) => {
                let (Some(&other), Some(&(_, other_parent))) = (faces.get(j), new.get(j)) else { return false };
                if self.are_apart(face, other) {
                    return false;
                }
                let [a, b] = [old(parent), old(other_parent)];
                parent == other_parent || self.is_collinear(a) || self.is_collinear(b) || self.are_apart(a, b)
            }
            OtherFace::Old(f) => {
                if removed.contains(&f) || new.iter().any(|&(_, replaced)| replaced == f) {
                    return false;
                }
                let other = old(f);
                if !self.boxes_meet(face, other) || self.is_collinear(other) || self.are_apart(face, other) {
                    return false;
                }
                let parent = old(parent);
                let met_before = !self.is_collinear(parent)
                    && matches!(
                        contact(&self.unit, parent, other, &mut 0),
                        Contact::Touching | Contact::Crossing | Contact::Coplanar
                    );
                !met_before
            }
        }
    }

    /// The slots of a face's vertices, with [`NEW`] in slot `at_new`.
    fn slots(&self, face: [u32; 3], at_new: u32) -> [u32; 3] {
        let slot = |v: u32| if v == NEW { at_new } else { self.slot[v as usize] };
        let [a, b, c] = face;
        [slot(a), slot(b), slot(c)]
    }

    fn corners(&self, face: [u32; 3]) -> [DVec3; 3] {
        let [a, b, c] = face;
        [self.unit[a as usize], self.unit[b as usize], self.unit[c as usize]]
    }

    fn is_collinear(&self, face: [u32; 3]) -> bool {
        let [a, b, c] = self.corners(face);
        collinear(a, b, c)
    }

    fn area_vanishes(&self, face: [u32; 3]) -> bool {
        let [a, b, c] = self.corners(face);
        area_vanishes(a, b, c)
    }

    fn boxes_meet(&self, a: [u32; 3], b: [u32; 3]) -> bool {
        Box3::of(self.corners(a)).meets(&Box3::of(self.corners(b)))
    }

    fn are_apart(&self, a: [u32; 3], b: [u32; 3]) -> bool {
        contact(&self.unit, a, b, &mut 0).is_apart()
    }

    /// Records that vertex `v` moved to `q`.
    pub fn record_move(&mut self, v: u32, q: DVec3) {
        let q = q * self.scale;
        self.max_growth = self.max_growth.max(self.unit[self.slot[v as usize] as usize].distance(q));
        self.slot[v as usize] = self.push(q);
    }

    /// Records a new vertex at `q`, at most `off` outside the faces that it belongs to.
    pub fn record_vertex(&mut self, q: DVec3, off: f64) {
        self.max_growth = self.max_growth.max(off * self.scale);
        let slot = self.push(q * self.scale);
        self.slot.push(slot);
    }

    /// Records that `piece` was split off face `from`.
    pub fn record_split(&mut self, from: u32, piece: u32) {
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

/// For each position the index of the first equal one.
pub(super) fn first_at_position(positions: &[DVec3]) -> Vec<u32> {
    let mut first: FxHashMap<[u64; 3], u32> = FxHashMap::default();
    (0u32..).zip(positions).map(|(v, p)| *first.entry(position_key(*p)).or_insert(v)).collect()
}

/// The faces at a vertex with another vertex in its place, in the form that [`MoveClearance::is_clear`] takes.
pub(super) fn with_vertex(surface: &Surface, star: &[u32], v: u32, new: u32) -> Vec<([u32; 3], u32)> {
    star.iter().map(|&f| (surface.faces[f as usize].map(|w| if w == v { new } else { w }), f)).collect()
}

/// Whether the faces at vertex `v` keep their orientation and an area when the vertex moves to `q`.
pub(super) fn keeps_orientation(surface: &Surface, mut faces: impl Iterator<Item = u32>, v: u32, q: DVec3) -> bool {
    faces.all(|f| {
        let position = |w: u32| if w == v { q } else { surface.positions[w as usize] };
        let [a, b, c] = surface.faces[f as usize].map(position);
        (b - a).cross(c - a).dot(surface.area_vector(f as usize)) > 0.0 && !collinear(a, b, c)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A triangle to move, and the corners of another face.
    fn surface(other: [DVec3; 3]) -> Surface {
        let own = [DVec3::ZERO, DVec3::X, DVec3::Y];
        Surface {
            positions: own.into_iter().chain(other).collect(),
            faces: vec![[0, 1, 2], [3, 4, 5]],
            source: vec![0, 1],
        }
    }

    fn is_clear(other: [DVec3; 3], q: DVec3) -> bool {
        let surface = surface(other);
        MoveClearance::new(&surface).is_clear(&surface, &[([NEW, 1, 2], 0)], &[], q)
    }

    #[test]
    fn a_vertex_may_not_move_through_another_face() {
        let wall = [DVec3::new(-0.5, -2.0, -2.0), DVec3::new(-0.5, 2.0, -2.0), DVec3::new(-0.5, 0.0, 2.0)];
        assert!(is_clear(wall, DVec3::new(-0.25, 0.0, 0.0)));
        assert!(!is_clear(wall, DVec3::new(-1.0, 0.0, 0.0)));
    }

    #[test]
    fn a_face_with_two_corners_at_one_position_is_no_obstacle() {
        let needle = [DVec3::new(-0.5, 0.0, -2.0), DVec3::new(-0.5, 0.0, -2.0), DVec3::new(-0.5, 0.0, 2.0)];
        assert!(is_clear(needle, DVec3::new(-1.0, 0.0, 0.0)));
        let doubled = [DVec3::X, DVec3::X, DVec3::Y];
        assert!(is_clear(doubled, DVec3::new(-1.0, 0.0, 0.0)));
    }
}
