//! Refinement: splits the edges of faces on which the growth varies, so that it is nearly linear on each piece.

use crate::context::{Cancelled, Context};
use crate::math::Precision;
use crate::mesh::Surface;
use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::growth::Growths;

/// The most passes. Each halves the longest edges once.
const MAX_PASSES: usize = 40;
/// The most neighbours on the way to an edge that is split, and the most splits until a piece itself is split.
const MAX_PATH: usize = 64;
/// Pieces whose longest edge is below this share of the least wall are not split.
const FINEST: f64 = 0.5;
/// The largest difference between the growth and its linear interpolation, as a share of the least wall.
const TOLERANCE: f64 = 0.015;
/// The most splits: a constant and a number for each face.
const MAX_SPLITS: usize = 20_000;
const MAX_SPLITS_PER_FACE: usize = 2;

/// A corner of a face of the surface: where the face has a vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FaceCorner {
    /// The vertex.
    pub vertex: u32,
    /// The face of the surface, before it was split into pieces.
    pub face: u32,
}

/// A surface with some edges split. Pieces know the face that they belong to.
pub struct Refined {
    /// Positions: those of the surface, then the new ones.
    pub positions: Vec<DVec3>,
    /// The pieces.
    pub faces: Vec<[u32; 3]>,
    /// For each piece, the face of the surface that it belongs to.
    pub parent: Vec<u32>,
    /// The growth at each corner of a thin face, in the model's unit.
    pub growth: FxHashMap<FaceCorner, f64>,
    /// For each face of the surface, the largest growth that a point of it needs. `growth` can be larger, so that it suffices between the
    /// corners. Only [`Refined::new`] fills it.
    pub largest: Vec<f64>,
    /// The face of each half-edge. An edge with more than two faces has none.
    half_edges: FxHashMap<(u32, u32), u32>,
    precision: Precision,
}

