//! Edge-connected parts of a mesh (shells), their orientation, and the attributes that follow.

use serde::{Deserialize, Serialize};

use super::{Analysis, BoundingBox, Measures, Volume, finite};
use crate::context::{Cancelled, Context};
use crate::mesh::{Edges, Parts, boundary_chains};

/// Maximum number of parts that the report lists.
const MOST_SHELLS: usize = 100;

/// Answer to a question that may not apply.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// The mesh has the attribute.
    Yes,
    /// The mesh lacks the attribute.
    No,
    /// The attribute is undefined because a prerequisite is missing, or is undecided.
    NotMeasurable,
}

impl From<bool> for Answer {
    fn from(yes: bool) -> Self {
        if yes { Self::Yes } else { Self::No }
    }
}

/// Why a quantity cannot be measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Unmeasurable {
    /// The mesh has a boundary edge.
    NotClosed,
    /// The mesh has a non-manifold edge or vertex.
    NotManifold,
    /// Neighbouring faces have opposite winding.
    NotConsistent,
    /// The mesh has no element of this type.
    NoElement,
}

/// Edge-connected parts (shells) of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Shells {
    /// Number of parts.
    pub count: u64,
    /// Sum of the parts' genera (number of handles); `null` if a part has no defined genus.
    pub genus: Option<u64>,
    /// Why the genus is `null`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub genus_not_measurable: Option<Unmeasurable>,
    /// Number of parts with the wrong orientation, as defined by a part's `outward`.
    pub inward: u64,
    /// The parts with the largest area, in descending order; at most 100.
    pub list: Vec<Shell>,
}

/// One edge-connected part of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Shell {
    /// Index of the part's first face in the file, from 0.
    pub first_face: u32,
    /// Number of faces.
    pub faces: u64,
    /// Number of distinct vertex positions.
    pub vertices: u64,
    /// Number of edges.
    pub edges: u64,
    /// Number of closed chains of boundary edges.
    pub boundaries: u64,
    /// Whether the part has no boundary edge.
    pub closed: bool,
    /// Whether every edge has at most two faces, and every vertex one fan of this part's faces.
    pub manifold: bool,
    /// Whether no two faces traverse an edge in the same direction.
    pub consistent: bool,
    /// Area, in square model units.
    pub area: f64,
    /// Enclosed volume, in cubic model units. Reliable if the part is closed, manifold and consistent.
    pub volume: Volume,
    /// Bounding box of the part.
    pub bounding_box: BoundingBox,
    /// Genus (number of handles) by the Euler-Poincaré formula: vertices - edges + faces = 2 - 2 genus. Unreferenced
    /// vertices do not count. `null` if the genus is undefined.
    pub genus: Option<u64>,
    /// Why the genus is `null`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub genus_not_measurable: Option<Unmeasurable>,
    /// Number of other closed parts that contain this part; `null` if the part is open or the depth is undecided.
    pub depth: Option<u32>,
    /// Whether the faces point out of the material: outward at even depth, into the cavity at odd depth. `null` if
    /// the part is not closed, manifold and consistent, has zero volume, or has an undecided depth.
    pub outward: Option<bool>,
}

/// Numbers of parts by orientation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct OrientationCounts {
    /// Parts with the orientation that [`Shell::outward`] defines as correct.
    pub outward: u64,
    /// Parts with the opposite orientation.
    pub inward: u64,
    /// Parts with an undecided orientation.
    pub unknown: u64,
}

/// The four attributes of a mesh as the tool meshalyzer defines them. Some attributes require preceding ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Attributes {
    /// Whether every edge is shared by two or more faces. Edges with more than two faces are allowed.
    pub closed: Answer,
    /// Whether every edge has at most two faces, and the faces at each vertex are connected across edges. The mesh
    /// may be open.
    pub manifold: Answer,
    /// Whether no two faces traverse an edge in the same direction. Requires `manifold`; the mesh may be open.
    pub consistent: Answer,
    /// Whether a ray along any face's normal crosses an even number of further faces, in each part: outer shells face
    /// outward and cavities face inward. Requires `closed`, `manifold` and `consistent`. Stricter than the field of
    /// the measures, which accepts an outward-facing part inside another.
    pub outward: Answer,
}

impl Attributes {
    /// Derives the attributes from the measures and from the orientation of the parts.
    #[must_use]
    pub fn new(measures: &Measures, orientation: &OrientationCounts) -> Self {
        let closed = measures.closed.into();
        let manifold = measures.manifold.into();
        let consistent = if measures.manifold { measures.consistent.into() } else { Answer::NotMeasurable };
        let outward = if !(measures.closed && measures.manifold && measures.consistent) {
            Answer::NotMeasurable
        } else if orientation.inward > 0 {
            Answer::No
        } else if orientation.unknown > 0 {
            Answer::NotMeasurable
        } else {
            Answer::Yes
        };
        Self { closed, manifold, consistent, outward }
    }

    /// Why measurements that require a manifold, consistent mesh are impossible; `None` if they are possible.
    #[must_use]
    pub fn reason_not_oriented(&self) -> Option<Unmeasurable> {
        if self.manifold != Answer::Yes {
            Some(Unmeasurable::NotManifold)
        } else if self.consistent != Answer::Yes {
            Some(Unmeasurable::NotConsistent)
        } else {
            None
        }
    }
}

/// Counts and sums of one part, in coordinates of [`Analysis::unit`].
#[derive(Clone, Default)]
struct Tally {
    first_face: Option<u32>,
    faces: u32,
    vertices: u32,
    edges: u32,
    boundary_edges: u32,
    boundaries: u32,
    nonmanifold: bool,
    inconsistent: bool,
    area: f64,
    volume: f64,
}

