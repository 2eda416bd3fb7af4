use glam::DVec3;

use super::quadric::Quadric;

/// No corner, no vertex.
pub(super) const NONE: u32 = u32::MAX;

/// Bits of an edge's marks: it is a line that must be kept, and it has one face only.
pub(super) const LINE: u8 = 1;
pub(super) const OPEN: u8 = 8;

/// The faces while edges collapse: each vertex knows its corners as a linked list, so that two lists become one in a few
/// steps. A corner is `3 * face + i`, and names the edge from there to the next corner too.
pub(super) struct Complex {
    /// Positions, scaled by a power of two into the range of the exact predicates.
    pub at: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
    /// For each vertex one of its corners, for each corner another one of the same vertex.
    first: Vec<u32>,
    next: Vec<u32>,
    /// For each face the marks of its three edges: [`LINE`] and [`OPEN`], shifted by the number of the edge's corner.
    marks: Vec<u8>,
    /// For each face how far it is from the surface at the start and that from it: what was measured last and what was added
    /// since.
    pub error: Vec<f32>,
    /// For each face a bound of that: all that was added.
    pub bound: Vec<f32>,
    /// For each face whether its corners lie on a line, exactly.
    pub flat: Vec<bool>,
    /// For each vertex how many lines end there, at most 255.
    pub lines: Vec<u8>,
    /// Vertices that take part in no collapse.
    pub fixed: Vec<bool>,
    /// For each vertex the number of its faces.
    pub degree: Vec<u32>,
    pub quadric: Vec<Quadric>,
    /// Grows whenever the faces around a vertex change.
    pub version: Vec<u32>,
    /// How many faces there are now.
    pub alive: usize,
}

impl Complex {
    pub fn new(at: Vec<DVec3>, faces: Vec<[u32; 3]>) -> Self {
        let (vertices, count) = (at.len(), faces.len());
        let mut it = Self {
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
        // From the last to the first, so that the lists stand in the order of faces.
        for f in (0..count).rev() {
            for i in 0..3 {
                let v = it.faces[f][i] as usize;
                it.degree[v] += 1;
                it.link(v, corner(f, i));
            }
        }
        it
    }

    fn link(&mut self, v: usize, corner: u32) {
        self.next[corner as usize] = self.first[v];
        self.first[v] = corner;
    }

    /// Whether a face is still there.
    pub fn is_alive(&self, face: usize) -> bool {
        self.faces[face][0] != NONE
    }

    /// Lists the corners of a vertex, and forgets those of faces that are gone.
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

    /// Makes these all the corners of a vertex.
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

pub(super) fn corner(face: usize, i: usize) -> u32 {
    #[expect(clippy::cast_possible_truncation, reason = "corners are counted in u32")]
    {
        (3 * face + i) as u32
    }
}