impl Refined {
    /// Refines the faces of a surface until the growth is nearly linear on each piece.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn new(
        surface: &Surface,
        growths: &Growths<'_>,
        precision: Precision,
        context: &Context<'_>,
    ) -> Result<Self, Cancelled> {
        let mut refined = Self {
            positions: surface.positions.clone(),
            faces: surface.faces.clone(),
            parent: (0u32..).take(surface.faces.len()).collect(),
            growth: FxHashMap::default(),
            largest: Vec::new(),
            half_edges: half_edges(&surface.faces),
            precision,
        };
        let mut active: Vec<u32> = (0u32..).take(surface.faces.len()).filter(|&f| growths.is_thin(f)).collect();
        let mut splits = MAX_SPLITS + MAX_SPLITS_PER_FACE * surface.faces.len();
        for _ in 0..MAX_PASSES {
            refined.evaluate(&active, growths, context)?;
            let is_far = context.map_in_parallel(&active, |&face| refined.is_far_from_linear(face, growths))?;
            let mut changed: Vec<u32> = Vec::new();
            for (&face, _) in active.iter().zip(is_far).filter(|(_, is_far)| *is_far) {
                let before = refined.faces[face as usize];
                // A split of a neighbour may have split the piece already.
                let is_left = |refined: &Self| refined.faces[face as usize] == before;
                for _ in 0..MAX_PATH {
                    if splits == 0 || !is_left(&refined) {
                        break;
                    }
                    let new = refined.split_towards(face, growths);
                    if new.is_empty() {
                        break;
                    }
                    splits -= 1;
                    changed.extend(new);
                }
            }
            changed.sort_unstable();
            changed.dedup();
            changed.retain(|&face| growths.is_thin(refined.parent[face as usize]));
            if changed.is_empty() {
                break;
            }
            active = changed;
            refined.evaluate(&active, growths, context)?;
        }
        refined.largest = largest(&refined.growth, growths, surface.faces.len());
        refined.raise(growths, context)?;
        Ok(refined)
    }

    /// The faces of a surface as they are, with the growth at their corners.
    pub fn unsplit(surface: &Surface, growth: FxHashMap<FaceCorner, f64>, precision: Precision) -> Self {
        Self {
            positions: surface.positions.clone(),
            faces: surface.faces.clone(),
            parent: (0u32..).take(surface.faces.len()).collect(),
            growth,
            largest: Vec::new(),
            half_edges: FxHashMap::default(),
            precision,
        }
    }

    /// The same pieces, of which only those grow whose face takes part.
    pub fn only(&self, takes_part: impl Fn(u32) -> bool) -> Self {
        let mut growth = self.growth.clone();
        growth.retain(|corner, _| takes_part(corner.face));
        let (half_edges, largest) = (FxHashMap::default(), Vec::new());
        let (positions, faces, parent) = (self.positions.clone(), self.faces.clone(), self.parent.clone());
        Self { positions, faces, parent, growth, largest, half_edges, precision: self.precision }
    }

    /// The growth at corner `k` of a piece.
    pub fn corner_growth(&self, face: u32, k: usize) -> f64 {
        self.growth_at(self.corner(face, self.faces[face as usize][k]))
    }

    /// The growth at a corner.
    pub fn growth_at(&self, corner: FaceCorner) -> f64 {
        self.growth.get(&corner).copied().unwrap_or(0.0)
    }

    /// The corner where a piece has a vertex, of the face that the piece belongs to.
    pub fn corner(&self, piece: u32, vertex: u32) -> FaceCorner {
        FaceCorner { vertex, face: self.parent[piece as usize] }
    }

    /// The corner positions of a piece.
    pub fn corners(&self, face: u32) -> [DVec3; 3] {
        self.faces[face as usize].map(|v| self.positions[v as usize])
    }

    /// Evaluates the growth at the corners of pieces.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    fn evaluate(&mut self, faces: &[u32], growths: &Growths<'_>, context: &Context<'_>) -> Result<(), Cancelled> {
        let mut keys: Vec<FaceCorner> = faces
            .iter()
            .flat_map(|&face| self.faces[face as usize].map(|v| self.corner(face, v)))
            .filter(|key| !self.growth.contains_key(key))
            .collect();
        keys.sort_unstable();
        keys.dedup();
        let at = |key: &FaceCorner| growths.at(self.positions[key.vertex as usize], key.face);
        let values = context.map_in_parallel(&keys, at)?;
        self.growth.extend(keys.into_iter().zip(values));
        Ok(())
    }

    /// The longest edge of a piece, with its length. Equal edges are ordered by their vertices.
    fn longest_edge(&self, face: u32) -> (f64, [u32; 2]) {
        longest_edge(&self.positions, self.faces[face as usize])
    }

    /// Splits the longest edge of a piece, or first that of a neighbour of which this edge is not the longest: the path
    /// to a terminal edge of Rivara 1997, which keeps the angles. Returns the pieces that changed or are new.
    fn split_towards(&mut self, face: u32, growths: &Growths<'_>) -> Vec<u32> {
        let mut at = face;
        let mut edge = self.longest_edge(at).1;
        for _ in 0..MAX_PATH {
            let neighbour = [(edge[0], edge[1]), (edge[1], edge[0])]
                .into_iter()
                .filter_map(|half_edge| self.half_edges.get(&half_edge).copied())
                .find(|&other| other != at);
            let Some(next) = neighbour.filter(|&next| growths.is_thin(self.parent[next as usize])) else { break };
            let longest = self.longest_edge(next).1;
            if longest == edge {
                break;
            }
            (at, edge) = (next, longest);
        }
        self.split(edge)
    }

    /// Whether the growth on a piece is far from linear, and the piece is large enough to be split.
    fn is_far_from_linear(&self, face: u32, growths: &Growths<'_>) -> bool {
        let corners = self.corners(face);
        let (length, edge) = self.longest_edge(face);
        if length <= FINEST * growths.min_wall() {
            return false;
        }
        let parent = self.parent[face as usize];
        let tolerance = TOLERANCE * growths.min_wall();
        let at_corners = [0, 1, 2].map(|k| self.corner_growth(face, k));
        let is_off = |weights: [f64; 3]| {
            let point = corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2];
            let linear: f64 = (0..3).map(|k| at_corners[k] * weights[k]).sum();
            (growths.at(point, parent) - linear).abs() > tolerance
        };
        let middle = self.faces[face as usize].map(|v| if edge.contains(&v) { 0.5 } else { 0.0 });
        is_off([1.0 / 3.0; 3])
            || is_off(middle)
            || growths.witnesses(parent).iter().any(|witness| {
                weights(witness.point, corners)
                    .is_some_and(|w| witness.growth - (0..3).map(|k| at_corners[k] * w[k]).sum::<f64>() > tolerance)
            })
    }

    /// Splits an edge in the middle. Returns the pieces that changed or are new; none if the edge cannot be split.
    fn split(&mut self, [a, b]: [u32; 2]) -> Vec<u32> {
        let (Some(&f), Some(&g)) = (self.half_edges.get(&(a, b)), self.half_edges.get(&(b, a))) else {
            return Vec::new();
        };
        let middle = self.precision.round(self.positions[a as usize].midpoint(self.positions[b as usize]));
        let m = index(self.positions.len());
        self.positions.push(middle);
        let opposite = |face: u32| self.faces[face as usize].into_iter().find(|&v| v != a && v != b);
        let (Some(c), Some(d)) = (opposite(f), opposite(g)) else {
            self.positions.pop();
            return Vec::new();
        };
        let pieces = [(f, [a, m, c]), (f, [m, b, c]), (g, [b, m, d]), (g, [m, a, d])];
        let area = |[a, b, c]: [u32; 3]| {
            let [a, b, c] = [a, b, c].map(|v| self.positions[v as usize]);
            (b - a).cross(c - a)
        };
        let keeps_side = |&(face, piece): &(u32, [u32; 3])| area(piece).dot(area(self.faces[face as usize])) > 0.0;
        if !pieces.iter().all(keeps_side) {
            self.positions.pop();
            return Vec::new();
        }
        let (new_f, new_g) = (index(self.faces.len()), index(self.faces.len() + 1));
        self.half_edges.remove(&(a, b));
        self.half_edges.remove(&(b, a));
        self.faces[f as usize] = pieces[0].1;
        self.faces[g as usize] = pieces[2].1;
        self.faces.extend([pieces[1].1, pieces[3].1]);
        self.parent.extend([self.parent[f as usize], self.parent[g as usize]]);
        for face in [f, new_f, g, new_g] {
            let [x, y, z] = self.faces[face as usize];
            for half_edge in [(x, y), (y, z), (z, x)] {
                let is_new = half_edge.0 == m || half_edge.1 == m;
                if is_new || self.half_edges.contains_key(&half_edge) {
                    self.half_edges.insert(half_edge, face);
                }
            }
        }
        vec![f, new_f, g, new_g]
    }

    /// Raises the growth at the corners of pieces where a sample or a witness of a thin wall needs more.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    fn raise(&mut self, growths: &Growths<'_>, context: &Context<'_>) -> Result<(), Cancelled> {
        let faces: Vec<u32> = (0..index(self.faces.len())).collect();
        let lacks = context.map_in_parallel(&faces, |&face| self.lack(face, growths))?;
        // Pieces share corners, so that each corner takes the largest of its pieces' lacks once.
        let mut most: FxHashMap<FaceCorner, f64> = FxHashMap::default();
        for (face, lack) in faces.into_iter().zip(lacks).filter(|(_, lack)| *lack > 0.0) {
            for v in self.faces[face as usize] {
                let at = most.entry(self.corner(face, v)).or_insert(0.0);
                *at = at.max(lack);
            }
        }
        for (key, more) in most {
            *self.growth.entry(key).or_insert(0.0) += more;
        }
        Ok(())
    }

    /// How far the growth on a piece is below what it needs.
    fn lack(&self, face: u32, growths: &Growths<'_>) -> f64 {
        let parent = self.parent[face as usize];
        if !growths.is_thin(parent) {
            return 0.0;
        }
        let corners = self.corners(face);
        let at_corners = [0, 1, 2].map(|k| self.corner_growth(face, k));
        let linear = |w: [f64; 3]| (0..3).map(|k| at_corners[k] * w[k]).sum::<f64>();
        let mut lack = 0.0f64;
        for witness in growths.witnesses(parent) {
            if let Some(w) = weights(witness.point, corners) {
                lack = lack.max(witness.growth - linear(w));
            }
        }
        if self.longest_edge(face).0 > FINEST * growths.min_wall() {
            for w in [[1.0 / 3.0; 3], [0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]] {
                let point = corners[0] * w[0] + corners[1] * w[1] + corners[2] * w[2];
                lack = lack.max(growths.at(point, parent) - linear(w));
            }
        }
        lack
    }
}

