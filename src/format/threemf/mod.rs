//! 3MF: models in parts of XML, in a ZIP archive (3MF core specification 1.3; materials extension 1.2, production extension 1.1).
//!
//! `relationships` says which is the model, `xml` reads its elements and `model` what they mean; `palettes`
//! and `assemble` make a scene of it. What the specification forbids is refused, but for names that are not its own and do no harm.

mod assemble;
mod budget;
mod mesh;
mod model;
mod namespaces;
mod notes;
mod palettes;
mod part;
mod part_name;
mod properties;
mod relationships;
mod stream;
mod values;
mod warnings;
mod write;
mod write_model;
mod write_notes;
mod write_text;
mod xml;

use std::collections::HashSet;

pub(super) use write::write;

use super::archive::{Archive, Packed, key, names_in_head};
use super::errors::{ReadError, ReadErrorKind};
use super::scenes::ReadScene;
use super::{Format, ReadOptions};
use crate::scene::Scene;
use budget::Budget;
use model::ModelReader;
use part::{Part, ShapeResource};
use stream::Stream;
use warnings::Warnings;
use xml::Xml;

/// Names of parts that only packages have, in lowercase.
const PARTS: [&str; 4] = ["[content_types].xml", "_rels/", "3d/", "metadata/"];

/// Whether the head of an archive names what 3MF files begin with.
pub(super) fn is_likely(head: &[u8]) -> bool {
    let begins =
        |name: &[u8], part: &str| name.get(..part.len()).is_some_and(|it| it.eq_ignore_ascii_case(part.as_bytes()));
    let head = &head[..head.len().min(super::sniff::HEAD)];
    names_in_head(head).any(|name| PARTS.iter().any(|part| begins(name.strip_prefix(b"/").unwrap_or(name), part)))
}

/// Reads 3MF; none where the archive is not one.
pub(super) fn read(archive: &mut Archive<'_>, options: &ReadOptions) -> Result<Option<ReadScene>, ReadError> {
    let Some(root) = relationships::root_model(archive)? else { return Ok(None) };
    let mut reader = ModelReader { budget: Budget::new(options.limits), warnings: Warnings::default() };
    let mut known = HashSet::from([key(&root)]);
    let mut names = vec![root];
    let mut parts: Vec<Part> = Vec::new();
    while let Some(name) = names.get(parts.len()) {
        relationships::check_model(name, archive)?;
        let Some(mut xml) = xml(name, archive)? else {
            let detail = format!(
                "the model is in parts, and the part {} is not in the file; export the model again",
                shown_name(name)
            );
            return Err(ReadError::whole(ReadErrorKind::Malformed, detail));
        };
        let part = reader.read(&mut xml)?;
        names.extend(others(&part).filter(|path| known.insert(key(path))).map(str::to_owned));
        parts.push(part);
    }
    let ModelReader { mut warnings, .. } = reader;
    let scene = assemble::scene(parts, archive, &mut warnings)?;
    check(&scene, options)?;
    Ok(Some(ReadScene { scene, format: Format::ThreeMf, dialect: "3MF".to_owned(), warnings: warnings.finish() }))
}

/// The XML of a part; none if there is no such part.
fn xml<'z>(part: &str, archive: &'z mut Archive<'_>) -> Result<Option<Xml<'z>>, ReadError> {
    let Some(Packed { reader, size }) = archive.unpack(part)? else { return Ok(None) };
    Xml::new(part, Stream::new(reader, size)).map(Some)
}

/// The name of a part or an object, as it can be shown in a message.
fn shown_name(name: &str) -> String {
    super::archive::shown(name)
}

/// The parts that a part takes objects from.
fn others(part: &Part) -> impl Iterator<Item = &str> {
    let components = part.objects.iter().filter_map(|object| match &object.shape {
        ShapeResource::Components(components) => Some(components),
        ShapeResource::Mesh { .. } => None,
    });
    components.flatten().chain(&part.items).filter_map(|placed| placed.path.as_deref())
}

/// What is to be built has to have faces, and not too many.
fn check(scene: &Scene, options: &ReadOptions) -> Result<(), ReadError> {
    if scene.items.is_empty() {
        let detail = "the 3MF file says of no object that it is to be built; put the objects on the build plate and export again";
        return Err(ReadError::whole(ReadErrorKind::NoFaces, detail));
    }
    match scene.placed_faces() {
        0 => {
            let detail = "what the 3MF file says is to be built has no triangles; export the model as triangles";
            Err(ReadError::whole(ReadErrorKind::NoFaces, detail))
        }
        faces => options.limits.check_faces(faces),
    }
}
