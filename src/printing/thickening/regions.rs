//! What grows together: pieces of faces, or flat regions as a whole. A flat region is connected faces in one plane.
//!
//! Growth that follows the thickness exactly splits faces. Where a wall is thin nearly everywhere, one distance for each
//! flat region needs hardly more material, splits no face and keeps edges sharp:
//!
//! ```text
//!    +--------------+          +----------------+
//!    |  +-----------+    ->    |                |
//!    |  |                      |   +------------+
//!    +--+                      |   |
//!                              +---+
//! ```

use crate::mesh::{Edges, Surface, UnionFind};
use glam::DVec3;
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

use super::growth::Growths;
use super::refine::{FaceCorner, Refined, longest_edge};
use super::walls::Walls;

/// Cosine of the angle up to which neighbours count as one flat region: half a degree.
const FLAT: f64 = 0.999_96;
/// The share of a region's area that must be thin if the region grows as a whole.
const LEAST_SHARE: f64 = 0.7;
/// How much more material a whole region may need than growth that follows the thickness, and all regions together.
const MAX_MORE: f64 = 1.3;
/// The share of a region's area that may need more than the region grows, if most needs far less than the largest growth:
/// where it meets other walls, a wall can need much more. Later rounds or balls add that.
const PEAKS: f64 = 0.1;
/// The area of a small region, in squares of the least wall.
const SMALL: f64 = 4.0;

/// The most such faces between one and the neighbour whose plane it takes, if they are in the least favourable order.
const MAX_PASSES: usize = 16;

/// The flat regions of a surface, with the growth that a refined surface needs.
pub struct Regions {
    /// For each face, its region: the smallest face in it.
    of_face: Vec<u32>,
    /// For each region, its faces.
    faces: FxHashMap<u32, Vec<u32>>,
    /// For each face, its unit normal; zero if rounding decides it.
    normals: Vec<DVec3>,
    /// For each face, the unit normal of the plane that it lies in. Where rounding decides its own one, that of a neighbour in its
    /// region.
    planes: Vec<DVec3>,
    /// The distance up to which vertices are one place but for rounding.
    noise: f64,
    /// The area up to which a region is small.
    small: f64,
    /// The regions with a thin face.
    needs: FxHashMap<u32, Need>,
    /// Those of them that may grow as a whole, with hardly more material than growth that follows the thickness.
    whole: FxHashSet<u32>,
}

/// What a region needs.
#[derive(Debug, Clone, Copy, Default)]
struct Need {
    /// The area of the region.
    area: f64,
    /// The area of its pieces that grow.
    thin_area: f64,
    /// How far the region grows: by the largest growth or, where only a small part needs that, by what the rest needs.
    growth: f64,
    /// The material that growth following the thickness adds.
    volume: f64,
}

impl Regions {
    /// Finds the flat regions of `surface`, of which `refined` has the pieces.
    pub fn new(surface: &Surface, growths: &Growths<'_>, refined: &Refined, min_wall: f64) -> Self {
        let edges = Edges::new(&surface.faces);
        let (normals, planes) = normals_and_planes(surface, &growths.walls, &edges);
        let mut groups = UnionFind::new(surface.faces.len());
        for [f, g] in edges.pairs().map(|pair| pair.map(|half_edge| half_edge / 3)) {
            if planes[f as usize].dot(planes[g as usize]) >= FLAT {
                groups.unite(f, g);
            }
        }
        let of_face = groups.into_roots();
        let mut faces: FxHashMap<u32, Vec<u32>> = FxHashMap::default();
        for (face, &region) in (0u32..).zip(&of_face) {
            faces.entry(region).or_default().push(face);
        }
        let (needs, whole, small) = (FxHashMap::default(), FxHashSet::default(), SMALL * min_wall * min_wall);
        let noise = growths.walls.contact;
        let mut regions = Self { of_face, faces, normals, planes, noise, small, needs, whole };
        regions.assess(refined);
        regions
    }

    /// Finds what each region needs, by the growth of its pieces.
    pub fn assess(&mut self, refined: &Refined) {
        let mut needs: FxHashMap<u32, Need> = FxHashMap::default();
        for (piece, &parent) in (0u32..).zip(&refined.parent) {
            let growth = [0, 1, 2].map(|k| refined.corner_growth(piece, k));
            let [a, b, c] = refined.corners(piece);
            let area = (b - a).cross(c - a).length() / 2.0;
            let need = needs.entry(self.of(parent)).or_default();
            need.area += area;
            need.growth = need.growth.max(refined.largest[parent as usize]);
            if growth.iter().any(|&growth| growth > 0.0) {
                need.thin_area += area;
                need.volume += area * growth.iter().sum::<f64>() / 3.0;
            }
        }
        needs.retain(|_, need| need.growth > 0.0);
        self.leave_out_peaks(&mut needs, refined);
        self.whole = whole(&needs, self.small);
        self.needs = needs;
    }

