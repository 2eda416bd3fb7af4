//! Report types for the counts and sizes of a mesh, and the definition of a printable mesh.

use serde::{Deserialize, Serialize};

use super::Meeting;

/// Counts and sizes of a mesh. Vertices at exactly equal positions are merged first, as every STL reader must, so the
/// counts agree with a slicer's view; `-0.0` equals `0.0`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Measures {
    /// Number of faces in the file.
    pub faces: u64,
    /// Number of distinct vertex positions that faces use.
    pub vertices: u64,
    /// Number of distinct edges.
    pub edges: u64,
    /// Number of edge-connected parts, counted before any processing.
    pub parts: u64,
    /// Edges with exactly one face.
    pub boundary_edges: u64,
    /// Closed chains of boundary edges, that is, holes.
    pub boundary_loops: u64,
    /// Edges with more than two faces.
    pub non_manifold_edges: u64,
    /// Vertices whose faces form more than one edge-connected fan.
    pub non_manifold_vertices: u64,
    /// Edges whose two faces have opposite winding: both traverse the edge in the same direction.
    pub misoriented_edges: u64,
    /// Faces without area: a vertex repeats, the corners are collinear, or the area is zero in f64.
    pub degenerate_faces: u64,
    /// Faces with the same three vertices as an earlier face.
    pub duplicate_faces: u64,
    /// Vertices of the file that no face uses.
    pub unreferenced_vertices: u64,
    /// Faces with a corner that is not a finite number. All other counts exclude these faces.
    pub non_finite_faces: u64,
    /// Edges whose two faces share positions but not vertex indices in the file. A reader that joins vertices by
    /// index sees a slit. 0 for STL and glTF, whose readers join vertices by position.
    #[serde(default)]
    pub unshared_edges: u64,
    /// Faces that name a vertex missing from the file. All other counts exclude these faces.
    #[serde(default)]
    pub unreadable_faces: u64,
    /// Faces that collapse and edges that lose their opposite face when a reader rounds positions. Counted for
    /// rounding to eight decimals, as in trimesh, or to 1e-7 of the diagonal if that is finer.
    #[serde(default)]
    pub near_coincident_defects: u64,
    /// Closed parts turned inside out: of negative volume and not a cavity of another part.
    pub inverted_parts: u64,
    /// Number of materials in an assembly of bodies, such as a 3MF file for a multi-material print. Bodies of one
    /// material are judged together; bodies of different materials may touch. 0 if the file is a single mesh.
    #[serde(default)]
    pub materials: u64,
    /// Faces of an assembly that lie inside a body of another material.
    #[serde(default)]
    pub faces_in_other_materials: u64,
    /// Whether the mesh has faces and no boundary edge.
    pub closed: bool,
    /// Whether every edge has at most two faces and every vertex one fan.
    pub manifold: bool,
    /// Whether no two faces traverse an edge in the same direction.
    pub consistent: bool,
    /// Whether the mesh is closed, manifold and consistent, and no part is inside out.
    pub outward: bool,
    /// Bounding box of all faces; `null` for a mesh without faces.
    pub bounding_box: Option<BoundingBox>,
    /// Total area of all faces, in square model units.
    pub area: f64,
    /// Enclosed volume, in cubic model units.
    pub volume: Volume,
    /// Pairs of faces that intersect outside a shared vertex or edge.
    pub self_intersections: SelfIntersections,
}

impl Measures {
    /// Whether the mesh is printable as it is: closed, manifold, outward, of positive volume, without degenerate or
    /// duplicate faces, and proven free of self-intersections. Every face must be readable. These conditions must
    /// hold for readers that join vertices by position, by index, or by positions rounded to eight decimals.
    ///
    /// The outcome of a repair, `after.check`, `meshmend inspect` and the ranking of candidates all use this
    /// function.
    #[must_use]
    pub fn printable(&self) -> bool {
        self.printable_but_for_intersections() && self.self_intersections.proven_none()
    }

    /// [`Measures::printable`] without the condition on self-intersections.
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

