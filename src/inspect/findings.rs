//! Kinds of defects, and the collection of the defects that an inspection finds.

use serde::{Deserialize, Serialize};

/// Kind of a defect that an inspection can locate.
///
/// The first ten kinds follow Parasolid's `PK_MESH_find_defects`. Each variant names the quantity in
/// a defect's `value`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum DefectKind {
    /// A part other than the largest; the value is its face count. Not a fault by itself.
    Disjoint,
    /// A region of faces folded back onto their neighbours; the value is the height between the two layers.
    Foldover,
    /// A face with height below the tolerance; the value is the height, 0 if its corners are exactly collinear.
    FlatFace,
    /// A face with an edge shorter than the tolerance; the value is that length, 0 if a vertex repeats. Also a flat
    /// face.
    DegenerateFace,
    /// A chain of coincident boundary edges that are not joined; the value is the widest gap.
    Slit,
    /// Two faces that intersect outside a shared vertex or edge.
    SelfIntersection,
    /// An edge with more than two faces; the value is their count.
    NonManifoldEdge,
    /// A vertex whose faces form more than one edge-connected fan; the value is the number of fans.
    NonManifoldVertex,
    /// A vertex whose stored normal points into the mesh; the value is the angle to the face normals, in radians.
    BadVertexNormal,
    /// A face that cannot be used because a corner is not finite or names a missing vertex.
    Corrupt,
    /// A hole, bounded by a closed chain of boundary edges; the value is the chain's length.
    Hole,
    /// An edge whose two faces have opposite winding.
    MisorientedEdge,
    /// A boundary vertex in the interior of a boundary edge; the value is the distance, 0 if the vertex lies exactly
    /// on the edge.
    TJunction,
    /// Chains of boundary edges that almost coincide; the value is the widest gap.
    Crack,
    /// A closed part turned inside out; the value, if any, is the (even) number of parts that contain it.
    InvertedPart,
    /// A face with the same vertices and the same winding as another face.
    DuplicateFace,
    /// A face with the same vertices as another face and the opposite winding.
    OppositeFace,
    /// A zero-thickness region whose two sides coincide; the value is the measured thickness.
    Sheet,
    /// A closed part inside other parts. The value counts the containing parts: positive for an inward-facing cavity,
    /// negative for a solid inside a solid. Not a fault by itself.
    InnerShell,
    /// A part too small to print; the value is its bounding-box diagonal.
    TinyPart,
}

impl DefectKind {
    /// All kinds, in the order of their discriminants.
    pub const ALL: [Self; 20] = [
        Self::Disjoint,
        Self::Foldover,
        Self::FlatFace,
        Self::DegenerateFace,
        Self::Slit,
        Self::SelfIntersection,
        Self::NonManifoldEdge,
        Self::NonManifoldVertex,
        Self::BadVertexNormal,
        Self::Corrupt,
        Self::Hole,
        Self::MisorientedEdge,
        Self::TJunction,
        Self::Crack,
        Self::InvertedPart,
        Self::DuplicateFace,
        Self::OppositeFace,
        Self::Sheet,
        Self::InnerShell,
        Self::TinyPart,
    ];

    /// The kind's bit in [`Findings::marks`].
    #[must_use]
    pub fn bit(self) -> u32 {
        1 << self as u32
    }
}

/// How two intersecting faces meet.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Meeting {
    /// The interior of one face passes through the other face.
    Crossing,
    /// The faces share points, but neither passes through the other.
    Touching,
    /// The faces are coplanar and overlap.
    Coplanar,
}

/// One defect and its place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Defect {
    /// A point of the defect, in the model's unit.
    pub at: [f64; 3],
    /// The affected faces of the file: 0-based indices, ascending. Only the first ones of a large set.
    pub faces: Vec<u32>,
    /// Points along the affected edge or chain of edges, in the model's unit; empty for a face or vertex defect.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub line: Vec<[f64; 3]>,
    /// The measured quantity: a height, gap or size in the model's unit, an angle in radians, or a count. See the
    /// kind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// For a self-intersection, how the two faces meet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub meeting: Option<Meeting>,
}

