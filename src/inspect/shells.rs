//! The parts of a mesh, how they are turned, and the attributes that follow.

use serde::{Deserialize, Serialize};

use super::{Analysis, BoundingBox, Measures, Volume, finite};
use crate::context::{Cancelled, Context};
use crate::mesh::{Edges, Parts, boundary_chains};

/// Parts that the report lists.
const MOST_SHELLS: usize = 100;

/// An answer to a question that can't always be asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Answer {
    /// The mesh has the attribute.
    Yes,
    /// It has not.
    No,
    /// An attribute that this one assumes is missing, or it can't be told.
    NotMeasurable,
}

impl From<bool> for Answer {
    fn from(yes: bool) -> Self {
        if yes { Self::Yes } else { Self::No }
    }
}

/// Why something can't be measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Unmeasurable {
    /// There is a boundary edge.
    NotClosed,
    /// There is a non-manifold edge or vertex.
    NotManifold,
    /// Faces are turned against each other.
    NotConsistent,
    /// There is no element of the kind.
    NoElement,
}

/// The edge-connected parts of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Shells {
    /// How many there are.
    pub count: u64,
    /// The sum of their genera (handles); none where a part has none.
    pub genus: Option<u64>,
    /// Why there is no genus.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub genus_not_measurable: Option<Unmeasurable>,
    /// Parts that are turned the wrong way, as [`Shell::outward`] says.
    pub inward: u64,
    /// The parts of largest area, largest first, at most 100.
    pub list: Vec<Shell>,
}

/// One edge-connected part of a mesh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Shell {
    /// Its first face, by index in the file from 0.
    pub first_face: u32,
    /// Faces.
    pub faces: u64,
    /// Different positions that they use.
    pub vertices: u64,
    /// Edges.
    pub edges: u64,
    /// Closed chains of boundary edges.
    pub boundaries: u64,
    /// No boundary edge.
    pub closed: bool,
    /// Every edge has at most two faces and every vertex one fan of this part's faces.
    pub manifold: bool,
    /// No edge is crossed twice in the same direction.
    pub consistent: bool,
    /// Area, in square units.
    pub area: f64,
    /// Enclosed volume, in cubic units; reliable where the part is closed, manifold and consistent.
    pub volume: Volume,
    /// The box around it.
    pub bounding_box: BoundingBox,
    /// Its handles by the formula of Euler and Poincaré, vertices - edges + faces = 2 - 2 genus. Vertices that no face uses
    /// don't count here, so that they don't stand in its way.
    pub genus: Option<u64>,
    /// Why there is no genus.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub genus_not_measurable: Option<Unmeasurable>,
    /// How many other closed parts it lies in; none where it is open or that can't be told.
    pub depth: Option<u32>,
    /// Whether its faces are turned outward, or into the hollow where an odd number of parts is around it; none where it
    /// is not closed, manifold and consistent, has no volume, or its depth can't be told.
    pub outward: Option<bool>,
}

/// How the parts of a mesh are turned.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Turning {
    /// Parts turned as [`Shell::outward`] says.
    pub outward: u64,
    /// Parts turned the other way.
    pub inward: u64,
    /// Parts of which it can't be told.
    pub unknown: u64,
}

/// The four attributes of a mesh as meshalyzer defines them (seed 004), each one assuming those before it where its
/// definition does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Attributes {
    /// Each edge is shared by two or more faces. Edges of more than two are allowed.
    pub closed: Answer,
    /// All faces at a vertex are reached from one another across edges, of which each has at most two faces. The mesh
    /// may be open.
    pub manifold: Answer,
    /// No edge is crossed twice in the same direction. Assumes manifold; the mesh may be open.
    pub consistent: Answer,
    /// A ray from a face to the outside passes an even number of faces, for each part of the mesh: outer shells are
    /// turned outward and cavities into their hollow. Assumes closed, manifold and consistent. Unlike the field of
    /// [`Measures`] it is not given to a part turned outward inside another.
    pub outward: Answer,
}

impl Attributes {
    /// The attributes, from what was counted and how the parts are turned.
    #[must_use]
    pub fn new(measures: &Measures, turning: &Turning) -> Self {
        let closed = measures.closed.into();
        let manifold = measures.manifold.into();
        let consistent = if measures.manifold { measures.consistent.into() } else { Answer::NotMeasurable };
        let outward = if !(measures.closed && measures.manifold && measures.consistent) {
            Answer::NotMeasurable
        } else if turning.inward > 0 {
            Answer::No
        } else if turning.unknown > 0 {
            Answer::NotMeasurable
        } else {
            Answer::Yes
        };
        Self { closed, manifold, consistent, outward }
    }

    /// Why what assumes manifold and consistent can't be measured.
    #[must_use]
    pub fn why_not_oriented(&self) -> Option<Unmeasurable> {
        if self.manifold != Answer::Yes {
            Some(Unmeasurable::NotManifold)
        } else if self.consistent != Answer::Yes {
            Some(Unmeasurable::NotConsistent)
        } else {
            None
        }
    }
}

