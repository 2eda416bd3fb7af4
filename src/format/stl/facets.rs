//! What the readers of binary and ASCII STL have in common.

use glam::DVec3;

use crate::format::{Format, ReadMesh};
use crate::mesh::{CornerNormals, Soup};

/// The mesh of a file, which stores three vertices for each facet.
pub(super) fn mesh_of(soup: Soup, dialect: &str, normals: FacetNormals, warnings: Vec<String>) -> ReadMesh {
    let stored_vertices = Some(3 * soup.faces.len() as u64);
    ReadMesh { normals: normals.finish(), stored_vertices, warnings, ..ReadMesh::of(soup, Format::Stl, dialect) }
}

/// Collects facet normals while they are read. A zero normal asks the reader to compute it, so it counts as absent. Normals that agree with
/// their corners carry no information, so only opposed normals are stored.
#[derive(Debug, Default)]
pub(super) struct FacetNormals {
    opposed: Vec<(u32, [f32; 3])>,
    has_any: bool,
}

impl FacetNormals {
    /// Takes the normal of a facet; facets come in order.
    #[inline]
    pub fn add(&mut self, facet: u32, normal: [f32; 3], [a, b, c]: [DVec3; 3]) {
        if normal == [0.0; 3] {
            return;
        }
        self.has_any = true;
        // Products of f32 values neither overflow nor underflow in f64. Comparisons with not-a-number are false.
        if (b - a).cross(c - a).dot(DVec3::from_array(normal.map(f64::from))) < 0.0 {
            self.opposed.push((facet, normal));
        }
    }

    /// The normals of these facets and of facets that follow them.
    pub fn and(mut self, later: Self) -> Self {
        self.opposed.extend(later.opposed);
        Self { opposed: self.opposed, has_any: self.has_any || later.has_any }
    }

    /// The collected normals; `None` if no facet had a normal.
    fn finish(self) -> Option<CornerNormals> {
        self.has_any.then_some(CornerNormals::OfFaces { opposed: self.opposed })
    }
}