    /// Lowers the growth of thin regions that need far more at a small part of their area than elsewhere.
    fn leave_out_peaks(&self, needs: &mut FxHashMap<u32, Need>, refined: &Refined) {
        let has_peaks = |need: &Need| need.is_thin() && !need.is_little_as_a_whole();
        let with_peaks = needs.iter().filter(|(_, need)| has_peaks(need));
        // For each such region, the growth at the corners of its pieces, with the area that needs it.
        let mut at_corners: FxHashMap<u32, Vec<(f64, f64)>> =
            with_peaks.map(|(&region, _)| (region, Vec::new())).collect();
        if at_corners.is_empty() {
            return;
        }
        for (piece, &parent) in (0u32..).zip(&refined.parent) {
            if let Some(at_corners) = at_corners.get_mut(&self.of(parent)) {
                let [a, b, c] = refined.corners(piece);
                let area = (b - a).cross(c - a).length() / 6.0;
                at_corners.extend([0, 1, 2].map(|k| (refined.corner_growth(piece, k), area)));
            }
        }
        for (region, mut at_corners) in at_corners {
            needs.entry(region).and_modify(|need| {
                need.growth = need.growth.min(growth_without_peaks(&mut at_corners, PEAKS * need.area));
            });
        }
    }

    /// The region of a face.
    pub fn of(&self, face: u32) -> u32 {
        self.of_face[face as usize]
    }

    /// The faces of a region, in ascending order.
    pub fn faces(&self, region: u32) -> &[u32] {
        self.faces.get(&region).map_or(&[], Vec::as_slice)
    }

    /// The unit normals of all faces; zero where rounding decides.
    pub fn normals(&self) -> &[DVec3] {
        &self.normals
    }

    /// The unit normal of the plane that a face lies in; zero where there is none.
    pub fn plane(&self, face: u32) -> DVec3 {
        self.planes[face as usize]
    }

    /// Groups the vertices at the ends of edges that are no longer than rounding errors.
    pub fn near_vertices(&self, Refined { positions, faces, .. }: &Refined) -> UnionFind {
        let mut near = UnionFind::new(positions.len());
        for [a, b, c] in faces {
            for [from, to] in [[*a, *b], [*b, *c], [*c, *a]] {
                if positions[from as usize].distance(positions[to as usize]) <= self.noise {
                    near.unite(from, to);
                }
            }
        }
        near
    }

    /// Whether all thin regions may grow as a whole.
    pub fn are_thin_as_a_whole(&self) -> bool {
        self.whole.len() == self.needs.len()
    }

    /// Whether the region of a face is thin and may grow as a whole.
    pub fn is_thin_as_a_whole(&self, face: u32) -> bool {
        self.whole.contains(&self.of(face))
    }

    /// Keeps the growth of the regions that may grow as a whole.
    pub fn keep_thin_as_a_whole(&mut self) {
        self.needs.retain(|region, _| self.whole.contains(region));
    }

    /// Lowers the growth of regions so that no gap in front of them becomes too narrow.
    pub fn limit(&mut self, growths: &Growths<'_>) {
        let Self { faces, needs, .. } = self;
        needs.par_iter_mut().for_each(|(region, need)| {
            let of_region = faces.get(region).into_iter().flatten();
            need.growth = of_region.fold(need.growth, |least, &face| growths.limit_of_face(face, least));
        });
        needs.retain(|_, need| need.growth > 0.0);
    }

    /// The material that growth following the thickness adds.
    pub fn volume(&self) -> f64 {
        self.sum(|need| need.volume)
    }

    /// The material that whole regions add.
    pub fn whole_volume(&self) -> f64 {
        self.sum(|need| need.area * need.growth)
    }

    /// The sum over all regions, in the order of their faces.
    fn sum(&self, of: impl Fn(&Need) -> f64) -> f64 {
        let mut needs: Vec<(&u32, &Need)> = self.needs.iter().collect();
        needs.sort_unstable_by_key(|(region, _)| **region);
        needs.into_iter().map(|(_, need)| of(need)).sum()
    }

    /// The growth at each corner of the faces of `surface`, without pieces.
    pub fn growth(&self, surface: &Surface) -> FxHashMap<FaceCorner, f64> {
        let of_face = |face: u32| self.needs.get(&self.of(face)).map(|need| need.growth);
        let corners = |(face, corners): (u32, &[u32; 3])| {
            of_face(face).map(|growth| corners.map(|vertex| (FaceCorner { vertex, face }, growth)))
        };
        (0u32..).zip(&surface.faces).filter_map(corners).flatten().collect()
    }
}

