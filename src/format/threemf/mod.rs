//! 3MF: models in parts of XML, in a ZIP archive (3MF core specification 1.3; materials extension 1.2, production extension 1.1).
//!
//! `archive` unpacks parts, `relationships` says which is the model, `xml` reads its elements and `model` what they mean; `palettes`
//! and `assemble` make a scene of it. What the specification forbids is refused, but for names that are not its own and do no harm.

mod archive;
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

use super::errors::{ReadError, ReadErrorKind};
use super::scenes::ReadScene;
use super::{Format, ReadOptions};
use crate::scene::Scene;
use archive::Archive;
use budget::Budget;
use model::ModelReader;
use part::{Part, ShapeResource};
use part_name::key;
use warnings::Warnings;

/// Reads 3MF.
pub(super) fn read(bytes: &[u8], options: &ReadOptions) -> Result<ReadScene, ReadError> {
    let mut archive = Archive::open(bytes, &options.limits)?;
    let root = relationships::root_model(&mut archive)?;
    let mut reader = ModelReader { budget: Budget::new(options.limits), warnings: Warnings::default() };
    let mut known = HashSet::from([key(&root)]);
    let mut names = vec![root];
    let mut parts: Vec<Part> = Vec::new();
    while let Some(name) = names.get(parts.len()) {
        relationships::check_model(name, &mut archive)?;
        let Some(mut xml) = archive.xml(name)? else {
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
    let scene = assemble::scene(parts, &mut archive, &mut warnings)?;
    check(&scene, options)?;
    Ok(ReadScene { scene, format: Format::ThreeMf, dialect: "3MF".to_owned(), warnings: warnings.finish() })
}

/// The name of a part or an object, as it can be shown in a message.
fn shown_name(name: &str) -> String {
    super::errors::shown_up_to(100, name.as_bytes())
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
