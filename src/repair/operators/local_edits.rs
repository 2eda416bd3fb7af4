//! A surface with the faces at each vertex, for sequences of local edits. The surface need not be manifold.

use glam::DVec3;

use crate::math::{collinear, to_unit_range};
use crate::mesh::Surface;

/// A surface under local edits. [`LocalEdits::finish`] drops the removed faces.
pub(super) struct LocalEdits<'a> {
    /// The surface under edit, with removed faces still in place.
    pub surface: &'a mut Surface,
    /// The positions in the range of [`to_unit_range`].
    pub unit: Vec<DVec3>,
    alive: Vec<bool>,
    /// The faces at each vertex.
    stars: Vec<Vec<u32>>,
    /// The number of star entries visited so far, to be compared with a budget.
    pub spent: u64,
}

/// The lengths of a face on the unit scale.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    /// The length of each edge, from corner `i` to corner `i + 1`.
    pub sides: [f64; 3],
    /// The height over the longest edge.
    pub height: f64,
}

impl Shape {
    /// Measures a triangle.
    pub fn of([a, b, c]: [DVec3; 3]) -> Self {
        let sides = [a.distance(b), b.distance(c), c.distance(a)];
        let longest = sides.into_iter().fold(0.0, f64::max);
        let height = if longest > 0.0 { (b - a).cross(c - a).length() / longest } else { 0.0 };
        Self { sides, height }
    }

    /// The length of the shortest edge.
    pub fn shortest(&self) -> f64 {
        self.sides.into_iter().fold(f64::INFINITY, f64::min)
    }

    /// The index of the longest edge.
    pub fn longest(&self) -> usize {
        (1..3).fold(0, |best, i| if self.sides[i] > self.sides[best] { i } else { best })
    }
}

/// An edge with its two faces: `[a, b, m]` and `[b, a, d]`, up to rotation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hinge {
    /// The two faces.
    pub faces: [u32; 2],
    /// The ends `a` and `b` of the edge.
    pub ends: [u32; 2],
    /// The corners `m` and `d` opposite to the edge.
    pub apexes: [u32; 2],
}

impl Hinge {
    /// The two faces after flipping the edge to connect the apexes.
    pub fn flipped(&self) -> [[u32; 3]; 2] {
        let ([a, b], [m, d]) = (self.ends, self.apexes);
        [[m, a, d], [b, m, d]]
    }
}

impl<'a> LocalEdits<'a> {
    /// Collects the faces at each vertex.
    pub fn new(surface: &'a mut Surface) -> Self {
        let unit = to_unit_range(&surface.positions);
        let mut degree = vec![0usize; unit.len()];
        for &v in surface.faces.iter().flatten() {
            degree[v as usize] += 1;
        }
        let mut stars: Vec<Vec<u32>> = degree.into_iter().map(Vec::with_capacity).collect();
        for (face, f) in surface.faces.iter().zip(0u32..) {
            for &v in face {
                stars[v as usize].push(f);
            }
        }
        Self { alive: vec![true; surface.faces.len()], surface, unit, stars, spent: 0 }
    }

    /// Whether a face has not been removed.
    pub fn is_alive(&self, face: u32) -> bool {
        self.alive[face as usize]
    }

    /// The vertices of a face.
    pub fn face(&self, face: u32) -> [u32; 3] {
        self.surface.faces[face as usize]
    }

    /// The positions of three vertices on the unit scale.
    pub fn points(&self, face: [u32; 3]) -> [DVec3; 3] {
        face.map(|v| self.unit[v as usize])
    }

    /// The lengths of a face.
    pub fn shape(&self, face: u32) -> Shape {
        Shape::of(self.points(self.face(face)))
    }

    /// Twice the area times the unit normal, on the unit scale.
    pub fn area_vector(&self, face: [u32; 3]) -> DVec3 {
        let [a, b, c] = self.points(face);
        (b - a).cross(c - a)
    }

    /// Whether the corners are exactly collinear.
    pub fn is_collinear(&self, face: [u32; 3]) -> bool {
        let [a, b, c] = self.points(face);
        collinear(a, b, c)
    }

    /// The faces at a vertex.
    pub fn star(&self, v: u32) -> &[u32] {
        &self.stars[v as usize]
    }

    /// The faces that contain both vertices.
    pub fn faces_at_edge(&mut self, a: u32, b: u32) -> Vec<u32> {
        let (few, other) = if self.star(a).len() <= self.star(b).len() { (a, b) } else { (b, a) };
        self.spent += self.star(few).len() as u64;
        self.star(few).iter().copied().filter(|&f| self.face(f).contains(&other)).collect()
    }

    /// The edge from `a` to `b` with its faces. `None` unless exactly two faces traverse the edge in opposite directions and
    /// have different third vertices.
    pub fn hinge(&mut self, a: u32, b: u32) -> Option<Hinge> {
        let &[f, g] = &*self.faces_at_edge(a, b) else { return None };
        let along = |face: [u32; 3]| (0..3).find(|&i| face[i] == a && face[(i + 1) % 3] == b);
        let (faces, at) = match (along(self.face(f)), along(self.face(g))) {
            (Some(at), None) => ([f, g], at),
            (None, Some(at)) => ([g, f], at),
            _ => return None,
        };
        let m = self.face(faces[0])[(at + 2) % 3];
        let d = self.face(faces[1]).into_iter().find(|&v| v != a && v != b)?;
        (m != d).then_some(Hinge { faces, ends: [a, b], apexes: [m, d] })
    }

    /// Replaces a face's vertices.
    pub fn set_face(&mut self, face: u32, corners: [u32; 3]) {
        let old = std::mem::replace(&mut self.surface.faces[face as usize], corners);
        for v in old {
            if !corners.contains(&v) {
                self.stars[v as usize].retain(|&f| f != face);
            }
        }
        for v in corners {
            if !old.contains(&v) {
                self.stars[v as usize].push(face);
            }
        }
    }

    /// Removes a face.
    pub fn remove(&mut self, face: u32) {
        self.alive[face as usize] = false;
        for v in self.face(face) {
            self.stars[v as usize].retain(|&f| f != face);
        }
    }

    /// Collapses vertex `a` into `b` and removes their common faces.
    pub fn collapse(&mut self, a: u32, b: u32) {
        for f in std::mem::take(&mut self.stars[a as usize]) {
            let face = self.face(f);
            if face.contains(&b) {
                self.remove(f);
            } else {
                self.surface.faces[f as usize] = face.map(|v| if v == a { b } else { v });
                self.stars[b as usize].push(f);
            }
        }
    }

    /// Drops the removed faces and the vertices that no face uses.
    pub fn finish(self) {
        if self.alive.contains(&false) {
            self.surface.retain_faces(&self.alive);
        }
        self.surface.drop_unreferenced();
    }
}
