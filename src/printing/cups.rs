//! Resin cups: hollows that hold air or resin under suction while a bottom-up printer cures their brim.
//!
//! When the printer cures the layer at height z, the film closes the model at z. The air below z is then cut off from
//! outside wherever no way below z leads around the model. Such a hollow grows with z until its brim, the height at
//! which it first joins the outside.
//!
//! The sweep is the merge tree of the air by height (Carr, Snoeyink and Axen 2003, "Computing contour trees in all
//! dimensions"): parts of the air below z appear and join only at vertices of the surface. Vertices are visited in the
//! order of their heights, equal heights by index, and their parts of the air are joined by union-find.

use glam::DVec3;

use crate::math::{Crossing, Tree, crossing, to_unit_range};
use crate::mesh::{Edges, Surface, UnionFind};

use super::voids::{OUTSIDE, Regions, RegionsError, around_edge};
use crate::context::Context;

/// A cup with less than this share of the model's box is rounding.
const LEAST_SHARE: f64 = 1e-12;
/// Where on a face beside a vertex a ray starts: shares of its two edges at the vertex.
const STARTS: [[f64; 2]; 4] = [[0.412, 0.347], [0.193, 0.587], [0.611, 0.218], [0.301, 0.299]];
/// How far from the vertex a ray starts, as a share of the shortest edge there.
const START: f64 = 1e-3;
/// Length of a ray on the unit scale, which leaves the model.
const RAY_LENGTH: f64 = 8.0;

/// A hollow that is cut off from outside while the layers below its brim are printed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cup {
    /// Its lowest point, where a drain would empty it.
    pub at: DVec3,
    /// The point of the brim at which the hollow first joins the outside.
    pub brim: DVec3,
    /// Volume of the hollow below the brim. Exact up to the rounding of f64.
    pub volume: f64,
    /// Height of the lowest point along the build direction.
    pub bottom_height: f64,
    /// Height of the brim along the build direction.
    pub opening_height: f64,
    /// Area of the cross-section just below the brim.
    pub opening_area: f64,
}

/// Finds the resin cups of a closed surface without intersections, printed in the direction `up`, largest first.
///
/// Layers are cured in the order of their height along `up`, and the model does not stand on a plate: a bowl that opens
/// upward is a cup, a bowl that opens downward is none. Sealed voids are not cups. A direction of zero counts as +z.
///
/// # Errors
/// [`RegionsError`] if the surface is not closed, if the nesting of its parts is undecided, and on cancellation.
pub fn resin_cups(
    surface: &Surface,
    regions: &Regions,
    up: DVec3,
    context: &Context<'_>,
) -> Result<Vec<Cup>, RegionsError> {
    let up = up.try_normalize().unwrap_or(DVec3::Z);
    let edges = Edges::new(&surface.faces);
    let air = AirSurface::new(surface, regions, &edges, up, context)?;
    let mut cups = Sweep::new(&air).run(context)?;
    let size = surface.bounds().max - surface.bounds().min;
    let least = LEAST_SHARE * size.x * size.y * size.z;
    cups.retain(|cup| cup.volume > least && cup.opening_height > cup.bottom_height);
    cups.sort_by(|a, b| b.volume.total_cmp(&a.volume).then(a.opening_height.total_cmp(&b.opening_height)));
    Ok(cups)
}

/// The surface between material and the outside, in the order of the sweep.
///
/// A node is the tip of one connected part of the outside's air at a vertex. Most vertices have one node; a vertex at
/// which parts of the model touch has several.
struct AirSurface<'a> {
    surface: &'a Surface,
    up: DVec3,
    /// The nodes of each face's corners, by rank; none for a face that is not between material and the outside.
    nodes: Vec<Option<[u32; 3]>>,
    /// For each face 1 if its normal points into the air, else -1.
    sign: Vec<f64>,
    /// The vertex of each node, by rank.
    vertex: Vec<u32>,
    /// Heights of the vertices.
    height: Vec<f64>,
    /// The faces at each node: start in `faces`, by rank.
    first: Vec<u32>,
    faces: Vec<u32>,
    unit: Vec<DVec3>,
    tree: Tree,
}

