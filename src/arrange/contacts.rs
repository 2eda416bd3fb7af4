//! Records where faces meet: on each face, the points and segments that other faces leave on it.

use rustc_hash::FxHashMap;
use smallvec::SmallVec;

use super::grid::{Plane, Whole, side, turn};
use super::points::Points;
use crate::math::Sign;
use crate::mesh::UnionFind;

/// Two faces that have more in common than corners and edges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MeetingFaces {
    /// The two faces, the smaller first.
    pub faces: [u32; 2],
    /// Whether the faces overlap in a plane.
    pub overlap: bool,
}

/// The points and segments that other faces leave on one face.
#[derive(Debug, Clone, Default)]
pub(super) struct Cuts {
    /// Points on the face that are not its corners; a point may occur repeatedly.
    pub points: Vec<u32>,
    /// Segments on the face: their two end points, and the plane of the other face.
    pub lines: Vec<([u32; 2], u32)>,
}

/// Collects the cuts of every face that meets another.
pub(super) struct Contacts<'a> {
    faces: &'a [[u32; 3]],
    /// The points of the arrangement, which grow with each contact.
    pub points: &'a mut Points,
    /// The index in [`Points`] of the plane of each face that meets others, by face.
    planes: FxHashMap<u32, u32>,
    /// The cuts of each face that meets another.
    pub cuts: FxHashMap<u32, Cuts>,
    /// Sets of faces that overlap within one plane.
    pub together: UnionFind,
}

/// A face that meets another, with its relation to the other's plane.
struct Face {
    ids: [u32; 3],
    corners: [Whole; 3],
    plane: u32,
    /// The side of the other face's plane on which each corner lies.
    sides: [Sign; 3],
}

/// The common points of two faces.
type Common = SmallVec<[u32; 4]>;

impl<'a> Contacts<'a> {
    /// Starts without any contact.
    pub fn new(faces: &'a [[u32; 3]], points: &'a mut Points) -> Self {
        let together = UnionFind::new(faces.len());
        Self { faces, points, planes: FxHashMap::default(), cuts: FxHashMap::default(), together }
    }

    /// The index in [`Points`] of a face's plane.
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

    /// Records the intersection of two faces. `overlap` is true if they are coplanar and their interiors overlap.
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
        let side_of = |plane: u32, corners: &[Whole; 3]| corners.map(|x| self.points.planes[plane as usize].side(x));
        let one = Face { ids: a, corners: p, plane: planes[0], sides: side_of(planes[1], &p) };
        let two = Face { ids: b, corners: q, plane: planes[1], sides: side_of(planes[0], &q) };
        let mut common = Common::new();
        self.corners_on(&one, &two, &mut common);
        self.corners_on(&two, &one, &mut common);
        self.edges_through(&one, &two, &mut common);
        self.edges_through(&two, &one, &mut common);
        // Coplanar faces that touch meet along their edges, which are lines already. Their planes have no common line.
        let are_coplanar = one.sides == [Sign::Zero; 3];
        for (face, own, other) in [(f, &one, &two), (g, &two, &one)] {
            let cuts = self.cuts.entry(face).or_default();
            cuts.points.extend(common.iter().filter(|point| !own.ids.contains(point)));
            if let [from, to] = common.as_slice()
                && !are_coplanar
            {
                cuts.lines.push(([*from, *to], other.plane));
            }
        }
    }

    /// Adds the corners of one face that lie in the other to the common points.
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

    /// Adds the points where edges of one face pass through the other to the common points.
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
                // The edge passes through the corner that both zero edges share.
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
