//! What faces are painted with.

use std::sync::Arc;

use crate::mesh::Soup;

/// A mesh, and what its faces are painted with.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PaintedMesh {
    /// The triangles.
    pub soup: Soup,
    /// One for each face of the soup, or empty where none is painted.
    pub paint: Vec<Paint>,
}

/// What one face is painted with: a palette of the scene, and in it an entry for each corner. Colours and places in a texture run
/// evenly from corner to corner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Paint {
    /// Index into [`super::Scene::palettes`].
    pub palette: u32,
    /// Entries of the palette, one a corner; of [`Palette::Materials`] all three are the same.
    pub at: [u32; 3],
}

/// A face that is not painted.
pub const PAINTLESS: Paint = Paint { palette: u32::MAX, at: [0; 3] };

/// What faces can be painted with. Colours are sRGB with alpha, 255 being opaque.
#[derive(Debug, Clone, PartialEq)]
pub enum Palette {
    /// Named materials, such as those of a printer: 3MF's base materials, OBJ's `usemtl`, glTF's materials without a texture.
    Materials(Vec<Material>),
    /// Colours: 3MF's colour groups, vertex colours of PLY, OBJ and glTF.
    Colors(Vec<[u8; 4]>),
    /// Places in a texture: 3MF's texture groups, `TEXCOORD_n` of glTF, `vt` of OBJ.
    Textured {
        /// Index into [`super::Scene::textures`].
        texture: u32,
        /// The name of the material, where it has one.
        name: Option<String>,
        /// What the texture's colours are multiplied with.
        tint: [u8; 4],
        /// Places, (0, 0) being the lower left corner of the picture and (1, 1) the upper right one, as in 3MF and OBJ.
        places: Vec<[f64; 2]>,
    },
}

impl Palette {
    /// How many entries it has.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Materials(materials) => materials.len(),
            Self::Colors(colors) => colors.len(),
            Self::Textured { places, .. } => places.len(),
        }
    }

    /// The colours of three entries; none of places in a texture, or where there is no such entry.
    #[must_use]
    pub fn colors(&self, at: [u32; 3]) -> Option<[[u8; 4]; 3]> {
        let color = |at: u32| match self {
            Self::Materials(materials) => materials.get(at as usize).map(|material| material.color),
            Self::Colors(colors) => colors.get(at as usize).copied(),
            Self::Textured { .. } => None,
        };
        Some([color(at[0])?, color(at[1])?, color(at[2])?])
    }

    /// Whether it has none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A material of a [`Palette`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Material {
    /// Its name; empty where it has none.
    pub name: String,
    /// The colour that it is shown in.
    pub color: [u8; 4],
}

/// A picture that faces are painted with: the file's own bytes, which nothing here decodes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Texture {
    /// The file.
    pub bytes: Arc<[u8]>,
    /// `image/png` or `image/jpeg`.
    pub media_type: String,
    /// What is beyond the picture to its sides.
    pub wrap_u: Wrap,
    /// What is beyond the picture above and below.
    pub wrap_v: Wrap,
    /// Whether it is to be shown with the pixel that is nearest, not smoothly.
    pub nearest: bool,
}

/// How a texture goes on beyond its picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wrap {
    /// Again and again.
    #[default]
    Repeat,
    /// Again and again, every second time mirrored.
    Mirror,
    /// With its last pixels.
    Clamp,
    /// With nothing.
    None,
}