impl<'a> AirSurface<'a> {
    fn new(
        surface: &'a Surface,
        regions: &Regions,
        edges: &Edges,
        up: DVec3,
        context: &Context<'_>,
    ) -> Result<Self, RegionsError> {
        let unit = to_unit_range(&surface.positions);
        let sign: Vec<f64> = (0u32..)
            .take(surface.faces.len())
            .map(|f| match regions.beside(f).map(|region| region == OUTSIDE) {
                [true, false] => 1.0,
                [false, true] => -1.0,
                _ => 0.0,
            })
            .collect();
        let mut corners = UnionFind::new(3 * surface.faces.len());
        for (at, half_edges) in edges.iter().enumerate() {
            if at % 65_536 == 0 {
                context.check()?;
            }
            join_corners(surface, &unit, &sign, half_edges, &mut corners)?;
        }
        let roots = corners.into_roots();
        let height: Vec<f64> = surface.positions.iter().map(|p| p.dot(up)).collect();
        let vertex_of = |corner: u32| surface.faces[corner as usize / 3][corner as usize % 3];
        let mut order: Vec<u32> = (0u32..)
            .zip(&roots)
            .filter(|&(corner, &root)| corner == root && sign[corner as usize / 3] != 0.0)
            .map(|(corner, _)| corner)
            .collect();
        let height_of = |corner: u32| height[vertex_of(corner) as usize];
        order.sort_by(|&a, &b| height_of(a).total_cmp(&height_of(b)).then(a.cmp(&b)));
        let mut rank = vec![u32::MAX; roots.len()];
        (0u32..).zip(&order).for_each(|(at, &corner)| rank[corner as usize] = at);
        let nodes: Vec<Option<[u32; 3]>> = (0..surface.faces.len())
            .map(|f| (sign[f] != 0.0).then(|| [0, 1, 2].map(|i| rank[roots[3 * f + i] as usize])))
            .collect();
        let vertex: Vec<u32> = order.iter().map(|&corner| vertex_of(corner)).collect();
        let (first, faces) = faces_at(&nodes, vertex.len());
        let tree = Tree::new(&unit, &surface.faces);
        Ok(Self { surface, up, nodes, sign, vertex, height, first, faces, unit, tree })
    }

    /// The faces at a node.
    fn faces_of(&self, node: u32) -> &[u32] {
        &self.faces[self.first[node as usize] as usize..self.first[node as usize + 1] as usize]
    }

    fn height_of(&self, node: u32) -> f64 {
        self.height[self.vertex[node as usize] as usize]
    }

    /// The air straight below a node that has no lower neighbour.
    fn below(&self, node: u32) -> Below {
        let v = self.vertex[node as usize];
        let at = self.unit[v as usize];
        let shortest = self
            .faces_of(node)
            .iter()
            .flat_map(|&f| self.surface.faces[f as usize])
            .filter(|&w| w != v)
            .map(|w| at.distance(self.unit[w as usize]))
            .fold(f64::INFINITY, f64::min);
        for &face in self.faces_of(node) {
            let [a, b, c] = self.corners(face);
            let normal = (b - a).cross(c - a) * self.sign[face as usize];
            if normal.dot(self.up) >= 0.0 {
                continue;
            }
            let ends = self.surface.faces[face as usize].map(|w| self.unit[w as usize] - at);
            let sides: [DVec3; 2] = match self.surface.faces[face as usize].iter().position(|&w| w == v) {
                Some(k) => [ends[(k + 1) % 3], ends[(k + 2) % 3]],
                None => continue,
            };
            for [s, t] in STARTS {
                let step = sides[0].normalize_or_zero() * s + sides[1].normalize_or_zero() * t;
                match self.first_below(at + step * (START * shortest), face) {
                    Some(Some(found)) if self.faces_of(node).contains(&found) => break,
                    Some(Some(found)) => match self.lowest_node(found) {
                        Some(lowest) => return Below::Node(lowest),
                        None => break,
                    },
                    Some(None) => return Below::Outside,
                    None => {}
                }
            }
        }
        Below::Material
    }

