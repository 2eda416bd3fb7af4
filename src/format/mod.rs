//! Bytes to [`Soup`] and back: one file a format, found by content and never by name.
//!
//! Every input is hostile: readers check counts against [`Limits`] and against the bytes that are there before they
//! allocate, and answer a [`ReadError`] that names the byte or line and what was expected there.

mod archive;
mod beside;
mod bundle;
mod content;
mod errors;
mod faces;
mod facet_normals;
mod foreign;
mod gltf;
mod lengths;
mod limits;
mod losses;
mod obj;
mod off;
mod palettes;
mod pictures;
mod ply;
mod polygon;
mod scenes;
mod sniff;
mod stl;
mod text;
mod threemf;
mod vertex_face;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

pub use errors::{Place, ReadError, ReadErrorKind, WriteError};
pub use limits::{Limits, ReadOptions};
pub use losses::{Loss, losses, losses_in_words};
pub use scenes::{ReadFile, ReadScene};

use crate::math::Precision;
use crate::mesh::{CornerNormals, Numbering, Soup};
use crate::scene::{PaintedMesh, Scene};
use content::Content;

/// A file format that is both read and written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Stereolithography, binary or ASCII; written as binary. Coordinates are f32 and there are no indices.
    Stl,
    /// Wavefront OBJ.
    Obj,
    /// Stanford PLY, ASCII or binary of either byte order; written as little-endian binary.
    Ply,
    /// Object File Format with its variants.
    Off,
    /// Lines `Vertex i x y z` and `Face j v1 v2 v3`, as meshalyzer has them; numbers count from 1.
    Mesh,
    /// glTF 2.0: GLB, or JSON with buffers that are embedded or, in a ZIP archive, beside it; written as GLB. Coordinates are f32, in metres.
    Glb,
    /// 3D Manufacturing Format: objects, places, colours and a unit, in a ZIP archive.
    #[serde(rename = "3mf")]
    ThreeMf,
    /// Wavefront OBJ with its materials and pictures in a ZIP archive. One model of any other format may be in the archive too, and is then read
    /// as what it is.
    Zip,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 8] =
        [Self::Stl, Self::Obj, Self::Ply, Self::Off, Self::Mesh, Self::Glb, Self::ThreeMf, Self::Zip];

    /// The usual ending of a file's name, without the point.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Stl => "stl",
            Self::Obj => "obj",
            Self::Ply => "ply",
            Self::Off => "off",
            Self::Mesh => "mesh",
            Self::Glb => "glb",
            Self::ThreeMf => "3mf",
            Self::Zip => "zip",
        }
    }

    /// The precision in which coordinates are written.
    #[must_use]
    pub fn precision(self) -> Precision {
        match self {
            Self::Stl | Self::Glb => Precision::F32,
            _ => Precision::F64,
        }
    }

    /// Whether faces share vertices by their indices, so that a reader takes them as they are. STL has no indices, and glTF gives a vertex
    /// once for each normal and each place in a picture, so that readers of both join vertices by position.
    #[must_use]
    pub fn is_indexed(self) -> bool {
        !matches!(self, Self::Stl | Self::Glb)
    }

    /// Whether it says what faces are painted with.
    #[must_use]
    pub fn has_paint(self) -> bool {
        matches!(self, Self::Ply | Self::Zip | Self::Glb | Self::ThreeMf)
    }

    /// Whether it keeps objects apart, each in its places.
    #[must_use]
    pub fn has_objects(self) -> bool {
        matches!(self, Self::Glb | Self::ThreeMf)
    }
}

/// A mesh read from bytes, with what a reader should tell.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadMesh {
    /// The triangles.
    pub soup: Soup,
    /// The format that was found.
    pub format: Format,
    /// The dialect in words: `binary STL`, `ASCII PLY`, `COFF`.
    pub dialect: String,
    /// The file's own numbers, where the format has numbers.
    pub numbering: Option<Numbering>,
    /// The normals that the file gives, if it gives any. None of them is ever a reason not to read a file.
    pub normals: Option<CornerNormals>,
    /// Of each face the number of its material, where the file is an assembly of bodies of several materials: 3MF alone. Bodies of one
    /// material are judged together, and may touch those of another.
    pub materials: Option<Vec<u32>>,
    /// The polygons of more than three corners that were cut.
    pub polygons: Polygons,
    /// Oddities that were read past, each a sentence for the person who sent the file.
    pub warnings: Vec<String>,
}

impl ReadMesh {
    /// Triangles of a file of this format and dialect that says nothing else.
    pub(crate) fn of(soup: Soup, format: Format, dialect: impl Into<String>) -> Self {
        Self {
            soup,
            format,
            dialect: dialect.into(),
            numbering: None,
            normals: None,
            materials: None,
            polygons: Polygons::default(),
            warnings: Vec::new(),
        }
    }

