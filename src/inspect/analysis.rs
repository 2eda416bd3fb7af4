//! Structure of a mesh shared by all measurements and searches: connectivity, parts, fans, and cached spatial data.

use std::borrow::Cow;
use std::sync::{Arc, OnceLock};

use glam::DVec3;

use super::matching::{Common, FaceHashes, KeyedFaces};
use super::solids::depths_of;
use super::{Intersections, Measures, Meeting, Solid, nesting, solids};
use crate::context::{Cancelled, Context};
use crate::math::{Box3, Dipoles, Hit, Tree, area_vanishes, collinear, threads, to_unit_range, unit_scale};
use crate::mesh::{CornerNormals, Edges, Fans, Ingest, Numbering, Parts, Soup, Surface};
use crate::scene::LengthUnit;

/// Input of an analysis: a mesh as read from a file, with additional information from the file.
#[derive(Debug, Clone)]
pub struct Subject<'a> {
    /// Triangles of the mesh. The analysis drops an owned soup if it holds no more than the surface.
    pub soup: Cow<'a, Soup>,
    /// What else is known of the file.
    pub facts: FileFacts<'a>,
}

/// What is known of a mesh's file besides the triangles.
#[derive(Debug, Clone, Copy, Default)]
pub struct FileFacts<'a> {
    /// Corner normals, if the format stores normals.
    pub normals: Option<&'a CornerNormals>,
    /// The file's own vertex and face numbers, if the format has numbers.
    pub numbering: Option<&'a Numbering>,
    /// For each face its material number, if the mesh is an assembly of bodies of several materials. Bodies of
    /// different materials may touch.
    pub materials: Option<&'a [u32]>,
    /// Number of vertices in the file, if the soup has fewer because the format stores vertices of each face separately.
    pub stored_vertices: Option<u64>,
    /// Whether the format's readers join vertices by index only, not by position.
    pub is_indexed: bool,
    /// Unit of lengths, if settled.
    pub unit: Option<&'a LengthUnit>,
}

impl<'a> From<&'a Soup> for Subject<'a> {
    fn from(soup: &'a Soup) -> Self {
        Self { soup: Cow::Borrowed(soup), facts: FileFacts::default() }
    }
}

impl From<Soup> for Subject<'_> {
    fn from(soup: Soup) -> Self {
        Self { soup: Cow::Owned(soup), facts: FileFacts::default() }
    }
}

/// Connectivity and derived structure of a mesh, built once and shared by all measurements and searches.
///
/// Face indices refer to `surface`; [`Surface::source`] maps them to the file's faces. Expensive structures are built
/// on first use.
pub struct Analysis<'a> {
    /// What is known of the file.
    pub facts: FileFacts<'a>,
    /// The mesh as it was read; `None` if its faces and positions are those of `surface`.
    soup: Option<Cow<'a, Soup>>,
    /// Faces with finite corners, with vertices merged at equal positions.
    pub surface: Surface,
    /// Counts of merged and omitted elements.
    pub ingest: Ingest,
    /// Edges of `surface`.
    pub edges: Arc<Edges>,
    /// Edge-connected parts of `surface`, before any processing.
    pub parts: Parts,
    /// Fans of `surface`: for each vertex, its faces grouped by shared edges.
    pub fans: Fans,
    /// Volume, area and bounding box of each part.
    pub solids: Vec<Solid>,
    scale: OnceLock<f64>,
    unit: OnceLock<Vec<DVec3>>,
    flat: OnceLock<Vec<bool>>,
    extent: OnceLock<Box3>,
    containers: OnceLock<Vec<Option<Vec<u32>>>>,
    depths: OnceLock<Vec<Option<u32>>>,
    tree: OnceLock<Tree>,
    dipoles: OnceLock<Dipoles>,
    hashes: OnceLock<FaceHashes>,
    /// Cache of [`measures`](super::measures()).
    pub(super) measures: OnceLock<Measures>,
    /// Cache of [`Analysis::intersections`].
    pub(super) intersections: OnceLock<Intersections>,
    /// Cache of [`Analysis::faces_in_other_materials`].
    pub(super) faces_in_other_materials: OnceLock<Vec<u32>>,
    /// Intersections that are known from an earlier mesh.
    pub(super) known_pairs: Option<KnownPairs>,
}

