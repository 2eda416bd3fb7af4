use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What can be wrong with a mesh at a place.
///
/// The first ten are those of Parasolid's `PK_MESH_find_defects` (seed 002).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum DefectKind {
    /// The mesh is in several parts. No fault by itself.
    Disjoint,
    /// Faces folded back on their neighbours.
    Foldover,
    /// A face of no height.
    FlatFace,
    /// A face with an edge of no length.
    DegenerateFace,
    /// Boundary edges that lie on one another.
    Slit,
    /// Two faces intersect other than in a shared vertex or edge.
    SelfIntersection,
    /// An edge of more than two faces.
    NonManifoldEdge,
    /// A vertex with more than one fan.
    NonManifoldVertex,
    /// A normal of the file that points into the mesh.
    BadVertexNormal,
    /// A face that can't be used: a corner is not a number, or names no vertex.
    Corrupt,
    /// A hole: a closed chain of boundary edges.
    Hole,
    /// Two faces that run along their edge in the same direction.
    MisorientedEdge,
    /// A vertex that lies on the edge of a face that does not use it.
    TJunction,
    /// Boundaries that nearly coincide.
    Crack,
    /// A closed part that is turned inside out.
    InvertedPart,
    /// A face with the same vertices as an earlier one, turned the same way.
    DuplicateFace,
    /// A face with the same vertices as an earlier one, turned the other way.
    OppositeFace,
    /// Surface of no thickness: two sides that lie on one another.
    Sheet,
    /// A closed part inside another: a cavity where it is turned inward. No fault by itself.
    InnerShell,
    /// A part too small to print.
    TinyPart,
}

impl DefectKind {
    /// All kinds, in the order of their numbers.
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

/// How two faces meet that should not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Meeting {
    /// The inside of one passes through the other.
    Crossing,
    /// They have points in common, but neither passes through the other.
    Touching,
    /// They lie in one plane and overlap.
    Coplanar,
}

/// One thing that is wrong, with its place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Defect {
    /// A point of it, in the model's unit.
    pub at: [f64; 3],
    /// The faces of the file that it concerns, by index from 0, ascending. Of a large set only the first.
    pub faces: Vec<u32>,
    /// The points of the edge or chain of edges that it is, in the model's unit; empty for a face or a vertex.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub line: Vec<[f64; 3]>,
    /// What was measured: a height, a gap or a size in the model's unit, an angle in radians, or a count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// Of a self-intersection: how the faces meet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub meeting: Option<Meeting>,
}

/// Everything that was found: exact counts, places up to a limit for each kind, and a mark on every face.
#[derive(Debug, Clone, PartialEq)]
pub struct Findings {
    counts: [u64; DefectKind::ALL.len()],
    places: Vec<Vec<Defect>>,
    most: usize,
    /// For each face of the file, the [`DefectKind::bit`]s of what it has part in.
    pub marks: Vec<u32>,
}

impl Findings {
    /// Nothing found yet on a file of `faces` faces; at most `most` places of each kind will be kept.
    #[must_use]
    pub fn new(faces: usize, most: usize) -> Self {
        let places = vec![Vec::new(); DefectKind::ALL.len()];
        Self { counts: [0; DefectKind::ALL.len()], places, most, marks: vec![0; faces] }
    }

    /// Counts one defect, marks its faces, and keeps its place while there is room.
    pub fn push(&mut self, kind: DefectKind, defect: Defect) {
        self.mark(kind, &defect.faces);
        self.counts[kind as usize] += 1;
        let places = &mut self.places[kind as usize];
        if places.len() < self.most {
            places.push(defect);
        }
    }

    /// How many more places of a kind would be kept.
    #[must_use]
    pub fn room(&self, kind: DefectKind) -> usize {
        self.most.saturating_sub(self.places[kind as usize].len())
    }

    /// Counts defects whose places are not kept.
    pub fn count_more(&mut self, kind: DefectKind, count: u64) {
        self.counts[kind as usize] += count;
    }

    /// Marks faces of the file without counting, such as the rest of a part whose defect names only some.
    pub fn mark(&mut self, kind: DefectKind, faces: &[u32]) {
        for &face in faces {
            if let Some(marks) = self.marks.get_mut(face as usize) {
                *marks |= kind.bit();
            }
        }
    }

    /// How many defects of a kind there are.
    #[must_use]
    pub fn count(&self, kind: DefectKind) -> u64 {
        self.counts[kind as usize]
    }

    /// The places of a kind that were kept, in the order they were found.
    #[must_use]
    pub fn places(&self, kind: DefectKind) -> &[Defect] {
        &self.places[kind as usize]
    }

    /// The kinds of which there is one, each with its count and its first `most` places.
    #[must_use]
    pub fn groups(&self, most: usize) -> Vec<DefectGroup> {
        let some = DefectKind::ALL.into_iter().filter(|&kind| self.count(kind) > 0);
        some.map(|kind| DefectGroup {
            kind,
            count: self.count(kind),
            places: self.places(kind).iter().take(most).cloned().collect(),
        })
        .collect()
    }
}

/// All defects of one kind.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct DefectGroup {
    /// Which kind.
    pub kind: DefectKind,
    /// How many there are, exactly.
    pub count: u64,
    /// The first of them, with their places; all of them where offenders were asked for.
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
    fn kinds_are_listed_in_the_order_of_their_numbers() {
        for (number, kind) in DefectKind::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, number);
        }
    }
}
