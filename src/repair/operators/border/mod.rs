//! The boundary of a surface while cracks in it are closed.
//!
//! A half-edge mesh has one fan at each vertex; a crack that is closed vertex by vertex has two at those that are done and whose
//! neighbours are not. So the faces at boundary vertices are kept here as lists,
//! and boundary edges by their half-edges; the surface may be anything elsewhere. Both edits re-index faces where they are:
//! no face is removed, and no position is made or changed but where vertices meet halfway.

mod edits;

use glam::DVec3;

use crate::math::{Tree, nearest_on_segment, unit_scale};
use crate::mesh::{Edges, Parts, Surface};

const NONE: u32 = u32::MAX;

/// The least cosine of the angle between boundary edges that run along one another.
const ALONG: f64 = 0.5;

/// Boundary edges with what is needed to find those near a point and to merge their vertices.
pub(super) struct Border<'a> {
    pub surface: &'a mut Surface,
    /// The vertices that were on the boundary, ascending.
    pub vertices: Vec<u32>,
    /// The place of each vertex in `vertices`, or [`NONE`].
    place: Vec<u32>,
    /// The faces at each of `vertices`.
    faces_at: Vec<Vec<u32>>,
    /// The boundary edges as they were.
    edges: Vec<[u32; 2]>,
    /// The half-edges without a face beyond into which each of those was cut; some may have found their face since.
    pieces: Vec<Vec<u32>>,
    /// For each half-edge without a face beyond the edge in `edges` that it is of, otherwise [`NONE`].
    edge_of: Vec<u32>,
    /// The vertex of `vertices` that each was merged into, or itself.
    into: Vec<u32>,
    /// How far the vertices that were merged into each of `vertices` have come, at most.
    strayed: Vec<f64>,
    /// The farthest of those.
    farthest: f64,
    tree: Tree,
    /// The power of two that brings coordinates into the range of exact predicates.
    to_unit: f64,
    /// Where vertices meet.
    pub meeting: Meeting,
    /// Faces and edges that may still be looked at: a crafted input spends them.
    pub steps: u64,
}

/// Where two vertices of the boundary meet that become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Meeting {
    /// Where the vertex is that stays.
    #[default]
    AtOne,
    /// Halfway between them.
    Halfway,
    /// Halfway between them, rounded to f32.
    HalfwayInF32,
}

/// A half-edge at a vertex.
#[derive(Debug, Clone, Copy)]
struct Spoke {
    half_edge: u32,
    /// The vertex at its other end.
    other: u32,
    /// Whether it leaves the vertex.
    leaves: bool,
}

/// A direction in which the boundary runs at a point, and whether it is that of the half-edges there or against it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Course {
    direction: DVec3,
    leaves: bool,
}

/// A boundary edge near a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Near {
    /// The edge as it was, of which this is all or a piece.
    pub edge: u32,
    pub half_edge: u32,
    pub ends: [u32; 2],
    /// Where between the ends it is nearest, from 0 to 1.
    pub ratio: f64,
    pub distance: f64,
}

