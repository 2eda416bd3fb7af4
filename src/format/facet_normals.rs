use glam::DVec3;

use crate::mesh::CornerNormals;

/// Collects the normals of STL's facets as they are read. A normal of zeros says that readers should compute it, and is
/// none; one that agrees with its corners says nothing new, so that only those against them take memory.
#[derive(Debug, Default)]
pub(super) struct FacetNormals {
    opposed: Vec<(u32, [f32; 3])>,
    any: bool,
}

impl FacetNormals {
    /// Takes the normal of a facet; facets come in order.
    #[inline]
    pub fn take(&mut self, facet: u32, normal: [f32; 3], [a, b, c]: [DVec3; 3]) {
        if normal == [0.0; 3] {
            return;
        }
        self.any = true;
        // In f64 products of f32 neither overflow nor vanish; a comparison with not-a-number is false.
        if (b - a).cross(c - a).dot(DVec3::from_array(normal.map(f64::from))) < 0.0 {
            self.opposed.push((facet, normal));
        }
    }

    /// What was read, unless no facet had a normal.
    pub fn finish(self) -> Option<CornerNormals> {
        self.any.then_some(CornerNormals::OfFaces { opposed: self.opposed })
    }
}