    /// The first face straight below a point, `face` apart. `None` if the ray touches an edge.
    fn first_below(&self, from: DVec3, face: u32) -> Option<Option<u32>> {
        let to = from - self.up * RAY_LENGTH;
        let (mut clear, mut first) = (true, None::<(f64, u32)>);
        self.tree.along(from, to, |other| {
            let corners = self.corners(other);
            match if other == face { Crossing::Miss } else { crossing(from, to, corners) } {
                Crossing::Miss => {}
                Crossing::Touches => clear = false,
                Crossing::Enters | Crossing::Leaves => {
                    let [a, b, c] = corners;
                    let normal = (b - a).cross(c - a);
                    let found = (normal.dot(a - from) / normal.dot(to - from), other);
                    if first.is_none_or(|first| found < first) {
                        first = Some(found);
                    }
                }
            }
            clear
        });
        clear.then_some(first.map(|(_, face)| face))
    }

    fn corners(&self, face: u32) -> [DVec3; 3] {
        self.surface.faces[face as usize].map(|v| self.unit[v as usize])
    }

    /// The lowest node of a face; `None` if the face does not face the outside.
    fn lowest_node(&self, face: u32) -> Option<u32> {
        self.nodes[face as usize].map(|[a, b, c]| a.min(b).min(c))
    }

    /// The share of a face's projection along `up` below a height: its signed area, and the integral of the depth.
    fn below_height(&self, face: u32, top: f64) -> [f64; 2] {
        let area = self.surface.area_vector(face as usize).dot(self.up) * self.sign[face as usize] / 2.0;
        let mut heights = self.surface.faces[face as usize].map(|v| self.height[v as usize]);
        heights.sort_by(f64::total_cmp);
        let [low, middle, high] = heights;
        if top >= high {
            return [area, area * ((top - low) + (top - middle) + (top - high)) / 3.0];
        }
        if top <= low {
            return [0.0; 2];
        }
        if top <= middle {
            let share = (top - low) / (middle - low) * ((top - low) / (high - low));
            return [area * share, area * share * (top - low) / 3.0];
        }
        let above = (high - top) / (high - middle) * ((high - top) / (high - low));
        let whole = ((top - low) + (top - middle) + (top - high)) / 3.0;
        [area * (1.0 - above), area * (whole + above * (high - top) / 3.0)]
    }
}

/// What lies straight below a node.
enum Below {
    /// Material: the air around the node appears here.
    Material,
    /// Air as far as infinity.
    Outside,
    /// Air down to a face, of which this is the lowest node.
    Node(u32),
}

/// Joins the corners of faces around an edge that have a part of the outside's air between them.
fn join_corners(
    surface: &Surface,
    unit: &[DVec3],
    sign: &[f64],
    half_edges: &[u32],
    corners: &mut UnionFind,
) -> Result<(), RegionsError> {
    let face = half_edges[0] / 3;
    let mut around = around_edge(surface, unit, half_edges).ok_or(RegionsError::Undecided { face })?;
    around.retain(|(f, _)| sign[*f as usize] != 0.0);
    let ends = Edges::ends(&surface.faces, half_edges[0]);
    for (k, &(face, forward)) in around.iter().enumerate() {
        let (next, next_forward) = around[(k + 1) % around.len()];
        // Counter-clockwise of a forward face is its front; the next face shows its back there if it is forward.
        let is_air = |face: u32, front: bool| (sign[face as usize] > 0.0) == front;
        if is_air(face, forward) && is_air(next, !next_forward) {
            for v in ends {
                let corner = |f: u32| {
                    let position = surface.faces[f as usize].iter().position(|&w| w == v).unwrap_or(0);
                    3 * f + u32::try_from(position).unwrap_or(0)
                };
                corners.unite(corner(face), corner(next));
            }
        }
    }
    Ok(())
}

