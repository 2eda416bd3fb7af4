//! Reading and writing mesh files. Each format has a module of its own, and is detected by content, never by file name.
//!
//! How a file is read: [`sniff`] detects the format from the first bytes. `archive` opens ZIP archives, and `sidecar` finds the model in
//! them. The format's reader returns a mesh or a scene, which `content` holds. The format's writer turns a mesh or a scene into bytes.
//!
//! Every input is hostile. Readers check counts against [`Limits`] and against the file's size before they allocate memory. A
//! [`ReadError`] names the byte or line, and what was expected there.

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
mod program;
mod sidecar;
mod sniff;
mod stl;
mod text;
mod threemf;
mod vertex_face;

pub use content::{Polygons, ReadFile, ReadMesh, ReadScene};
pub use errors::{FileLocation, ReadError, ReadErrorKind, WriteError};
pub use formats::{Format, Loss, losses, losses_in_words};
pub use limits::{Limits, ReadOptions};
pub use program::program_of;
pub use sniff::sniff;

use crate::mesh::Soup;
use crate::scene::{PaintedMesh, Scene};
use archive::Archive;
use content::Content;
use sidecar::{ObjZipFiles, Sidecars};

/// Reads a file of any supported format as one mesh.
///
/// Coordinates that are not finite are kept. STL has three positions for each face; duplicate positions are not merged here.
///
/// # Errors
/// A [`ReadError`] that says where the problem is, what was expected and what to do.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<ReadMesh, ReadError> {
    read_with(bytes, &ReadOptions::within(*limits))
}

/// As [`read`], with all options.
///
/// # Errors
/// As [`read`].
pub fn read_with(bytes: &[u8], options: &ReadOptions) -> Result<ReadMesh, ReadError> {
    read_shape(bytes, options).map(|file| file.mesh)
}

/// As [`read_file`], but does not read the colours of a file that holds a single mesh.
///
/// # Errors
/// As [`read`].
pub fn read_shape(bytes: &[u8], options: &ReadOptions) -> Result<ReadFile, ReadError> {
    read_content(bytes, options, false)?.into_file(&options.limits)
}

/// Reads a file with its scene: objects, build items, colours and unit.
///
/// # Errors
/// As [`read`].
pub fn read_file(bytes: &[u8], options: &ReadOptions) -> Result<ReadFile, ReadError> {
    read_content(bytes, options, true)?.into_file(&options.limits)
}

/// Reads a file as a scene: its objects, their instances, and their paint.
///
/// # Errors
/// As [`read`].
pub fn read_scene(bytes: &[u8], options: &ReadOptions) -> Result<ReadScene, ReadError> {
    read_content(bytes, options, true).map(Content::into_scene)
}

/// Reads a file of any format. `painted` tells whether to read the colours of a single mesh.
fn read_content(bytes: &[u8], options: &ReadOptions, painted: bool) -> Result<Content, ReadError> {
    options.limits.check_bytes(bytes.len() as u64)?;
    match sniff(bytes, Some(bytes.len() as u64))? {
        // Only the archive's directory, at its end, shows whether the archive is a 3MF package.
        Format::ThreeMf | Format::Zip => read_archive(bytes, options, painted),
        format => read_model(format, bytes, options, painted, &Sidecars::none()),
    }
}

/// Reads a ZIP archive: a 3MF package, or an archive that holds one model with its sidecar files.
fn read_archive(bytes: &[u8], options: &ReadOptions, painted: bool) -> Result<Content, ReadError> {
    let mut archive = Archive::open(bytes, &options.limits)?;
    if let Some(scene) = threemf::read(&mut archive, options)? {
        return Ok(Content::Scene(scene));
    }
    let (name, format) = sidecar::find_model(&archive)?;
    let model = archive.read_file(name, options.limits.max_bytes)?.unwrap_or_default();
    let sidecars = Sidecars::in_archive(name, &archive, &options.limits);
    let within = |error: ReadError| {
        let detail = format!("in the archive's file {}: {}", archive::name_excerpt(name), error.detail);
        ReadError { detail, ..error }
    };
    let mut content = read_model(format, &model, options, painted, &sidecars).map_err(within)?;
    let (format, dialect, warnings) = content.metadata_mut();
    if *format == Format::Obj {
        *format = Format::Zip;
    }
    dialect.push_str(" in a ZIP archive");
    warnings.extend(sidecars.warnings());
    Ok(content)
}

/// Reads a file of a known format.
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
                let detail = "the ZIP archive holds no 3MF model; unpack the archive and send the model file itself";
                ReadError::for_file(ReadErrorKind::UnsupportedFormat, detail)
            });
        }
    };
    Ok(Content::Mesh(Box::new(mesh)))
}

/// Writes a mesh in a format. The same mesh always gives the same bytes.
///
/// Reading the bytes gives the same mesh: exactly for OBJ, OBJ zip, PLY, OFF and Vertex/Face text; rounded to f32 and without indices for
/// STL.
///
/// # Errors
/// A [`WriteError`] if the format can't store the mesh, for example because a coordinate is not finite.
///
/// # Panics
/// If a face refers to a vertex that does not exist, which violates the invariant of [`Soup`].
pub fn write(soup: &Soup, format: Format) -> Result<Vec<u8>, WriteError> {
    match format {
        Format::Stl => stl::write(soup),
        Format::Obj => Ok(obj::write(soup)),
        Format::Ply => Ok(ply::write(soup)),
        Format::Off => Ok(off::write(soup)),
        Format::Mesh => Ok(vertex_face::write(soup)),
        Format::Zip => sidecar::pack(&ObjZipFiles { obj: obj::write(soup), mtl: None, textures: Vec::new() }),
        Format::Glb | Format::ThreeMf => {
            write_scene(&Scene::of_mesh(PaintedMesh { soup: soup.clone(), paint: Vec::new() }), format)
        }
    }
}

/// Writes a scene in a format. Formats other than 3MF and GLB store it as one mesh. Properties that the format can't store are dropped;
/// [`losses`] lists them.
///
/// # Errors
/// A [`WriteError`] as for [`write`], or `TooLarge` if all instances together have more than `u32::MAX` faces.
///
/// # Panics
/// As [`write`].
pub fn write_scene(scene: &Scene, format: Format) -> Result<Vec<u8>, WriteError> {
    let placed = || scene.placed(u64::from(u32::MAX)).map_err(|_| WriteError::TooLarge);
    match format {
        Format::ThreeMf => threemf::write(scene),
        Format::Glb => gltf::write(scene),
        Format::Zip => sidecar::pack(&obj::write_painted(&placed()?, scene, sidecar::MTL_NAME)),
        Format::Ply => Ok(ply::write_painted(&placed()?, scene)),
        Format::Stl | Format::Obj | Format::Off | Format::Mesh => write(&placed()?.soup, format),
    }
}
