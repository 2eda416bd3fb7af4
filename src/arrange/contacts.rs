use rustc_hash::FxHashMap;
use smallvec::SmallVec;

use super::grid::{Plane, Whole, side, turn};
use super::points::Points;
use crate::math::Sign;
use crate::mesh::UnionFind;

/// What other faces leave on one face.
#[derive(Debug, Clone, Default)]
pub(super) struct Cuts {
    /// Points on it that are none of its corners, perhaps more than once.
    pub points: Vec<u32>,
    /// Where it meets other faces: two points, and the plane of the other.
    pub lines: Vec<([u32; 2], u32)>,
}

/// Where faces meet, face by face.
pub(super) struct Contacts<'a> {
    faces: &'a [[u32; 3]],
    pub points: &'a mut Points,
    /// The plane of each face that meets others, by face.
    planes: FxHashMap<u32, u32>,
    pub cuts: FxHashMap<u32, Cuts>,
    /// Faces that overlap in a plane, as sets.
    pub together: UnionFind,
}

/// A face that meets another.
struct Face {
    ids: [u32; 3],
    corners: [Whole; 3],
    plane: u32,
    /// The sides of its corners of the plane of the other.
    sides: [Sign; 3],
}

/// The points that two faces have in common.
type Common = SmallVec<[u32; 4]>;

impl<'a> Contacts<'a> {
    pub fn new(faces: &'a [[u32; 3]], points: &'a mut Points) -> Self {
        let together = UnionFind::new(faces.len());
        Self { faces, points, planes: FxHashMap::default(), cuts: FxHashMap::default(), together }
    }

    /// The plane of a face, by its number in the points.
    pub fn plane(&mut self, face: u32) -> u32 {
        let corners = self.faces[face as usize].map(|v| self.points.whole(v));
        *self.planes.entry(face).or_insert_with(|| {
            self.points.planes.push(Plane::through(corners));
            #[expect(clippy::cast_possible_truncation, reason = "no more planes than faces and edges")]
            {
                self.points.planes.len() as u32 - 1
            }
        })
    }

    /// Writes down what two faces have in common. `overlap` is true where they lie in one plane and their insides overlap.
    pub fn meet(&mut self, f: u32, g: u32, overlap: bool) {
        for face in [f, g] {
            self.cuts.entry(face).or_default();
        }
        let planes = [f, g].map(|face| self.plane(face));
        if overlap {
            self.together.unite(f, g);
            return;
        }
        let [a, b] = [f, g].map(|face| self.faces[face as usize]);
        let [p, q] = [a, b].map(|face| face.map(|v| self.points.whole(v)));
        let side_of = |plane: u32, it: &[Whole; 3]| it.map(|x| self.points.planes[plane as usize].side(x));
        let one = Face { ids: a, corners: p, plane: planes[0], sides: side_of(planes[1], &p) };
        let two = Face { ids: b, corners: q, plane: planes[1], sides: side_of(planes[0], &q) };
        let mut common = Common::new();
        self.corners_on(&one, &two, &mut common);
        self.corners_on(&two, &one, &mut common);
        self.edges_through(&one, &two, &mut common);
        self.edges_through(&two, &one, &mut common);
        for (face, own, other) in [(f, &one, &two), (g, &two, &one)] {
            let cuts = self.cuts.entry(face).or_default();
            cuts.points.extend(common.iter().filter(|point| !own.ids.contains(point)));
            if let [from, to] = common.as_slice() {
                cuts.lines.push(([*from, *to], other.plane));
            }
        }
    }

    /// Adds the corners of one face that lie in the other.
    fn corners_on(&self, face: &Face, other: &Face, common: &mut Common) {
        let axis = self.points.planes[other.plane as usize].axis();
        for i in (0..3).filter(|&i| face.sides[i] == Sign::Zero) {
            let turns = [0, 1, 2].map(|k| turn(axis, other.corners[k], other.corners[(k + 1) % 3], face.corners[i]));
            let within = !(turns.contains(&Sign::Positive) && turns.contains(&Sign::Negative));
            if within && !common.contains(&face.ids[i]) {
                common.push(face.ids[i]);
            }
        }
    }

    /// Adds the points where edges of one face pass through the other.
    fn edges_through(&mut self, face: &Face, other: &Face, common: &mut Common) {
        for i in 0..3 {
            let j = (i + 1) % 3;
            if !face.sides[i].opposes(face.sides[j]) {
                continue;
            }
            let [u, v] = [face.corners[i], face.corners[j]];
            let turns = [0, 1, 2].map(|k| side(u, v, other.corners[k], other.corners[(k + 1) % 3]));
            if turns.contains(&Sign::Positive) && turns.contains(&Sign::Negative) {
                continue;
            }
            let zeros = turns.iter().filter(|&&s| s == Sign::Zero).count();
            let point = if zeros == 2 {
                // Through the corner that both edges share.
                let k = (0..3).find(|&k| turns[k] == Sign::Zero && turns[(k + 2) % 3] == Sign::Zero).unwrap_or(0);
                other.ids[k]
            } else {
                self.points.on_edge([face.ids[i], face.ids[j]], other.plane)
            };
            if !common.contains(&point) {
                common.push(point);
            }
        }
    }
}
