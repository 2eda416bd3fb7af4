//! The layer: prisms on the thin faces, as high as the growth, whose sides meet in mitres.
//!
//! The prisms stand on pieces of the surface itself, so that the surface with the layer is the surface with these pieces
//! replaced by the tops of the prisms. Where a thin face ends at an edge, a wall joins its top to the edge:
//!
//! ```text
//!                        +----------+   tops
//!    +----------+        |          |
//!    |          |   ->   +          +   the sides of the plate stay
//!    +----------+        |          |
//!                        +----------+
//! ```

use crate::context::{Cancelled, Context};
use crate::math::Precision;
use crate::mesh::{Stars, Surface, position_key};
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

use super::mitre::{Plane, mitre};
use super::refine::{Refined, index};
use super::walls::{noise_of, trusted_normal};

/// Cosine of the angle up to which faces at an edge are one smooth surface, on which the growth fades out.
pub const SMOOTH: f64 = 0.866_025_403_784_438_6;
/// Cosine of the angle between thin faces up to which their tops meet in a mitre.
const MITRED: f64 = -0.3;
/// Cosine of the angle up to which pieces count as coplanar: 8 degrees.
const COPLANAR: f64 = 0.99;
/// The most rounds in which mitres are given up at the corners of tops that turn over.
const MAX_PLAIN_ROUNDS: usize = 6;
/// How deep a wall goes behind the face at a concave edge, as a share of the growth.
const DEPTH: f64 = 0.3;
/// Cosine of the largest angle between a face and its top.
const LEAST_TOP_COSINE: f64 = 0.02;

/// A surface with a layer on its thin faces.
pub struct Layered {
    /// The surface: closed, but its faces may intersect.
    pub surface: Surface,
    /// For each face that is a top, its piece.
    pub piece: Vec<Option<u32>>,
    /// For each face, the face of the surface that its piece belongs to.
    pub parent: Vec<u32>,
    /// Whether some faces of flat regions face back.
    pub is_folded: bool,
}

impl Layered {
    /// Removes the faces that face back, compared with the normals of the faces of the surface before.
    pub fn drop_faces_that_face_back(&mut self, normal_before: impl Fn(u32) -> DVec3) {
        let faces_on = |face: usize| self.surface.area_vector(face).dot(normal_before(self.parent[face])) >= 0.0;
        let keep: Vec<bool> = (0..self.parent.len()).map(faces_on).collect();
        self.surface.retain_faces(&keep);
        self.piece = kept(&self.piece, &keep);
        self.parent = kept(&self.parent, &keep);
    }
}

/// The items whose flag is set.
fn kept<T: Copy>(items: &[T], keep: &[bool]) -> Vec<T> {
    items.iter().zip(keep).filter(|(_, keep)| **keep).map(|(item, _)| *item).collect()
}

/// Puts a layer on a refined surface. Faces of the layer get the source of their piece plus `added`.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn layered(
    refined: &Refined,
    source: &[u32],
    added: u32,
    precision: Precision,
    context: &Context<'_>,
) -> Result<Layered, Cancelled> {
    let tops = Tops::new(refined, precision, context)?;
    let mut builder = Builder::new(refined);
    let mut piece: Vec<Option<u32>> = Vec::new();
    let mut parent: Vec<u32> = Vec::new();
    for face in 0..index(refined.faces.len()) {
        let own = refined.parent[face as usize];
        let carrier = source[own as usize];
        let Some(top) = tops.of_face(face) else {
            builder.surface.faces.push(refined.faces[face as usize]);
            builder.surface.source.push(carrier);
            parent.push(own);
            continue;
        };
        let carrier = carrier % added + added;
        let ids = builder.vertices(refined.faces[face as usize], top);
        piece.resize(builder.surface.faces.len(), None);
        builder.push(ids, carrier);
        piece.resize(builder.surface.faces.len(), Some(face));
        for k in 0..3 {
            if !tops.is_continued(face, k) {
                let [u, v] = [k, (k + 1) % 3].map(|k| refined.faces[face as usize][k]);
                builder.push_wall([u, v], [ids[k], ids[(k + 1) % 3]], carrier);
            }
        }
        parent.resize(builder.surface.faces.len(), own);
    }
    let mut surface = builder.surface;
    surface.drop_unreferenced();
    piece.resize(surface.faces.len(), None);
    Ok(Layered { surface, piece, parent, is_folded: false })
}

