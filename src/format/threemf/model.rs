//! The element `model`: unit, metadata, resources and build (core specification, 3.4).

use std::collections::HashSet;

use super::part::{
    Group, ModelReader, ObjectReference, ObjectResource, Part, ShapeResource, parse_index, unexpected_value,
};
use super::schema::{self, Namespace, boolean, is_optional_extension, matrix, resolve, subject, words};
use super::xml::{Tag, Xml};
use super::{mesh, properties};
use crate::format::errors::{ReadError, ReadErrorKind, excerpt};
use crate::mesh::Soup;
use crate::scene::{Note, ObjectKind, Unit};

impl ModelReader {
    /// Reads one model part.
    pub fn read(&mut self, xml: &mut Xml<'_>) -> Result<Part, ReadError> {
        self.budget.part(xml)?;
        let mut part = Part { name: xml.part().to_owned(), ..Part::default() };
        xml.root(|xml, root| match root.name() {
            b"model" if root.space.is_core() => self.model(xml, root, &mut part),
            name => {
                let detail = format!(
                    "the root element is <{}>, but must be the <model> of 3MF; export the model again",
                    excerpt(name)
                );
                Err(xml.malformed(detail))
            }
        })?;
        Ok(part)
    }

    fn model(&mut self, xml: &mut Xml<'_>, root: &Tag<'_>, part: &mut Part) -> Result<(), ReadError> {
        part.unit = Some(Unit::Millimetre);
        xml.attributes(root, |attribute| {
            match (attribute.space, attribute.name) {
                (Namespace::None, b"unit") => part.unit = Some(unit(xml, attribute.value)?),
                (Namespace::None, b"requiredextensions") => required(xml, attribute.value)?,
                (Namespace::None, b"recommendedextensions") | (Namespace::Xml, b"lang") => {}
                _ => self.ignore_attribute(xml, &attribute, true)?,
            }
            Ok(())
        })?;
        if root.space == Namespace::Draft {
            self.warnings.add("the file follows a draft of 3MF; its shapes were read, but its colours were ignored");
        }
        let (mut resources, mut builds) = (0, 0);
        let mut ids = HashSet::new();
        xml.children(root, |xml, tag| match tag.name() {
            b"metadata" if tag.space.is_core() => self.note(xml, tag, &mut part.notes),
            b"resources" if tag.space.is_core() => {
                resources += 1;
                self.resources(xml, tag, &mut ids, part)
            }
            b"build" if tag.space.is_core() => {
                builds += 1;
                self.build(xml, tag, part)
            }
            _ => self.ignore_element(xml, tag),
        })?;
        for (name, count) in [("resources", resources), ("build", builds)] {
            if count != 1 {
                let detail = format!(
                    "the model has {count} elements <{name}>, but 3MF requires exactly one; export the model again"
                );
                return Err(xml.malformed(detail));
            }
        }
        Ok(())
    }

    fn resources(
        &mut self,
        xml: &mut Xml<'_>,
        tag: &Tag<'_>,
        ids: &mut HashSet<u32>,
        part: &mut Part,
    ) -> Result<(), ReadError> {
        xml.attributes(tag, |attribute| self.ignore_attribute(xml, &attribute, true))?;
        xml.children(tag, |xml, tag| {
            let known = tag.space.is_core() || tag.space == Namespace::Material;
            let draft = tag.space == Namespace::Draft && tag.name() != b"object";
            if !known || draft {
                return self.ignore_element(xml, tag);
            }
            let id = properties::id(xml, tag)?;
            if !ids.insert(id) {
                return Err(xml.malformed(format_args!("two resources have the id {id}; export the model again")));
            }
            if tag.space.is_core() && tag.name() == b"object" {
                return self.object(xml, tag, id, part);
            }
            self.budget.resource(xml)?;
            let kind = match (tag.space, tag.name()) {
                (Namespace::Core, b"basematerials") => properties::materials(self, xml, tag)?,
                (Namespace::Material, b"colorgroup") => properties::colors(self, xml, tag)?,
                (Namespace::Material, b"texture2dgroup") => properties::texture_coordinates(self, xml, tag)?,
                (Namespace::Material, b"compositematerials") => properties::composites(self, xml, tag)?,
                (Namespace::Material, b"multiproperties") => properties::multiproperties(self, xml, tag)?,
                (Namespace::Material, b"texture2d") => {
                    part.textures.push(properties::texture(self, xml, tag, id)?);
                    return Ok(());
                }
                (Namespace::Material, _) => {
                    self.warnings.add("display properties of materials, such as shininess, were ignored");
                    return Ok(());
                }
                _ => return self.ignore_element(xml, tag),
            };
            part.groups.push(Group { id, kind });
            Ok(())
        })
    }

