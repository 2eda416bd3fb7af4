//! Distances between the original and the simplified surface: bounds for each collapse, and measurements at witnesses.

use std::cell::OnceCell;

use glam::{DVec2, DVec3};

use super::dynamic_mesh::NONE;
use super::max_distance::Target;
use crate::math::{Tree, nearest_on_segment, nearest_on_triangle};

/// Cosine below which a face counts as vertical in the projection.
const MIN_UP_COSINE: f64 = 1e-3;
/// Relative length by which edges are extended, so that rounding misses no crossing.
const OVERREACH: f64 = 1e-9;

/// Not a witness yet: the vertex still exists at its original position.
const UNMOVED: u32 = NONE - 1;
/// Maximum witnesses evaluated at once. If there are more, only the farthest half of this number is kept.
const MAX_WITNESSES: usize = 256;

/// The faces around one or two vertices, before or after a collapse.
#[derive(Default)]
pub(super) struct Patch {
    /// The corner positions of the faces.
    pub faces: Vec<[DVec3; 3]>,
    /// The inner edges, from a vertex in the centre to one on the rim, with positions and vertex indices.
    pub spokes: Vec<([DVec3; 2], [u32; 2])>,
    /// The positions of the central vertices.
    pub centres: Vec<DVec3>,
}

impl Patch {
    /// Empties the patch.
    pub fn clear(&mut self) {
        self.faces.clear();
        self.spokes.clear();
        self.centres.clear();
    }
}

/// An upper bound of the distance between any point of one patch and the other patch, in both directions. Both patches
/// have the same rim.
///
/// Both patches are projected along their common normal. If no face is vertical or faces down, the projection maps one
/// patch to the other. The map is linear on each piece that the edges of both patches cut out. The largest displacement
/// therefore occurs at a corner of a piece: at a vertex, or where edges cross (Bajaj and Schikore 1996; Cohen, Manocha
/// and Olano 1997). Otherwise the result is none. `origin` is a nearby point.
pub(super) fn deviation(old: &Patch, new: &Patch, origin: DVec3) -> Option<f64> {
    let sum: DVec3 = old.faces.iter().map(|f| normal(*f)).sum();
    let up = sum.try_normalize()?;
    let faces_up = |f: &[DVec3; 3]| {
        let n = normal(*f);
        n.dot(up) > MIN_UP_COSINE * n.length()
    };
    if !old.faces.iter().all(faces_up) || !new.faces.iter().all(faces_up) {
        return None;
    }
    let (x, y) = up.any_orthonormal_pair();
    let frame = Frame { origin, x, y, up };
    let mut most = 0.0f64;
    for (patch, other) in [(old, new), (new, old)] {
        for &middle in &patch.centres {
            most = most.max(frame.height_over(middle, &other.faces));
        }
    }
    let flat = |patch: &Patch| -> Vec<_> {
        patch.spokes.iter().map(|(ends, ids)| (ends.map(|p| frame.flat(p)), *ids)).collect()
    };
    let (olds, news) = (flat(old), flat(new));
    for (a, ids_a) in &olds {
        for (b, ids_b) in &news {
            if !ids_a.iter().any(|id| ids_b.contains(id))
                && let Some(height) = height_where_they_cross(a, b)
            {
                most = most.max(height);
            }
        }
    }
    most.is_finite().then_some(most)
}

/// The displacement of a line when one of its vertices is removed: the distance of that vertex from the new edge.
pub(super) fn line_deviation(gone: DVec3, ends: [DVec3; 2]) -> f64 {
    gone.distance(nearest_on_segment(gone, ends))
}

fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// A projected point and its height.
type Raised = (DVec2, f64);

/// An orthonormal frame for the projection: two axes in the plane, and `up`.
struct Frame {
    origin: DVec3,
    x: DVec3,
    y: DVec3,
    up: DVec3,
}

impl Frame {
    /// Projects a point.
    fn flat(&self, p: DVec3) -> Raised {
        let d = p - self.origin;
        (DVec2::new(d.dot(self.x), d.dot(self.y)), d.dot(self.up))
    }

