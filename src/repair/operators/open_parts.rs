use crate::mesh::{Edges, Parts, Surface};

/// The parts of a surface that have a boundary.
pub(in crate::repair) struct OpenParts {
    /// How many there are.
    pub count: u64,
    /// Their faces, in order.
    pub faces: Vec<u32>,
    /// For each of those its part, by number among the open ones.
    pub part: Vec<u32>,
}

/// Finds the parts that have an edge of one face.
pub(in crate::repair) fn open_parts(surface: &Surface) -> OpenParts {
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
