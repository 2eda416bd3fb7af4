//! The package: parts, what they are, and how they belong together. The same scene gives the same bytes.

use std::io::{Cursor, Write};

use zip::ZipWriter;
use zip::result::ZipResult;

use super::relationships::{MODEL, TEXTURE};
use super::write_model::ModelWriter;
use super::write_text::attribute;
use crate::format::WriteError;
use crate::format::archive::{compressed, stored};
use crate::scene::{Scene, Texture};

const ROOT: &str = "3D/3dmodel.model";

/// Writes 3MF. What it has no words for is left out: a palette's tint and name, textures that are neither PNG nor JPEG.
pub(in crate::format) fn write(scene: &Scene) -> Result<Vec<u8>, WriteError> {
    match package(scene) {
        Ok((true, archive)) => Ok(archive),
        Ok((false, _)) => Err(WriteError::NotFinite),
        // To memory nothing else can fail.
        Err(_) => Err(WriteError::TooLarge),
    }
}

/// The archive, and whether all numbers in it are finite.
fn package(scene: &Scene) -> ZipResult<(bool, Vec<u8>)> {
    let pictures = Pictures::of(&scene.textures);
    let packed = compressed(false);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file("[Content_Types].xml", packed)?;
    zip.write_all(content_types(&pictures).as_bytes())?;
    zip.start_file("_rels/.rels", packed)?;
    zip.write_all(relationships([(MODEL, ROOT)].into_iter()).as_bytes())?;
    zip.start_file(ROOT, compressed(is_long(scene)))?;
    let finite = ModelWriter::new(scene, &pictures.of_textures).write(&mut zip)?;
    if !pictures.files.is_empty() {
        zip.start_file("3D/_rels/3dmodel.model.rels", packed)?;
        let targets = pictures.files.iter().map(|(path, _)| (TEXTURE, path.as_str()));
        zip.write_all(relationships(targets).as_bytes())?;
    }
    for (path, texture) in &pictures.files {
        zip.start_file(path.as_str(), stored())?;
        zip.write_all(&texture.bytes)?;
    }
    Ok((finite, zip.finish()?.into_inner()))
}

/// Whether the model's text may be too long for the sizes of a ZIP entry, which have 32 bits unless they are given 64.
fn is_long(scene: &Scene) -> bool {
    let lengths = scene
        .objects
        .iter()
        .filter_map(|object| object.mesh())
        .map(|mesh| 100 * (mesh.soup.positions.len() as u64 + mesh.soup.faces.len() as u64));
    lengths.sum::<u64>() > u64::from(u32::MAX) / 2
}

/// The parts of pictures.
struct Pictures<'s> {
    files: Vec<(String, &'s Texture)>,
    /// For each texture its part; none where 3MF does not take it.
    of_textures: Vec<Option<String>>,
}

impl<'s> Pictures<'s> {
    fn of(textures: &'s [Texture]) -> Self {
        let mut pictures = Self { files: Vec::new(), of_textures: Vec::new() };
        for texture in textures {
            let ending = match texture.media_type.as_str() {
                "image/png" => "png",
                "image/jpeg" => "jpg",
                _ => {
                    pictures.of_textures.push(None);
                    continue;
                }
            };
            let same = |other: &&(String, &Texture)| {
                other.1.bytes == texture.bytes && other.1.media_type == texture.media_type
            };
            let path = match pictures.files.iter().find(same) {
                Some((path, _)) => path.clone(),
                None => {
                    let path = format!("3D/Textures/texture{}.{ending}", pictures.files.len() + 1);
                    pictures.files.push((path.clone(), texture));
                    path
                }
            };
            pictures.of_textures.push(Some(path));
        }
        pictures
    }
}

const DECLARATION: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n";

fn content_types(pictures: &Pictures<'_>) -> String {
    let mut text =
        format!("{DECLARATION}<Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\">\n");
    let of_pictures = [("png", "image/png"), ("jpg", "image/jpeg")]
        .into_iter()
        .filter(|(_, media_type)| pictures.files.iter().any(|(_, texture)| texture.media_type == *media_type));
    let types = [
        ("rels", "application/vnd.openxmlformats-package.relationships+xml"),
        ("model", "application/vnd.ms-package.3dmanufacturing-3dmodel+xml"),
    ];
    for (extension, media_type) in types.into_iter().chain(of_pictures) {
        text += &format!("<Default Extension=\"{extension}\" ContentType=\"{media_type}\"/>\n");
    }
    text + "</Types>\n"
}

fn relationships<'t>(all: impl Iterator<Item = (&'t str, &'t str)>) -> String {
    let mut text = format!(
        "{DECLARATION}<Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">\n"
    );
    for (number, (kind, target)) in all.enumerate() {
        text += &format!("<Relationship Id=\"rel{number}\" Type=\"{kind}\" Target=\"/{}\"/>\n", attribute(target));
    }
    text + "</Relationships>\n"
}
