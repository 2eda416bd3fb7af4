//! 3MF: XML parts in a ZIP package (3MF core specification 1.3, materials extension 1.2, production extension 1.1).
//!
//! Relationships between parts (core specification, 2.1) name the root model. `xml` reads elements, `model` interprets them, and `assemble`
//! builds the scene. Content that the specification forbids is rejected, except unknown names that do no harm.

mod assemble;
mod mesh;
mod model;
mod part;
mod properties;
mod schema;
mod write;
mod xml;

use std::collections::HashSet;

pub(super) use write::write;

use super::archive::{Archive, name_excerpt, name_key};
use super::content::ReadScene;
use super::errors::{ReadError, ReadErrorKind};
use super::formats::Format;
use super::limits::ReadOptions;
use crate::scene::Scene;
use part::{ModelReader, Part, ShapeResource};
use schema::{MODEL_RELATIONSHIP, TEXTURE_RELATIONSHIP, resolve};
use xml::Xml;

/// Reads 3MF; `None` if the archive is not a 3MF package.
pub(super) fn read(archive: &mut Archive<'_>, options: &ReadOptions) -> Result<Option<ReadScene>, ReadError> {
    let Some(root) = root_model(archive)? else { return Ok(None) };
    let mut reader = ModelReader::new(options.limits);
    let mut known = HashSet::from([name_key(&root)]);
    let mut names = vec![root];
    let mut parts: Vec<Part> = Vec::new();
    while let Some(name) = names.get(parts.len()) {
        check_model_part(name, archive)?;
        let Some(mut xml) = xml(name, archive)? else {
            let detail = format!(
                "the model refers to the part {}, which is not in the file; export the model again",
                name_excerpt(name)
            );
            return Err(ReadError::for_file(ReadErrorKind::Malformed, detail));
        };
        let part = reader.read(&mut xml)?;
        names.extend(referenced_parts(&part).filter(|path| known.insert(name_key(path))).map(str::to_owned));
        parts.push(part);
    }
    let ModelReader { mut warnings, .. } = reader;
    let scene = assemble::scene(parts, archive, &mut warnings)?;
    check_build(&scene, options)?;
    Ok(Some(ReadScene { scene, format: Format::ThreeMf, dialect: "3MF".to_owned(), warnings: warnings.finish() }))
}

/// Opens a part as XML; `None` if there is no such part.
fn xml<'z>(part: &str, archive: &'z mut Archive<'_>) -> Result<Option<Xml<'z>>, ReadError> {
    archive.unpack(part)?.map(|stream| Xml::new(part, stream)).transpose()
}

/// The paths of other parts whose objects a part refers to.
fn referenced_parts(part: &Part) -> impl Iterator<Item = &str> {
    let components = part.objects.iter().filter_map(|object| match &object.shape {
        ShapeResource::Components(components) => Some(components),
        ShapeResource::Mesh { .. } => None,
    });
    components.flatten().chain(&part.items).filter_map(|placed| placed.path.as_deref())
}

/// Checks that the build has faces, and not more than the limits allow.
fn check_build(scene: &Scene, options: &ReadOptions) -> Result<(), ReadError> {
    if scene.items.is_empty() {
        let detail = "the 3MF file has no build items; put the objects on the build plate and export the model again";
        return Err(ReadError::for_file(ReadErrorKind::NoFaces, detail));
    }
    match scene.placed_faces() {
        0 => {
            let detail = "the build items of the 3MF file have no triangles; export the model as triangles";
            Err(ReadError::for_file(ReadErrorKind::NoFaces, detail))
        }
        faces => options.limits.check_faces(faces),
    }
}

const NAMESPACE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
const PRINT_TICKET: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/printticket";
const THUMBNAIL: &str = "http://schemas.openxmlformats.org/package/2006/relationships/metadata/thumbnail";
const ENCRYPTED: &str = "http://schemas.openxmlformats.org/package/2006/relationships/encryptedfile";

/// Maximum number of relationships of a part.
const MOST_RELATIONSHIPS: usize = 10_000;
/// Maximum length in bytes of a relationship's target or type.
const LONGEST_RELATIONSHIP: usize = 4096;

/// A relationship of a part or of the package.
struct Relationship {
    kind: String,
    target: String,
}