/// The faces of a mesh that are not in an earlier mesh, and the known intersections of all other faces with each other.
pub(super) struct KnownPairs {
    /// For each face of the mesh's surface, whether the earlier mesh has no face at the same positions.
    pub changed: Vec<bool>,
    /// The intersecting pairs of unchanged faces, the smaller index first.
    pub hits: Vec<Hit<Meeting>>,
}

impl<'a> Analysis<'a> {
    /// Builds the connectivity. O(n log n) in the number of faces.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn new(subject: Subject<'a>, context: &Context<'_>) -> Result<Self, Cancelled> {
        let Subject { soup, facts } = subject;
        let (surface, ingest) = match facts.materials {
            Some(materials) => Surface::from_assembly(&soup, materials),
            None => Surface::from_soup(&soup),
        };
        // If the vertices have the same numbers and none was merged, they have the same positions.
        let is_surface = ingest == Ingest::default() && surface.faces == soup.faces;
        let soup = Some(soup).filter(|_| !is_surface);
        context.check()?;
        let edges = Edges::new(&surface.faces);
        context.check()?;
        let parts_and_solids = || {
            let parts = Parts::new(&surface, &edges);
            let solids = solids(&surface, &edges, &parts);
            (parts, solids)
        };
        let ((parts, solids), fans) =
            threads::join(surface.faces.len(), parts_and_solids, || Fans::new(&surface, &edges));
        context.check()?;
        Ok(Self {
            facts,
            soup,
            surface,
            ingest,
            edges: Arc::new(edges),
            parts,
            fans,
            solids,
            scale: OnceLock::new(),
            unit: OnceLock::new(),
            flat: OnceLock::new(),
            extent: OnceLock::new(),
            containers: OnceLock::new(),
            depths: OnceLock::new(),
            tree: OnceLock::new(),
            dipoles: OnceLock::new(),
            hashes: OnceLock::new(),
            measures: OnceLock::new(),
            intersections: OnceLock::new(),
            faces_in_other_materials: OnceLock::new(),
            known_pairs: None,
        })
    }

    /// The faces of the mesh as it was read.
    pub(crate) fn file_faces(&self) -> &[[u32; 3]] {
        self.soup.as_ref().map_or(&self.surface.faces, |soup| &soup.faces)
    }

    /// The positions of the vertices of [`Analysis::file_faces`].
    pub(super) fn file_positions(&self) -> &[DVec3] {
        self.soup.as_ref().map_or(&self.surface.positions, |soup| &soup.positions)
    }

    /// Material of a face of `surface`; 0 if the mesh is not an assembly.
    pub(super) fn material(&self, face: u32) -> u32 {
        let source = self.surface.source[face as usize] as usize;
        self.facts.materials.and_then(|materials| materials.get(source)).copied().unwrap_or(0)
    }

    /// Positions of `surface`, scaled by a power of two into the range of the exact predicates (see
    /// [`to_unit_range`]).
    pub fn unit(&self) -> &[DVec3] {
        get_or_init(&self.unit, || to_unit_range(&self.surface.positions)).as_slice()
    }

    /// Scale factor from the model's unit to [`Analysis::unit`]: a power of two.
    pub fn scale(&self) -> f64 {
        *get_or_init(&self.scale, || unit_scale(&self.surface.positions))
    }

    /// Scale factor from [`Analysis::unit`] to the model's unit: a power of two.
    pub fn unit_length(&self) -> f64 {
        1.0 / self.scale()
    }

    /// For each face, whether its corners are exactly collinear.
    pub fn flat(&self) -> &[bool] {
        get_or_init(&self.flat, || flat_faces(self.unit(), &self.surface.faces)).as_slice()
    }

    /// Whether a face of `surface` has zero area, exactly or in f64.
    pub(super) fn is_without_area(&self, face: u32) -> bool {
        let [a, b, c] = self.unit_corners(face);
        self.flat()[face as usize] || area_vanishes(a, b, c)
    }

    /// Bounding box, in coordinates of [`Analysis::unit`], of all faces with an area, which are the faces that a
    /// repair can keep. If no face has an area, the box of all faces.
    pub(super) fn extent(&self) -> Box3 {
        *get_or_init(&self.extent, || {
            let flat = self.flat();
            #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
            let of_chunks = threads::map_chunks(self.surface.faces.len(), |range| {
                let with_corners = range.filter(|&f| !flat[f]).map(|f| self.unit_corners(f as u32));
                Box3::of(with_corners.filter(|&[a, b, c]| !area_vanishes(a, b, c)).flatten())
            });
            let extent = of_chunks.into_iter().fold(Box3::EMPTY, |all, of_chunk| all.joined(&of_chunk));
            if extent.diagonal() > 0.0 { extent } else { Box3::of(self.unit().iter().copied()) }
        })
    }

    /// Diagonal of [`Analysis::extent`].
    pub(super) fn unit_diagonal(&self) -> f64 {
        self.extent().diagonal()
    }

    /// For each part the other closed parts that contain it, as [`nesting`] computes for all parts.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub(super) fn containers(&self, context: &Context<'_>) -> Result<&[Option<Vec<u32>>], Cancelled> {
        let find = || {
            let all = vec![true; self.solids.len()];
            nesting(&self.surface, &self.parts, &self.solids, &all, context)
        };
        get_or_try_init(&self.containers, find).map(Vec::as_slice)
    }

    /// For each part the number of closed parts that contain it; `None` if undecided.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn depths(&self, context: &Context<'_>) -> Result<&[Option<u32>], Cancelled> {
        let containers = self.containers(context)?;
        Ok(get_or_init(&self.depths, || depths_of(containers)).as_slice())
    }

    /// The faces by position, with positions multiplied by `scale`. Cached for the first requested scale.
    pub(super) fn keyed_faces(&self, scale: f64) -> KeyedFaces<'_> {
        let of_scale = || FaceHashes::new(&self.surface, self.unit(), scale);
        let known = get_or_init(&self.hashes, of_scale);
        let hashes = if known.scale() == scale { Cow::Borrowed(known) } else { Cow::Owned(of_scale()) };
        KeyedFaces { surface: &self.surface, hashes }
    }

    /// The faces that this mesh and another have in common: all of them, if both are one.
    pub(super) fn common_faces(&self, other: &Analysis<'_>) -> Common {
        if std::ptr::eq(self, other) {
            return Common::whole(self.surface.faces.len());
        }
        let scale = self.scale();
        Common::new(&self.keyed_faces(scale), &other.keyed_faces(scale))
    }

    /// Bounding volume hierarchy over the faces of `surface`, in coordinates of [`Analysis::unit`].
    pub fn tree(&self) -> &Tree {
        get_or_init(&self.tree, || Tree::new(self.unit(), &self.surface.faces))
    }

    /// [`Analysis::tree`], if it has been built, and `surface` has the same triangles in the same order, whatever their winding and the
    /// numbers of their vertices.
    pub(crate) fn tree_of(&self, surface: &Surface) -> Option<&Tree> {
        let tree = self.tree.get()?;
        let count = self.surface.faces.len();
        if count != surface.faces.len() || self.scale() != unit_scale(&surface.positions) {
            return None;
        }
        let is_other = |face: usize| {
            let [own, other] = [self.surface.corners(face), surface.corners(face)];
            !own.iter().all(|corner| other.contains(corner)) || !other.iter().all(|corner| own.contains(corner))
        };
        (threads::count(count, is_other) == 0).then_some(tree)
    }

    /// Dipole moments of the tree's nodes, for fast winding numbers. O(n) on first use.
    pub(super) fn dipoles(&self) -> &Dipoles {
        get_or_init(&self.dipoles, || self.tree().dipoles(|f| self.unit_corners(f)))
    }

    /// Corners of a face of `surface`, in coordinates of [`Analysis::unit`].
    pub(super) fn unit_corners(&self, face: u32) -> [DVec3; 3] {
        let (unit, [a, b, c]) = (self.unit(), self.surface.faces[face as usize]);
        [unit[a as usize], unit[b as usize], unit[c as usize]]
    }

    /// Area vector of a face of `surface`: the unit normal times twice the area, in coordinates of
    /// [`Analysis::unit`].
    pub(super) fn unit_area_vector(&self, face: u32) -> DVec3 {
        let [a, b, c] = self.unit_corners(face);
        (b - a).cross(c - a)
    }

    /// Unit normal of a face of `surface`; zero if the face has no area.
    pub(super) fn unit_normal(&self, face: u32) -> DVec3 {
        self.unit_area_vector(face).normalize_or_zero()
    }

    /// Centroid of a face of `surface`, in coordinates of [`Analysis::unit`].
    pub(super) fn unit_centre(&self, face: u32) -> DVec3 {
        let [a, b, c] = self.unit_corners(face);
        (a + b + c) / 3.0
    }
}

