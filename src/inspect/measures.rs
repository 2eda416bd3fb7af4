use serde::{Deserialize, Serialize};

use super::Meeting;

/// A mesh measured. Vertices are merged at exactly equal positions first, as every STL reader must, so that the
/// counts say what a slicer sees; `-0.0` equals `0.0`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Measures {
    /// Faces, as the file has them.
    pub faces: u64,
    /// Different vertex positions that a face uses.
    pub vertices: u64,
    /// Different edges.
    pub edges: u64,
    /// Edge-connected parts of the raw mesh, counted before anything is processed.
    pub parts: u64,
    /// Edges that one face uses.
    pub boundary_edges: u64,
    /// Closed chains of boundary edges.
    pub boundary_loops: u64,
    /// Edges that more than two faces use.
    pub non_manifold_edges: u64,
    /// Vertices whose faces form more than one fan.
    pub non_manifold_vertices: u64,
    /// Edges of two faces that both run along it in the same direction.
    pub misoriented_edges: u64,
    /// Faces without area: a repeated vertex, or corners on a line, or so near one that f64 finds no area.
    pub degenerate_faces: u64,
    /// Faces with the same three vertices as an earlier face.
    pub duplicate_faces: u64,
    /// Vertices of the file that no face uses.
    pub unreferenced_vertices: u64,
    /// Faces with a corner that is not a finite number; they are left out of every other count.
    pub non_finite_faces: u64,
    /// Edges of two faces that are joined by position only: in the file each of the two faces has vertices of its own there. A reader
    /// that takes vertices by index sees a slit. 0 for STL and glTF, whose readers join vertices by position.
    #[serde(default)]
    pub unshared_edges: u64,
    /// Faces that name a vertex which the file does not give; they are left out of every other count.
    #[serde(default)]
    pub unreadable_faces: u64,
    /// Faces that lose a corner and edges that lose their pairing for a reader that rounds positions to eight decimals, as trimesh does,
    /// or to 1e-7 of the diagonal where that is finer.
    #[serde(default)]
    pub near_coincident_defects: u64,
    /// Closed parts that are turned inside out: not within another part, and of negative volume.
    pub inverted_parts: u64,
    /// Materials of an assembly of bodies, such as a 3MF file for a print of several materials. Bodies of one material are judged
    /// together; those of another may touch them. 0 where the file is one mesh.
    #[serde(default)]
    pub materials: u64,
    /// Faces of an assembly that lie inside a body of another material.
    #[serde(default)]
    pub faces_in_other_materials: u64,
    /// No boundary edge, and there is a face.
    pub closed: bool,
    /// Every edge has at most two faces and every vertex one fan.
    pub manifold: bool,
    /// No edge is crossed twice in the same direction.
    pub consistent: bool,
    /// Closed, manifold, consistent, and no part is inside out.
    pub outward: bool,
    /// The box around all faces; none for a mesh without faces.
    pub bounding_box: Option<BoundingBox>,
    /// Area of all faces, in square units.
    pub area: f64,
    /// Enclosed volume, in cubic units.
    pub volume: Volume,
    /// Pairs of faces that intersect other than in a shared vertex or edge.
    pub self_intersections: SelfIntersections,
}

impl Measures {
    /// Whether the file is printable as it stands: closed, manifold, outward, without degenerate or duplicate faces, of positive volume,
    /// and proven to be without self-intersections; all that for a reader that joins vertices by position, for one that takes them by
    /// index, and for one that rounds positions to eight decimals; and every face can be read.
    ///
    /// The outcome of a repair, `after.check`, `meshmend inspect` and the ranking of candidates all ask this function.
    #[must_use]
    pub fn printable(&self) -> bool {
        self.printable_but_for_intersections() && self.self_intersections.proven_none()
    }

    /// What [`Measures::printable`] says but for self-intersections.
    #[must_use]
    pub fn printable_but_for_intersections(&self) -> bool {
        self.closed
            && self.manifold
            && self.consistent
            && self.outward
            && self.faces > 0
            && self.non_finite_faces == 0
            && self.unreadable_faces == 0
            && self.unshared_edges == 0
            && self.near_coincident_defects == 0
            && self.degenerate_faces == 0
            && self.duplicate_faces == 0
            && self.faces_in_other_materials == 0
            && self.volume.value > 0.0
    }

    /// Whether the mesh is printable; none where nothing is wrong that was looked for, but intersections were not looked
    /// for, or not to the end.
    #[must_use]
    pub fn verdict(&self) -> Option<bool> {
        let undecided = !self.printable()
            && self.printable_but_for_intersections()
            && self.self_intersections.pairs.unwrap_or(0) == 0;
        (!undecided).then(|| self.printable())
    }

    /// Its size and its defects in a few words, for a log.
    #[must_use]
    pub fn in_short(&self) -> String {
        format!("{} faces, {} parts, {} defects", self.faces, self.parts, self.defects())
    }

    /// What was left out of every count, as a sentence for the person who sent the file.
    #[must_use]
    pub fn omitted(&self) -> Option<String> {
        let faces = self.non_finite_faces;
        (faces > 0).then(|| format!("{faces} faces have a corner that is not a finite number; they were left out"))
    }