impl<'a> Border<'a> {
    /// None where there is no boundary. Linear but for the tree over boundary edges.
    pub fn new(surface: &'a mut Surface) -> Option<Self> {
        let all = Edges::new(&surface.faces);
        let open: Vec<(usize, u32)> =
            all.iter().enumerate().filter(|(_, h)| h.len() == 1).map(|(e, h)| (e, h[0])).collect();
        if open.is_empty() {
            return None;
        }
        let mut place = vec![NONE; surface.positions.len()];
        let edges: Vec<[u32; 2]> = open.iter().map(|&(e, _)| all.vertices(e)).collect();
        for &v in edges.iter().flatten() {
            place[v as usize] = 0;
        }
        let vertices: Vec<u32> = (0u32..).zip(&place).filter(|&(_, &p)| p == 0).map(|(v, _)| v).collect();
        for (at, &v) in (0u32..).zip(&vertices) {
            place[v as usize] = at;
        }
        let mut faces_at = vec![Vec::new(); vertices.len()];
        for (f, &[a, b, c]) in (0u32..).zip(&surface.faces).filter(|&(_, &[a, b, c])| a != b && b != c && c != a) {
            for v in [a, b, c].into_iter().filter(|&v| place[v as usize] != NONE) {
                faces_at[place[v as usize] as usize].push(f);
            }
        }
        let mut edge_of = vec![NONE; 3 * surface.faces.len()];
        for (e, &(_, h)) in (0u32..).zip(&open) {
            edge_of[h as usize] = e;
        }
        let needles: Vec<[u32; 3]> = edges.iter().map(|&[a, b]| [a, b, b]).collect();
        let tree = Tree::new(&surface.positions, &needles);
        Some(Self {
            place,
            faces_at,
            pieces: open.iter().map(|&(_, h)| vec![h]).collect(),
            edge_of,
            into: vertices.clone(),
            strayed: vec![0.0; vertices.len()],
            farthest: 0.0,
            tree,
            to_unit: unit_scale(&surface.positions),
            meeting: Meeting::AtOne,
            steps: 1_000_000 + 400 * edges.len() as u64,
            vertices,
            edges,
            surface,
        })
    }

    /// Where a vertex is.
    pub fn position(&self, v: u32) -> DVec3 {
        self.surface.positions[v as usize]
    }

    /// The vertex that a vertex of the boundary is now.
    pub fn now(&mut self, mut v: u32) -> u32 {
        loop {
            let at = self.place(v);
            let next = self.into[at];
            if next == v {
                return v;
            }
            self.into[at] = self.into[self.place(next)];
            v = next;
        }
    }

    /// The place of a vertex among `vertices`, which must have been on the boundary.
    pub fn place(&self, v: u32) -> usize {
        self.place[v as usize] as usize
    }

    /// The farthest that a vertex was moved.
    pub fn farthest(&self) -> f64 {
        self.farthest
    }

    /// How many boundary edges there were.
    pub fn edges_before(&self) -> usize {
        self.edges.len()
    }