    fn object(&mut self, xml: &mut Xml<'_>, tag: &Tag<'_>, id: u32, part: &mut Part) -> Result<(), ReadError> {
        self.budget.object(xml)?;
        let (mut name, mut part_number, mut kind) = (None, None, ObjectKind::Model);
        let (mut pid, mut pindex) = (None, None);
        xml.attributes(tag, |attribute| {
            match (attribute.space, attribute.name) {
                (Namespace::None, b"id" | b"thumbnail") => {}
                (Namespace::None, b"name") => name = Some(self.text(xml, attribute.value)?),
                (Namespace::None, b"partnumber") => part_number = Some(self.text(xml, attribute.value)?),
                (Namespace::None, b"type") => kind = object_kind(xml, attribute.value)?,
                (Namespace::None, b"pid") => pid = Some(parse_index(xml, attribute.value)?),
                (Namespace::None, b"pindex") => pindex = Some(parse_index(xml, attribute.value)?),
                _ => self.ignore_attribute(xml, &attribute, true)?,
            }
            Ok(())
        })?;
        let default = match (pid, pindex) {
            (Some(pid), pindex) => Some((pid, pindex.unwrap_or(0))),
            (None, None) => None,
            (None, Some(_)) => {
                return Err(
                    xml.malformed(format_args!("the object {id} has a pindex but no pid; export the model again"))
                );
            }
        };
        let mut notes = Vec::new();
        let mut shape = None;
        xml.children(tag, |xml, tag| {
            let new_shape = match tag.name() {
                b"metadatagroup" if tag.space.is_core() => return self.notes(xml, tag, &mut notes),
                b"mesh" if tag.space.is_core() => mesh::read(self, xml, tag, default, part)?,
                b"components" if tag.space.is_core() => self.components(xml, tag)?,
                _ => return self.ignore_element(xml, tag),
            };
            match shape.replace(new_shape) {
                None => Ok(()),
                Some(_) => Err(xml.malformed(format_args!(
                    "the object {id} has more than one mesh or list of components; export the model again"
                ))),
            }
        })?;
        // The shape may be described by an extension that was ignored.
        let shape = shape.unwrap_or_else(|| ShapeResource::Mesh { soup: Soup::default(), paint: Vec::new() });
        part.objects.push(ObjectResource { id, name, part_number, kind, notes, shape });
        Ok(())
    }

    fn components(&mut self, xml: &mut Xml<'_>, tag: &Tag<'_>) -> Result<ShapeResource, ReadError> {
        xml.attributes(tag, |attribute| self.ignore_attribute(xml, &attribute, false))?;
        let mut components = Vec::new();
        xml.children(tag, |xml, tag| {
            if tag.name() != b"component" || !tag.space.is_core() {
                return self.ignore_element(xml, tag);
            }
            components.push(self.object_reference(xml, tag)?);
            Ok(())
        })?;
        Ok(ShapeResource::Components(components))
    }

    fn build(&mut self, xml: &mut Xml<'_>, tag: &Tag<'_>, part: &mut Part) -> Result<(), ReadError> {
        xml.attributes(tag, |attribute| self.ignore_attribute(xml, &attribute, true))?;
        xml.children(tag, |xml, tag| {
            if tag.name() != b"item" || !tag.space.is_core() {
                return self.ignore_element(xml, tag);
            }
            let mut item = self.object_reference(xml, tag)?;
            xml.children(tag, |xml, tag| match tag.name() {
                b"metadatagroup" if tag.space.is_core() => self.notes(xml, tag, &mut item.notes),
                _ => self.ignore_element(xml, tag),
            })?;
            part.items.push(item);
            Ok(())
        })
    }

    /// Reads a component or a build item.
    fn object_reference(&mut self, xml: &mut Xml<'_>, tag: &Tag<'_>) -> Result<ObjectReference, ReadError> {
        self.budget.placed(xml)?;
        let (mut path, mut id, mut part_number) = (None, None, None);
        let mut transform = glam::DAffine3::IDENTITY;
        xml.attributes(tag, |attribute| {
            match (attribute.space, attribute.name) {
                (Namespace::None, b"objectid") => id = Some(parse_index(xml, attribute.value)?),
                (Namespace::None, b"partnumber") => part_number = Some(self.text(xml, attribute.value)?),
                (Namespace::None, b"transform") => {
                    transform = matrix(attribute.value).ok_or_else(|| not_a_matrix(xml, attribute.value))?;
                    if transform.matrix3.determinant() == 0.0 {
                        let detail =
                            "a transform flattens its object, because its determinant is zero; export the model again";
                        return Err(xml.malformed(detail));
                    }
                }
                (Namespace::Production, b"path") => {
                    let reference = self.text(xml, attribute.value)?;
                    let resolved = resolve("", &reference).filter(|_| reference.starts_with('/'));
                    path = Some(resolved.ok_or_else(|| {
                        xml.malformed(format_args!(
                            "'{}' is not the absolute path of a part; export the model again",
                            excerpt(reference.as_bytes())
                        ))
                    })?);
                }
                _ => self.ignore_attribute(xml, &attribute, true)?,
            }
            Ok(())
        })?;
        let Some(id) = id else {
            return Err(
                xml.malformed(format_args!("a <{}> has no objectid; export the model again", excerpt(tag.name())))
            );
        };
        Ok(ObjectReference { path, id, transform, part_number, notes: Vec::new() })
    }

