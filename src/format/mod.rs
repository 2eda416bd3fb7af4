//! Bytes to [`Soup`] and back: one file or folder a format, found by content and never by name.
//!
//! The way of a file: [`sniff`] names its format from its first bytes; `archive` opens what is packed, and `sidecar` finds the model in it;
//! the format's reader makes a mesh or a scene of it, which `content` holds; and the format's writer makes bytes again.
//!
//! Every input is hostile: readers check counts against [`Limits`] and against the bytes that are there before they
//! allocate, and answer a [`ReadError`] that names the byte or line and what was expected there.

mod archive;
mod content;
mod errors;
mod faces;
mod formats;
mod gltf;
mod limits;
mod obj;
mod off;
mod paint;
mod ply;
mod polygon;
mod sidecar;
mod sniff;
mod stl;
mod text;
mod threemf;
mod vertex_face;

pub use content::{Polygons, ReadFile, ReadMesh, ReadScene};
pub use errors::{Place, ReadError, ReadErrorKind, WriteError};
pub use formats::{Format, Loss, losses, losses_in_words};
pub use limits::{Limits, ReadOptions};
pub use sniff::sniff;

use crate::mesh::Soup;
use crate::scene::{PaintedMesh, Scene};
use archive::Archive;
use content::Content;
use sidecar::{Files, Sidecars};

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
    read_content(bytes, options, false)?.into_file(&options.limits)
}

/// Reads a whole file with all that it holds.
///
/// # Errors
/// As [`read`].
pub fn read_file(bytes: &[u8], options: &ReadOptions) -> Result<ReadFile, ReadError> {
    read_content(bytes, options, true)?.into_file(&options.limits)
}

/// Reads a whole file with its objects, where they stand and what they are painted with.
///
/// # Errors
/// As [`read`].
pub fn read_scene(bytes: &[u8], options: &ReadOptions) -> Result<ReadScene, ReadError> {
    read_content(bytes, options, true).map(Content::into_scene)
}

/// Reads a whole file, whatever its format; the colours of a mesh only where they are asked for.
fn read_content(bytes: &[u8], options: &ReadOptions, painted: bool) -> Result<Content, ReadError> {
    options.limits.check_bytes(bytes.len() as u64)?;
    match sniff(bytes, Some(bytes.len() as u64))? {
        // Only the whole of an archive tells what it holds.
        Format::ThreeMf | Format::Zip => read_archive(bytes, options, painted),
        format => read_model(format, bytes, options, painted, &Sidecars::nothing()),
    }
}

/// Reads an archive: 3MF, which is one too, or one that holds a model.
fn read_archive(bytes: &[u8], options: &ReadOptions, painted: bool) -> Result<Content, ReadError> {
    let mut archive = Archive::open(bytes, &options.limits)?;
    if let Some(scene) = threemf::read(&mut archive, options)? {
        return Ok(Content::Scene(scene));
    }
    let (name, format) = sidecar::model_of(&archive)?;
    let model = archive.bytes(name, options.limits.max_bytes)?.unwrap_or_default();
    let sidecars = Sidecars::of(name, &archive, &options.limits);
    let within = |error: ReadError| {
        let detail = format!("in the archive's file {}: {}", archive::shown(name), error.detail);
        ReadError { detail, ..error }
    };
    let mut content = read_model(format, &model, options, painted, &sidecars).map_err(within)?;
    let (format, dialect, warnings) = content.account();
    if *format == Format::Obj {
        *format = Format::Zip;
    }
    dialect.push_str(" in a ZIP archive");
    warnings.extend(sidecars.warnings());
    Ok(content)
}

/// Reads a file of a format.
fn read_model(
    format: Format,
    bytes: &[u8],
    options: &ReadOptions,
    painted: bool,
    sidecars: &Sidecars<'_>,
) -> Result<Content, ReadError> {
    let mesh = match format {
        Format::Stl => stl::read(bytes, &options.limits)?.into(),
        Format::Obj => obj::read(bytes, options, painted.then_some(sidecars))?,
        Format::Ply => ply::read(bytes, options, painted)?,
        Format::Off => off::read(bytes, options)?.into(),
        Format::Mesh => vertex_face::read(bytes, &options.limits)?.into(),
        Format::Glb => return gltf::read(bytes, options, sidecars).map(Content::Scene),
        Format::ThreeMf | Format::Zip => {
            let read = threemf::read(&mut Archive::open(bytes, &options.limits)?, options)?;
            return read.map(Content::Scene).ok_or_else(|| {
                let detail = "the ZIP archive holds no 3MF model; unpack it, and send the model that is in it";
                ReadError::whole(ReadErrorKind::UnsupportedFormat, detail)
            });
        }
    };
    Ok(Content::Mesh(Box::new(mesh)))
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
        Format::Zip => sidecar::pack(&Files { obj: obj::write(soup), mtl: None, pictures: Vec::new() }),
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
    let placed = || scene.placed(u64::from(u32::MAX)).map_err(|_| WriteError::TooLarge);
    match format {
        Format::ThreeMf => threemf::write(scene),
        Format::Glb => gltf::write(scene),
        Format::Zip => sidecar::pack(&obj::write_painted(&placed()?, scene, sidecar::MATERIALS)),
        Format::Ply => Ok(ply::write_painted(&placed()?, scene)),
        Format::Stl | Format::Obj | Format::Off | Format::Mesh => write(&placed()?.soup, format),
    }
}
