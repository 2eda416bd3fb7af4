//! Where a vertex may be moved: positions that f32 can hold and no vertex has yet, and whether faces moved there meet others.

use std::collections::HashSet;

use glam::DVec3;
use rustc_hash::FxHashMap;

use crate::math::{Box3, Contact, Precision, Tree, area_vanishes, collinear, contact, unit_scale};
use crate::mesh::{Surface, position_key, weld_exactly};

/// The least step between positions that readers tell apart which round to eight decimals: a power of two above 1e-8.
pub(super) const DISTINCT_STEP: f64 = 1.0 / (1 << 26) as f64;

/// The directions to the corners, edges and sides of a cube.
pub(super) const NEIGHBOURS: [DVec3; 26] = {
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

/// Rounds every position to the nearest f32 and merges what then coincides, so that every operator after it works on
/// the coordinates that an STL file will hold. Answers how many vertices moved.
///
/// Leaves coordinates that do not fit an f32 as they are: the writer refuses them with their index.
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

/// Lengths that are tried, each twice the one before, beginning with the distance between neighbouring f32 numbers.
const STEPS: i32 = 12;

/// The positions that are taken, as f32.
pub(super) struct FreePositions {
    taken: HashSet<[u32; 3]>,
    /// Whether positions are rounded to f32.
    precision: Precision,
    /// The least length that is tried.
    least: f64,
    /// The farthest that was gone so far.
    pub moved: f64,
}

impl FreePositions {
    /// Those of a surface's vertices.
    pub fn new(surface: &Surface, precision: Precision) -> Self {
        let largest = surface.positions.iter().fold(DVec3::ZERO, |most, p| most.max(p.abs()));
        // In a direction between the axes it is still above 1e-8 along one of them.
        let least = (2.0 * DISTINCT_STEP).min(spacing(largest));
        Self { taken: surface.positions.iter().map(|&p| key(p)).collect(), precision, least, moved: 0.0 }
    }

    /// The nearest free position from `p` in a direction, no farther than `most`, for which `fits` holds; then it is taken.
    pub fn find(
        &mut self,
        p: DVec3,
        direction: DVec3,
        most: f64,
        mut fits: impl FnMut(DVec3) -> bool,
    ) -> Option<DVec3> {
        let least = spacing(p).max(self.least);
        for k in 0..STEPS {
            let q = self.precision.round(p + direction * (least * 2f64.powi(k)));
            let free = q.is_finite() && p.distance(q) <= most && !self.taken.contains(&key(q));
            if free && fits(q) {
                self.taken.insert(key(q));
                self.moved = self.moved.max(p.distance(q));
                return Some(q);
            }
        }
        None
    }
}

/// A position as an STL file would hold it, to be compared.
#[expect(clippy::cast_possible_truncation, reason = "compared as an STL file would hold them")]
pub(super) fn key(p: DVec3) -> [u32; 3] {
    p.to_array().map(|x| (x as f32 + 0.0).to_bits())
}

/// The distance between f32 numbers as large as the largest coordinate, and where that is too large for one, as the largest number.
#[expect(clippy::cast_possible_truncation, reason = "asked about f32")]
pub(super) fn spacing(p: DVec3) -> f64 {
    let largest = (p.abs().max_element() as f32).clamp(f32::MIN_POSITIVE, f32::MAX.next_down());
    f64::from(largest.next_up() - largest)
}

/// Faces that all questions together may look at: this many, and as many more for each face.
const MOST: u64 = 5_000_000;
const MOST_A_FACE: u64 = 100;
/// Obstacles that are remembered from one question to the next.
const REMEMBERED: usize = 4;
/// Pairs of new faces, which have a vertex in common, that are looked at as fast as one that is near.
const NEIGHBOURS_A_STEP: u64 = 4;

/// Stands for the new position in faces that are asked about.
pub(super) const NEW: u32 = u32::MAX;

/// The surface as its positions say it: vertices at one position are one, until one of them is moved.
pub(super) struct MoveClearance {
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
    /// What was in the way of the last places, the last first.
    in_the_way: Vec<Obstacle>,
}

/// Whether a vertex may be moved to a place.
struct Question<'a> {
    surface: &'a Surface,
    /// The new faces, and those that they are made from.
    new: &'a [([u32; 3], u32)],
    gone: &'a [u32],
    /// The new faces, by slots.
    faces: Vec<[u32; 3]>,
}

/// Two faces that meet: a new one, by its place in the question, and another.
#[derive(Clone, Copy)]
struct Obstacle {
    face: usize,
    other: Other,
}

#[derive(Clone, Copy)]
enum Other {
    /// A new face, by its place in the question.
    New(usize),
    /// A face of the surface.
    Old(u32),
}