    fn notes(&mut self, xml: &mut Xml<'_>, tag: &Tag<'_>, notes: &mut Vec<Note>) -> Result<(), ReadError> {
        xml.attributes(tag, |attribute| self.ignore_attribute(xml, &attribute, false))?;
        xml.children(tag, |xml, tag| match tag.name() {
            b"metadata" if tag.space.is_core() => self.note(xml, tag, notes),
            _ => self.ignore_element(xml, tag),
        })
    }

    fn note(&mut self, xml: &mut Xml<'_>, tag: &Tag<'_>, all: &mut Vec<Note>) -> Result<(), ReadError> {
        self.budget.note(xml)?;
        let (mut name, mut kind, mut preserve) = (None, None, false);
        xml.attributes(tag, |attribute| {
            match (attribute.space, attribute.name) {
                (Namespace::None, b"name") => name = Some(self.text(xml, attribute.value)?),
                (Namespace::None, b"type") => kind = Some(self.text(xml, attribute.value)?),
                (Namespace::None, b"preserve") => {
                    preserve =
                        boolean(attribute.value).ok_or_else(|| unexpected_value(xml, "0 or 1", attribute.value))?;
                }
                _ => self.ignore_attribute(xml, &attribute, false)?,
            }
            Ok(())
        })?;
        let Some(mut name) = name.filter(|name| !name.trim().is_empty()) else {
            return Err(xml.malformed("a <metadata> element has no name; export the model again"));
        };
        let mut namespace = match name.split_once(':') {
            Some((prefix, _)) => Some(xml.uri_of_prefix(prefix.as_bytes())?),
            None => None,
        };
        if namespace.as_deref() == Some(schema::OWN_NOTES_URI) {
            namespace = None;
            name = name.split_off(name.find(':').map_or(0, |colon| colon + 1));
        } else if namespace.is_none() && !schema::is_known_note(&name) {
            self.warnings.note(&name);
        }
        if all.iter().any(|note| note.name == name && note.namespace == namespace) {
            let detail =
                format!("two <metadata> elements have the name '{}'; export the model again", excerpt(name.as_bytes()));
            return Err(xml.malformed(detail));
        }
        let value = xml.text(tag)?;
        self.budget.text(value.len(), xml)?;
        all.push(Note { name, namespace, value, kind, preserve });
        Ok(())
    }
}

fn unit(xml: &Xml<'_>, value: &[u8]) -> Result<Unit, ReadError> {
    Ok(match value {
        b"micron" => Unit::Micrometre,
        b"millimeter" => Unit::Millimetre,
        b"centimeter" => Unit::Centimetre,
        b"inch" => Unit::Inch,
        b"foot" => Unit::Foot,
        b"meter" => Unit::Metre,
        _ => return Err(unexpected_value(xml, "a unit (micron, millimeter, centimeter, inch, foot, meter)", value)),
    })
}

fn object_kind(xml: &Xml<'_>, value: &[u8]) -> Result<ObjectKind, ReadError> {
    Ok(match value {
        b"model" => ObjectKind::Model,
        b"solidsupport" => ObjectKind::SolidSupport,
        b"support" => ObjectKind::Support,
        b"surface" => ObjectKind::Surface,
        b"other" => ObjectKind::Other,
        _ => return Err(unexpected_value(xml, "an object type (model, solidsupport, support, surface, other)", value)),
    })
}

/// Rejects a model that requires an extension without which it is incomplete.
fn required(xml: &Xml<'_>, value: &[u8]) -> Result<(), ReadError> {
    for prefix in words(value) {
        let address = xml.uri_of_prefix(prefix)?;
        if !is_optional_extension(&address) {
            let detail = format!(
                "the model requires a 3MF extension that is not supported: {}; export the model as plain triangles",
                subject(&address)
            );
            return Err(xml.error(ReadErrorKind::UnsupportedFormat, detail));
        }
    }
    Ok(())
}

fn not_a_matrix(xml: &Xml<'_>, value: &[u8]) -> ReadError {
    match value.contains(&b',') {
        true => xml.malformed("a transform has decimal commas; export the model with decimal points"),
        false => unexpected_value(xml, "a transform of 12 numbers", value),
    }
}