/// Defects found by an inspection: exact counts, a limited number of places per kind, and a bit mask per face.
#[derive(Debug, Clone, PartialEq)]
pub struct Findings {
    counts: [u64; DefectKind::ALL.len()],
    places: Vec<Vec<Defect>>,
    most: usize,
    incomplete: Vec<DefectKind>,
    /// For each face of the file, the [`DefectKind::bit`]s of the defects that affect the face.
    pub marks: Vec<u32>,
}

impl Findings {
    /// Creates empty findings for a file with `faces` faces. Keeps at most `most` places of each kind.
    #[must_use]
    pub fn new(faces: usize, most: usize) -> Self {
        let places = vec![Vec::new(); DefectKind::ALL.len()];
        Self { counts: [0; DefectKind::ALL.len()], places, most, incomplete: Vec::new(), marks: vec![0; faces] }
    }

    /// Counts a defect, marks its faces, and keeps its place while the limit allows.
    pub fn push(&mut self, kind: DefectKind, defect: Defect) {
        self.mark(kind, &defect.faces);
        self.counts[kind as usize] += 1;
        let places = &mut self.places[kind as usize];
        if places.len() < self.most {
            places.push(defect);
        }
    }

    /// Number of further places of this kind that [`Findings::push`] keeps.
    #[must_use]
    pub fn remaining_places(&self, kind: DefectKind) -> usize {
        self.most.saturating_sub(self.places[kind as usize].len())
    }

    /// Adds to a kind's count without keeping places.
    pub fn count_more(&mut self, kind: DefectKind, count: u64) {
        self.counts[kind as usize] += count;
    }

    /// Marks faces of the file without counting a defect, for example the faces of a part that its defect does not
    /// list.
    pub fn mark(&mut self, kind: DefectKind, faces: &[u32]) {
        for &face in faces {
            if let Some(marks) = self.marks.get_mut(face as usize) {
                *marks |= kind.bit();
            }
        }
    }

    /// Number of defects of a kind.
    #[must_use]
    pub fn count(&self, kind: DefectKind) -> u64 {
        self.counts[kind as usize]
    }

    /// The kept places of a kind, in the order of discovery.
    #[must_use]
    pub fn places(&self, kind: DefectKind) -> &[Defect] {
        &self.places[kind as usize]
    }

    /// Records that the search for a kind stopped early, so that its count is a lower bound.
    pub fn mark_incomplete(&mut self, kind: DefectKind) {
        if let Err(at) = self.incomplete.binary_search(&kind) {
            self.incomplete.insert(at, kind);
        }
    }

    /// Kinds whose search stopped early, in the order of their discriminants.
    #[must_use]
    pub fn incomplete(&self) -> &[DefectKind] {
        &self.incomplete
    }

    /// Groups the defects by kind, each with its count and its first `most` places. Omits kinds without defects.
    #[must_use]
    pub fn groups(&self, most: usize) -> Vec<DefectGroup> {
        let kinds = DefectKind::ALL.into_iter().filter(|&kind| self.count(kind) > 0);
        kinds
            .map(|kind| DefectGroup {
                kind,
                count: self.count(kind),
                places: self.places(kind).iter().take(most).cloned().collect(),
            })
            .collect()
    }
}

/// All defects of one kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct DefectGroup {
    /// The kind of these defects.
    pub kind: DefectKind,
    /// Exact number of defects of this kind. A lower bound if the inspection lists the kind as incomplete.
    pub count: u64,
    /// The first of these defects, as many as the option `places` allows; all of them with `meshmend inspect
    /// --offenders`.
    pub places: Vec<Defect>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_exact_and_places_are_kept_up_to_the_limit() {
        let mut findings = Findings::new(3, 2);
        for face in [0, 1, 1] {
            let defect = Defect { at: [0.0; 3], faces: vec![face, 9], line: Vec::new(), value: None, meeting: None };
            findings.push(DefectKind::FlatFace, defect);
        }
        assert_eq!(findings.count(DefectKind::FlatFace), 3);
        assert_eq!(findings.places(DefectKind::FlatFace).len(), 2);
        assert_eq!(findings.marks, [DefectKind::FlatFace.bit(), DefectKind::FlatFace.bit(), 0]);
        let groups = findings.groups(1);
        assert_eq!((groups.len(), groups[0].count, groups[0].places.len()), (1, 3, 1));
    }

    #[test]
    fn all_kinds_are_listed_in_the_order_of_their_discriminants() {
        for (number, kind) in DefectKind::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, number);
        }
    }
}