/// The tops of the pieces.
struct Tops<'a> {
    refined: &'a Refined,
    /// For each piece, the places of its corners; none for a piece outside the layer.
    places: Vec<Option<[DVec3; 3]>>,
    half_edges: FxHashMap<(u32, u32), u32>,
}

impl<'a> Tops<'a> {
    fn new(refined: &'a Refined, precision: Precision, context: &Context<'_>) -> Result<Self, Cancelled> {
        let normals = trusted_normals(refined);
        let stars = Stars::new(refined.positions.len(), &refined.faces);
        let mut growing: Vec<u32> =
            refined.growth.iter().filter(|(_, g)| **g > 0.0).map(|(corner, _)| corner.vertex).collect();
        growing.sort_unstable();
        growing.dedup();
        let mut is_plain = vec![false; refined.positions.len()];
        let mut tops = Self { refined, places: Vec::new(), half_edges: FxHashMap::default() };
        for _ in 0..MAX_PLAIN_ROUNDS {
            context.check()?;
            tops.place(&growing, (&normals, &stars), &is_plain, precision);
            let turned: Vec<u32> =
                (0..index(refined.faces.len())).filter(|&face| tops.is_turned(face, &normals)).collect();
            let mut is_new = false;
            for v in turned.into_iter().flat_map(|face| refined.faces[face as usize]) {
                is_new |= !std::mem::replace(&mut is_plain[v as usize], true);
            }
            if !is_new {
                break;
            }
        }
        tops.straighten(&normals, precision);
        for (face, &[a, b, c]) in (0u32..).zip(&refined.faces) {
            for half_edge in [(a, b), (b, c), (c, a)] {
                if tops.half_edges.insert(half_edge, face).is_some() {
                    // Of several faces at a half-edge none continues another.
                    tops.half_edges.insert(half_edge, u32::MAX);
                }
            }
        }
        Ok(tops)
    }

    /// Places the corners of all tops.
    fn place(
        &mut self,
        growing: &[u32],
        (normals, stars): (&[DVec3], &Stars),
        is_plain: &[bool],
        precision: Precision,
    ) {
        let refined = self.refined;
        let offsets: Vec<SmallVec<[(u32, DVec3); 8]>> = growing
            .par_iter()
            .map(|&v| {
                let is_plain = is_plain[v as usize];
                Corner { refined, normals, star: stars.of(v), vertex: v, is_plain }.offsets()
            })
            .collect();
        self.places = vec![None; refined.faces.len()];
        for (&v, offsets) in growing.iter().zip(&offsets) {
            for &(face, offset) in offsets {
                let place = self.places[face as usize].get_or_insert_with(|| refined.corners(face));
                if let Some(k) = refined.faces[face as usize].iter().position(|&w| w == v) {
                    place[k] = precision.round(place[k] + offset);
                }
            }
        }
    }

    /// Whether the prism under a top is turned over somewhere.
    fn is_turned(&self, face: u32, normals: &[DVec3]) -> bool {
        let Some(top) = self.places[face as usize] else { return false };
        let (corners, own) = (self.refined.corners(face), normals[face as usize]);
        let half = [0, 1, 2].map(|k| corners[k].midpoint(top[k]));
        top != corners && (normal(top).dot(own) < LEAST_TOP_COSINE || normal(half).dot(own) < LEAST_TOP_COSINE)
    }

