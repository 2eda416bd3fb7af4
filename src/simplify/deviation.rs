use std::cell::OnceCell;

use glam::{DVec2, DVec3};

use super::complex::NONE;
use crate::math::{Tree, nearest_on_segment, nearest_on_triangle};

/// Cosine below which a face is taken to stand upright in the projection.
const UPRIGHT: f64 = 1e-3;
/// How far beyond its ends, as a share of its length, an edge is taken to reach, so that rounding misses no crossing.
const OVERREACH: f64 = 1e-9;

/// Not yet a witness: its vertex stands where it stood.
const STANDS: u32 = NONE - 1;
/// Most witnesses that are asked at once. Of more only half as many stay, those that are farthest away.
const MOST: usize = 256;

/// A surface from which distances are measured.
#[derive(Clone, Copy)]
pub struct Reference<'a> {
    /// The tree of these triangles.
    pub tree: &'a Tree,
    /// Vertex positions.
    pub positions: &'a [DVec3],
    /// Triangles as numbers in `positions`.
    pub faces: &'a [[u32; 3]],
}

impl Reference<'_> {
    /// The distance from `p` to the surface; none where it is over `bound`.
    pub(super) fn distance(&self, p: DVec3, bound: f64) -> Option<f64> {
        let corners = |f: u32| self.faces[f as usize].map(|v| self.positions[v as usize]);
        let mut steps = u64::MAX;
        self.tree.nearest(p, bound, &mut steps, corners).map(|nearest| nearest.distance)
    }
}

/// Faces around one or two vertices, before or after a collapse.
#[derive(Default)]
pub(super) struct Patch {
    pub faces: Vec<[DVec3; 3]>,
    /// The edges within, from a vertex in the middle to one on the rim, which is known by its number.
    pub spokes: Vec<([DVec3; 2], [u32; 2])>,
    /// The vertices in the middle.
    pub middles: Vec<DVec3>,
}

impl Patch {
    pub fn clear(&mut self) {
        self.faces.clear();
        self.spokes.clear();
        self.middles.clear();
    }
}

