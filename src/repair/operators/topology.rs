//! What the indices of a surface's faces tell: how much is wrong, and which parts have a boundary.

use crate::inspect::group_faces;
use crate::math::{collinear, to_unit_range};
use crate::mesh::{Edges, Fans, Parts, Surface};

/// What can be wrong with a mesh as far as its faces' indices tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Counter {
    /// Edges of one face.
    BoundaryEdges,
    /// Edges of more than two faces.
    NonmanifoldEdges,
    /// Edges of two faces that run along them in the same direction.
    MisorientedEdges,
    /// Vertices whose faces form more than one fan.
    PinchedVertices,
    /// Faces whose corners lie on a line.
    DegenerateFaces,
    /// Faces with the same three vertices as an earlier one.
    DuplicateFaces,
}

impl Counter {
    /// All of them, in the order of [`Counts`].
    pub const ALL: [Self; 6] = [
        Self::BoundaryEdges,
        Self::NonmanifoldEdges,
        Self::MisorientedEdges,
        Self::PinchedVertices,
        Self::DegenerateFaces,
        Self::DuplicateFaces,
    ];

    /// In words, for many.
    #[must_use]
    pub fn in_words(self) -> &'static str {
        match self {
            Self::BoundaryEdges => "open edges",
            Self::NonmanifoldEdges => "non-manifold edges",
            Self::MisorientedEdges => "edges between faces that are turned against one another",
            Self::PinchedVertices => "pinched vertices",
            Self::DegenerateFaces => "faces without area",
            Self::DuplicateFaces => "duplicate faces",
        }
    }
}

/// How much of each is wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts([u64; Counter::ALL.len()]);

impl Counts {
    /// Counts by index: what stands at one position with indices of its own is apart here. Linear but for sorting.
    #[must_use]
    pub fn of(surface: &Surface) -> Self {
        let faces = &surface.faces;
        let edges = Edges::new(faces);
        let mut counts = Self::default();
        for half_edges in edges.iter() {
            let counter = match *half_edges {
                [_] => Counter::BoundaryEdges,
                [x, y] if Edges::is_forward(faces, x) == Edges::is_forward(faces, y) => Counter::MisorientedEdges,
                [_, _] => continue,
                _ => Counter::NonmanifoldEdges,
            };
            counts.0[counter as usize] += 1;
        }
        let unit = to_unit_range(&surface.positions);
        let flat = |face: &&[u32; 3]| {
            let [a, b, c] = face.map(|v| unit[v as usize]);
            collinear(a, b, c)
        };
        counts.0[Counter::PinchedVertices as usize] = Fans::new(surface, &edges).nonmanifold_vertices;
        counts.0[Counter::DegenerateFaces as usize] = faces.iter().filter(flat).count() as u64;
        counts.0[Counter::DuplicateFaces as usize] = (faces.len() - group_faces(faces).len()) as u64;
        counts
    }

    /// Whether there is more of any kind than before.
    pub(super) fn rose_from(&self, before: &Self) -> bool {
        self.0.iter().zip(&before.0).any(|(now, before)| now > before)
    }

    /// How much of one kind.
    #[must_use]
    pub fn get(&self, counter: Counter) -> u64 {
        self.0[counter as usize]
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