/// The unit normals of all faces, zero where rounding decides, and the normals of the planes that they lie in: faces without a normal
/// lie in the plane of a neighbour, also over other such faces.
fn normals_and_planes(surface: &Surface, walls: &Walls<'_>, edges: &Edges) -> (Vec<DVec3>, Vec<DVec3>) {
    let all = || (0u32..).take(surface.faces.len());
    let mut normals: Vec<DVec3> = all().map(|face| walls.normal(face)).collect();
    // Faces without a normal, each with the neighbour in whose plane it lies.
    let in_plane = |pair| sliver_in_plane(surface, &normals, pair, walls.contact);
    let mut slivers: Vec<[u32; 2]> = edges.pairs().filter_map(in_plane).collect();
    slivers.iter().for_each(|[sliver, _]| normals[*sliver as usize] = DVec3::ZERO);
    let is_sliver = |face: &u32| normals[*face as usize] == DVec3::ZERO;
    for face in all().filter(is_sliver) {
        let (_, [a, b]) = longest_edge(&surface.positions, surface.faces[face as usize]);
        let across = edges.find(a, b).map(|edge| edges.half_edges(edge)).unwrap_or_default();
        slivers.extend(across.iter().map(|half_edge| [face, half_edge / 3]).filter(|[_, beside]| *beside != face));
    }
    let mut planes = normals.clone();
    take_planes(&mut planes, &slivers, (surface, walls.contact));
    // Two slivers at their longest edges know only each other.
    let beside = edges.pairs().map(|pair| pair.map(|half_edge| half_edge / 3)).flat_map(|[f, g]| [[f, g], [g, f]]);
    let unknown: Vec<[u32; 2]> = beside.filter(|[face, _]| planes[*face as usize] == DVec3::ZERO).collect();
    take_planes(&mut planes, &unknown, (surface, walls.contact));
    (normals, planes)
}

/// Gives faces without a plane the plane of a neighbour, also over other such faces, if they lie in it except for `noise` and the
/// angle between faces of one region. `neighbours` are pairs of a face and a neighbour.
fn take_planes(planes: &mut [DVec3], neighbours: &[[u32; 2]], (surface, noise): (&Surface, f64)) {
    let lies_in = |face: u32, plane: DVec3| {
        let [a, b, c] = surface.corners(face as usize);
        let most = |way: DVec3| noise + (1.0 - FLAT * FLAT).sqrt() * way.length();
        [b - a, c - a].into_iter().all(|way| way.dot(plane).abs() <= most(way))
    };
    for _ in 0..MAX_PASSES {
        let mut is_done = true;
        for &[face, beside] in neighbours {
            let [own, plane] = [face, beside].map(|face| planes[face as usize]);
            if own == DVec3::ZERO && plane != DVec3::ZERO && lies_in(face, plane) {
                planes[face as usize] = plane;
                is_done = false;
            }
        }
        if is_done {
            break;
        }
    }
}

/// The smaller of two faces at an edge, given by its half-edges, with the larger one, if it is so narrow that it lies in the plane of the
/// larger one except for `noise`, and yet its normal differs: rounding decides it.
fn sliver_in_plane(surface: &Surface, normals: &[DVec3], pair: [u32; 2], noise: f64) -> Option<[u32; 2]> {
    let area = |half_edge: u32| surface.area_vector(half_edge as usize / 3).length_squared();
    let [large, small] = if area(pair[0]) >= area(pair[1]) { pair } else { [pair[1], pair[0]] };
    let [plane, own] = [large, small].map(|half_edge| normals[half_edge as usize / 3]);
    let at = |vertex: u32| surface.positions[vertex as usize];
    let apex = at(Edges::opposite(&surface.faces, small)) - at(Edges::ends(&surface.faces, large)[0]);
    ((0.0..FLAT).contains(&plane.dot(own)) && own != DVec3::ZERO && apex.dot(plane).abs() <= noise)
        .then_some([small / 3, large / 3])
}

/// The regions that may grow as a whole: all if together they need hardly more material for it. Otherwise those that need
/// hardly more each, and small ones, from the least waste on, as long as all together need hardly more.
fn whole(needs: &FxHashMap<u32, Need>, small: f64) -> FxHashSet<u32> {
    let mut regions: Vec<(u32, Need)> = needs.iter().map(|(&region, &need)| (region, need)).collect();
    let waste = |need: &Need| need.area * need.growth - need.volume;
    regions.sort_unstable_by(|(r, a), (s, b)| waste(a).total_cmp(&waste(b)).then(r.cmp(s)));
    let mut left = (MAX_MORE - 1.0) * regions.iter().map(|(_, need)| need.volume).sum::<f64>();
    if regions.iter().map(|(_, need)| waste(need)).sum::<f64>() <= left {
        return needs.keys().copied().collect();
    }
    let (mut whole, others): (Vec<_>, Vec<_>) = regions.into_iter().partition(|(_, need)| need.is_thin_as_a_whole());
    left -= whole.iter().map(|(_, need)| waste(need)).sum::<f64>();
    whole.extend(others.into_iter().filter(|(_, need)| need.area <= small).take_while(|(_, need)| {
        left -= waste(need);
        left >= 0.0
    }));
    whole.into_iter().map(|(region, _)| region).collect()
}

