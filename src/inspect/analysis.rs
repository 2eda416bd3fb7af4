use std::borrow::Cow;
use std::sync::OnceLock;

use glam::DVec3;

use super::matching::FaceKeys;
use super::solids::depths_of;
use super::{Intersections, Measures, Solid, nesting, solids};
use crate::context::{Cancelled, Context};
use crate::math::{Box3, Dipoles, Tree, area_vanishes, collinear, to_unit_range, unit_scale};
use crate::mesh::{CornerNormals, Edges, Fans, Ingest, Numbering, Parts, Soup, Surface};
use crate::scene::LengthUnit;

/// What is looked at: a mesh as its file has it, with what the file says beyond triangles.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// The triangles.
    pub soup: &'a Soup,
    /// Normals at the corners, where the format carries them.
    pub normals: Option<&'a CornerNormals>,
    /// The file's own numbers, where the format has numbers.
    pub numbering: Option<&'a Numbering>,
    /// Of each face the number of its material, where the mesh is an assembly of bodies of several materials. Such bodies may touch.
    pub materials: Option<&'a [u32]>,
    /// Whether its readers take faces to share vertices by the file's indices only, and not by position.
    pub is_indexed: bool,
    /// What its lengths are in, where that is settled.
    pub unit: Option<&'a LengthUnit>,
}

impl<'a> From<&'a Soup> for Subject<'a> {
    fn from(soup: &'a Soup) -> Self {
        Self { soup, normals: None, numbering: None, materials: None, is_indexed: false, unit: None }
    }
}

/// The structure of a mesh, found once and shared by everything that looks at it.
///
/// Faces are those of `surface`; [`Surface::source`] leads back to the file's. What is costly and not always
/// needed is made at its first use.
pub struct Analysis<'a> {
    /// What is looked at.
    pub subject: Subject<'a>,
    /// Its finite faces, with vertices merged at equal positions.
    pub surface: Surface,
    /// What was merged and left out.
    pub ingest: Ingest,
    /// The edges of `surface`.
    pub edges: Edges,
    /// Its edge-connected parts, before anything is processed.
    pub parts: Parts,
    /// Its fans.
    pub fans: Fans,
    /// Volume, area and box of each part.
    pub solids: Vec<Solid>,
    scale: OnceLock<f64>,
    unit: OnceLock<Vec<DVec3>>,
    flat: OnceLock<Vec<bool>>,
    extent: OnceLock<Box3>,
    containers: OnceLock<Vec<Option<Vec<u32>>>>,
    depths: OnceLock<Vec<Option<u32>>>,
    tree: OnceLock<Tree>,
    dipoles: OnceLock<Dipoles>,
    keys: OnceLock<(f64, FaceKeys)>,
    pub(super) measures: OnceLock<Measures>,
    pub(super) intersections: OnceLock<Intersections>,
    pub(super) faces_in_other_materials: OnceLock<Vec<u32>>,
}