/// For each face of the surface, the largest growth at its corners and at the witnesses of its thin walls.
fn largest(growth: &FxHashMap<FaceCorner, f64>, growths: &Growths<'_>, faces: usize) -> Vec<f64> {
    let of_witnesses = |face| growths.witnesses(face).iter().map(|witness| witness.growth).fold(0.0, f64::max);
    let mut largest: Vec<f64> = (0..index(faces)).map(of_witnesses).collect();
    for (corner, &growth) in growth {
        let of_face = &mut largest[corner.face as usize];
        *of_face = of_face.max(growth);
    }
    largest
}

/// The longest edge of a face, with its length. Equal edges are ordered by their vertices.
pub fn longest_edge(positions: &[DVec3], [a, b, c]: [u32; 3]) -> (f64, [u32; 2]) {
    let at = |v: u32| positions[v as usize];
    let edge = |a: u32, b: u32| (at(a).distance(at(b)), [a.min(b), a.max(b)]);
    let longer = |x: (f64, [u32; 2]), y: (f64, [u32; 2])| if (y.0, y.1) > (x.0, x.1) { y } else { x };
    longer(edge(a, b), longer(edge(b, c), edge(c, a)))
}

/// The face of each half-edge that only one face has.
fn half_edges(faces: &[[u32; 3]]) -> FxHashMap<(u32, u32), u32> {
    let mut of_face: FxHashMap<(u32, u32), u32> = FxHashMap::default();
    let mut several: FxHashSet<(u32, u32)> = FxHashSet::default();
    for (face, &[a, b, c]) in (0u32..).zip(faces) {
        for half_edge in [(a, b), (b, c), (c, a)] {
            if of_face.insert(half_edge, face).is_some() {
                several.insert(half_edge);
            }
        }
    }
    of_face.retain(|half_edge, _| !several.contains(half_edge));
    of_face
}

/// The barycentric weights of a point on a triangle, if it lies in the triangle.
fn weights(p: DVec3, [a, b, c]: [DVec3; 3]) -> Option<[f64; 3]> {
    let normal = (b - a).cross(c - a);
    let area = normal.length_squared();
    let w = [(b - p).cross(c - p), (c - p).cross(a - p), (a - p).cross(b - p)].map(|part| part.dot(normal) / area);
    w.iter().all(|&w| w >= -1e-9).then_some(w)
}

/// The index of the item after `count` vertices or faces.
#[expect(clippy::cast_possible_truncation, reason = "vertices and faces are counted in u32")]
pub fn index(count: usize) -> u32 {
    count as u32
}