impl Tally {
    fn reason_without_genus(&self) -> Option<Unmeasurable> {
        if self.boundary_edges > 0 {
            Some(Unmeasurable::NotClosed)
        } else if self.nonmanifold {
            Some(Unmeasurable::NotManifold)
        } else if self.inconsistent {
            Some(Unmeasurable::NotConsistent)
        } else {
            None
        }
    }

    fn genus(&self) -> Option<u64> {
        let characteristic = i64::from(self.vertices) - i64::from(self.edges) + i64::from(self.faces);
        self.reason_without_genus().map_or_else(|| u64::try_from((2 - characteristic) / 2).ok(), |_| None)
    }

    fn outward(&self, depth: Option<u32>) -> Option<bool> {
        let known = self.reason_without_genus().is_none() && self.volume != 0.0;
        depth.filter(|_| known).map(|depth| (self.volume > 0.0) == (depth % 2 == 0))
    }
}

/// Describes the parts of a mesh and counts their orientations. O(n log n).
///
/// # Errors
/// [`Cancelled`] on cancellation or timeout.
pub fn shells(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<(Shells, OrientationCounts), Cancelled> {
    let Analysis { surface, parts, solids, .. } = analysis;
    let tallies = tally(analysis);
    context.check()?;
    let depths = analysis.depths(context)?;
    let mut orientation = OrientationCounts::default();
    for (tally, &depth) in tallies.iter().zip(depths) {
        match tally.outward(depth) {
            Some(true) => orientation.outward += 1,
            Some(false) => orientation.inward += 1,
            None => orientation.unknown += 1,
        }
    }
    let mut order: Vec<usize> = (0..parts.count).collect();
    order.sort_by(|&a, &b| tallies[b].area.total_cmp(&tallies[a].area));
    let unit = analysis.unit_length();
    let list = order.iter().take(MOST_SHELLS).map(|&part| {
        let (part_tally, bounds) = (&tallies[part], solids[part].bounds);
        Shell {
            first_face: part_tally.first_face.map_or(0, |face| surface.source[face as usize]),
            faces: part_tally.faces.into(),
            vertices: part_tally.vertices.into(),
            edges: part_tally.edges.into(),
            boundaries: part_tally.boundaries.into(),
            closed: part_tally.boundary_edges == 0,
            manifold: !part_tally.nonmanifold,
            consistent: !part_tally.inconsistent,
            area: finite(part_tally.area * unit * unit),
            volume: Volume {
                value: finite(part_tally.volume * unit * unit * unit),
                reliable: part_tally.reason_without_genus().is_none(),
            },
            bounding_box: BoundingBox { min: bounds.min.to_array(), max: bounds.max.to_array() },
            genus: part_tally.genus(),
            genus_not_measurable: part_tally.reason_without_genus(),
            depth: depths[part],
            outward: part_tally.outward(depths[part]),
        }
    });
    let reason = tallies.iter().find_map(Tally::reason_without_genus);
    let shells = Shells {
        count: parts.count as u64,
        genus: tallies.iter().map(Tally::genus).sum::<Option<u64>>().filter(|_| parts.count > 0),
        genus_not_measurable: reason.or((parts.count == 0).then_some(Unmeasurable::NoElement)),
        inward: orientation.inward,
        list: list.collect(),
    };
    Ok((shells, orientation))
}

fn tally(analysis: &Analysis<'_>) -> Vec<Tally> {
    let Analysis { surface, edges, parts, fans, solids, .. } = analysis;
    let (unit, length) = (analysis.unit(), analysis.unit_length());
    let mut all = vec![Tally::default(); parts.count];
    for (f, &part) in (0u32..).zip(&parts.of_face).filter(|&(_, &part)| part != Parts::NONE) {
        let part_tally = &mut all[part as usize];
        part_tally.faces += 1;
        part_tally.first_face.get_or_insert(f);
        // Relative to the centre of the part, so that a part far from the origin loses no precision.
        let about = solids[part as usize].bounds.centre() / length;
        let [a, b, c] = surface.faces[f as usize].map(|v| unit[v as usize] - about);
        part_tally.area += (b - a).cross(c - a).length() / 2.0;
        part_tally.volume += a.dot(b.cross(c)) / 6.0;
    }
    // All faces of an edge belong to one part.
    let part_of = |half_edge: u32| parts.of_face[half_edge as usize / 3] as usize;
    for half_edges in edges.iter() {
        let forward = half_edges.iter().filter(|&&h| Edges::is_forward(&surface.faces, h)).count();
        let part_tally = &mut all[part_of(half_edges[0])];
        part_tally.edges += 1;
        part_tally.boundary_edges += u32::from(half_edges.len() == 1);
        part_tally.nonmanifold |= half_edges.len() > 2;
        part_tally.inconsistent |= forward > 1 || half_edges.len() - forward > 1;
    }
    for half_edge in boundary_chains(&surface.faces, edges, fans) {
        all[part_of(half_edge)].boundaries += 1;
    }
    // Each fan belongs to one part and one vertex. Two fans of one part at a vertex make the vertex non-manifold.
    let part_and_vertex = |root: u32| (parts.of_face[root as usize / 3], Edges::ends(&surface.faces, root)[0]);
    let mut fan_at: Vec<(u32, u32)> = fans.roots().map(part_and_vertex).collect();
    fan_at.sort_unstable();
    for same in fan_at.chunk_by(|a, b| a == b) {
        let part_tally = &mut all[same[0].0 as usize];
        part_tally.vertices += 1;
        part_tally.nonmanifold |= same.len() > 1;
    }
    all
}
