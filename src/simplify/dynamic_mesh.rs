//! The mesh during edge collapses, its preparation, and quadrics.

use glam::{DMat3, DVec3};

use crate::context::{Cancelled, Context};
use crate::math::collinear;
use crate::mesh::{Edges, Fans, Parts, Surface};

/// Marks an absent corner or vertex.
pub(super) const NONE: u32 = u32::MAX;

/// Mark of an edge on a line that must be kept. A face has three such bits, shifted by the index of the edge's corner.
pub(super) const LINE: u8 = 1;
/// Mark of a boundary edge, which has one face; the bits follow the three bits of [`LINE`].
pub(super) const OPEN: u8 = 8;

/// Share of its trace that is added to a quadric's diagonal. The quadric then has a unique minimum, even if its planes
/// meet in a line or are coplanar: the candidate nearest to the start of the search.
const REGULARISATION: f64 = 1e-4;

/// Weight of the planes that keep a line in place, relative to surface planes, per squared length of the line.
const LINE_WEIGHT: f64 = 1.0;

/// The faces while edges collapse. The corners of each vertex form a linked list, so that two lists merge in a few
/// steps. A corner is `3 * face + i`, and also identifies the edge from there to the next corner.
pub(super) struct DynamicMesh {
    /// Positions, scaled by a power of two into the range of the exact predicates.
    pub at: Vec<DVec3>,
    /// Faces as indices into `at`; `[NONE; 3]` for a removed face.
    pub faces: Vec<[u32; 3]>,
    /// For each vertex, one of its corners.
    first: Vec<u32>,
    /// For each corner, the next corner of the same vertex.
    next: Vec<u32>,
    /// For each face, the marks of its three edges: [`LINE`] and [`OPEN`], shifted by the index of the edge's corner.
    marks: Vec<u8>,
    /// For each face, its distance from the original surface, and of that surface from the face: the last measured
    /// value plus all steps since.
    pub error: Vec<f32>,
    /// For each face, an upper bound of that distance: the sum of the lengths of all steps.
    pub bound: Vec<f32>,
    /// For each face, whether its corners are exactly collinear.
    pub flat: Vec<bool>,
    /// For each vertex, the number of line edges that end there, at most 255.
    pub lines: Vec<u8>,
    /// Vertices that take part in no collapse.
    pub fixed: Vec<bool>,
    /// For each vertex, the number of its faces.
    pub degree: Vec<u32>,
    /// For each vertex, the quadric of its planes.
    pub quadric: Vec<Quadric>,
    /// For each vertex, a counter that increases whenever its faces change.
    pub version: Vec<u32>,
    /// The current number of faces.
    pub alive: usize,
}