/// The faces at each node, as starts and a list.
fn faces_at(nodes: &[Option<[u32; 3]>], count: usize) -> (Vec<u32>, Vec<u32>) {
    let mut first = vec![0u32; count + 1];
    for &node in nodes.iter().flatten().flatten() {
        first[node as usize + 1] += 1;
    }
    for node in 0..count {
        first[node + 1] += first[node];
    }
    let mut next = first.clone();
    let mut faces = vec![0; first[count] as usize];
    for (face, corners) in (0u32..).zip(nodes) {
        for &node in corners.iter().flatten() {
            faces[next[node as usize] as usize] = face;
            next[node as usize] += 1;
        }
    }
    (first, faces)
}

/// The parts of the air below the height of the sweep. The smallest member of a part is its lowest node.
struct Sweep<'a> {
    air: &'a AirSurface<'a>,
    parts: UnionFind,
    /// For the lowest node of each part, whether it has joined the outside.
    is_outside: Vec<bool>,
    /// The nodes of each part as a list: for each node the next one, and for the lowest node of a part the last one.
    next: Vec<u32>,
    last: Vec<u32>,
}

impl<'a> Sweep<'a> {
    fn new(air: &'a AirSurface<'a>) -> Self {
        let count = air.vertex.len();
        let last = (0u32..).take(count).collect();
        Self { air, parts: UnionFind::new(count), is_outside: vec![false; count], next: vec![u32::MAX; count], last }
    }

    fn run(mut self, context: &Context<'_>) -> Result<Vec<Cup>, RegionsError> {
        let mut cups = Vec::new();
        let mut lower = Vec::new();
        for node in (0u32..).take(self.air.vertex.len()) {
            if node % 4096 == 0 {
                context.check()?;
            }
            lower.clear();
            let neighbours = self.air.faces_of(node).iter().filter_map(|&f| self.air.nodes[f as usize]).flatten();
            lower.extend(neighbours.filter(|&other| other < node));
            if lower.is_empty() {
                match self.air.below(node) {
                    Below::Material => {}
                    Below::Outside => {
                        let part = self.parts.root(node);
                        self.is_outside[part as usize] = true;
                    }
                    Below::Node(other) => lower.push(other),
                }
            }
            lower.push(node);
            lower.iter_mut().for_each(|other| *other = self.parts.root(*other));
            lower.sort_unstable();
            lower.dedup();
            if lower.iter().any(|&part| self.is_outside[part as usize]) {
                let closed = lower.iter().filter(|&&part| part != node && !self.is_outside[part as usize]);
                cups.extend(closed.map(|&part| self.cup(part, node)));
            }
            lower.iter().for_each(|&part| self.unite(part, node));
        }
        Ok(cups)
    }

    fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.parts.root(a), self.parts.root(b));
        let (low, high) = (a.min(b) as usize, a.max(b) as usize);
        if low != high {
            self.parts.unite(a, b);
            self.is_outside[low] |= self.is_outside[high];
            let end = self.last[low];
            self.next[end as usize] = a.max(b);
            self.last[low] = self.last[high];
        }
    }

    /// The cup that is a part of the air below the height of `brim`.
    fn cup(&self, part: u32, brim: u32) -> Cup {
        let top = self.air.height_of(brim);
        let (mut area, mut volume, mut node) = (0.0, 0.0, part);
        while node != u32::MAX {
            for &face in self.air.faces_of(node) {
                if self.air.lowest_node(face) == Some(node) {
                    let [face_area, face_volume] = self.air.below_height(face, top);
                    area += face_area;
                    volume += face_volume;
                }
            }
            node = self.next[node as usize];
        }
        let place = |node: u32| self.air.surface.positions[self.air.vertex[node as usize] as usize];
        Cup {
            at: place(part),
            brim: place(brim),
            volume,
            bottom_height: self.air.height_of(part),
            opening_height: top,
            opening_area: area,
        }
    }
}

#[cfg(test)]
mod tests;