    /// Other triangles of the same file.
    #[must_use]
    pub fn of_same_file(&self, soup: Soup) -> Self {
        Self::of(soup, self.format, self.dialect.clone())
    }
}

/// The polygons of more than three corners in a file.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Polygons {
    /// How many there are.
    pub count: u64,
    /// How many are twisted by more than [`ReadOptions::twist_angle_deg`]; they were cut with the least fold.
    pub twisted: u64,
    /// The largest twist of one, in degrees: the largest angle between the plane of the polygon through its corners' middle and the way from
    /// there to a corner, after Mesh Heal (seed 001).
    pub largest_twist_deg: f64,
}

/// Names the format of a file from its first bytes and its length where it is known.
///
/// 4096 bytes are enough, and no more are looked at, so that [`read`] finds the same format; but what an archive holds is only told by its
/// end, so that [`Format::ThreeMf`] and [`Format::Zip`] may turn out to be each other, or what the archive holds.
///
/// # Errors
/// [`ReadErrorKind::Empty`], [`ReadErrorKind::UnknownFormat`] or [`ReadErrorKind::UnsupportedFormat`], with what was found.
pub fn sniff(head: &[u8], length: Option<u64>) -> Result<Format, ReadError> {
    sniff::sniff(head, length)
}

/// Reads a whole file of any known format.
///
/// Coordinates that are not finite are passed on. STL gives three positions a face, which nothing has merged yet.
///
/// # Errors
/// A [`ReadError`] that names the place and what was expected.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<ReadMesh, ReadError> {
    read_with(bytes, &ReadOptions::within(*limits))
}

/// As [`read`], with all that can be chosen.
///
/// # Errors
/// As [`read`].
pub fn read_with(bytes: &[u8], options: &ReadOptions) -> Result<ReadMesh, ReadError> {
    read_shape(bytes, options).map(|file| file.mesh)
}

/// As [`read_file`], where a file of one mesh is read without its colours.
///
/// # Errors
/// As [`read`].
pub fn read_shape(bytes: &[u8], options: &ReadOptions) -> Result<ReadFile, ReadError> {
    Content::read(bytes, options, false)?.into_file(&options.limits)
}

/// Reads a whole file with all that it holds.
///
/// # Errors
/// As [`read`].
pub fn read_file(bytes: &[u8], options: &ReadOptions) -> Result<ReadFile, ReadError> {
    Content::read(bytes, options, true)?.into_file(&options.limits)
}

/// Reads a whole file with its objects, where they stand and what they are painted with.
///
/// # Errors
/// As [`read`].
pub fn read_scene(bytes: &[u8], options: &ReadOptions) -> Result<ReadScene, ReadError> {
    Content::read(bytes, options, true).map(Content::into_scene)
}

/// Writes a mesh in a format. The same mesh gives the same bytes, and reading them gives the same mesh: exactly for OBJ, in an archive or not,
/// PLY, OFF and Vertex/Face, rounded to f32 and without indices for STL.
///
/// # Errors
/// [`WriteError`] when the mesh can't be said in the format; only STL has such limits.
///
/// # Panics
/// When a face names a position that is not there, against what [`Soup`] promises.
pub fn write(soup: &Soup, format: Format) -> Result<Vec<u8>, WriteError> {
    match format {
        Format::Stl => stl::write(soup),
        Format::Obj => Ok(obj::write(soup)),
        Format::Ply => Ok(ply::write(soup)),
        Format::Off => Ok(off::write(soup)),
        Format::Mesh => Ok(vertex_face::write(soup)),
        Format::Zip => bundle::pack(&obj::Files { obj: obj::write(soup), mtl: None, pictures: Vec::new() }),
        Format::Glb | Format::ThreeMf => {
            write_scene(&Scene::of_mesh(PaintedMesh { soup: soup.clone(), paint: Vec::new() }), format)
        }
    }
}

/// Writes a scene in a format: with all that the format can say of it, in others than 3MF and GLB as one mesh. What it can't say is left out,
/// and [`losses`] tells what that is.
///
/// # Errors
/// [`WriteError`] as for [`write`], and where the scene's places together have more faces than can be counted.
///
/// # Panics
/// As [`write`].
pub fn write_scene(scene: &Scene, format: Format) -> Result<Vec<u8>, WriteError> {
    match format {
        Format::ThreeMf => threemf::write(scene),
        Format::Glb => gltf::write(scene),
        Format::Zip => bundle::write(scene),
        _ => {
            let mesh = scene.placed(u64::from(u32::MAX)).map_err(|_| WriteError::TooLarge)?;
            if format == Format::Ply { Ok(ply::write_painted(&mesh, scene)) } else { write(&mesh.soup, format) }
        }
    }
}
