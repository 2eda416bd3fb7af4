use std::io::{Cursor, Write};

use zip::ZipWriter;
use zip::result::ZipResult;

use super::super::archive::{compressed, stored};
use super::super::errors::WriteError;
use super::super::obj::{self, Files};
use crate::scene::Scene;

const MODEL: &str = "model.obj";
const MATERIALS: &str = "model.mtl";

/// Writes a scene as OBJ with its materials and pictures: all objects in their places as one mesh. The same scene gives the same bytes.
pub(in crate::format) fn write(scene: &Scene) -> Result<Vec<u8>, WriteError> {
    let mesh = scene.placed(u64::from(u32::MAX)).map_err(|_| WriteError::TooLarge)?;
    pack(&obj::write_painted(&mesh, scene, MATERIALS))
}

/// Packs a model with its side files.
pub(in crate::format) fn pack(files: &Files) -> Result<Vec<u8>, WriteError> {
    // To memory nothing can fail but a size.
    packed(files).map_err(|_| WriteError::TooLarge)
}

fn packed(files: &Files) -> ZipResult<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let texts = [(MODEL, Some(&files.obj)), (MATERIALS, files.mtl.as_ref())];
    for (name, text) in texts {
        if let Some(text) = text {
            zip.start_file(name, compressed(text.len() as u64 > u64::from(u32::MAX) / 2))?;
            zip.write_all(text)?;
        }
    }
    for (name, bytes) in &files.pictures {
        zip.start_file(name.as_str(), stored())?;
        zip.write_all(bytes)?;
    }
    Ok(zip.finish()?.into_inner())
}