    /// How many things are wrong, to compare candidates of which none is printable.
    #[must_use]
    pub fn defects(&self) -> u64 {
        self.boundary_edges
            + self.non_manifold_edges
            + self.non_manifold_vertices
            + self.misoriented_edges
            + self.degenerate_faces
            + self.duplicate_faces
            + self.non_finite_faces
            + self.unreadable_faces
            + self.unshared_edges
            + self.near_coincident_defects
            + self.inverted_parts
            + self.faces_in_other_materials
            + self.self_intersections.pairs.unwrap_or(0)
    }

    /// What keeps the mesh from being printable, each fault with its count in words.
    #[must_use]
    pub fn faults(&self) -> Vec<String> {
        let counts = [
            (self.non_manifold_edges, "non-manifold edge", "non-manifold edges"),
            (self.non_manifold_vertices, "non-manifold vertex", "non-manifold vertices"),
            (
                self.misoriented_edges,
                "edge between faces of opposite winding",
                "edges between faces of opposite winding",
            ),
            (self.degenerate_faces, "face without area", "faces without area"),
            (self.duplicate_faces, "duplicate face", "duplicate faces"),
            (self.non_finite_faces, "face that is not finite", "faces that are not finite"),
            (
                self.faces_in_other_materials,
                "face inside a body of another material",
                "faces inside bodies of another material",
            ),
            (self.unreadable_faces, "face that names a missing vertex", "faces that name missing vertices"),
            (
                self.unshared_edges,
                "edge whose two faces do not share its vertices",
                "edges whose two faces do not share their vertices",
            ),
            (
                self.near_coincident_defects,
                "face or edge that breaks when positions are rounded to eight decimals",
                "faces and edges that break when positions are rounded to eight decimals",
            ),
            (self.inverted_parts, "part turned inside out", "parts turned inside out"),
            (self.self_intersections.pairs.unwrap_or(0), "pair of intersecting faces", "pairs of intersecting faces"),
        ];
        let words =
            |&(count, one, more): &(u64, &str, &str)| format!("{count} {}", if count == 1 { one } else { more });
        let mut faults = Vec::new();
        if self.boundary_edges > 0 {
            let holes = words(&(self.boundary_loops, "hole", "holes"));
            faults.push(format!("{holes} ({})", words(&(self.boundary_edges, "open edge", "open edges"))));
        }
        faults.extend(counts.iter().filter(|(count, ..)| *count > 0).map(words));
        if !self.self_intersections.checked {
            faults.push("intersecting faces were not looked for".to_owned());
        } else if !self.self_intersections.complete {
            faults.push("so many overlapping faces that they were not all counted".to_owned());
        }
        if faults.is_empty() && !self.printable() {
            faults.push("it encloses no volume".to_owned());
        }
        faults
    }
}

/// An axis-parallel box.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct BoundingBox {
    /// Smallest coordinates.
    pub min: [f64; 3],
    /// Largest coordinates.
    pub max: [f64; 3],
}

impl BoundingBox {
    /// Length of the diagonal.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        (0..3).map(|k| (self.max[k] - self.min[k]).powi(2)).sum::<f64>().sqrt()
    }
}

/// Enclosed volume by the divergence theorem.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Volume {
    /// Cubic units; negative for a mesh that is inside out.
    pub value: f64,
    /// Whether the mesh is closed and consistently oriented, without which the figure means little.
    pub reliable: bool,
}

/// Pairs of faces that intersect, counted exactly: they have a point in common beside a vertex or an edge that they
/// share. Left out are faces whose corners are on a line and pairs with the same three vertices, which are counted as
/// degenerate and duplicate faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SelfIntersections {
    /// Whether they were counted at all.
    pub checked: bool,
    /// Whether the count was brought to its end. Where it is not, for the sake of time, each number is at least so
    /// large.
    pub complete: bool,
    /// How many pairs, where counted.
    pub pairs: Option<u64>,
    /// Pairs within one edge-connected part.
    pub within_one_part: u64,
    /// Pairs of faces of two parts.
    pub between_parts: u64,
    /// Pairs of which the inside of one passes through the inside of the other.
    pub crossing: u64,
    /// Pairs that only touch.
    pub touching: u64,
    /// Pairs that lie in one plane and overlap.
    pub coplanar: u64,
    /// Faces that are in a pair.
    pub faces: u64,
}

impl SelfIntersections {
    /// Whether there is none for certain.
    #[must_use]
    pub fn proven_none(&self) -> bool {
        self.checked && self.complete && self.pairs == Some(0)
    }
}

/// Two faces that intersect other than in a shared vertex or edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct IntersectingPair {
    /// The faces by index in the file, the smaller first; between two meshes, first that of the first mesh.
    pub faces: [u32; 2],
    /// How they meet.
    pub meeting: Meeting,
    /// Whether both are of one edge-connected part.
    pub within_one_part: bool,
}

/// All faces of a mesh, or of two meshes, that intersect.
#[derive(Debug, Clone, PartialEq)]
pub struct Intersections {
    /// The pairs, sorted. Of more than a million those that were found first.
    pub pairs: Vec<IntersectingPair>,
    /// Exact counts of all pairs, listed or not.
    pub counts: SelfIntersections,
    /// For each face of the file whether it takes part; between two meshes, of the first and then of the second.
    pub takes_part: [Vec<bool>; 2],
}