/// The name of the root model part; `None` if the archive is not a 3MF package.
fn root_model(archive: &mut Archive<'_>) -> Result<Option<String>, ReadError> {
    let mut models =
        relationships("", archive)?.into_iter().filter(|relationship| relationship.kind == MODEL_RELATIONSHIP);
    match (models.next(), models.next()) {
        (Some(model), None) => Ok(Some(model.target)),
        (Some(_), Some(_)) => {
            Err(malformed("the package has more than one root model, which 3MF forbids; export the model again"))
        }
        (None, _) if archive.contains("3D/3dmodel.model") || archive.contains("[Content_Types].xml") => {
            Err(malformed("the package's relationships (_rels/.rels) name no 3MF model; export the model again"))
        }
        (None, _) => Ok(None),
    }
}

/// Checks the relationships of a model part.
fn check_model_part(part: &str, archive: &mut Archive<'_>) -> Result<(), ReadError> {
    let tickets = relationships(part, archive)?.iter().filter(|relationship| relationship.kind == PRINT_TICKET).count();
    match tickets {
        0 | 1 => Ok(()),
        _ => Err(malformed(format!(
            "the part {} has more than one print ticket, which 3MF forbids; export the model again",
            name_excerpt(part)
        ))),
    }
}

/// The relationships of a part, or of the package if `part` is empty. Rejects those to missing or encrypted parts.
fn relationships(part: &str, archive: &mut Archive<'_>) -> Result<Vec<Relationship>, ReadError> {
    let relationships = match xml(&relationships_of(part), archive)? {
        Some(mut xml) => read_relationships(part, &mut xml)?,
        None => Vec::new(),
    };
    for relationship in &relationships {
        if relationship.kind == ENCRYPTED {
            let detail = format!(
                "the part {} is encrypted; export the model without encryption",
                name_excerpt(&relationship.target)
            );
            return Err(ReadError::for_file(ReadErrorKind::UnsupportedFormat, detail));
        }
        let of_3mf =
            [MODEL_RELATIONSHIP, TEXTURE_RELATIONSHIP, PRINT_TICKET, THUMBNAIL].contains(&relationship.kind.as_str());
        if of_3mf && !archive.contains(&relationship.target) {
            let detail = format!(
                "a relationship refers to the part {}, which is not in the file; export the model again",
                name_excerpt(&relationship.target)
            );
            return Err(malformed(detail));
        }
    }
    Ok(relationships)
}

/// Parses a relationships part of the part `source`.
fn read_relationships(source: &str, xml: &mut Xml<'_>) -> Result<Vec<Relationship>, ReadError> {
    let mut relationships = Vec::new();
    xml.root(|xml, root| {
        xml.children(root, |xml, tag| {
            if tag.name() != b"Relationship" || xml.uri(tag.space) != NAMESPACE {
                return Ok(());
            }
            let (mut kind, mut target, mut external) = (None, None, false);
            xml.attributes(tag, |attribute| {
                match attribute.name {
                    b"Type" => kind = Some(xml.string(attribute.value)?),
                    b"Target" => target = Some(xml.string(attribute.value)?),
                    b"TargetMode" => external = attribute.value == b"External",
                    _ => {}
                }
                Ok(())
            })?;
            let (Some(kind), Some(target)) = (kind, target) else {
                return Err(xml.malformed("a relationship has no type or no target; export the model again"));
            };
            if kind.len().max(target.len()) > LONGEST_RELATIONSHIP {
                let detail = format!(
                    "a relationship has a type or target of more than {LONGEST_RELATIONSHIP} bytes; export the model again"
                );
                return Err(xml.error(ReadErrorKind::TooLarge, detail));
            }
            let inside = if external { None } else { resolve(source, &target) };
            let Some(inside) = inside else {
                let detail = format!(
                    "a relationship refers to '{}', outside the file, which 3MF forbids; export the model again",
                    name_excerpt(&target)
                );
                return Err(xml.malformed(detail));
            };
            if relationships.len() >= MOST_RELATIONSHIPS {
                let detail = format!("a part has more than {MOST_RELATIONSHIPS} relationships; export the model again");
                return Err(xml.error(ReadErrorKind::TooLarge, detail));
            }
            relationships.push(Relationship { kind, target: inside });
            Ok(())
        })
    })?;
    Ok(relationships)
}

fn malformed(detail: impl Into<String>) -> ReadError {
    ReadError::for_file(ReadErrorKind::Malformed, detail)
}

/// The name of the part with a part's relationships, or with the package's if `part` is empty.
fn relationships_of(part: &str) -> String {
    let (folder, name) = part.rsplit_once('/').unwrap_or(("", part));
    let slash = if folder.is_empty() { "" } else { "/" };
    format!("{folder}{slash}_rels/{name}.rels")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relationships_are_in_a_folder_next_to_their_part() {
        assert_eq!(relationships_of(""), "_rels/.rels");
        assert_eq!(relationships_of("3D/a.model"), "3D/_rels/a.model.rels");
    }
}