impl MoveClearance {
    pub fn new(surface: &Surface) -> Self {
        let scale = unit_scale(&surface.positions);
        let unit: Vec<DVec3> = surface.positions.iter().map(|&p| p * scale).collect();
        let mut first: FxHashMap<[u64; 3], u32> = FxHashMap::default();
        let slot = (0u32..).zip(&surface.positions).map(|(v, p)| *first.entry(position_key(*p)).or_insert(v)).collect();
        let tree = Tree::new(&unit, &surface.faces);
        let left = MOST + MOST_A_FACE * surface.faces.len() as u64;
        Self { unit, scale, slot, tree, pieces: FxHashMap::default(), grown: 0.0, left, in_the_way: Vec::new() }
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

    /// Whether all was looked at that questions may look at. Every answer is then that faces meet.
    pub fn is_spent(&self) -> bool {
        self.left == 0
    }

    fn look(&mut self, surface: &Surface, new: &[([u32; 3], u32)], gone: &[u32], at_new: usize) -> bool {
        if self.left == 0 {
            return false;
        }
        #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
        let at_new = at_new as u32;
        let faces: Vec<[u32; 3]> = new.iter().map(|&(face, _)| self.slots(face, at_new)).collect();
        if faces.iter().any(|&face| self.area_vanishes(face) || self.is_flat(face)) {
            return false;
        }
        let question = Question { surface, new, gone, faces };
        // What was in the way of one place is mostly in the way of the next.
        let mut work = self.in_the_way.len() as u64 + 1;
        let known = self.in_the_way.iter().position(|&obstacle| self.is_in_the_way(&question, obstacle));
        let found = known.map(|at| self.in_the_way[at]).or_else(|| self.find_in_the_way(&question, &mut work));
        self.left = self.left.saturating_sub(work);
        if let Some(obstacle) = found {
            let last = self.in_the_way.len().min(REMEMBERED - 1);
            match known {
                Some(at) => self.in_the_way[..=at].rotate_right(1),
                None => {
                    self.in_the_way.truncate(last);
                    self.in_the_way.insert(0, obstacle);
                }
            }
        }
        found.is_none() && self.left > 0
    }

    /// What a new face meets, if anything. `work` grows by the faces that are looked at.
    fn find_in_the_way(&self, question: &Question<'_>, work: &mut u64) -> Option<Obstacle> {
        let Question { new, faces, .. } = question;
        for i in 0..faces.len() {
            for j in i + 1..faces.len() {
                let obstacle = Obstacle { face: i, other: Other::New(j) };
                if self.is_in_the_way(question, obstacle) {
                    return Some(obstacle);
                }
            }
            *work += (faces.len() - i) as u64 / NEIGHBOURS_A_STEP;
            if *work > self.left {
                return None;
            }
        }
        let mut near: Vec<u32> = Vec::new();
        for (i, face) in faces.iter().enumerate() {
            let mut bounds = Box3::of(self.corners(*face));
            bounds.min -= DVec3::splat(self.grown);
            bounds.max += DVec3::splat(self.grown);
            near.clear();
            self.tree.overlapping(&bounds, |f| {
                near.push(f);
                near.extend(self.pieces.get(&f).into_iter().flatten());
                *work + (near.len() as u64) < self.left
            });
            *work += near.len() as u64 + 1;
            if *work >= self.left {
                return None;
            }
            let replaced = |f: u32| new.iter().any(|&(_, replaced)| replaced == f);
            for &f in near.iter().filter(|&&f| !replaced(f)) {
                let obstacle = Obstacle { face: i, other: Other::Old(f) };
                if self.is_in_the_way(question, obstacle) {
                    return Some(obstacle);
                }
            }
        }
        None
    }

    /// Whether a new face meets another, and what it is made from did not.
    fn is_in_the_way(&self, question: &Question<'_>, obstacle: Obstacle) -> bool {
        let &Question { surface, new, gone, ref faces } = question;
        let old = |f: u32| self.slots(surface.faces[f as usize], NEW);
        let Obstacle { face: i, other } = obstacle;
        let (Some(&face), Some(&(_, parent))) = (faces.get(i), new.get(i)) else { return false };
        match other {
            Other::New(j) => {
                let (Some(&other), Some(&(_, other_parent))) = (faces.get(j), new.get(j)) else { return false };
                if self.are_apart(face, other) {
                    return false;
                }
                let [a, b] = [old(parent), old(other_parent)];
                parent == other_parent || self.is_flat(a) || self.is_flat(b) || self.are_apart(a, b)
            }
            Other::Old(f) => {
                if gone.contains(&f) || new.iter().any(|&(_, replaced)| replaced == f) {
                    return false;
                }
                let other = old(f);
                if self.is_flat(other) || self.are_apart(face, other) {
                    return false;
                }
                let parent = old(parent);
                let met_before = !self.is_flat(parent)
                    && matches!(
                        contact(&self.unit, parent, other, &mut 0),
                        Contact::Touching | Contact::Crossing | Contact::Coplanar
                    );
                !met_before
            }
        }
    }

    /// A face by the slots of its vertices, [`NEW`] being at `at_new`.
    fn slots(&self, face: [u32; 3], at_new: u32) -> [u32; 3] {
        face.map(|v| if v == NEW { at_new } else { self.slot[v as usize] })
    }

    fn corners(&self, face: [u32; 3]) -> [DVec3; 3] {
        face.map(|slot| self.unit[slot as usize])
    }

    fn is_flat(&self, face: [u32; 3]) -> bool {
        let [a, b, c] = self.corners(face);
        collinear(a, b, c)
    }

    fn area_vanishes(&self, face: [u32; 3]) -> bool {
        let [a, b, c] = self.corners(face);
        area_vanishes(a, b, c)
    }

    fn are_apart(&self, a: [u32; 3], b: [u32; 3]) -> bool {
        contact(&self.unit, a, b, &mut 0).is_apart()
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

/// Faces at a vertex with another vertex in its place, as [`MoveClearance::is_clear`] asks for them.
pub(super) fn with_vertex(surface: &Surface, star: &[u32], v: u32, new: u32) -> Vec<([u32; 3], u32)> {
    star.iter().map(|&f| (surface.faces[f as usize].map(|w| if w == v { new } else { w }), f)).collect()
}

/// Whether faces at a vertex keep some area, and the side to which they look, when it moves to `q`.
pub(super) fn keep_facing(surface: &Surface, mut faces: impl Iterator<Item = u32>, v: u32, q: DVec3) -> bool {
    faces.all(|f| {
        let place = |w: u32| if w == v { q } else { surface.positions[w as usize] };
        let [a, b, c] = surface.faces[f as usize].map(place);
        (b - a).cross(c - a).dot(surface.area_vector(f as usize)) > 0.0 && !collinear(a, b, c)
    })
}