/// Returns the value of a cell, computing it on first use. Threads that need it at the same time each compute it: none
/// waits for another. A thread in a parallel loop takes up other work while it waits, which might need the same cell, and
/// the thread would wait for itself.
fn get_or_init<T>(cell: &OnceLock<T>, find: impl FnOnce() -> T) -> &T {
    if let Some(known) = cell.get() {
        return known;
    }
    let value = find();
    cell.get_or_init(|| value)
}

/// Like [`get_or_init`], for a computation that may be cancelled.
pub(super) fn get_or_try_init<T>(
    cell: &OnceLock<T>,
    find: impl FnOnce() -> Result<T, Cancelled>,
) -> Result<&T, Cancelled> {
    match cell.get() {
        Some(known) => Ok(known),
        None => find().map(|value| get_or_init(cell, || value)),
    }
}

/// Two meshes, each in its own unit coordinates, and the factor between these coordinates.
#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    /// First mesh.
    pub from: &'a Analysis<'a>,
    /// Second mesh.
    pub to: &'a Analysis<'a>,
    /// Factor from unit coordinates of `from` to unit coordinates of `to`: a power of two, so that no rounding
    /// occurs.
    pub ratio: f64,
}

impl<'a> Pair<'a> {
    /// Builds a pair, computing both scales.
    pub fn new(from: &'a Analysis<'a>, to: &'a Analysis<'a>) -> Self {
        Self::scaled([from, to], [from, to].map(|mesh| mesh.scale()))
    }

    /// Builds a pair from two meshes whose scales are already known.
    pub fn scaled([from, to]: [&'a Analysis<'a>; 2], [own_scale, other_scale]: [f64; 2]) -> Self {
        // Beyond this ratio, the smaller mesh is a point at the origin in the coordinates of the larger.
        Self { from, to, ratio: (other_scale / own_scale).clamp(2f64.powi(-1000), 2f64.powi(1000)) }
    }
}

/// For each face, whether its corners are exactly collinear. Positions must be in the range of [`to_unit_range`].
pub(super) fn flat_faces(unit: &[DVec3], faces: &[[u32; 3]]) -> Vec<bool> {
    threads::map_cheap(faces.len(), |face| {
        let [a, b, c] = faces[face].map(|v| unit[v as usize]);
        collinear(a, b, c)
    })
}
