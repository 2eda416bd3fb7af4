use std::cell::OnceCell;

use glam::DVec3;

use super::complex::NONE;
use crate::math::{Tree, nearest_on_triangle};

/// Not yet a witness: its vertex stands where it stood.
const STANDS: u32 = NONE - 1;
/// Most witnesses that are asked at once. Of more only half as many stay, those that are farthest away.
const MOST: usize = 256;

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
