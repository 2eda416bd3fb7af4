//! What a file holds, whatever its format: the one mesh that most formats know, or a scene.

use super::archive::Archive;
use super::beside::Beside;
use super::errors::{ReadError, ReadErrorKind};
use super::scenes::{ReadFile, ReadScene};
use super::{Format, Limits, ReadMesh, ReadOptions, bundle, gltf, obj, off, ply, sniff, stl, threemf, vertex_face};
use crate::scene::{Paint, PaintedMesh, Palette, Scene, Texture};

/// What was read.
pub(super) enum Content {
    Mesh(Box<Painted>),
    Scene(ReadScene),
}

/// A mesh, and what its faces are painted with.
pub(super) struct Painted {
    pub mesh: ReadMesh,
    pub paints: Paints,
}

/// What faces are painted with; empty where none is painted.
#[derive(Default)]
pub(super) struct Paints {
    pub of_faces: Vec<Paint>,
    pub palettes: Vec<Palette>,
    pub textures: Vec<Texture>,
}

impl From<ReadMesh> for Painted {
    fn from(mesh: ReadMesh) -> Self {
        Self { mesh, paints: Paints::default() }
    }
}

impl Content {
    /// Reads a whole file, whatever its format; the colours of a mesh only where they are asked for.
    pub fn read(bytes: &[u8], options: &ReadOptions, painted: bool) -> Result<Self, ReadError> {
        options.limits.check_bytes(bytes.len() as u64)?;
        match sniff(bytes, Some(bytes.len() as u64))? {
            // Only the whole of an archive tells what it holds.
            Format::ThreeMf | Format::Zip => bundle::read(bytes, options, painted),
            format => Self::of_file(format, bytes, options, painted, &Beside::nothing()),
        }
    }

    /// Reads a file of a format.
    pub fn of_file(
        format: Format,
        bytes: &[u8],
        options: &ReadOptions,
        painted: bool,
        beside: &Beside<'_>,
    ) -> Result<Self, ReadError> {
        let mesh = match format {
            Format::Stl => stl::read(bytes, &options.limits)?.into(),
            Format::Obj => obj::read(bytes, options, painted.then_some(beside))?,
            Format::Ply => ply::read(bytes, options, painted)?,
            Format::Off => off::read(bytes, options)?.into(),
            Format::Mesh => vertex_face::read(bytes, &options.limits)?.into(),
            Format::Glb => return gltf::read(bytes, options, beside).map(Self::Scene),
            Format::ThreeMf | Format::Zip => {
                let read = threemf::read(&mut Archive::open(bytes, &options.limits)?, options)?;
                return read.map(Self::Scene).ok_or_else(|| {
                    let detail = "the ZIP archive holds no 3MF model; unpack it, and send the model that is in it";
                    ReadError::whole(ReadErrorKind::UnsupportedFormat, detail)
                });
            }
        };
        Ok(Self::Mesh(Box::new(mesh)))
    }

    /// What was found and what there is to tell.
    pub fn account(&mut self) -> (&mut Format, &mut String, &mut Vec<String>) {
        match self {
            Self::Mesh(it) => (&mut it.mesh.format, &mut it.mesh.dialect, &mut it.mesh.warnings),
            Self::Scene(it) => (&mut it.format, &mut it.dialect, &mut it.warnings),
        }
    }

    /// All of it, and in its places as one mesh.
    pub fn into_file(self, limits: &Limits) -> Result<ReadFile, ReadError> {
        match self {
            Self::Scene(read) => read.into_file(limits),
            Self::Mesh(painted) => {
                let Painted { mesh, paints: Paints { of_faces, palettes, textures } } = *painted;
                let scene = (!of_faces.is_empty()).then(|| {
                    let whole = PaintedMesh { soup: mesh.soup.clone(), paint: of_faces.clone() };
                    Scene { palettes, textures, ..Scene::of_mesh(whole) }
                });
                Ok(ReadFile { mesh, paint: of_faces, scene, unit: None })
            }
        }
    }

    /// All of it as a scene.
    pub fn into_scene(self) -> ReadScene {
        match self {
            Self::Scene(read) => read,
            Self::Mesh(painted) => {
                let Painted { mesh: ReadMesh { soup, format, dialect, warnings, .. }, paints } = *painted;
                let Paints { of_faces, palettes, textures } = paints;
                let scene = Scene::of_mesh(PaintedMesh { soup, paint: of_faces });
                ReadScene { scene: Scene { palettes, textures, ..scene }, format, dialect, warnings }
            }
        }
    }
}
