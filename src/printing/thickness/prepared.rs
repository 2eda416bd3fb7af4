//! A surface prepared for thickness queries: a tree with the normals below each node, and the concave edges.

use std::borrow::Cow;

use crate::math::vec3a;
use crate::math::{Tree, hit, unit_scale};
use crate::mesh::{Edges, Stars, Surface};
use glam::{DVec3, Vec3A};
use obvhs::bvh2::node::Bvh2Node;
use rayon::prelude::*;

use super::places::Space;

/// Two faces are opposed if the dot product of their unit normals is at most this: their planes enclose at most 36.87
/// degrees. A wedge with a larger angle is an edge of the solid, not a wall.
pub(super) const OPPOSED: f64 = -0.8;
/// The angle between two chords that both count as perpendicular to a wall: half of that angle, in radians.
pub(super) const TILT: f64 = 0.321_750_554_396_642_2;
/// Relative bound of the rounding errors of box tests in f32.
const SLACK: f32 = 1e-5;
/// A concave edge is sharp if the normals of its faces differ by more than this angle; cosine of 15 degrees. The wall
/// at a blunter edge is measured from the faces.
const SHARP: f64 = 0.965_925_826_289_068_3;
/// A face with a height below this fraction of the largest coordinate has no reliable normal: f32 has 24 bits.
pub(super) const FLAT: f64 = 2.4e-7;
/// Like [`FLAT`], as a fraction of the face's longest edge.
const NEEDLE: f64 = 1e-9;

/// Summary of a node's faces: the range of their normals, and the sharpest concave edge.
#[derive(Clone, Copy)]
pub(super) struct Below {
    low: Vec3A,
    high: Vec3A,
    /// Largest angle in radians between the normals at a sharp concave edge.
    pub spread: f32,
}

impl Below {
    const EMPTY: Self = Self { low: Vec3A::INFINITY, high: Vec3A::NEG_INFINITY, spread: 0.0 };

    fn and(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high), spread: self.spread.max(other.spread) }
    }

    /// Lower bound of the dot product of a unit vector with the normals below.
    #[inline]
    pub fn least_dot(&self, normal: Vec3A) -> f32 {
        (normal * self.low).min(normal * self.high).element_sum() - SLACK
    }

    /// Upper bound of the dot product of a unit vector with the normals below.
    #[inline]
    pub fn most_dot(&self, normal: Vec3A) -> f32 {
        (normal * self.low).max(normal * self.high).element_sum() + SLACK
    }
}

/// A surface prepared for thickness queries. For gaps the faces are reversed, so that material and air change places.
pub(super) struct Prepared<'a> {
    pub surface: Cow<'a, Surface>,
    /// Factor by which the positions were multiplied: a power of two.
    pub scale: f64,
    pub tree: Tree,
    /// The rounding of the largest coordinate in f32.
    pub rounding: f64,
    /// Unit normal of each face; zero for a face without a reliable normal.
    pub normals: Vec<DVec3>,
    pub below: Vec<Below>,
    pub stars: Stars,
    /// For each face the largest angle at its sharp concave edges ([`Below::spread`]); 0 for a face without one.
    pub spread: Vec<f32>,
    /// For each face a bit for each edge, set if the edge is sharp and concave.
    pub concave: Vec<u8>,
}

impl<'a> Prepared<'a> {
    /// Prepares a surface for chords through the material or, reversed, through the air.
    pub fn new(surface: &'a Surface, side: Space) -> Self {
        let scale = unit_scale(&surface.positions);
        let mut own = Cow::Borrowed(surface);
        if scale != 1.0 {
            own.to_mut().positions.iter_mut().for_each(|p| *p *= scale);
        }
        if side == Space::Air {
            own.to_mut().faces.iter_mut().for_each(|face| face.swap(1, 2));
        }
        let largest = largest_coordinate(&own);
        let normals: Vec<DVec3> =
            (0..own.faces.len()).into_par_iter().map(|f| reliable_normal(own.corners(f), largest)).collect();
        let stars = Stars::new(own.positions.len(), &own.faces);
        let tree = Tree::new(&own.positions, &own.faces);
        let mut prepared = Self {
            surface: own,
            scale,
            tree,
            rounding: FLAT * largest,
            normals,
            below: Vec::new(),
            stars,
            spread: Vec::new(),
            concave: Vec::new(),
        };
        prepared.mark_concave();
        prepared.below = prepared.summaries();
        prepared
    }

