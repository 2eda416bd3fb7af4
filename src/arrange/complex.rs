use glam::DVec3;
use rustc_hash::FxHashMap;
use smallvec::SmallVec;

use super::contacts::{Contacts, Cuts};
use super::grid::{Grid, Plane, Whole};
use super::points::Points;
use super::triangulation::{Line, Support, Triangulation};
use crate::context::{Cancelled, Context};
use crate::math::{Contact, PairSearch, Tree, contact};
use crate::mesh::{NotClosed, Surface};

/// Steps that the search for faces that meet may take, and as many more for each face.
const STEPS: u64 = 512_000_000;
const STEPS_A_FACE: u64 = 2_000;
/// Pairs of faces that may meet, and points that an arrangement may make: each takes some hundred bytes, so that both come to two
/// gigabytes at most.
const MOST_PAIRS: usize = 4_000_000;
const MOST_POINTS: usize = 3_000_000;
/// Points that an arrangement of few faces may make, and so many more for each face: a few hundred that all meet each other have
/// millions of points in common, and are no surface with faults in it.
const ENOUGH_POINTS: usize = 250_000;
const POINTS_A_FACE: usize = 8;
/// Entries of all lists of faces that cover a piece of one plane.
const MOST_COVERS: usize = 50_000_000;
/// How far out the corners of the triangle are in which overlapping faces are laid, in steps of the grid.
const OUT: i64 = 1 << 43;