impl Need {
    fn is_thin_as_a_whole(&self) -> bool {
        self.is_thin() && self.is_little_as_a_whole()
    }

    /// Whether most of the region is thin.
    fn is_thin(&self) -> bool {
        self.thin_area >= LEAST_SHARE * self.area
    }

    /// Whether the whole region needs hardly more material than growth that follows the thickness.
    fn is_little_as_a_whole(&self) -> bool {
        self.area * self.growth <= MAX_MORE * self.volume
    }
}

/// The least growth that suffices except for some area. `at_corners` are growths, each with the area that needs it.
fn growth_without_peaks(at_corners: &mut [(f64, f64)], mut except: f64) -> f64 {
    at_corners.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(b.1.total_cmp(&a.1)));
    let suffices = |&&(_, area): &&(f64, f64)| {
        except -= area;
        except < 0.0
    };
    at_corners.iter().find(suffices).map_or(0.0, |(growth, _)| *growth)
}

/// A surface that grows, in pieces or in flat regions without pieces.
pub struct Pieces {
    /// The surface with its growth.
    pub refined: Refined,
    /// The flat regions; none if pieces grow.
    pub regions: Option<Regions>,
}

impl Pieces {
    /// The pieces that are raised together are one group: each alone, or all of a region.
    pub fn group_of(&self, piece: u32) -> u32 {
        self.regions.as_ref().map_or(piece, |regions| regions.of(piece))
    }

    /// Raises the corners of groups, each corner by the most of its pieces. Regions grow as far as the gaps in front of them
    /// allow.
    pub fn raise(&mut self, groups: FxHashMap<u32, f64>, growths: &Growths<'_>) {
        let mut at: FxHashMap<FaceCorner, f64> = FxHashMap::default();
        for (group, more) in groups {
            let alone = [group];
            let pieces = self.regions.as_ref().map_or(&alone[..], |regions| regions.faces(group));
            let more = if self.regions.is_some() { self.limited(pieces, more, growths) } else { more };
            for &piece in pieces {
                for v in self.refined.faces[piece as usize] {
                    let most = at.entry(self.refined.corner(piece, v)).or_insert(0.0);
                    *most = most.max(more);
                }
            }
        }
        for (key, more) in at {
            *self.refined.growth.entry(key).or_insert(0.0) += more;
        }
    }

    /// How much more whole faces may grow, at most `more`.
    fn limited(&self, faces: &[u32], more: f64, growths: &Growths<'_>) -> f64 {
        let room = |more: f64, &face: &u32| {
            let growth = (0..3).map(|k| self.refined.corner_growth(face, k)).fold(0.0, f64::max);
            growths.limit_of_face(face, growth + more) - growth
        };
        faces.iter().fold(more, room).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Soup;

    #[test]
    fn a_sliver_lies_in_the_plane_of_its_neighbours_although_its_own_normal_differs() {
        let corners = |z: f64| [[0.0, 0.0], [10.0, 0.0], [10.0, 0.5], [0.0, 0.5]].map(|[x, y]| DVec3::new(x, y, z));
        // A vertex of the top is nearly on its long side, and higher than the top by a rounding error.
        let near_edge = DVec3::new(5.0, 2e-5, 0.5 + 3e-6);
        let positions = [&corners(0.0)[..], &corners(0.5), &[near_edge]].concat();
        let sides = (0..4u32).flat_map(|k| [[k, (k + 1) % 4, 4 + (k + 1) % 4], [k, 4 + (k + 1) % 4, 4 + k]]);
        let top = (0..4u32).map(|k| [4 + k, 4 + (k + 1) % 4, 8]);
        let faces: Vec<[u32; 3]> = [[0, 2, 1], [0, 3, 2]].into_iter().chain(sides).chain(top).collect();
        let bar = Surface::from_soup(&Soup { positions, faces }).0;
        let walls = Walls::new(&bar);
        let sliver = 10;
        assert!(walls.normal(sliver).z < 0.99, "{}", walls.normal(sliver));
        let (normals, planes) = normals_and_planes(&bar, &walls, &Edges::new(&bar.faces));
        assert_eq!(normals[sliver as usize], DVec3::ZERO);
        assert!(planes[10..].iter().all(|plane| plane.dot(DVec3::Z) >= FLAT), "{planes:?}");
        assert!((2..10).all(|side| planes[side].z == 0.0 && planes[side] == normals[side]));
    }
}
