//! What surrounds each connected piece of a surface, by rays from infinity.

use std::cmp::Ordering;

use glam::DVec3;

use crate::math::{Crossing, Sign, Tree, crossing, orient3d, ray_direction};
use crate::mesh::Surface;

/// Rays that are tried to find what surrounds a piece of the surface.
const ATTEMPTS: u32 = 16;
/// Length of a ray on the unit scale, where every coordinate is below 2: it starts outside of the model.
const RAY_LENGTH: f64 = 8.0;
/// How far a ray runs on behind the face that it aims at, on the unit scale.
const RAY_OVERSHOOT: f64 = 1e-3;
/// The error of a hit's parameter for a ray at right angles to the face.
const HIT_ERROR: f64 = 1e-14;
/// Budget of all rays: faces visited, a fixed allowance plus an allowance per face.
const BUDGET: u64 = 20_000_000;
const BUDGET_PER_FACE: u64 = 16;

/// A face that a ray passes through.
struct RayHit {
    face: u32,
    /// The parameter along the ray, and its error.
    parameter: f64,
    error: f64,
    /// Whether the ray passes from the front of the face to its back.
    enters: bool,
}

/// Finds what surrounds each connected piece of a surface.
pub(super) struct Nesting<'a> {
    unit: &'a [DVec3],
    faces: &'a [[u32; 3]],
    /// For each face the smallest face of its piece.
    piece_of: Vec<u32>,
    /// For each face the largest face of its piece, at the index of the piece.
    largest: Vec<u32>,
    tree: Tree,
    budget: u64,
}

impl<'a> Nesting<'a> {
    /// `unit` has the positions on the unit scale, and `piece_of` for each face the smallest face of its piece.
    pub fn new(surface: &'a Surface, unit: &'a [DVec3], piece_of: Vec<u32>) -> Self {
        let tree = Tree::new(unit, &surface.faces);
        let budget = BUDGET + BUDGET_PER_FACE * surface.faces.len() as u64;
        let mut nesting = Self { unit, faces: &surface.faces, largest: piece_of.clone(), piece_of, tree, budget };
        for face in (0u32..).take(surface.faces.len()) {
            let piece = nesting.piece_of[face as usize] as usize;
            if nesting.doubled_area_squared(face) > nesting.doubled_area_squared(nesting.largest[piece]) {
                nesting.largest[piece] = face;
            }
        }
        nesting
    }

    fn corners(&self, face: u32) -> [DVec3; 3] {
        self.faces[face as usize].map(|v| self.unit[v as usize])
    }

    fn doubled_area_squared(&self, face: u32) -> f64 {
        let [a, b, c] = self.corners(face);
        (b - a).cross(c - a).length_squared()
    }

    /// The pieces, each by its smallest face.
    pub fn pieces(&self) -> Vec<u32> {
        let own = (0u32..).zip(&self.piece_of).filter(|&(face, &piece)| face == piece);
        own.map(|(face, _)| face).collect()
    }

    /// For each face whether it bounds nothing: it has a repeated vertex, or no face of its piece has an area.
    pub fn flat_faces(&self) -> Vec<bool> {
        let encloses_nothing = |piece: u32| self.doubled_area_squared(self.largest[piece as usize]) == 0.0;
        let has_repeated_vertex = |[a, b, c]: [u32; 3]| a == b || b == c || c == a;
        self.faces
            .iter()
            .zip(&self.piece_of)
            .map(|(&f, &piece)| has_repeated_vertex(f) || encloses_nothing(piece))
            .collect()
    }

    /// The outer side of a piece, and the side around it: along a ray from infinity to the piece, its first side, and the last side
    /// before it. `None` if that is undecided.
    pub fn surroundings(&mut self, piece: u32, infinity: u32) -> Option<[u32; 2]> {
        let face = self.largest[piece as usize];
        let centre = self.corners(face).iter().sum::<DVec3>() / 3.0;
        (0..ATTEMPTS).find_map(|attempt| {
            let direction = ray_direction(attempt);
            let hits = self.hits(centre + direction * RAY_LENGTH, centre - direction * RAY_OVERSHOOT)?;
            let (own, others): (Vec<RayHit>, Vec<RayHit>) =
                hits.into_iter().partition(|hit| self.piece_of[hit.face as usize] == piece);
            let first = self.extreme(&own, Ordering::Less)?;
            let mut before = Vec::new();
            for hit in others {
                if self.order(&hit, first)? == Ordering::Less {
                    before.push(hit);
                }
            }
            let around = if before.is_empty() {
                infinity
            } else {
                let last = self.extreme(&before, Ordering::Greater)?;
                2 * last.face + u32::from(last.enters)
            };
            Some([2 * first.face + u32::from(!first.enters), around])
        })
    }

    /// The first or the last of some hits of a ray; `None` if there is no hit, or if the order of two is uncertain.
    fn extreme<'h>(&self, hits: &'h [RayHit], wanted: Ordering) -> Option<&'h RayHit> {
        let (first, rest) = hits.split_first()?;
        rest.iter().try_fold(first, |best, hit| Some(if self.order(hit, best)? == wanted { hit } else { best }))
    }

    /// The order of two hits along their ray; `None` if it is uncertain. Where the parameters are too close, it is exact: a face that
    /// lies on one side of another's plane is hit before or after it.
    fn order(&self, a: &RayHit, b: &RayHit) -> Option<Ordering> {
        if (a.parameter - b.parameter).abs() > 2.0 * a.error.max(b.error) {
            return Some(a.parameter.total_cmp(&b.parameter));
        }
        // The order of `other` relative to `face`, which the ray passes through once.
        let relative = |face: &RayHit, other: &RayHit| {
            let [p, q, r] = self.corners(face.face);
            let sides = self.corners(other.face).map(|corner| orient3d(p, q, r, corner));
            let is_behind = sides.contains(&Sign::Positive);
            let is_on_one_side = is_behind != sides.contains(&Sign::Negative);
            let order = if is_behind == face.enters { Ordering::Greater } else { Ordering::Less };
            is_on_one_side.then_some(order)
        };
        relative(b, a).or_else(|| relative(a, b).map(Ordering::reverse))
    }

    /// The faces that a ray passes through. `None` if it touches one, or if the budget ran out.
    fn hits(&mut self, from: DVec3, to: DVec3) -> Option<Vec<RayHit>> {
        let (mut hits, mut clear, mut budget) = (Vec::new(), true, self.budget);
        self.tree.along(from, to, |face| {
            budget = budget.saturating_sub(1);
            let corners = self.corners(face);
            match crossing(from, to, corners) {
                Crossing::Miss => {}
                Crossing::Touches => clear = false,
                found @ (Crossing::Enters | Crossing::Leaves) => {
                    hits.push(ray_hit(face, corners, [from, to], found == Crossing::Enters));
                }
            }
            clear && budget > 0
        });
        self.budget = budget;
        (clear && budget > 0).then_some(hits)
    }
}

fn ray_hit(face: u32, [a, b, c]: [DVec3; 3], [from, to]: [DVec3; 2], enters: bool) -> RayHit {
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let slope = normal.dot(to - from);
    let parameter = normal.dot(a - from) / slope;
    // A face seen edge-on or without a normal gets an error that excludes the ray.
    let error = if slope == 0.0 { f64::INFINITY } else { HIT_ERROR * RAY_LENGTH / slope.abs() };
    RayHit { face, parameter, error, enters }
}