    /// The corners of a face, on the unit scale.
    #[inline]
    pub fn corners(&self, face: u32) -> [DVec3; 3] {
        self.surface.corners(face as usize)
    }

    /// The unit normal of a face; zero if it is not reliable.
    #[inline]
    pub fn normal(&self, face: u32) -> DVec3 {
        self.normals[face as usize]
    }

    /// The number of faces.
    pub fn len(&self) -> usize {
        self.surface.faces.len()
    }

    /// Whether two faces have a common vertex.
    pub fn share_a_vertex(&self, f: u32, h: u32) -> bool {
        let (f, h) = (self.surface.faces[f as usize], self.surface.faces[h as usize]);
        f.iter().any(|v| h.contains(v))
    }

    /// The first face besides `ends` that the segment meets strictly between its ends.
    pub fn blocker(&self, [from, to]: [DVec3; 2], steps: &mut u64, is_end: impl Fn(u32) -> bool) -> Option<u32> {
        let step = to - from;
        let found = self.tree.first_along([from, to], None, steps, |face| {
            let fraction = if is_end(face) { None } else { hit(from, step, self.corners(face)) };
            fraction.filter(|fraction| (1e-9..=1.0 - 1e-9).contains(fraction))
        });
        found.map(|(_, face)| face)
    }

    /// The first face that a ray of at most `longest` meets, with the distance. Face `skip` does not count.
    pub fn first_hit(
        &self,
        [from, direction]: [DVec3; 2],
        longest: f64,
        skip: Option<u32>,
        steps: &mut u64,
    ) -> Option<(f64, u32)> {
        let found = self.tree.first_hit([from, direction * longest], skip, steps, |face| self.corners(face));
        found.map(|(fraction, face)| (fraction * longest, face))
    }

    /// Finds the sharp concave edges, and the angle at them.
    fn mark_concave(&mut self) {
        let faces = &self.surface.faces;
        self.spread = vec![0.0; faces.len()];
        self.concave = vec![0; faces.len()];
        for half_edges in Edges::new(faces).iter() {
            let &[h, k] = half_edges else { continue };
            let (n, m) = (self.normal(h / 3), self.normal(k / 3));
            let [from, apex] =
                [Edges::ends(faces, h)[0], Edges::opposite(faces, k)].map(|v| self.surface.positions[v as usize]);
            if n.dot(m) < SHARP && n != DVec3::ZERO && m != DVec3::ZERO && n.dot(apex - from) > 0.0 {
                #[expect(clippy::cast_possible_truncation, reason = "the slack covers the rounding")]
                let angle = n.dot(m).clamp(-1.0, 1.0).acos() as f32;
                for half_edge in [h, k] {
                    let f = half_edge as usize / 3;
                    self.concave[f] |= 1 << (half_edge % 3);
                    self.spread[f] = self.spread[f].max(angle);
                }
            }
        }
    }

    fn summaries(&self) -> Vec<Below> {
        let of_leaf = |_: &Bvh2Node, faces: &[u32]| {
            let own = faces.iter().filter(|&&f| self.normal(f) != DVec3::ZERO);
            let of = own.map(|&f| {
                let n = vec3a(self.normal(f));
                Below { low: n, high: n, spread: self.spread[f as usize] }
            });
            of.fold(Below::EMPTY, Below::and)
        };
        self.tree.summaries(Below::EMPTY, of_leaf, |_, [left, right]| left.and(right))
    }
}

/// The largest coordinate of a surface, without its sign.
pub(super) fn largest_coordinate(surface: &Surface) -> f64 {
    surface.positions.iter().fold(0.0, |most, p| most.max(p.abs().max_element()))
}

/// The unit normal of a triangle, or zero if rounding of the coordinates makes it unreliable.
fn reliable_normal([a, b, c]: [DVec3; 3], largest: f64) -> DVec3 {
    let sides = [b - a, c - b, a - c];
    let longest = sides.iter().fold(0.0f64, |m, side| m.max(side.length()));
    let area = sides[0].cross(sides[1]);
    let length = area.length();
    let height = length / longest;
    if longest > 0.0 && height > FLAT * largest && height > NEEDLE * longest { area / length } else { DVec3::ZERO }
}
