//! Splits the faces of a surface where they meet, into a complex of facets that share only whole edges and corners.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use glam::DVec3;
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

use super::contacts::{Contacts, Cuts, MeetingFaces};
use super::grid::{Grid, Plane};
use super::points::Points;
use super::triangulation::{Line, Support, Triangulation};
use crate::context::{Cancelled, Context};
use crate::math::{ChangedTriangles, Contact, Hit, Hubs, PairSearch, Tree, contact, threads};
use crate::mesh::{NotClosed, Surface, first_equal, number_by_first};

/// Step budget of the search for meeting faces, and the additional steps for each face.
const STEPS: u64 = 512_000_000;
const STEPS_PER_FACE: u64 = 2_000;
/// Limits on meeting face pairs and on points. Each takes a few hundred bytes, so both together stay below two
/// gigabytes.
const MAX_PAIRS: usize = 4_000_000;
const MAX_POINTS: usize = 3_000_000;
/// Points that an arrangement of few faces may create, and additional points for each face. A few hundred faces that
/// all meet each other have millions of common points; such input is not a surface with defects.
const BASE_POINTS: usize = 250_000;
const POINTS_PER_FACE: usize = 8;
/// Maximum total length of the lists of faces that cover facets of one plane.
const MAX_COVERS: usize = 50_000_000;
/// Distance from the origin, in grid steps, of the corners of the triangle that encloses overlapping faces.
const ENCLOSING_DISTANCE: i64 = 1 << 43;