    /// Replaces tops that turn over: by straight ones on thin pieces, and by none on others.
    fn straighten(&mut self, normals: &[DVec3], precision: Precision) {
        for face in 0..index(self.places.len()) {
            if !self.is_turned(face, normals) {
                continue;
            }
            let (corners, own) = (self.refined.corners(face), normals[face as usize]);
            let growth = [0, 1, 2].map(|k| self.refined.corner_growth(face, k));
            let straight = [0, 1, 2].map(|k| precision.round(corners[k] + own * growth[k]));
            self.places[face as usize] = Some(straight);
            if self.is_turned(face, normals) {
                self.places[face as usize] = None;
            }
        }
    }

    /// The corners of the top of a piece, if it has one.
    fn of_face(&self, face: u32) -> Option<[DVec3; 3]> {
        let top = self.places[face as usize]?;
        (top != self.refined.corners(face)).then_some(top)
    }

    /// Whether the top of the neighbour at edge `k` of a piece continues the top of the piece.
    fn is_continued(&self, face: u32, k: usize) -> bool {
        let corners = self.refined.faces[face as usize];
        let [u, v] = [corners[k], corners[(k + 1) % 3]];
        let alone = self.half_edges.get(&(u, v)) == Some(&face);
        let Some(&other) = self.half_edges.get(&(v, u)).filter(|&&other| alone && other != u32::MAX) else {
            return false;
        };
        let place = |face: u32, v: u32| {
            let at = self.refined.faces[face as usize].iter().position(|&w| w == v)?;
            self.places[face as usize].map(|top| top[at])
        };
        let or_base = |face: u32, v: u32| place(face, v).unwrap_or(self.refined.positions[v as usize]);
        or_base(face, u) == or_base(other, u) && or_base(face, v) == or_base(other, v)
    }
}

/// The normals of the pieces; zero where rounding decides them.
pub fn trusted_normals(refined: &Refined) -> Vec<DVec3> {
    let noise = noise_of(&refined.positions);
    (0..index(refined.faces.len())).map(|face| trusted_normal(refined.corners(face), noise)).collect()
}

/// A vertex with the pieces around it.
struct Corner<'a> {
    refined: &'a Refined,
    normals: &'a [DVec3],
    star: &'a [u32],
    vertex: u32,
    /// Whether only coplanar pieces share the vertex's place, and neighbours do not bound it.
    is_plain: bool,
}

