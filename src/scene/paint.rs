//! Colours, materials and textures of faces.

use std::sync::Arc;

use crate::mesh::Soup;

/// A mesh with the paint of its faces.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PaintedMesh {
    /// The triangles.
    pub soup: Soup,
    /// Paint of each face of the soup; empty if no face is painted.
    pub paint: Vec<Paint>,
}

/// Paint of one face: a palette of the scene and an entry for each corner. Colours and texture coordinates are
/// interpolated between the corners.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Paint {
    /// Index into [`super::Scene::palettes`].
    pub palette: u32,
    /// Palette entry of each corner; all equal for [`Palette::Materials`].
    pub at: [u32; 3],
}

/// Paint of an unpainted face.
pub const PAINTLESS: Paint = Paint { palette: u32::MAX, at: [0; 3] };

/// Source of the paint of faces. Colours are sRGB with alpha; 255 is opaque.
#[derive(Debug, Clone, PartialEq)]
pub enum Palette {
    /// Named materials, for example of a printer: 3MF base materials, OBJ `usemtl`, glTF materials without a texture.
    Materials(Vec<Material>),
    /// Colours: 3MF colour groups, and vertex colours of PLY, OBJ and glTF.
    Colors(Vec<[u8; 4]>),
    /// Texture coordinates: 3MF texture groups, glTF `TEXCOORD_n`, OBJ `vt`.
    Textured {
        /// Index into [`super::Scene::textures`].
        texture: u32,
        /// Name of the material, if any.
        name: Option<String>,
        /// Colour that multiplies the texture.
        tint: [u8; 4],
        /// Texture coordinates: (0, 0) is the lower left corner of the image and (1, 1) the upper right corner, as in
        /// 3MF and OBJ.
        places: Vec<[f64; 2]>,
    },
}

impl Palette {
    /// Number of entries.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Materials(materials) => materials.len(),
            Self::Colors(colors) => colors.len(),
            Self::Textured { places, .. } => places.len(),
        }
    }

    /// Colours of three entries; `None` for texture coordinates and for missing entries.
    #[must_use]
    pub fn colors(&self, at: [u32; 3]) -> Option<[[u8; 4]; 3]> {
        let color = |at: u32| match self {
            Self::Materials(materials) => materials.get(at as usize).map(|material| material.color),
            Self::Colors(colors) => colors.get(at as usize).copied(),
            Self::Textured { .. } => None,
        };
        Some([color(at[0])?, color(at[1])?, color(at[2])?])
    }

    /// Whether the palette has no entries.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// A material of a [`Palette`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Material {
    /// Name of the material; empty if unnamed.
    pub name: String,
    /// Display colour.
    pub color: [u8; 4],
}

/// A texture image, stored as the file's undecoded bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Texture {
    /// Contents of the image file.
    pub bytes: Arc<[u8]>,
    /// `image/png` or `image/jpeg`.
    pub media_type: String,
    /// Horizontal wrapping.
    pub wrap_u: Wrap,
    /// Vertical wrapping.
    pub wrap_v: Wrap,
    /// Whether sampling uses the nearest pixel instead of interpolation.
    pub nearest: bool,
}

/// Wrapping of a texture beyond its image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wrap {
    /// The image repeats.
    #[default]
    Repeat,
    /// The image repeats, mirrored every second time.
    Mirror,
    /// The edge pixels extend.
    Clamp,
    /// No colour beyond the image.
    None,
}
