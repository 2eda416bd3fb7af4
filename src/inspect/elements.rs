use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Analysis, Measures};

/// What the file itself says of its vertices and faces, before vertices are merged.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Elements {
    /// Vertices in the file.
    pub vertices: u64,
    /// Used vertices of the file that can't be told from another one, since they stand at its position. None where no
    /// vertex of the file is used twice, as in STL, which has no numbers: there, it is the rule.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub indistinguishable_vertices: Option<u64>,
    /// Faces that name a vertex more than once, by its number or by its position.
    pub repeated_vertex_faces: u64,
    /// Faces of three different vertices that lie on a line, or so near one that f64 finds no area.
    pub collinear_faces: u64,
    /// Vertices that a face names and the file does not give. None where the format can't have them, or its reader refuses
    /// them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing_vertices: Option<u64>,
    /// Faces that name such a vertex; nothing else counts them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub faces_without_vertex: Option<u64>,
    /// Whether vertices are numbered 1, 2, 3 and so on; none where the format has no numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vertices_contiguous: Option<bool>,
    /// Whether faces are numbered 1, 2, 3 and so on; none where the format has no numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub faces_contiguous: Option<bool>,
}

impl Elements {
    /// Counts, with the degenerate faces that `measures` has found. Linear.
    #[must_use]
    pub fn new(analysis: &Analysis<'_>, measures: &Measures) -> Self {
        let (soup, numbering) = (analysis.subject.soup, analysis.subject.numbering);
        let mut used = vec![false; soup.positions.len()];
        let mut used_before = |v: u32| used.get_mut(v as usize).is_some_and(|it| std::mem::replace(it, true));
        let shared = soup.faces.iter().flatten().any(|&v| used_before(v));
        let faces = &analysis.surface.faces;
        let repeated = faces.iter().filter(|[a, b, c]| a == b || b == c || c == a).count() as u64;
        Self {
            vertices: soup.positions.len() as u64,
            indistinguishable_vertices: (shared || numbering.is_some()).then_some(analysis.ingest.merged_vertices),
            repeated_vertex_faces: repeated,
            collinear_faces: measures.degenerate_faces.saturating_sub(repeated),
            missing_vertices: numbering.map(|it| it.missing_vertices),
            faces_without_vertex: numbering.map(|it| it.faces_without_vertex),
            vertices_contiguous: numbering.map(|it| it.vertices_contiguous),
            faces_contiguous: numbering.map(|it| it.faces_contiguous),
        }
    }
}