/// What is counted and added up of each part, in units of [`Analysis::unit`].
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
    fn why_no_genus(&self) -> Option<Unmeasurable> {
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
        self.why_no_genus().map_or_else(|| u64::try_from((2 - characteristic) / 2).ok(), |_| None)
    }

    fn outward(&self, depth: Option<u32>) -> Option<bool> {
        let known = self.why_no_genus().is_none() && self.volume != 0.0;
        depth.filter(|_| known).map(|depth| (self.volume > 0.0) == (depth % 2 == 0))
    }
}

/// Describes the parts of a mesh, and counts how they are turned. O(n log n).
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn shells(analysis: &Analysis<'_>, context: &Context<'_>) -> Result<(Shells, Turning), Cancelled> {
    let Analysis { surface, parts, solids, .. } = analysis;
    let tallies = tally(analysis);
    context.check()?;
    let depths = analysis.depths(context)?;
    let mut turning = Turning::default();
    for (tally, &depth) in tallies.iter().zip(depths) {
        match tally.outward(depth) {
            Some(true) => turning.outward += 1,
            Some(false) => turning.inward += 1,
            None => turning.unknown += 1,
        }
    }
    let mut order: Vec<usize> = (0..parts.count).collect();
    order.sort_by(|&a, &b| tallies[b].area.total_cmp(&tallies[a].area));
    let unit = analysis.unit_length();
    let list = order.iter().take(MOST_SHELLS).map(|&part| {
        let (it, bounds) = (&tallies[part], solids[part].bounds);
        Shell {
            first_face: it.first_face.map_or(0, |face| surface.source[face as usize]),
            faces: it.faces.into(),
            vertices: it.vertices.into(),
            edges: it.edges.into(),
            boundaries: it.boundaries.into(),
            closed: it.boundary_edges == 0,
            manifold: !it.nonmanifold,
            consistent: !it.inconsistent,
            area: finite(it.area * unit * unit),
            volume: Volume { value: finite(it.volume * unit * unit * unit), reliable: it.why_no_genus().is_none() },
            bounding_box: BoundingBox { min: bounds.min.to_array(), max: bounds.max.to_array() },
            genus: it.genus(),
            genus_not_measurable: it.why_no_genus(),
            depth: depths[part],
            outward: it.outward(depths[part]),
        }
    });
    let why = tallies.iter().find_map(Tally::why_no_genus);
    let shells = Shells {
        count: parts.count as u64,
        genus: tallies.iter().map(Tally::genus).sum::<Option<u64>>().filter(|_| parts.count > 0),
        genus_not_measurable: why.or((parts.count == 0).then_some(Unmeasurable::NoElement)),
        inward: turning.inward,
        list: list.collect(),
    };
    Ok((shells, turning))
}

fn tally(analysis: &Analysis<'_>) -> Vec<Tally> {
    let Analysis { surface, edges, parts, fans, solids, .. } = analysis;
    let (unit, length) = (analysis.unit(), analysis.unit_length());
    let mut all = vec![Tally::default(); parts.count];
    for (f, &part) in (0u32..).zip(&parts.of_face).filter(|&(_, &part)| part != Parts::NONE) {
        let it = &mut all[part as usize];
        it.faces += 1;
        it.first_face.get_or_insert(f);
        // About the middle of the part, so that a part far from the origin loses nothing.
        let about = solids[part as usize].bounds.centre() / length;
        let [a, b, c] = surface.faces[f as usize].map(|v| unit[v as usize] - about);
        it.area += (b - a).cross(c - a).length() / 2.0;
        it.volume += a.dot(b.cross(c)) / 6.0;
    }
    // All faces of an edge are of one part.
    let part_of = |half_edge: u32| parts.of_face[half_edge as usize / 3] as usize;
    for half_edges in edges.iter() {
        let forward = half_edges.iter().filter(|&&h| Edges::is_forward(&surface.faces, h)).count();
        let it = &mut all[part_of(half_edges[0])];
        it.edges += 1;
        it.boundary_edges += u32::from(half_edges.len() == 1);
        it.nonmanifold |= half_edges.len() > 2;
        it.inconsistent |= forward > 1 || half_edges.len() - forward > 1;
    }
    for half_edge in boundary_chains(edges, fans) {
        all[part_of(half_edge)].boundaries += 1;
    }
    // A fan is of one part and at one vertex; a vertex with two fans of a part pinches it.
    let mut fan_at: Vec<(u32, u32)> = (0u32..)
        .zip(&fans.of_corner)
        .filter(|&(corner, &fan)| corner == fan)
        .map(|(corner, _)| (parts.of_face[corner as usize / 3], Edges::ends(&surface.faces, corner)[0]))
        .collect();
    fan_at.sort_unstable();
    for same in fan_at.chunk_by(|a, b| a == b) {
        let it = &mut all[same[0].0 as usize];
        it.vertices += 1;
        it.nonmanifold |= same.len() > 1;
    }
    all
}
