//! Relationships between parts, and what 3MF asks of them (core specification, 2.1).

use super::part_name::{relationships_of, resolve};
use super::xml::Xml;
use super::{shown_name, xml};
use crate::format::archive::Archive;
use crate::format::errors::{ReadError, ReadErrorKind};

const NAMESPACE: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
/// Of the part that is the model, or of a part that it takes objects from.
pub(super) const MODEL: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel";
/// Of a picture that a model is painted with.
pub(super) const TEXTURE: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dtexture";
const PRINT_TICKET: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/printticket";
const THUMBNAIL: &str = "http://schemas.openxmlformats.org/package/2006/relationships/metadata/thumbnail";
const ENCRYPTED: &str = "http://schemas.openxmlformats.org/package/2006/relationships/encryptedfile";

/// Most relationships of a part.
const MOST: usize = 10_000;
/// The longest target or type of one, in bytes.
const LONGEST: usize = 4096;

struct Relationship {
    kind: String,
    target: String,
}

/// The part that is the model; none where the archive is no package.
pub(super) fn root_model(archive: &mut Archive<'_>) -> Result<Option<String>, ReadError> {
    let mut models = check("", archive)?.into_iter().filter(|it| it.kind == MODEL);
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
pub(super) fn check_model(part: &str, archive: &mut Archive<'_>) -> Result<(), ReadError> {
    let tickets = check(part, archive)?.iter().filter(|it| it.kind == PRINT_TICKET).count();
    match tickets {
        0 | 1 => Ok(()),
        _ => Err(malformed(format!(
            "the part {} has more than one print ticket, which 3MF forbids; export the model again",
            shown_name(part)
        ))),
    }
}

/// The relationships of a part, or, with an empty name, of the package: all to parts that are there.
fn check(part: &str, archive: &mut Archive<'_>) -> Result<Vec<Relationship>, ReadError> {
    let relationships = match xml(&relationships_of(part), archive)? {
        Some(mut xml) => read(part, &mut xml)?,
        None => Vec::new(),
    };
    for it in &relationships {
        if it.kind == ENCRYPTED {
            let detail =
                format!("the part {} is encrypted; export the model without encryption", shown_name(&it.target));
            return Err(ReadError::whole(ReadErrorKind::UnsupportedFormat, detail));
        }
        let of_3mf = [MODEL, TEXTURE, PRINT_TICKET, THUMBNAIL].contains(&it.kind.as_str());
        if of_3mf && !archive.has(&it.target) {
            let detail = format!(
                "a relationship is to the part {}, which is not in the file; export the model again",
                shown_name(&it.target)
            );
            return Err(malformed(detail));
        }
    }
    Ok(relationships)
}

fn read(source: &str, xml: &mut Xml<'_>) -> Result<Vec<Relationship>, ReadError> {
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
            if kind.len().max(target.len()) > LONGEST {
                let detail = format!("a relationship has a name of more than {LONGEST} bytes; export the model again");
                return Err(xml.error(ReadErrorKind::TooLarge, detail));
            }
            let inside = if external { None } else { resolve(source, &target) };
            let Some(inside) = inside else {
                let detail = format!(
                    "a relationship is to '{}', outside of the file, which 3MF forbids; export the model again",
                    shown_name(&target)
                );
                return Err(xml.malformed(detail));
            };
            if relationships.len() >= MOST {
                let detail = format!("a part has more than {MOST} relationships; export the model again");
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