/// A bound of how far any point of one patch is from the other, both ways, where both have the same rim.
///
/// Both are projected along their common normal. Where no face is upright then or looks down, that is a map from one to the
/// other which is linear on each piece that the edges of both cut, so that it moves nothing farther than the corners of those
/// pieces: the vertices, and where edges cross (Bajaj and Schikore 1996; Cohen, Manocha and Olano 1997). Otherwise none.
/// `origin` is a point nearby.
pub(super) fn deviation(old: &Patch, new: &Patch, origin: DVec3) -> Option<f64> {
    let sum: DVec3 = old.faces.iter().map(|f| normal(*f)).sum();
    let up = sum.try_normalize()?;
    let looks_up = |f: &[DVec3; 3]| {
        let n = normal(*f);
        n.dot(up) > UPRIGHT * n.length()
    };
    if !old.faces.iter().all(looks_up) || !new.faces.iter().all(looks_up) {
        return None;
    }
    let (x, y) = up.any_orthonormal_pair();
    let frame = Frame { origin, x, y, up };
    let mut most = 0.0f64;
    for (patch, other) in [(old, new), (new, old)] {
        for &middle in &patch.middles {
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

/// How far a line is moved where one of its vertices goes: that vertex's distance from the new edge.
pub(super) fn line_deviation(gone: DVec3, ends: [DVec3; 2]) -> f64 {
    gone.distance(nearest_on_segment(gone, ends))
}

fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// A point in the projection, and its height.
type Raised = (DVec2, f64);

struct Frame {
    origin: DVec3,
    x: DVec3,
    y: DVec3,
    up: DVec3,
}

impl Frame {
    fn flat(&self, p: DVec3) -> Raised {
        let d = p - self.origin;
        (DVec2::new(d.dot(self.x), d.dot(self.y)), d.dot(self.up))
    }

    /// How far a point is above or below faces. Beside all of them, its distance.
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

/// How far one edge is above the other where they cross in the projection.
fn height_where_they_cross(a: &[Raised; 2], b: &[Raised; 2]) -> Option<f64> {
    let (u, v, between) = (a[1].0 - a[0].0, b[1].0 - b[0].0, b[0].0 - a[0].0);
    let turn = u.perp_dot(v);
    // Most edges do not cross, and signs tell that without a division.
    let (s, t) = (between.perp_dot(v), between.perp_dot(u));
    let slack = OVERREACH * turn.abs();
    let (low, high) = (turn.min(0.0) - slack, turn.max(0.0) + slack);
    let within = |x: f64| low <= x && x <= high;
    (turn != 0.0 && within(s) && within(t)).then(|| {
        let height = |e: &[Raised; 2], share: f64| e[0].1 + (e[1].1 - e[0].1) * share;
        (height(a, s / turn) - height(b, t / turn)).abs()
    })
}

/// The vertices of the surface at the start that are no vertices any more: each is held by the face that it is nearest to, so
/// that how far the faces now are from the surface at the start can be measured without adding up.
pub(super) struct Witnesses {
    at: Vec<DVec3>,
    faces: Vec<[u32; 3]>,
    tree: OnceCell<Tree>,
    /// For each face now its first witness, for each witness the next one.
    first: Vec<u32>,
    next: Vec<u32>,
    /// Those of the faces that change, the faces' numbers among the new ones, and distances.
    asked: Vec<(u32, u32, f64)>,
}

impl Witnesses {
    pub fn new(at: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Self {
        let (vertices, count) = (at.len(), faces.len());
        let (first, next) = (vec![NONE; count], vec![STANDS; vertices]);
        Self { at, faces, tree: OnceCell::new(), first, next, asked: Vec::new() }
    }

    /// Gathers the witnesses of faces that change, and vertices that go or move for the first time.
    pub fn gather(&mut self, faces: impl Iterator<Item = u32>, vertices: &[u32]) {
        self.asked.clear();
        for f in faces {
            let mut v = self.first[f as usize];
            while v != NONE {
                self.asked.push((v, 0, 0.0));
                v = self.next[v as usize];
            }
        }
        let stand = vertices.iter().filter(|&&v| self.next[v as usize] == STANDS);
        self.asked.extend(stand.map(|&v| (v, 0, 0.0)));
    }

    /// How far the farthest of those is from the new faces.
    pub fn farthest(&mut self, new: &[[DVec3; 3]]) -> f64 {
        let mut most = 0.0f64;
        for (v, nearest, distance) in &mut self.asked {
            let p = self.at[*v as usize];
            let squares = new.iter().map(|&face| p.distance_squared(nearest_on_triangle(p, face)));
            let found = squares.zip(0u32..).fold((f64::INFINITY, 0), |best, it| if it.0 < best.0 { it } else { best });
            (*distance, *nearest) = (found.0.sqrt(), found.1);
            most = most.max(*distance);
        }
        most
    }

    /// Chooses for each of those the new face that it is nearest above, or the nearest where it is above none. The faces are those of one fan.
    pub fn assign(&mut self, new: &[[DVec3; 3]], centre: DVec3) {
        if self.asked.len() > MOST {
            self.farthest(new);
            return;
        }
        let wedges: Vec<[DVec3; 3]> = new.iter().map(|face| wedge(face, centre)).collect();
        for (v, chosen, _) in &mut self.asked {
            let p = self.at[*v as usize];
            let way = p - centre;
            let heights = wedges.iter().zip(0u32..).filter_map(|([normal, from, to], face)| {
                let is_over = from.dot(way) >= 0.0 && to.dot(way) >= 0.0;
                is_over.then(|| (normal.dot(way).abs(), face))
            });
            let over = heights.fold(None, |best: Option<(f64, u32)>, it| match best {
                Some(best) if best.0 <= it.0 => Some(best),
                _ => Some(it),
            });
            let nearest = || {
                let squares = new.iter().map(|&face| p.distance_squared(nearest_on_triangle(p, face)));
                squares.zip(0..).fold((f64::INFINITY, 0), |best, it| if it.0 < best.0 { it } else { best }).1
            };
            *chosen = over.map_or_else(nearest, |(_, face)| face);
        }
    }

    /// How far a point is from the surface at the start, where that is within a bound.
    pub fn distance(&self, p: DVec3, bound: f64) -> Option<f64> {
        let tree = self.tree.get_or_init(|| Tree::new(&self.at, &self.faces));
        let corners = |f: u32| self.faces[f as usize].map(|v| self.at[v as usize]);
        tree.nearest(p, bound, &mut u64::MAX.clone(), corners).map(|it| it.distance)
    }

    /// Gives those that were gathered and measured to the new faces, `new` being their numbers, after `old` faces changed.
    pub fn settle(&mut self, old: impl Iterator<Item = u32>, new: impl Fn(u32) -> u32) {
        old.for_each(|f| self.first[f as usize] = NONE);
        if self.asked.len() > MOST {
            self.asked.sort_by(|a, b| b.2.total_cmp(&a.2).then(a.0.cmp(&b.0)));
            for (v, ..) in self.asked.drain(MOST / 2..) {
                self.next[v as usize] = NONE;
            }
        }
        for &(v, nearest, _) in &self.asked {
            let first = &mut self.first[new(nearest) as usize];
            self.next[v as usize] = std::mem::replace(first, v);
        }
    }
}

/// The unit normal of a face with a corner at `centre`, and the normals, inward, of the planes that stand on its two edges there.
fn wedge(face: &[DVec3; 3], centre: DVec3) -> [DVec3; 3] {
    let first = face.iter().position(|corner| *corner == centre).unwrap_or(0);
    let [from, to] = [face[(first + 1) % 3] - centre, face[(first + 2) % 3] - centre];
    let normal = from.cross(to).normalize_or_zero();
    // A face without area is over nothing.
    let inward = |edge: DVec3| if normal == DVec3::ZERO { DVec3::NAN } else { edge };
    [normal, inward(normal.cross(from)), inward(to.cross(normal))]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fan(middle: DVec3, rim: &[DVec3], spokes: std::ops::Range<usize>) -> Patch {
        let mut patch = Patch { middles: vec![middle], ..Patch::default() };
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
    fn a_tip_that_goes_is_as_far_as_it_was_high() {
        let rim = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y];
        let old = fan(DVec3::Z * 0.3, &rim, 0..4);
        // The tip collapses into the first vertex of the rim.
        let mut new = fan(rim[0], &rim, 0..4);
        new.spokes = vec![([rim[0], rim[2]], [0, 2])];
        assert!((deviation(&old, &new, DVec3::ZERO).unwrap() - 0.3).abs() < 1e-12);
    }

    #[test]
    fn edges_that_cross_above_one_another_count() {
        // A saddle whose two diagonals are at different heights; the middles are at those of the edges.
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
    fn what_looks_down_is_not_bounded() {
        let rim = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y];
        let (old, new) = (fan(DVec3::ZERO, &rim, 0..4), fan(DVec3::X * 3.0, &rim, 0..4));
        assert_eq!(deviation(&old, &new, DVec3::ZERO), None);
    }
}