    /// Whether the mesh is printable. `None` if only the search for intersections is missing or incomplete and no
    /// other fault is known.
    #[must_use]
    pub fn verdict(&self) -> Option<bool> {
        let undecided = !self.printable()
            && self.printable_but_for_intersections()
            && self.self_intersections.pairs.unwrap_or(0) == 0;
        (!undecided).then(|| self.printable())
    }

    /// One-line summary of size and defects for logs.
    #[must_use]
    pub fn in_short(&self) -> String {
        format!("{} faces, {} parts, {} defects", self.faces, self.parts, self.defects())
    }

    /// A warning for the sender about faces that all counts exclude; `None` if there are none.
    #[must_use]
    pub fn omitted(&self) -> Option<String> {
        let faces = self.non_finite_faces;
        let subject = if faces == 1 { "1 face".to_owned() } else { format!("{faces} faces") };
        let verb = if faces == 1 { "was" } else { "were" };
        (faces > 0).then(|| format!("{subject} with a corner that is not a finite number {verb} ignored."))
    }

    /// Total number of defects, for ranking candidates of which none is printable.
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

    /// Descriptions of the faults that keep the mesh from being printable, each with its count.
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
            (self.non_finite_faces, "face with a non-finite corner", "faces with a non-finite corner"),
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
            faults.push("self-intersections not checked".to_owned());
        } else if !self.self_intersections.complete {
            faults.push("too many overlapping faces to count all intersections".to_owned());
        }
        if faults.is_empty() && !self.printable() {
            faults.push("no enclosed volume".to_owned());
        }
        faults
    }
}

/// An axis-parallel box.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct BoundingBox {
    /// Smallest x, y and z coordinates.
    pub min: [f64; 3],
    /// Largest x, y and z coordinates.
    pub max: [f64; 3],
}

impl BoundingBox {
    /// Length of the diagonal, in the unit of the coordinates.
    #[must_use]
    pub fn diagonal(&self) -> f64 {
        (0..3).map(|k| (self.max[k] - self.min[k]).powi(2)).sum::<f64>().sqrt()
    }
}

/// Enclosed volume, computed by the divergence theorem.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Volume {
    /// Signed volume in cubic model units; negative for a mesh turned inside out.
    pub value: f64,
    /// Whether the mesh is closed and consistently oriented. Otherwise the value has little meaning.
    pub reliable: bool,
}

/// Exact counts of intersecting face pairs: pairs with a common point outside a shared vertex or edge. Excludes flat
/// faces and pairs with the same three vertices, which count as degenerate and duplicate faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct SelfIntersections {
    /// Whether the search ran.
    pub checked: bool,
    /// Whether the search finished. If not, each count is a lower bound.
    pub complete: bool,
    /// Total number of pairs; `null` if the search did not run.
    pub pairs: Option<u64>,
    /// Pairs within one edge-connected part.
    pub within_one_part: u64,
    /// Pairs of faces from two different parts.
    pub between_parts: u64,
    /// Pairs in which the interior of one face passes through the interior of the other.
    pub crossing: u64,
    /// Pairs that only touch.
    pub touching: u64,
    /// Pairs that are coplanar and overlap.
    pub coplanar: u64,
    /// Number of faces in at least one pair.
    pub faces: u64,
}

impl SelfIntersections {
    /// Whether a complete search found no pair.
    #[must_use]
    pub fn proven_none(&self) -> bool {
        self.checked && self.complete && self.pairs == Some(0)
    }
}

/// Two faces that intersect outside a shared vertex or edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct IntersectingPair {
    /// File indices of the two faces, smaller first. Between two meshes, the first index belongs to the first mesh.
    pub faces: [u32; 2],
    /// How the two faces meet.
    pub meeting: Meeting,
    /// Whether both faces belong to one edge-connected part.
    pub within_one_part: bool,
}

/// All intersecting faces of a mesh, or between two meshes.
#[derive(Debug, Clone, PartialEq)]
pub struct Intersections {
    /// The pairs, sorted. Limited to the first million found.
    pub pairs: Vec<IntersectingPair>,
    /// Exact counts of all pairs, listed or not.
    pub counts: SelfIntersections,
    /// For each face of the file, whether it is in a pair. Between two meshes, one list per mesh.
    pub takes_part: [Vec<bool>; 2],
}