    /// The boundary edges as they were.
    pub fn lengths(&self) -> impl Iterator<Item = ([u32; 2], f64)> + '_ {
        self.edges.iter().map(|&[a, b]| ([a, b], self.position(a).distance(self.position(b))))
    }

    /// The half-edges at a vertex, along both of its sides of each face.
    fn spokes(&self, v: u32) -> impl Iterator<Item = Spoke> + '_ {
        let place = self.place[v as usize];
        let faces = self.faces_at.get(place as usize).map_or(&[][..], Vec::as_slice);
        faces.iter().flat_map(move |&f| {
            let face = self.surface.faces[f as usize];
            let corner = if face[0] == v { 0 } else { 1 + u32::from(face[1] != v) };
            let [next, last] = [(corner + 1) % 3, (corner + 2) % 3];
            [
                Spoke { half_edge: 3 * f + corner, other: face[next as usize], leaves: true },
                Spoke { half_edge: 3 * f + last, other: face[last as usize], leaves: false },
            ]
        })
    }

    fn is_open(&self, half_edge: u32) -> bool {
        self.edge_of[half_edge as usize] != NONE
    }

    /// The corner of the face that a half-edge does not touch.
    fn opposite(&self, half_edge: u32) -> u32 {
        Edges::opposite(&self.surface.faces, half_edge)
    }

    /// The vertices at the other ends of the boundary edges at a vertex.
    pub fn neighbours(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        self.spokes(v).filter(|s| self.is_open(s.half_edge)).map(|s| s.other)
    }

    /// Whether a vertex is there and on the boundary.
    pub fn is_on_boundary(&self, v: u32) -> bool {
        self.neighbours(v).next().is_some()
    }

    /// The ways in which the boundary leaves a vertex.
    pub fn courses(&self, v: u32) -> Vec<Course> {
        let at = self.position(v);
        let open = self.spokes(v).filter(|s| self.is_open(s.half_edge));
        open.map(|s| Course { direction: (self.position(s.other) - at).normalize_or_zero(), leaves: s.leaves })
            .collect()
    }

    /// The ways in which the boundary leaves a point on a boundary edge from one vertex to another.
    pub fn courses_on([a, b]: [DVec3; 2]) -> [Course; 2] {
        let direction = (b - a).normalize_or_zero();
        [Course { direction, leaves: true }, Course { direction: -direction, leaves: false }]
    }

    /// Whether two boundaries run along one another in opposite directions, as the two sides of a crack do.
    pub fn run_along(one: &[Course], other: &[Course]) -> bool {
        one.iter().any(|x| other.iter().any(|y| x.leaves != y.leaves && x.direction.dot(y.direction) > ALONG))
    }

    /// Lists the boundary edges nearer to a vertex than `reach` and without it.
    pub fn near(&mut self, v: u32, reach: f64, found: &mut Vec<Near>) {
        let p = self.position(v);
        let mut steps = self.steps;
        // The tree has edges as they were; those that were cut are where they were, or their ends have strayed.
        self.tree.around(p, reach + self.farthest, |e| {
            for &half_edge in self.pieces[e as usize].iter().filter(|&&h| self.edge_of[h as usize] == e) {
                steps = steps.saturating_sub(1);
                let ends = Edges::ends(&self.surface.faces, half_edge);
                let [a, b] = ends.map(|v| self.position(v));
                let foot = nearest_on_segment(p, [a, b]);
                let distance = p.distance(foot);
                if distance < reach && !ends.contains(&v) {
                    found.push(Near { edge: e, half_edge, ends, ratio: ratio(foot, [a, b]), distance });
                }
            }
            steps = steps.saturating_sub(1);
            steps > 0
        });
        self.steps = steps;
        // By what they are, since the tree's order says nothing.
        found.sort_unstable_by(|x, y| x.distance.total_cmp(&y.distance).then(x.half_edge.cmp(&y.half_edge)));
    }

    /// What is left of an edge behind the vertices at which it was cut, one after another along its half-edge; none where
    /// that is closed.
    pub fn last_piece(&self, edge: u32) -> Option<u32> {
        self.pieces[edge as usize].last().copied().filter(|&h| self.edge_of[h as usize] == edge)
    }

    /// In words, where the search was too long to be finished.
    pub fn gave_up(&self) -> Option<String> {
        (self.steps == 0).then(|| "some open edges were not looked at: too many lie in one place".to_owned())
    }

    /// The length that the boundary edge had of which a half-edge is.
    pub fn length_before(&self, half_edge: u32) -> f64 {
        let [a, b] = self.edges[self.edge_of[half_edge as usize] as usize];
        self.position(a).distance(self.position(b))
    }
}

fn ratio(foot: DVec3, [a, b]: [DVec3; 2]) -> f64 {
    let whole = a.distance(b);
    if foot == b {
        1.0
    } else if whole > 0.0 {
        (a.distance(foot) / whole).min(1.0)
    } else {
        0.0
    }
}

/// The parts of a surface that have a boundary.
pub(crate) struct OpenParts {
    /// How many there are.
    pub count: u64,
    /// Their faces, in order.
    pub faces: Vec<u32>,
    /// For each of those its part, by number among the open ones.
    pub part: Vec<u32>,
}

/// Finds the parts that have an edge of one face.
pub(crate) fn open_parts(surface: &Surface) -> OpenParts {
    let edges = Edges::new(&surface.faces);
    let mut found = OpenParts { count: 0, faces: Vec::new(), part: Vec::new() };
    if edges.iter().all(|h| h.len() != 1) {
        return found;
    }
    let parts = Parts::new(surface, &edges);
    let open = parts.open(&edges);
    let mut number = vec![Parts::NONE; parts.count];
    for (number, count) in number.iter_mut().zip(&open).filter(|(_, open)| **open).map(|(n, _)| n).zip(0u32..) {
        *number = count;
        found.count += 1;
    }
    for (f, &part) in (0u32..).zip(&parts.of_face) {
        if part != Parts::NONE && open[part as usize] {
            found.faces.push(f);
            found.part.push(number[part as usize]);
        }
    }
    found
}
