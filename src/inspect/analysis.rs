use std::sync::OnceLock;

use glam::DVec3;

use super::{Solid, solids};
use crate::context::{Cancelled, Context};
use crate::math::{Tree, to_unit_range};
use crate::mesh::{CornerNormals, Edges, Fans, Ingest, Numbering, Parts, Soup, Surface};

/// What is looked at: a mesh as its file has it, with what the file says beyond triangles.
#[derive(Debug, Clone, Copy)]
pub struct Subject<'a> {
    /// The triangles.
    pub soup: &'a Soup,
    /// Normals at the corners, where the format carries them.
    pub normals: Option<&'a CornerNormals>,
    /// The file's own numbers, where the format has numbers.
    pub numbering: Option<&'a Numbering>,
}

impl<'a> From<&'a Soup> for Subject<'a> {
    fn from(soup: &'a Soup) -> Self {
        Self { soup, normals: None, numbering: None }
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
    unit: OnceLock<Vec<DVec3>>,
    tree: OnceLock<Tree>,
}

impl<'a> Analysis<'a> {
    /// Finds the structure. O(n log n) in the number of faces.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn new(subject: Subject<'a>, context: &Context<'_>) -> Result<Self, Cancelled> {
        let (surface, ingest) = Surface::from_soup(subject.soup);
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
        let (unit, tree) = (OnceLock::new(), OnceLock::new());
        Ok(Self { subject, surface, ingest, edges, parts, fans, solids, unit, tree })
    }

    /// The positions of `surface`, scaled by a power of two for the exact predicates (see [`to_unit_range`]).
    pub fn unit(&self) -> &[DVec3] {
        self.unit.get_or_init(|| to_unit_range(&self.surface.positions))
    }

    /// How long 1 in [`Analysis::unit`] is in the model's unit: a power of two.
    pub fn unit_length(&self) -> f64 {
        let largest = |all: &[DVec3]| all.iter().fold(0.0f64, |m, p| m.max(p.abs().max_element()));
        let (given, scaled) = (largest(&self.surface.positions), largest(self.unit()));
        if scaled > 0.0 { given / scaled } else { 1.0 }
    }

    /// A tree over the faces of `surface` in the coordinates of [`Analysis::unit`].
    pub fn tree(&self) -> &Tree {
        self.tree.get_or_init(|| Tree::new(self.unit(), &self.surface.faces))
    }
}