    /// The vertical distance of a point from faces; the Euclidean distance if the point is above or below none of them.
    fn height_over(&self, p: DVec3, faces: &[[DVec3; 3]]) -> f64 {
        let (at, height) = self.flat(p);
        let mut most: Option<f64> = None;
        for face in faces {
            let [(a, ha), (b, hb), (c, hc)] = face.map(|q| self.flat(q));
            let whole = (b - a).perp_dot(c - a);
            let shares = [(b - at).perp_dot(c - at), (c - at).perp_dot(a - at), (a - at).perp_dot(b - at)];
            if whole > 0.0 && shares.iter().all(|&s| s >= -OVERREACH * whole) {
                let over = (shares[0] * (ha - height) + shares[1] * (hb - height) + shares[2] * (hc - height)) / whole;
                most = Some(most.unwrap_or(0.0).max(over.abs()));
            }
        }
        most.unwrap_or_else(|| {
            faces.iter().map(|&f| p.distance(nearest_on_triangle(p, f))).fold(f64::INFINITY, f64::min)
        })
    }
}

/// The height difference of two edges where they cross in the projection; none if they do not cross.
fn height_where_they_cross(a: &[Raised; 2], b: &[Raised; 2]) -> Option<f64> {
    let (u, v, between) = (a[1].0 - a[0].0, b[1].0 - b[0].0, b[0].0 - a[0].0);
    let turn = u.perp_dot(v);
    // Most edges do not cross, and signs decide that without a division.
    let (s, t) = (between.perp_dot(v), between.perp_dot(u));
    let slack = OVERREACH * turn.abs();
    let (low, high) = (turn.min(0.0) - slack, turn.max(0.0) + slack);
    let within = |x: f64| low <= x && x <= high;
    (turn != 0.0 && within(s) && within(t)).then(|| {
        let height = |e: &[Raised; 2], share: f64| e[0].1 + (e[1].1 - e[0].1) * share;
        (height(a, s / turn) - height(b, t / turn)).abs()
    })
}

/// Witnesses: removed or moved vertices of the original surface. Each is assigned to its nearest current face, so that
/// the distance from the original surface can be measured directly instead of adding up bounds.
pub(super) struct Witnesses {
    at: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    tree: OnceCell<Tree>,
    /// For each current face its first witness, and for each witness the next one.
    first: Vec<u32>,
    next: Vec<u32>,
    /// The witnesses of the changing faces, each with the index of its new face and the distance.
    gathered: Vec<(u32, u32, f64)>,
}

impl Witnesses {
    /// Starts without witnesses, from the original surface.
    pub fn new(at: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Self {
        let (vertices, count) = (at.len(), faces.len());
        let (first, next) = (vec![NONE; count], vec![UNMOVED; vertices]);
        Self { at, faces, tree: OnceCell::new(), first, next, gathered: Vec::new() }
    }

    /// Gathers the witnesses of changing faces, and vertices that are removed or moved for the first time.
    pub fn gather(&mut self, faces: impl Iterator<Item = u32>, vertices: &[u32]) {
        self.gathered.clear();
        for f in faces {
            let mut v = self.first[f as usize];
            while v != NONE {
                self.gathered.push((v, 0, 0.0));
                v = self.next[v as usize];
            }
        }
        let unmoved = vertices.iter().filter(|&&v| self.next[v as usize] == UNMOVED);
        self.gathered.extend(unmoved.map(|&v| (v, 0, 0.0)));
    }

    /// The distance of the farthest gathered witness from the new faces. Records the nearest face of each.
    pub fn farthest(&mut self, new: &[[DVec3; 3]]) -> f64 {
        let mut most = 0.0f64;
        for (v, nearest, distance) in &mut self.gathered {
            let p = self.at[*v as usize];
            let squares = new.iter().map(|&face| p.distance_squared(nearest_on_triangle(p, face)));
            let found =
                squares.zip(0u32..).fold((f64::INFINITY, 0), |best, next| if next.0 < best.0 { next } else { best });
            (*distance, *nearest) = (found.0.sqrt(), found.1);
            most = most.max(*distance);
        }
        most
    }

    /// Assigns each gathered witness to the new face above or below it, and to the nearest of several. A witness above
    /// or below no face goes to the nearest face. The faces form one fan around `centre`.
    pub fn assign(&mut self, new: &[[DVec3; 3]], centre: DVec3) {
        if self.gathered.len() > MAX_WITNESSES {
            self.farthest(new);
            return;
        }
        let wedges: Vec<[DVec3; 3]> = new.iter().map(|face| wedge(face, centre)).collect();
        for (v, chosen, _) in &mut self.gathered {
            let p = self.at[*v as usize];
            let way = p - centre;
            let heights = wedges.iter().zip(0u32..).filter_map(|([normal, from, to], face)| {
                let is_over = from.dot(way) >= 0.0 && to.dot(way) >= 0.0;
                is_over.then(|| (normal.dot(way).abs(), face))
            });
            let over = heights.fold(None, |best: Option<(f64, u32)>, next| match best {
                Some(best) if best.0 <= next.0 => Some(best),
                _ => Some(next),
            });
            let nearest = || {
                let squares = new.iter().map(|&face| p.distance_squared(nearest_on_triangle(p, face)));
                squares.zip(0..).fold((f64::INFINITY, 0), |best, next| if next.0 < best.0 { next } else { best }).1
            };
            *chosen = over.map_or_else(nearest, |(_, face)| face);
        }
    }

    /// The original surface.
    pub fn original(&self) -> Target<'_> {
        let tree = self.tree.get_or_init(|| Tree::new(&self.at, &self.faces));
        Target { tree, positions: &self.at, faces: &self.faces }
    }

