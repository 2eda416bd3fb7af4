use serde::{Deserialize, Serialize};

/// What can be wrong with a mesh at a place.
///
/// The first ten are those of Parasolid's `PK_MESH_find_defects` (seed 002).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum DefectKind {
    /// A part beside the largest, with its count of faces. No fault by itself.
    Disjoint,
    /// A region of faces folded back on their neighbours, with the height at which they lie over them.
    Foldover,
    /// A face of no height, with that height: 0 where its corners are exactly on a line.
    FlatFace,
    /// A face with an edge of no length, with that length: 0 where it has a vertex twice. It is flat too.
    DegenerateFace,
    /// A chain of boundary edges that lie on one another, with the largest gap.
    Slit,
    /// Two faces intersect other than in a shared vertex or edge.
    SelfIntersection,
    /// An edge of more than two faces, with their count.
    NonManifoldEdge,
    /// A vertex with more than one fan, with their count.
    NonManifoldVertex,
    /// A vertex of which a normal of the file points into the mesh, with the angle from the faces' normals.
    BadVertexNormal,
    /// A face that can't be used: a corner is not a number, or names no vertex.
    Corrupt,
    /// A hole: a closed chain of boundary edges, with its length.
    Hole,
    /// Two faces that run along their edge in the same direction.
    MisorientedEdge,
    /// A boundary vertex on a boundary edge that does not use it, with the gap: 0 where it lies on it exactly.
    TJunction,
    /// Chains of boundary edges that nearly coincide, with the widest gap.
    Crack,
    /// A closed part that is turned inside out, with the even number of parts it lies in, if any.
    InvertedPart,
    /// A face with the same vertices as another one, turned the same way.
    DuplicateFace,
    /// A face with the same vertices as another one, turned the other way.
    OppositeFace,
    /// Surface of no thickness, with that thickness: two sides that lie on one another.
    Sheet,
    /// A closed part inside others, with their count: positive for a cavity, which is turned inward; negative for a solid
    /// within a solid. No fault by itself.
    InnerShell,
    /// A part too small to print, with its diagonal.
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
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
    incomplete: Vec<DefectKind>,
    /// For each face of the file, the [`DefectKind::bit`]s of what it has part in.
    pub marks: Vec<u32>,
}

impl Findings {
    /// Nothing found yet on a file of `faces` faces; at most `most` places of each kind will be kept.
    #[must_use]
    pub fn new(faces: usize, most: usize) -> Self {
        let places = vec![Vec::new(); DefectKind::ALL.len()];
        Self { counts: [0; DefectKind::ALL.len()], places, most, incomplete: Vec::new(), marks: vec![0; faces] }
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

    /// Says that the search for a kind was given up before its end, so that there may be more than were counted.
    pub fn mark_incomplete(&mut self, kind: DefectKind) {
        if let Err(at) = self.incomplete.binary_search(&kind) {
            self.incomplete.insert(at, kind);
        }
    }

    /// The kinds whose search was given up, in the order of their numbers.
    #[must_use]
    pub fn incomplete(&self) -> &[DefectKind] {
        &self.incomplete
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
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
