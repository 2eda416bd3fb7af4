//! 3MF: models in parts of XML, in a ZIP archive (3MF core specification 1.3; materials extension 1.2, production extension 1.1).
//!
//! Relationships between parts (core specification, 2.1) say which is the model, `xml` reads its elements and `model` what they mean, and
//! `assemble` makes a scene of it. What the specification forbids is refused, but for names that are not its own and do no harm.

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

use super::archive::{Archive, key, shown};
use super::content::ReadScene;
use super::errors::{ReadError, ReadErrorKind};
use super::formats::Format;
use super::limits::ReadOptions;
use crate::scene::Scene;
use part::{ModelReader, Part, ShapeResource};
use schema::{MODEL_RELATIONSHIP, TEXTURE_RELATIONSHIP, resolve};
use xml::Xml;

/// Reads 3MF; none where the archive is not one.
pub(super) fn read(archive: &mut Archive<'_>, options: &ReadOptions) -> Result<Option<ReadScene>, ReadError> {
    let Some(root) = root_model(archive)? else { return Ok(None) };
    let mut reader = ModelReader::new(options.limits);
    let mut known = HashSet::from([key(&root)]);
    let mut names = vec![root];
    let mut parts: Vec<Part> = Vec::new();
    while let Some(name) = names.get(parts.len()) {
        check_model_part(name, archive)?;
        let Some(mut xml) = xml(name, archive)? else {
            let detail = format!(
                "the model is in parts, and the part {} is not in the file; export the model again",
                shown(name)
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
    archive.unpack(part)?.map(|stream| Xml::new(part, stream)).transpose()
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

const NAMESPACE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
const PRINT_TICKET: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/printticket";
const THUMBNAIL: &str = "http://schemas.openxmlformats.org/package/2006/relationships/metadata/thumbnail";
const ENCRYPTED: &str = "http://schemas.openxmlformats.org/package/2006/relationships/encryptedfile";

/// Most relationships of a part.
const MOST_RELATIONSHIPS: usize = 10_000;
/// The longest target or type of one, in bytes.
const LONGEST_RELATIONSHIP: usize = 4096;

struct Relationship {
    kind: String,
    target: String,
}

/// The part that is the model; none where the archive is no package.
fn root_model(archive: &mut Archive<'_>) -> Result<Option<String>, ReadError> {
    let mut models = relationships("", archive)?.into_iter().filter(|it| it.kind == MODEL_RELATIONSHIP);
    match (models.next(), models.next()) {
        (Some(model), None) => Ok(Some(model.target)),
        (Some(_), Some(_)) => {
            Err(malformed("the package has more than one model part, which 3MF forbids; export the model again"))
        }
        (None, _) if archive.has("3D/3dmodel.model") || archive.has("[Content_Types].xml") => Err(malformed(
            "no relationship of the package (_rels/.rels) says which part is the 3MF model; export the model again",
        )),
        (None, _) => Ok(None),
    }
}

/// Checks what a model part refers to.
fn check_model_part(part: &str, archive: &mut Archive<'_>) -> Result<(), ReadError> {
    let tickets = relationships(part, archive)?.iter().filter(|it| it.kind == PRINT_TICKET).count();
    match tickets {
        0 | 1 => Ok(()),
        _ => Err(malformed(format!(
            "the part {} has more than one print ticket, which 3MF forbids; export the model again",
            shown(part)
        ))),
    }
}

/// The relationships of a part, or, with an empty name, of the package: all to parts that are there.
fn relationships(part: &str, archive: &mut Archive<'_>) -> Result<Vec<Relationship>, ReadError> {
    let relationships = match xml(&relationships_of(part), archive)? {
        Some(mut xml) => read_relationships(part, &mut xml)?,
        None => Vec::new(),
    };
    for it in &relationships {
        if it.kind == ENCRYPTED {
            let detail = format!("the part {} is encrypted; export the model without encryption", shown(&it.target));
            return Err(ReadError::whole(ReadErrorKind::UnsupportedFormat, detail));
        }
        let of_3mf = [MODEL_RELATIONSHIP, TEXTURE_RELATIONSHIP, PRINT_TICKET, THUMBNAIL].contains(&it.kind.as_str());
        if of_3mf && !archive.has(&it.target) {
            let detail = format!(
                "a relationship is to the part {}, which is not in the file; export the model again",
                shown(&it.target)
            );
            return Err(malformed(detail));
        }
    }
    Ok(relationships)
}

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
                    "a relationship has a name of more than {LONGEST_RELATIONSHIP} bytes; export the model again"
                );
                return Err(xml.error(ReadErrorKind::TooLarge, detail));
            }
            let inside = if external { None } else { resolve(source, &target) };
            let Some(inside) = inside else {
                let detail = format!(
                    "a relationship is to '{}', outside of the file, which 3MF forbids; export the model again",
                    shown(&target)
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
    ReadError::whole(ReadErrorKind::Malformed, detail)
}

/// The part that holds the relationships of a part, or, with an empty name, of the package.
fn relationships_of(part: &str) -> String {
    let (folder, name) = part.rsplit_once('/').unwrap_or(("", part));
    let slash = if folder.is_empty() { "" } else { "/" };
    format!("{folder}{slash}_rels/{name}.rels")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relationships_stand_beside_their_part() {
        assert_eq!(relationships_of(""), "_rels/.rels");
        assert_eq!(relationships_of("3D/a.model"), "3D/_rels/a.model.rels");
    }
}