impl<'a> Analysis<'a> {
    /// Finds the structure. O(n log n) in the number of faces.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn new(subject: Subject<'a>, context: &Context<'_>) -> Result<Self, Cancelled> {
        let (surface, ingest) = match subject.materials {
            Some(materials) => Surface::from_assembly(subject.soup, materials),
            None => Surface::from_soup(subject.soup),
        };
        context.check()?;
        let edges = Edges::new(&surface.faces);
        context.check()?;
        let parts_and_solids = || {
            let parts = Parts::new(&surface, &edges);
            let solids = solids(&surface, &edges, &parts);
            (parts, solids)
        };
        let ((parts, solids), fans) = rayon::join(parts_and_solids, || Fans::new(&surface, &edges));
        context.check()?;
        Ok(Self {
            subject,
            surface,
            ingest,
            edges,
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
            keys: OnceLock::new(),
            measures: OnceLock::new(),
            intersections: OnceLock::new(),
            faces_in_other_materials: OnceLock::new(),
        })
    }

    /// The material of a face of `surface`; 0 where there is only one.
    pub(super) fn material(&self, face: u32) -> u32 {
        let source = self.surface.source[face as usize] as usize;
        self.subject.materials.and_then(|materials| materials.get(source)).copied().unwrap_or(0)
    }

    /// The positions of `surface`, scaled by a power of two for the exact predicates (see [`to_unit_range`]).
    pub fn unit(&self) -> &[DVec3] {
        self.unit.get_or_init(|| to_unit_range(&self.surface.positions))
    }

    /// What the positions were multiplied by for [`Analysis::unit`]: a power of two.
    pub fn scale(&self) -> f64 {
        *self.scale.get_or_init(|| unit_scale(&self.surface.positions))
    }

    /// How long 1 in [`Analysis::unit`] is in the model's unit: a power of two.
    pub fn unit_length(&self) -> f64 {
        1.0 / self.scale()
    }

    /// Of each face whether its corners are on a line, exactly.
    pub fn flat(&self) -> &[bool] {
        self.flat.get_or_init(|| flat_faces(self.unit(), &self.surface.faces))
    }

    /// Whether a face of `surface` has no area: exactly, or as far as f64 can tell.
    pub(super) fn is_without_area(&self, face: u32) -> bool {
        let [a, b, c] = self.unit_corners(face);
        self.flat()[face as usize] || area_vanishes(a, b, c)
    }

    /// The box in the coordinates of [`Analysis::unit`] around all faces that have an area, which are those that a repair can keep; around
    /// all faces where none has.
    pub(super) fn extent(&self) -> Box3 {
        *self.extent.get_or_init(|| {
            let faces = (0u32..).take(self.surface.faces.len());
            let sound = faces.filter(|&f| !self.is_without_area(f)).flat_map(|f| self.unit_corners(f));
            let extent = Box3::of(sound);
            if extent.diagonal() > 0.0 { extent } else { Box3::of(self.unit().iter().copied()) }
        })
    }

    /// The diagonal of [`Analysis::extent`].
    pub(super) fn unit_diagonal(&self) -> f64 {
        self.extent().diagonal()
    }

    /// The other closed parts that each part lies in, as [`nesting`] finds them for all parts.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub(super) fn containers(&self, context: &Context<'_>) -> Result<&[Option<Vec<u32>>], Cancelled> {
        let find = || {
            let all = vec![true; self.solids.len()];
            nesting(&self.surface, &self.parts, &self.solids, &all, context)
        };
        get_or_find(&self.containers, find).map(Vec::as_slice)
    }

    /// How many other closed parts each part lies in; none where it can't be found out.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn depths(&self, context: &Context<'_>) -> Result<&[Option<u32>], Cancelled> {
        let containers = self.containers(context)?;
        Ok(self.depths.get_or_init(|| depths_of(containers)))
    }

    /// The faces by where they are, when positions are multiplied by `scale`. Those of the first scale that is asked for are kept.
    pub(super) fn keys(&self, scale: f64) -> Cow<'_, FaceKeys> {
        let (known, keys) = self.keys.get_or_init(|| (scale, FaceKeys::new(&self.surface, self.unit(), scale)));
        if *known == scale { Cow::Borrowed(keys) } else { Cow::Owned(FaceKeys::new(&self.surface, self.unit(), scale)) }
    }

    /// A tree over the faces of `surface` in the coordinates of [`Analysis::unit`].
    pub fn tree(&self) -> &Tree {
        self.tree.get_or_init(|| Tree::new(self.unit(), &self.surface.faces))
    }

    /// What winding numbers of all faces are told from. Linear, once.
    pub(super) fn dipoles(&self) -> &Dipoles {
        self.dipoles.get_or_init(|| self.tree().dipoles(|f| self.unit_corners(f)))
    }

    /// The corners of a face of `surface` in the coordinates of [`Analysis::unit`].
    pub(super) fn unit_corners(&self, face: u32) -> [DVec3; 3] {
        let (unit, [a, b, c]) = (self.unit(), self.surface.faces[face as usize]);
        [unit[a as usize], unit[b as usize], unit[c as usize]]
    }

    /// Twice the area of a face of `surface` times its unit normal, in the coordinates of [`Analysis::unit`].
    pub(super) fn unit_area_vector(&self, face: u32) -> DVec3 {
        let [a, b, c] = self.unit_corners(face);
        (b - a).cross(c - a)
    }

    /// The unit normal of a face of `surface`; zero where it has no area.
    pub(super) fn unit_normal(&self, face: u32) -> DVec3 {
        self.unit_area_vector(face).normalize_or_zero()
    }

    /// The centre of a face of `surface` in the coordinates of [`Analysis::unit`].
    pub(super) fn unit_centre(&self, face: u32) -> DVec3 {
        let [a, b, c] = self.unit_corners(face);
        (a + b + c) / 3.0
    }
}

/// What a cell holds, found at its first use.
pub(super) fn get_or_find<T>(cell: &OnceLock<T>, find: impl FnOnce() -> Result<T, Cancelled>) -> Result<&T, Cancelled> {
    if let Some(known) = cell.get() {
        return Ok(known);
    }
    let found = find()?;
    Ok(cell.get_or_init(|| found))
}

/// Two meshes in their own unit coordinates, and how one's become the other's.
#[derive(Clone, Copy)]
pub(super) struct Pair<'a> {
    pub from: &'a Analysis<'a>,
    pub to: &'a Analysis<'a>,
    /// What makes unit coordinates of `from` such of `to`: a power of two, so it rounds nothing.
    pub ratio: f64,
}

impl<'a> Pair<'a> {
    pub fn new(from: &'a Analysis<'a>, to: &'a Analysis<'a>) -> Self {
        Self::scaled([from, to], [from, to].map(|mesh| mesh.scale()))
    }

    /// The same with the scales of both known.
    pub fn scaled([from, to]: [&'a Analysis<'a>; 2], [mine, theirs]: [f64; 2]) -> Self {
        // Beyond that, the smaller mesh is a point to the larger, at the origin.
        Self { from, to, ratio: (theirs / mine).clamp(2f64.powi(-1000), 2f64.powi(1000)) }
    }
}

/// Of each face whether its corners are on a line, for positions in the range of [`to_unit_range`].
pub(super) fn flat_faces(unit: &[DVec3], faces: &[[u32; 3]]) -> Vec<bool> {
    let on_line = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|v| unit[v as usize]);
        collinear(a, b, c)
    };
    faces.iter().map(on_line).collect()
}