impl DynamicMesh {
    /// Creates the mesh of positions and faces, without marks.
    pub fn new(at: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Self {
        let (vertices, count) = (at.len(), faces.len());
        let mut mesh = Self {
            at,
            first: vec![NONE; vertices],
            next: vec![NONE; 3 * count],
            marks: vec![0; count],
            error: vec![0.0; count],
            bound: vec![0.0; count],
            flat: vec![false; count],
            lines: vec![0; vertices],
            fixed: vec![false; vertices],
            degree: vec![0; vertices],
            quadric: vec![Quadric::default(); vertices],
            version: vec![0; vertices],
            alive: count,
            faces,
        };
        // From last to first, so that the lists are in the order of faces.
        for f in (0..count).rev() {
            for i in 0..3 {
                let v = mesh.faces[f][i] as usize;
                mesh.degree[v] += 1;
                mesh.link(v, corner(f, i));
            }
        }
        mesh
    }

    /// Prepends a corner to a vertex's list.
    fn link(&mut self, v: usize, corner: u32) {
        self.next[corner as usize] = self.first[v];
        self.first[v] = corner;
    }

    /// Whether a face still exists.
    pub fn is_alive(&self, face: usize) -> bool {
        self.faces[face][0] != NONE
    }

    /// Lists the corners of a vertex, and unlinks those of removed faces.
    pub fn star(&mut self, v: u32, into: &mut Vec<u32>) {
        into.clear();
        let mut at = self.first[v as usize];
        let mut last = NONE;
        while at != NONE {
            let next = self.next[at as usize];
            if self.faces[at as usize / 3][at as usize % 3] == v {
                into.push(at);
                if last == NONE {
                    self.first[v as usize] = at;
                } else {
                    self.next[last as usize] = at;
                }
                last = at;
            }
            at = next;
        }
        match last {
            NONE => self.first[v as usize] = NONE,
            last => self.next[last as usize] = NONE,
        }
    }

    /// Replaces the corners of a vertex.
    pub fn set_star(&mut self, v: u32, corners: &[u32]) {
        self.first[v as usize] = NONE;
        for &corner in corners.iter().rev() {
            self.link(v as usize, corner);
        }
        #[expect(clippy::cast_possible_truncation, reason = "corners are counted in u32")]
        {
            self.degree[v as usize] = corners.len() as u32;
        }
    }

    /// The corner positions of a face.
    pub fn corners(&self, face: usize) -> [DVec3; 3] {
        self.faces[face].map(|v| self.at[v as usize])
    }

    /// The marks of the edge that starts at a corner.
    pub fn marks(&self, corner: u32) -> u8 {
        self.marks[corner as usize / 3] >> (corner % 3) & (LINE | OPEN)
    }

    /// Adds marks to the edge that starts at a corner.
    pub fn mark(&mut self, corner: u32, marks: u8) {
        self.marks[corner as usize / 3] |= marks << (corner % 3);
    }
}

/// The index of corner `i` of a face.
pub(super) fn corner(face: usize, i: usize) -> u32 {
    #[expect(clippy::cast_possible_truncation, reason = "corners are counted in u32")]
    {
        (3 * face + i) as u32
    }
}

/// The parts of the original surface.
pub(super) struct PartVolumes {
    /// The part of each vertex that takes part in collapses.
    pub of_vertex: Vec<u32>,
    /// For each part, six times its current volume and its original volume; none for open parts.
    pub volumes: Vec<Option<[f64; 2]>>,
}

/// Prepares a surface whose vertices have pairwise different positions; `unit` are its positions in the scaled
/// coordinates. Finds lines, fixed vertices (those that are neither interior nor boundary vertices of a manifold) and
/// parts, and builds the quadrics.
pub(super) fn prepare(
    welded: &Surface,
    unit: Vec<DVec3>,
    feature_cosine: f64,
    context: &Context<'_>,
) -> Result<(DynamicMesh, PartVolumes), Cancelled> {
    let edges = Edges::new(&welded.faces);
    context.check()?;
    let parts = Parts::new(welded, &edges);
    let open = parts.open(&edges);
    let mut mesh = DynamicMesh::new(unit, welded.faces.clone());
    fix_irregular(&mut mesh, welded, &edges);
    context.check()?;
    let normals: Vec<DVec3> = (0..mesh.faces.len()).map(|f| area_vector(mesh.corners(f))).collect();
    for (f, &normal) in normals.iter().enumerate() {
        let [a, b, c] = mesh.corners(f);
        mesh.flat[f] = collinear(a, b, c);
        let doubled = normal.length();
        if doubled > 0.0 {
            let plane = Quadric::plane(normal / doubled, a, doubled * 0.5);
            for v in mesh.faces[f] {
                mesh.quadric[v as usize].add(&plane);
            }
        }
    }
    context.check()?;
    for e in 0..edges.len() {
        mark_line(&mut mesh, &edges, e, &normals, feature_cosine);
    }
    let mut part_volumes = PartVolumes {
        of_vertex: vec![Parts::NONE; mesh.at.len()],
        volumes: open.iter().map(|&open| (!open).then_some([0.0; 2])).collect(),
    };
    // Parts that share an edge of more than two faces count as one part here, without a volume of its own.
    for half_edges in edges.iter().filter(|h| h.len() > 2) {
        let part = parts.of_face[half_edges[0] as usize / 3];
        part_volumes.volumes[part as usize] = None;
    }
    for (f, &part) in parts.of_face.iter().enumerate().filter(|(_, part)| **part != Parts::NONE) {
        let [a, b, c] = mesh.corners(f);
        if let Some(volume) = &mut part_volumes.volumes[part as usize] {
            volume[0] += a.dot(b.cross(c));
        }
        for v in mesh.faces[f] {
            part_volumes.of_vertex[v as usize] = part;
        }
    }
    for volume in part_volumes.volumes.iter_mut().flatten() {
        volume[1] = volume[0];
    }
    Ok((mesh, part_volumes))
}

/// Fixes vertices whose faces do not form one fan or have inconsistent winding.
fn fix_irregular(mesh: &mut DynamicMesh, welded: &Surface, edges: &Edges) {
    for e in 0..edges.len() {
        let half_edges = edges.half_edges(e);
        let regular = match *half_edges {
            [_] => true,
            [x, y] => Edges::is_forward(&mesh.faces, x) != Edges::is_forward(&mesh.faces, y),
            _ => false,
        };
        if !regular {
            for v in edges.vertices(e) {
                mesh.fixed[v as usize] = true;
            }
        }
    }
    let fans = Fans::new(welded, edges);
    for (fixed, fans) in mesh.fixed.iter_mut().zip(fans.at_vertices(welded)) {
        *fixed |= fans != 1;
    }
    for face in welded.faces.iter().filter(|[a, b, c]| a == b || b == c || c == a) {
        face.iter().for_each(|&v| mesh.fixed[v as usize] = true);
    }
}

/// Marks an edge that must be kept, and adds planes through the edge, perpendicular to its faces, that keep it in
/// place.
fn mark_line(mesh: &mut DynamicMesh, edges: &Edges, e: usize, normals: &[DVec3], feature_cosine: f64) {
    let half_edges = edges.half_edges(e);
    let marks = match *half_edges {
        [_] => LINE | OPEN,
        [x, y] => {
            let [n, m] = [x, y].map(|h| normals[h as usize / 3]);
            let scale = (n.length_squared() * m.length_squared()).sqrt();
            if scale > 0.0 && n.dot(m) < feature_cosine * scale { LINE } else { return }
        }
        _ => LINE,
    };
    let ends = edges.vertices(e);
    let [p, q] = ends.map(|v| mesh.at[v as usize]);
    for v in ends {
        mesh.lines[v as usize] = mesh.lines[v as usize].saturating_add(1);
    }
    for &h in half_edges {
        mesh.mark(h, marks);
        let across = normals[h as usize / 3].cross(q - p).normalize_or_zero();
        let plane = Quadric::plane(across, p, LINE_WEIGHT * p.distance_squared(q));
        for v in ends {
            mesh.quadric[v as usize].add(&plane);
        }
    }
}

/// A triangle's area vector: its unit normal times twice its area.
pub(super) fn area_vector([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// The sum of weighted squared distances to planes, as a function of a point (Garland and Heckbert 1997).
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Quadric {
    /// The six distinct entries of the matrix: xx, xy, xz, yy, yz, zz.
    a: [f64; 6],
    b: DVec3,
    c: f64,
    /// Sum of the weights.
    pub weight: f64,
}

impl Quadric {
    /// The weighted squared distance to the plane through `point` with the unit normal `normal`.
    pub fn plane(normal: DVec3, point: DVec3, weight: f64) -> Self {
        let n = normal;
        let d = -n.dot(point);
        Self {
            a: [n.x * n.x, n.x * n.y, n.x * n.z, n.y * n.y, n.y * n.z, n.z * n.z].map(|x| x * weight),
            b: n * (d * weight),
            c: d * d * weight,
            weight,
        }
    }

    /// Adds another quadric.
    pub fn add(&mut self, other: &Self) {
        for (x, y) in self.a.iter_mut().zip(&other.a) {
            *x += y;
        }
        self.b += other.b;
        self.c += other.c;
        self.weight += other.weight;
    }

    /// The matrix times a vector.
    fn times(&self, p: DVec3) -> DVec3 {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        DVec3::new(xx * p.x + xy * p.y + xz * p.z, xy * p.x + yy * p.y + yz * p.z, xz * p.x + yz * p.y + zz * p.z)
    }

    /// The value at a point, clamped to 0 against rounding.
    pub fn at(&self, p: DVec3) -> f64 {
        (p.dot(self.times(p)) + 2.0 * self.b.dot(p) + self.c).max(0.0)
    }

    /// The minimum, with a slight pull towards `start`; none if the quadric has no plane.
    pub fn minimum(&self, start: DVec3) -> Option<DVec3> {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let regularisation = REGULARISATION * (xx + yy + zz);
        let matrix = DMat3::from_cols(
            DVec3::new(xx + regularisation, xy, xz),
            DVec3::new(xy, yy + regularisation, yz),
            DVec3::new(xz, yz, zz + regularisation),
        );
        // The step must cancel half of the gradient at the start.
        let slope = self.times(start) + self.b;
        let step = matrix.determinant().is_normal().then(|| matrix.inverse() * -slope)?;
        step.is_finite().then_some(start + step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_planes_have_their_minimum_where_they_meet_one_nearest_to_start() {
        let corner = DVec3::new(0.3, -0.2, 0.9);
        let mut three = Quadric::default();
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            three.add(&Quadric::plane(axis, corner, 2.0));
        }
        let found = three.minimum(DVec3::ZERO).unwrap();
        assert!(found.distance(corner) < 1e-3 && three.at(corner) < 1e-15, "{found}");
        assert!((three.at(corner + DVec3::X) - 2.0).abs() < 1e-12);
        let one = Quadric::plane(DVec3::Z, corner, 1.0);
        let found = one.minimum(DVec3::ZERO).unwrap();
        assert!(found.distance(DVec3::Z * corner.z) < 1e-3, "{found}");
        assert_eq!(Quadric::default().minimum(DVec3::ZERO), None);
    }
}