/// Why an arrangement could not be computed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ArrangeError {
    /// The surface is not closed, or not consistently wound.
    #[error(transparent)]
    NotClosed(#[from] NotClosed),
    /// A limit of faces or points was exceeded.
    #[error("could not resolve the intersecting faces: {0}")]
    Failed(String),
    /// So many pairs of faces intersect that splitting them would take minutes.
    #[error("could not resolve the intersecting faces: {0} pairs intersect, too many to split")]
    Tangled(u64),
    /// The inside is empty.
    #[error("the surface encloses nothing")]
    Empty,
    /// The work was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A piece of one or more coplanar faces that no other face passes through. Two facets have only whole edges and
/// corners in common.
#[derive(Debug, Clone)]
pub(super) struct Facet {
    /// The corners, counter-clockwise seen against the normal of its plane.
    pub corners: [u32; 3],
    /// The faces that cover the facet, sorted.
    pub faces: SmallVec<[u32; 2]>,
    /// The increase of the winding number across the facet, against the normal.
    pub weight: i32,
    /// The index of its plane, if its faces meet other faces.
    pub plane: Option<u32>,
}

/// The faces of a surface, split where they meet.
pub(super) struct Complex {
    /// The integer grid of all positions.
    pub grid: Grid,
    /// All points: vertices and intersections.
    pub points: Points,
    /// The facets.
    pub facets: Vec<Facet>,
    /// The faces of the surface with nonzero area, with a tree for queries.
    pub solid_faces: SolidFaces,
    /// The vertex of the surface at each point that is a vertex; these points come first.
    pub vertices: Vec<u32>,
}

/// Points for which room is made per pair of faces that meet: a segment has two ends, each shared with another pair.
const POINTS_PER_PAIR: usize = 2;

/// Faces with nonzero area, scaled into the range of the exact predicates.
pub(super) struct SolidFaces {
    /// The points at vertices, scaled by a power of two.
    pub unit: Vec<DVec3>,
    /// The corners of each face, as points.
    pub corners: Vec<[u32; 3]>,
    /// The index in the surface of each face, in ascending order.
    pub numbers: Vec<u32>,
    /// Bounding volume hierarchy over the scaled faces, built when it is first needed, never in a parallel loop.
    tree: OnceLock<Tree>,
}

impl SolidFaces {
    fn new(points: &Points, faces: &[Option<[u32; 3]>]) -> Self {
        let unit = threads::map_cheap(points.len(), |p| Self::to_unit(points.place(p as u32)));
        let numbers: Vec<u32> = threads::filter_map(faces.len(), |f| faces[f].map(|_| f as u32));
        let mut corners = Vec::with_capacity(numbers.len());
        corners.extend(faces.iter().flatten());
        Self { unit, corners, numbers, tree: OnceLock::new() }
    }

    /// The tree over the faces.
    pub fn tree(&self) -> &Tree {
        self.tree.get_or_init(|| Tree::new(&self.unit, &self.corners))
    }

    /// Scales a position in grid steps.
    pub fn to_unit(place: DVec3) -> DVec3 {
        place / ENCLOSING_DISTANCE as f64
    }

    /// The scaled corners of a face with area.
    pub fn triangle(&self, at: u32) -> [DVec3; 3] {
        self.corners[at as usize].map(|p| self.unit[p as usize])
    }
}

impl Complex {
    /// Splits the faces of a surface where they meet. Faces that meet before their positions are rounded to the grid may be
    /// `known`.
    pub fn new(surface: &Surface, known: Option<&[MeetingFaces]>, context: &Context<'_>) -> Result<Self, ArrangeError> {
        let grid = Grid::around(&surface.positions);
        let (mut points, point_of, vertices) = vertices_on_grid(surface, &grid);
        let grid_corners = |face: usize| surface.faces[face].map(|v| point_of[v as usize]);
        let is_flat = |corners: [u32; 3]| Plane::through(corners.map(|c| points.whole(c))).is_flat();
        let with_area = |face: usize| Some(grid_corners(face)).filter(|&corners| !is_flat(corners));
        let faces = threads::map_cheap(surface.faces.len(), with_area);
        let solid_faces = SolidFaces::new(&points, &faces);
        context.check()?;
        let pairs = match known {
            Some(known) => {
                let is_held = threads::map_cheap(surface.positions.len(), |v| grid.holds(surface.positions[v]));
                let is_exact = |face: u32| surface.faces[face as usize].iter().all(|&v| is_held[v as usize]);
                pairs_after(known, &solid_faces, is_exact, context)?
            }
            None => pairs_that_meet(&solid_faces, None, context)?,
        };
        let solid: Vec<[u32; 3]> = faces.iter().map(|face| face.unwrap_or([0; 3])).collect();
        for face in pairs.iter().flat_map(|pair| pair.faces) {
            solid[face as usize].iter().for_each(|&corner| points.enter_once(corner));
        }
        points.reserve_exact(POINTS_PER_PAIR * pairs.len());
        let mut contacts = Contacts::new(&solid, &mut points);
        for (at, &MeetingFaces { faces: [f, g], overlap }) in pairs.iter().enumerate() {
            if at % 4096 == 0 {
                context.check()?;
            }
            contacts.meet(f, g, overlap);
        }
        let mut facets = Vec::new();
        let groups = groups(&mut contacts);
        let planes: Vec<u32> = groups.iter().map(|group| contacts.plane(group[0])).collect();
        let cuts = std::mem::take(&mut contacts.cuts);
        let most = surface.positions.len() + (BASE_POINTS + POINTS_PER_FACE * solid.len()).min(MAX_POINTS);
        let cutter = Cutter { faces: &solid, cuts: &cuts, limits: SplitLimits { context, most } };
        let mut is_cut = vec![false; solid.len()];
        for (at, (group, plane)) in groups.iter().zip(planes).enumerate() {
            if at % 256 == 0 {
                context.check()?;
            }
            group.iter().for_each(|&face| is_cut[face as usize] = true);
            match group.as_slice() {
                &[face] => cutter.cut_one(&mut points, plane, face, &mut facets)?,
                _ => cutter.cut_many(&mut points, plane, group, &mut facets)?,
            }
        }
        facets.reserve_exact(solid_faces.numbers.len());
        for (face, corners) in (0u32..).zip(&faces) {
            if let Some(corners) = corners.filter(|_| !is_cut[face as usize]) {
                facets.push(Facet { corners, faces: SmallVec::from_slice(&[face]), weight: 1, plane: None });
            }
        }
        Ok(Self { grid, points, facets, solid_faces, vertices })
    }

    /// The plane of a facet, oriented so that the facet's corners are counter-clockwise.
    pub fn plane(&self, facet: &Facet) -> Plane {
        match facet.plane {
            Some(plane) => self.points.planes[plane as usize],
            None => Plane::through(facet.corners.map(|corner| self.points.whole(corner))),
        }
    }
}

/// Creates a point for each vertex; vertices at the same grid position share one. Returns the points, the point of each
/// vertex, and the vertex of each point.
fn vertices_on_grid(surface: &Surface, grid: &Grid) -> (Points, Vec<u32>, Vec<u32>) {
    let places = threads::map_cheap(surface.positions.len(), |v| grid.to_grid(surface.positions[v]));
    // Coordinates on the grid are small whole numbers, so f64 holds them exactly.
    let exact = threads::map_cheap(places.len(), |v| DVec3::from_array(places[v].map(|x| x as f64)));
    let (point_of, vertices) = number_by_first(first_equal(&exact));
    let mut points = Points::default();
    points.reserve_exact(vertices.len());
    for &v in &vertices {
        points.push(places[v as usize]);
    }
    (points, point_of, vertices)
}

/// The pairs of faces that meet on the grid, where those before the rounding to the grid are known: faces that `is_exact` finds on
/// the grid meet as before, and the others are searched.
fn pairs_after(
    known: &[MeetingFaces],
    faces: &SolidFaces,
    is_exact: impl Fn(u32) -> bool + Sync + Send,
    context: &Context<'_>,
) -> Result<Vec<MeetingFaces>, ArrangeError> {
    let is_moved = threads::map_cheap(faces.numbers.len(), |at| !is_exact(faces.numbers[at]));
    let mut pairs =
        if is_moved.contains(&true) { pairs_that_meet(faces, Some(&is_moved), context)? } else { Vec::new() };
    pairs.extend(known.iter().filter(|pair| pair.faces.iter().all(|&face| is_exact(face))));
    pairs.sort_unstable();
    Ok(pairs)
}

/// Searches the pairs of faces that have more in common than shared vertices or edges; with `moved`, only those with a face that
/// is marked there.
fn pairs_that_meet(
    faces: &SolidFaces,
    moved: Option<&[bool]>,
    context: &Context<'_>,
) -> Result<Vec<MeetingFaces>, ArrangeError> {
    let SolidFaces { unit, corners, numbers, .. } = faces;
    let look = |f: u32, g: u32, steps: &mut u64| {
        let mut slow = 0;
        let contact = contact(unit, corners[f as usize], corners[g as usize], &mut slow);
        *steps += 8 * slow;
        match contact {
            Contact::Disjoint | Contact::Neighbours => None,
            Contact::Touching | Contact::Crossing => Some(false),
            Contact::Coplanar | Contact::Same => Some(true),
        }
    };
    let mut pairs = Vec::new();
    let too_many = || ArrangeError::Failed("too many faces meet".to_owned());
    let take = |hits: Vec<Hit<bool>>| -> Result<(), ArrangeError> {
        let numbered = |pair: [u32; 2]| pair.map(|at| numbers[at as usize]);
        pairs.extend(hits.into_iter().map(|(pair, overlap)| MeetingFaces { faces: numbered(pair), overlap }));
        context.check()?;
        if pairs.len() > MAX_PAIRS { Err(too_many()) } else { Ok(()) }
    };
    let budget = STEPS + STEPS_PER_FACE * corners.len() as u64;
    let complete = match moved {
        Some(moved) => ChangedTriangles::new(unit, corners, moved).search(look, budget, take)?,
        None => {
            let hubs = Hubs::find(unit, corners);
            PairSearch { look, budget, hubs: hubs.as_ref() }.within(faces.tree(), take)?
        }
    };
    if !complete {
        return Err(too_many());
    }
    pairs.sort_unstable();
    Ok(pairs)
}

/// Groups the faces that meet others: each face alone, or together with the faces that overlap it in a plane. Groups
/// are in the order of their first face.
fn groups(contacts: &mut Contacts<'_>) -> Vec<Vec<u32>> {
    let mut faces: Vec<u32> = contacts.cuts.keys().copied().collect();
    faces.sort_unstable();
    let mut of_root: FxHashMap<u32, usize> = FxHashMap::default();
    let mut groups: Vec<Vec<u32>> = Vec::new();
    for face in faces {
        let root = contacts.together.root(face);
        let at = *of_root.entry(root).or_insert_with(|| {
            groups.push(Vec::new());
            groups.len() - 1
        });
        groups[at].push(face);
    }
    groups
}

/// Enforces the point limit and cancellation while faces are split.
struct SplitLimits<'a, 'b> {
    context: &'a Context<'b>,
    /// Maximum number of points.
    most: usize,
}

impl SplitLimits<'_, '_> {
    fn check(&self, points: usize) -> Result<(), ArrangeError> {
        if points.is_multiple_of(256) {
            self.context.check()?;
        }
        if points > self.most { Err(too_many_points()) } else { Ok(()) }
    }
}

fn too_many_points() -> ArrangeError {
    ArrangeError::Failed("the faces meet in too many points".to_owned())
}

/// Splits faces along their recorded cuts.
struct Cutter<'a, 'b> {
    faces: &'a [[u32; 3]],
    cuts: &'a FxHashMap<u32, Cuts>,
    limits: SplitLimits<'a, 'b>,
}

impl Cutter<'_, '_> {
    /// Splits a face that overlaps no other face in its plane.
    fn cut_one(&self, points: &mut Points, plane: u32, face: u32, facets: &mut Vec<Facet>) -> Result<(), ArrangeError> {
        let mut triangulation = Triangulation::new(points, plane, self.faces[face as usize]);
        self.insert_cuts(&mut triangulation, face)?;
        triangulation.improve();
        facets.extend(triangulation.triangles().map(|corners| Facet {
            corners,
            faces: SmallVec::from_slice(&[face]),
            weight: 1,
            plane: Some(plane),
        }));
        Ok(())
    }

    /// Inserts the cuts of a face into a triangulation.
    fn insert_cuts(&self, triangulation: &mut Triangulation<'_>, face: u32) -> Result<(), ArrangeError> {
        let cuts = &self.cuts[&face];
        for &point in &cuts.points {
            triangulation.insert(point);
        }
        for &(ends, other) in &cuts.lines {
            triangulation.insert_line(Line { ends, support: Support::Plane(other), bounds: None });
            self.limits.check(triangulation.count())?;
        }
        Ok(())
    }

    /// Splits the overlapping faces of one plane together, so that overlapping areas are split identically.
    fn cut_many(
        &self,
        points: &mut Points,
        plane: u32,
        group: &[u32],
        facets: &mut Vec<Facet>,
    ) -> Result<(), ArrangeError> {
        let axis = points.planes[plane as usize].axis();
        let upward = points.planes[plane as usize].normal[axis] > 0;
        let outer = points.outer(axis, upward, ENCLOSING_DISTANCE);
        // Whether each face is oriented like the plane; computed before the triangulation borrows the points.
        let normal = points.planes[plane as usize].normal;
        let agrees_with_plane: Vec<bool> = group
            .iter()
            .map(|&face| {
                let face_plane = Plane::through(self.faces[face as usize].map(|v| points.whole(v)));
                (face_plane.normal[axis] > 0) == (normal[axis] > 0)
            })
            .collect();
        let mut triangulation = Triangulation::new(points, plane, outer);
        for &face in group {
            for i in 0..3 {
                let ends = [self.faces[face as usize][i], self.faces[face as usize][(i + 1) % 3]];
                triangulation.insert_line(Line { ends, support: Support::Edge(ends), bounds: Some(face) });
                self.limits.check(triangulation.count())?;
            }
        }
        // A face that cuts several faces of the group cuts them along one line.
        let mut lines: BTreeMap<u32, Vec<[u32; 2]>> = BTreeMap::new();
        for cuts in group.iter().map(|face| &self.cuts[face]) {
            for &point in &cuts.points {
                triangulation.insert(point);
            }
            for &(ends, plane) in &cuts.lines {
                lines.entry(plane).or_default().push(ends);
            }
        }
        for (plane, segments) in lines {
            triangulation.insert_overlapping(&segments, Support::Plane(plane));
            self.limits.check(triangulation.count())?;
        }
        triangulation.improve();
        let covers = triangulation.covers(MAX_COVERS).ok_or_else(too_many_points)?;
        facets.extend(triangulation.triangles().zip(covers).filter(|(_, cover)| !cover.is_empty()).map(
            |(corners, cover)| {
                let weight = cover
                    .iter()
                    .map(|face| if group.binary_search(face).is_ok_and(|at| agrees_with_plane[at]) { 1 } else { -1 });
                Facet { corners, weight: weight.sum(), faces: cover, plane: Some(plane) }
            },
        ));
        Ok(())
    }
}