    /// Transfers the gathered witnesses to the new faces; `new` maps an index among the new faces to a face. `old` are
    /// the faces that changed.
    pub fn transfer(&mut self, old: impl Iterator<Item = u32>, new: impl Fn(u32) -> u32) {
        old.for_each(|f| self.first[f as usize] = NONE);
        if self.gathered.len() > MAX_WITNESSES {
            self.gathered.sort_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
            for (v, ..) in self.gathered.drain(MAX_WITNESSES / 2..) {
                self.next[v as usize] = NONE;
            }
        }
        for &(v, nearest, _) in &self.gathered {
            let first = &mut self.first[new(nearest) as usize];
            self.next[v as usize] = std::mem::replace(first, v);
        }
    }
}

/// The unit normal of a face with a corner at `centre`, and the inward normals of the perpendicular planes through its
/// two edges there.
fn wedge(face: &[DVec3; 3], centre: DVec3) -> [DVec3; 3] {
    let first = face.iter().position(|corner| *corner == centre).unwrap_or(0);
    let [from, to] = [face[(first + 1) % 3] - centre, face[(first + 2) % 3] - centre];
    let normal = from.cross(to).normalize_or_zero();
    // A face without area is above or below nothing.
    let inward = |edge: DVec3| if normal == DVec3::ZERO { DVec3::NAN } else { edge };
    [normal, inward(normal.cross(from)), inward(to.cross(normal))]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fan(middle: DVec3, rim: &[DVec3], spokes: std::ops::Range<usize>) -> Patch {
        let mut patch = Patch { centres: vec![middle], ..Patch::default() };
        for i in spokes {
            let next = (i + 1) % rim.len();
            patch.spokes.push(([middle, rim[i]], [99, i as u32]));
            if rim[i] != middle && rim[next] != middle {
                patch.faces.push([middle, rim[i], rim[next]]);
            }
        }
        patch
    }

    #[test]
    fn removing_a_tip_deviates_by_its_height() {
        let rim = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y];
        let old = fan(DVec3::Z * 0.3, &rim, 0..4);
        // The tip collapses into the first vertex of the rim.
        let mut new = fan(rim[0], &rim, 0..4);
        new.spokes = vec![([rim[0], rim[2]], [0, 2])];
        assert!((deviation(&old, &new, DVec3::ZERO).unwrap() - 0.3).abs() < 1e-12);
    }

    #[test]
    fn edges_that_cross_at_different_heights_count() {
        // A saddle whose two diagonals have different heights.
        let rim = [
            DVec3::new(1.0, 0.0, 0.5),
            DVec3::new(0.0, 1.0, -0.5),
            DVec3::new(-1.0, 0.0, 0.5),
            DVec3::new(0.0, -1.0, -0.5),
        ];
        let a = ([rim[0], rim[2]].map(|p| (p.truncate(), p.z)), [rim[1], rim[3]].map(|p| (p.truncate(), p.z)));
        assert!((height_where_they_cross(&a.0, &a.1).unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_patch_with_a_face_pointing_down_has_no_bound() {
        let rim = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y];
        let (old, new) = (fan(DVec3::ZERO, &rim, 0..4), fan(DVec3::X * 3.0, &rim, 0..4));
        assert_eq!(deviation(&old, &new, DVec3::ZERO), None);
    }
}