/// Why there is no arrangement.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ArrangeError {
    /// The surface is not closed.
    #[error(transparent)]
    NotClosed(#[from] NotClosed),
    /// It could not be done.
    #[error("the faces that intersect could not be resolved: {0}")]
    Failed(String),
    /// Nothing is inside.
    #[error("the surface encloses nothing")]
    Empty,
    /// The work was stopped.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A piece of faces that no other face passes through: facets have nothing in common but whole edges and corners.
#[derive(Debug, Clone)]
pub(super) struct Facet {
    /// Its corners, counter-clockwise seen against the normal of its plane.
    pub corners: [u32; 3],
    /// The faces that cover it, sorted.
    pub faces: SmallVec<[u32; 2]>,
    /// By how much the winding number grows through it, against the normal.
    pub weight: i32,
    /// Its plane, where its faces meet others.
    pub plane: Option<u32>,
}

/// Faces cut where they meet.
pub(super) struct Complex {
    pub grid: Grid,
    pub points: Points,
    pub facets: Vec<Facet>,
    /// The faces of the surface that have area, to be looked up.
    pub solid_faces: SolidFaces,
    /// For each point the vertex of the surface that it is.
    pub vertices: Vec<u32>,
}

/// Faces with area in the range of the predicates.
pub(super) struct SolidFaces {
    /// The vertices' points, scaled by a power of two.
    pub unit: Vec<DVec3>,
    /// The corners of each, as points.
    pub corners: Vec<[u32; 3]>,
    /// Which face of the surface each is, rising.
    pub numbers: Vec<u32>,
    pub tree: Tree,
}

impl SolidFaces {
    fn new(points: &Points, faces: &[Option<[u32; 3]>]) -> Self {
        let unit: Vec<DVec3> = (0..points.len()).map(|p| Self::to_unit(points.place(p as u32))).collect();
        let (numbers, corners): (Vec<u32>, Vec<[u32; 3]>) =
            (0u32..).zip(faces).filter_map(|(f, corners)| corners.map(|c| (f, c))).unzip();
        let tree = Tree::new(&unit, &corners);
        Self { unit, corners, numbers, tree }
    }

    /// A place of the grid in the same scale.
    pub fn to_unit(place: DVec3) -> DVec3 {
        place / OUT as f64
    }

    pub fn triangle(&self, at: u32) -> [DVec3; 3] {
        self.corners[at as usize].map(|p| self.unit[p as usize])
    }
}

impl Complex {
    /// Cuts the faces of a surface where they meet.
    pub fn new(surface: &Surface, context: &Context<'_>) -> Result<Self, ArrangeError> {
        let grid = Grid::around(&surface.positions);
        let (mut points, point_of, vertices) = vertices_on_grid(surface, &grid);
        let faces: Vec<Option<[u32; 3]>> = surface
            .faces
            .iter()
            .map(|face| {
                let corners = face.map(|v| point_of[v as usize]);
                let flat = Plane::through(corners.map(|c| points.whole(c))).is_flat();
                (!flat).then_some(corners)
            })
            .collect();
        let solid_faces = SolidFaces::new(&points, &faces);
        context.check()?;
        let pairs = pairs_that_meet(&solid_faces, context)?;
        let solid: Vec<[u32; 3]> = faces.iter().map(|face| face.unwrap_or([0; 3])).collect();
        for &([f, g], _) in &pairs {
            for face in [f, g] {
                solid[face as usize].iter().for_each(|&corner| points.enter_once(corner));
            }
        }
        let mut contacts = Contacts::new(&solid, &mut points);
        for (at, &([f, g], overlap)) in pairs.iter().enumerate() {
            if at % 4096 == 0 {
                context.check()?;
            }
            contacts.meet(f, g, overlap);
        }
        let mut facets = Vec::with_capacity(solid.len() + 4 * contacts.cuts.len());
        let groups = groups(&mut contacts);
        let planes: Vec<u32> = groups.iter().map(|group| contacts.plane(group[0])).collect();
        let cuts = std::mem::take(&mut contacts.cuts);
        let most = surface.positions.len() + (ENOUGH_POINTS + POINTS_A_FACE * solid.len()).min(MOST_POINTS);
        let cutter = Cutter { faces: &solid, cuts: &cuts, limits: Limits { context, most } };
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
        for (face, corners) in (0u32..).zip(&faces) {
            if let Some(corners) = corners.filter(|_| !is_cut[face as usize]) {
                facets.push(Facet { corners, faces: SmallVec::from_slice(&[face]), weight: 1, plane: None });
            }
        }
        Ok(Self { grid, points, facets, solid_faces, vertices })
    }

    /// The plane of a facet, looking where its corners turn counter-clockwise.
    pub fn plane(&self, facet: &Facet) -> Plane {
        match facet.plane {
            Some(plane) => self.points.planes[plane as usize],
            None => Plane::through(facet.corners.map(|corner| self.points.whole(corner))),
        }
    }
}

/// The vertices as points, those at one place of the grid as one. Answers the point of each vertex, and the vertex of each point.
fn vertices_on_grid(surface: &Surface, grid: &Grid) -> (Points, Vec<u32>, Vec<u32>) {
    let mut points = Points::default();
    let mut vertices = Vec::new();
    let mut known: FxHashMap<Whole, u32> = FxHashMap::default();
    let point_of = (0u32..)
        .zip(&surface.positions)
        .map(|(v, &p)| {
            let place = grid.to_grid(p);
            *known.entry(place).or_insert_with(|| {
                vertices.push(v);
                points.push(place)
            })
        })
        .collect();
    (points, point_of, vertices)
}

/// Pairs of faces that have more in common than a vertex or an edge by its vertices, and whether they overlap in a plane.
fn pairs_that_meet(faces: &SolidFaces, context: &Context<'_>) -> Result<Vec<([u32; 2], bool)>, ArrangeError> {
    let SolidFaces { unit, corners, numbers, tree } = faces;
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
    let search = PairSearch { look, budget: STEPS + STEPS_A_FACE * corners.len() as u64 };
    let mut pairs = Vec::new();
    let too_many = || ArrangeError::Failed("too many faces meet".to_owned());
    let complete = search.within(tree, |hits| -> Result<(), ArrangeError> {
        pairs.extend(hits.into_iter().map(|(pair, overlap)| (pair.map(|f| numbers[f as usize]), overlap)));
        context.check()?;
        if pairs.len() > MOST_PAIRS { Err(too_many()) } else { Ok(()) }
    })?;
    if !complete {
        return Err(too_many());
    }
    pairs.sort_unstable();
    Ok(pairs)
}

/// The faces that meet others: each by itself, or with those that overlap it in a plane; in order of their first face.
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

/// What holds an arrangement to its bounds.
struct Limits<'a, 'b> {
    context: &'a Context<'b>,
    /// Points that there may be.
    most: usize,
}

impl Limits<'_, '_> {
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

/// Cuts faces by what others left on them.
struct Cutter<'a, 'b> {
    faces: &'a [[u32; 3]],
    cuts: &'a FxHashMap<u32, Cuts>,
    limits: Limits<'a, 'b>,
}

impl Cutter<'_, '_> {
    /// Cuts a face that overlaps no other in its plane.
    fn cut_one(&self, points: &mut Points, plane: u32, face: u32, facets: &mut Vec<Facet>) -> Result<(), ArrangeError> {
        let mut triangulation = Triangulation::new(points, plane, self.faces[face as usize]);
        self.lay(&mut triangulation, face)?;
        triangulation.improve();
        facets.extend(triangulation.triangles().map(|corners| Facet {
            corners,
            faces: SmallVec::from_slice(&[face]),
            weight: 1,
            plane: Some(plane),
        }));
        Ok(())
    }

    /// Lays into a triangulation what other faces left on a face.
    fn lay(&self, triangulation: &mut Triangulation<'_>, face: u32) -> Result<(), ArrangeError> {
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

    /// Cuts faces that overlap in one plane, all at once, so that they are cut in the same way where they do.
    fn cut_many(
        &self,
        points: &mut Points,
        plane: u32,
        group: &[u32],
        facets: &mut Vec<Facet>,
    ) -> Result<(), ArrangeError> {
        let axis = points.planes[plane as usize].axis();
        let upward = points.planes[plane as usize].normal[axis] > 0;
        let outer = points.outer(axis, upward, OUT);
        // Which way each face looks, before the points are lent.
        let normal = points.planes[plane as usize].normal;
        let agrees: Vec<bool> = group
            .iter()
            .map(|&face| {
                let it = Plane::through(self.faces[face as usize].map(|v| points.whole(v)));
                (it.normal[axis] > 0) == (normal[axis] > 0)
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
        for &face in group {
            self.lay(&mut triangulation, face)?;
        }
        triangulation.improve();
        let covers = triangulation.covers(MOST_COVERS).ok_or_else(too_many_points)?;
        facets.extend(triangulation.triangles().zip(covers).filter(|(_, cover)| !cover.is_empty()).map(
            |(corners, cover)| {
                let weight =
                    cover.iter().map(|face| if group.binary_search(face).is_ok_and(|at| agrees[at]) { 1 } else { -1 });
                Facet { corners, weight: weight.sum(), faces: cover, plane: Some(plane) }
            },
        ));
        Ok(())
    }
}