impl Corner<'_> {
    /// The offset of the vertex for each piece that grows.
    fn offsets(&self) -> SmallVec<[(u32, DVec3); 8]> {
        let growth: SmallVec<[f64; 8]> = self.star.iter().map(|&face| self.growth(face)).collect();
        let group = self.groups(&growth);
        let mut offsets = SmallVec::new();
        for root in (0..self.star.len()).filter(|&i| group[i] == i) {
            let members: SmallVec<[usize; 8]> = (0..self.star.len()).filter(|&i| group[i] == root).collect();
            if members.iter().all(|&i| growth[i] <= 0.0) {
                continue;
            }
            let planes = self.planes(&members, &group, &growth);
            let offset = mitre(&planes);
            offsets.extend(members.iter().map(|&i| (self.star[i], offset)));
        }
        offsets
    }

    fn growth(&self, face: u32) -> f64 {
        self.refined.growth_at(self.refined.corner(face, self.vertex))
    }

    fn normal(&self, i: usize) -> DVec3 {
        self.normals[self.star[i] as usize]
    }

    /// The group of each piece: pieces of one group share the vertex's place on their tops.
    fn groups(&self, growth: &[f64]) -> SmallVec<[usize; 8]> {
        let mut group: SmallVec<[usize; 8]> = (0..self.star.len()).collect();
        for i in 0..self.star.len() {
            for j in 0..i {
                let cosine = self.normal(i).dot(self.normal(j));
                let least = if self.is_plain { COPLANAR } else { SMOOTH };
                let is_smooth = cosine >= least || self.normal(i) == DVec3::ZERO || self.normal(j) == DVec3::ZERO;
                let is_mitred = !self.is_plain && growth[i] > 0.0 && growth[j] > 0.0 && cosine >= MITRED;
                if (is_smooth || is_mitred) && group[i] != group[j] && self.are_neighbours(i, j) {
                    let [low, high] = [group[i].min(group[j]), group[i].max(group[j])];
                    group.iter_mut().filter(|g| **g == high).for_each(|g| *g = low);
                }
            }
        }
        group
    }

    /// Whether two pieces share an edge at the vertex.
    fn are_neighbours(&self, i: usize, j: usize) -> bool {
        let [f, g] = [i, j].map(|i| self.refined.faces[self.star[i] as usize]);
        f.iter().any(|&w| w != self.vertex && g.contains(&w))
    }

    /// The planes that bound the offset of a group. At a concave edge the layer goes into the neighbour, and then also
    /// behind the planes at convex edges, so that no wall lies in a plane of the surface.
    fn planes(&self, members: &[usize], group: &[usize], growth: &[f64]) -> Vec<Plane> {
        let mut planes: Vec<Plane> = members
            .iter()
            .filter(|&&i| growth[i] > 0.0 && self.normal(i) != DVec3::ZERO)
            .map(|&i| Plane { normal: self.normal(i), distance: growth[i], is_top: true })
            .collect();
        let most = planes.iter().map(|plane| plane.distance).fold(0.0, f64::max);
        if self.is_plain {
            return planes;
        }
        let mut neighbours: SmallVec<[usize; 8]> = SmallVec::new();
        let mut is_flush = true;
        for &i in members {
            for j in 0..self.star.len() {
                let is_outside = group[j] != group[i] && growth[j] <= 0.0;
                if is_outside && self.normal(j) != DVec3::ZERO && self.are_neighbours(i, j) {
                    neighbours.push(j);
                    is_flush &= self.is_convex(i, j);
                }
            }
        }
        let distance = if is_flush { 0.0 } else { -DEPTH * most };
        planes.extend(neighbours.iter().map(|&j| Plane { normal: self.normal(j), distance, is_top: false }));
        planes
    }

    /// Whether the edge between two pieces is convex: the second lies behind the first.
    fn is_convex(&self, i: usize, j: usize) -> bool {
        let [f, g] = [i, j].map(|i| self.star[i]);
        let far = self.refined.faces[g as usize].iter().find(|v| !self.refined.faces[f as usize].contains(v));
        let origin = self.refined.positions[self.vertex as usize];
        far.is_some_and(|&v| (self.refined.positions[v as usize] - origin).dot(self.normal(i)) < 0.0)
    }
}

/// Collects the faces of the layered surface, with one vertex for each position.
struct Builder {
    surface: Surface,
    at: FxHashMap<[u64; 3], u32>,
}

impl Builder {
    fn new(refined: &Refined) -> Self {
        let at = (0u32..).zip(&refined.positions).map(|(v, &p)| (position_key(p), v)).collect();
        Self { surface: Surface { positions: refined.positions.clone(), ..Surface::default() }, at }
    }

    /// The vertices at the corners of a top.
    fn vertices(&mut self, base: [u32; 3], top: [DVec3; 3]) -> [u32; 3] {
        let mut ids = base;
        for (id, place) in ids.iter_mut().zip(top) {
            if self.surface.positions[*id as usize] != place {
                let next = index(self.surface.positions.len());
                *id = *self.at.entry(position_key(place)).or_insert(next);
                if *id == next {
                    self.surface.positions.push(place);
                }
            }
        }
        ids
    }

    /// Adds a wall from an edge of a piece to the same edge of its top. The diagonal starts at the smaller vertex, so
    /// that the walls of both pieces at an edge coincide where their tops do.
    fn push_wall(&mut self, [u, v]: [u32; 2], [top_u, top_v]: [u32; 2], source: u32) {
        let faces = if u < v { [[u, v, top_v], [u, top_v, top_u]] } else { [[u, v, top_u], [v, top_v, top_u]] };
        faces.into_iter().for_each(|face| self.push(face, source));
    }

    /// Adds a face unless two of its corners coincide.
    fn push(&mut self, [a, b, c]: [u32; 3], source: u32) {
        if a != b && b != c && c != a {
            self.surface.faces.push([a, b, c]);
            self.surface.source.push(source);
        }
    }
}

fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a).normalize_or_zero()
}
