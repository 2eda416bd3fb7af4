//! The content of a model part before references are resolved, and the state that all parts of a file share: limits and warnings.

use std::collections::HashMap;

use glam::DAffine3;

use super::schema::{Namespace, index, subject};
use super::xml::{Attribute, Tag, Xml};
use crate::format::errors::{ReadError, ReadErrorKind, excerpt};
use crate::format::limits::Limits;
use crate::mesh::Soup;
use crate::scene::{Material, Note, ObjectKind, Paint, Unit, Wrap};

/// A model part. References between its resources are still ids.
#[derive(Default)]
pub(super) struct Part {
    /// Name of the part in the package.
    pub name: String,
    /// Unit of the coordinates.
    pub unit: Option<Unit>,
    /// Metadata of the model.
    pub notes: Vec<Note>,
    /// Texture resources.
    pub textures: Vec<TextureResource>,
    /// Property groups.
    pub groups: Vec<Group>,
    /// Objects.
    pub objects: Vec<ObjectResource>,
    /// Build items.
    pub items: Vec<ObjectReference>,
    /// The property groups that paint refers to.
    pub used_groups: UsedGroups,
}

/// The ids of property groups in the order of first use. Until palettes are built, [`Paint::palette`] is an index into this list.
#[derive(Default)]
pub(super) struct UsedGroups {
    /// Ids of the groups.
    pub groups: Vec<u32>,
    numbers: HashMap<u32, u32>,
}

impl UsedGroups {
    /// The index of a group id, which is added if new.
    pub fn number(&mut self, group: u32) -> u32 {
        let next = u32::try_from(self.groups.len()).unwrap_or(u32::MAX);
        let number = *self.numbers.entry(group).or_insert(next);
        if number == next {
            self.groups.push(group);
        }
        number
    }
}

/// An object of a part.
pub(super) struct ObjectResource {
    /// Resource id.
    pub id: u32,
    /// Name.
    pub name: Option<String>,
    /// Part number.
    pub part_number: Option<String>,
    /// Type.
    pub kind: ObjectKind,
    /// Metadata.
    pub notes: Vec<Note>,
    /// Mesh or components.
    pub shape: ShapeResource,
}

/// The shape of an object: a mesh with paint, or components.
pub(super) enum ShapeResource {
    Mesh { soup: Soup, paint: Vec<Paint> },
    Components(Vec<ObjectReference>),
}

/// A reference to an object with a transform: a component or a build item.
pub(super) struct ObjectReference {
    /// The part that holds the object; `None` for the same part.
    pub path: Option<String>,
    /// Id of the object.
    pub id: u32,
    /// Transform to the coordinates of the parent.
    pub transform: DAffine3,
    /// Part number.
    pub part_number: Option<String>,
    /// Metadata.
    pub notes: Vec<Note>,
}

/// A texture resource.
pub(super) struct TextureResource {
    /// Resource id.
    pub id: u32,
    /// Part that holds the image.
    pub path: String,
    /// Media type of the image.
    pub media_type: &'static str,
    /// Wrap mode along u.
    pub wrap_u: Wrap,
    /// Wrap mode along v.
    pub wrap_v: Wrap,
    /// Whether filtering is nearest-neighbour.
    pub nearest: bool,
}

/// A property group, which gives triangles their colour.
pub(super) struct Group {
    /// Resource id.
    pub id: u32,
    /// Its entries.
    pub kind: GroupKind,
}

/// The entries of a property group.
pub(super) enum GroupKind {
    /// Base materials.
    Materials(Vec<Material>),
    /// Colours.
    Colors(Vec<[u8; 4]>),
    /// Texture coordinates in the texture with this id.
    TextureCoordinates { texture: u32, places: Vec<[f64; 2]> },
    /// Mixtures of the `materials` of the group `of`. Each mixture is a row of `shares`, one for each material.
    Composites { of: u32, materials: Vec<u32>, shares: Vec<f64> },
    /// Layered entries of the groups `of`. Each row of `entries` has one entry for each group.
    Layers { of: Vec<u32>, entries: Vec<u32> },
}

/// Reader of model parts.
pub(super) struct ModelReader {
    /// Limits, shared by all parts.
    pub budget: Budget,
    /// Warnings, shared by all parts.
    pub warnings: Warnings,
}

impl ModelReader {
    /// A reader with these limits.
    pub fn new(limits: Limits) -> Self {
        Self { budget: Budget::new(limits), warnings: Warnings::default() }
    }

    /// Unescapes a value that is kept, and counts its length.
    pub fn text(&mut self, xml: &Xml<'_>, value: &[u8]) -> Result<String, ReadError> {
        self.budget.text(value.len(), xml)?;
        xml.string(value)
    }

    /// Ignores an unknown attribute. `allow_others` tells whether attributes of other namespaces are allowed here (core specification,
    /// 2.3.2).
    pub fn ignore_attribute(
        &mut self,
        xml: &Xml<'_>,
        attribute: &Attribute<'_>,
        allow_others: bool,
    ) -> Result<(), ReadError> {
        match attribute.space {
            // For example the UUIDs of the production extension.
            Namespace::Production | Namespace::Material if allow_others => Ok(()),
            Namespace::Other(_) if allow_others => {
                self.warnings.extension(subject(xml.uri(attribute.space)));
                Ok(())
            }
            Namespace::None | Namespace::Core | Namespace::Draft => {
                self.warnings.name(attribute.name);
                Ok(())
            }
            _ => {
                let detail = format!(
                    "the attribute '{}' has a namespace that 3MF forbids here; export the model again",
                    excerpt(attribute.name)
                );
                Err(xml.malformed(detail))
            }
        }
    }

    /// Ignores an unknown element.
    pub fn ignore_element(&mut self, xml: &Xml<'_>, tag: &Tag<'_>) -> Result<(), ReadError> {
        match tag.space {
            Namespace::Other(_) => self.warnings.extension(subject(xml.uri(tag.space))),
            Namespace::SchemaInstance | Namespace::Xml => {
                let detail = format!(
                    "the element <{}> has a namespace that 3MF forbids; export the model again",
                    excerpt(tag.name())
                );
                return Err(xml.malformed(detail));
            }
            _ => self.warnings.name(tag.name()),
        }
        Ok(())
    }
}

/// The error for a value that is not `expected`.
#[cold]
pub(super) fn unexpected_value(xml: &Xml<'_>, expected: &str, value: &[u8]) -> ReadError {
    xml.malformed(format_args!("found '{}' where {expected} was expected; export the model again", excerpt(value)))
}

/// Parses a resource id or an index.
pub(super) fn parse_index(xml: &Xml<'_>, value: &[u8]) -> Result<u32, ReadError> {
    index(value).ok_or_else(|| unexpected_value(xml, "a whole number", value))
}

/// Maximum number of objects, and of components and build items together.
const MAX_OBJECTS: u64 = 100_000;
/// Maximum number of property groups and textures, and of metadata elements, which are searched linearly.
const MAX_RESOURCES: u64 = 10_000;
/// Maximum total length of names and metadata, in bytes.
const MAX_TEXT_BYTES: u64 = 16 << 20;
/// Maximum number of model parts.
const MAX_PARTS: u64 = 1_000;

/// Limits on all parts of a file together. Each item is counted before it is kept.
pub(super) struct Budget {
    limits: Limits,
    vertices: u64,
    faces: u64,
    objects: u64,
    placed: u64,
    resources: u64,
    notes: u64,
    entries: u64,
    text: u64,
    parts: u64,
}

impl Budget {
    fn new(limits: Limits) -> Self {
        let (vertices, faces, objects, placed, resources, notes) = (0, 0, 0, 0, 0, 0);
        Self { limits, vertices, faces, objects, placed, resources, notes, entries: 0, text: 0, parts: 0 }
    }

    /// Counts a vertex.
    #[inline]
    pub fn vertex(&mut self) -> Result<(), ReadError> {
        self.vertices += 1;
        self.limits.check_vertices(self.vertices)
    }

    /// Counts a triangle.
    #[inline]
    pub fn face(&mut self) -> Result<(), ReadError> {
        self.faces += 1;
        self.limits.check_faces(self.faces)
    }

    /// Counts an object.
    pub fn object(&mut self, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.objects, 1, MAX_OBJECTS, "objects", xml)
    }

    /// Counts a component or a build item.
    pub fn placed(&mut self, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.placed, 1, MAX_OBJECTS, "components and build items", xml)
    }

    /// Counts a metadata element.
    pub fn note(&mut self, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.notes, 1, MAX_RESOURCES, "metadata elements", xml)
    }

    /// Counts a property group or a texture.
    pub fn resource(&mut self, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.resources, 1, MAX_RESOURCES, "property groups and textures", xml)
    }

    /// Counts entries of property groups, which may be as many as vertices.
    pub fn entries(&mut self, number: usize, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.entries, number as u64, self.limits.max_vertices, "colours and texture coordinates", xml)
    }

    /// Counts the bytes of a name or of metadata.
    pub fn text(&mut self, bytes: usize, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.text, bytes as u64, MAX_TEXT_BYTES, "bytes of names and metadata", xml)
    }

    /// Counts a model part.
    pub fn part(&mut self, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.parts, 1, MAX_PARTS, "model parts", xml)
    }
}

/// Adds to a count, and checks it against its limit.
#[inline]
fn count(sum: &mut u64, more: u64, most: u64, items: &str, xml: &Xml<'_>) -> Result<(), ReadError> {
    *sum = sum.saturating_add(more);
    if *sum <= most {
        return Ok(());
    }
    let detail = format!("the file has more than {most} {items}; simplify the model before you send it");
    Err(xml.error(ReadErrorKind::TooLarge, detail))
}

/// Warnings about ignored content, each reported once.
#[derive(Default)]
pub(super) struct Warnings {
    /// Subjects of unsupported extensions.
    extensions: Vec<String>,
    /// Number of unknown attributes and elements, and the first name.
    names: (u64, Option<String>),
    /// Number of metadata elements with unknown names, and the first name.
    notes: (u64, Option<String>),
    other: Vec<String>,
}

impl Warnings {
    /// Records ignored content of an extension.
    pub fn extension(&mut self, subject: String) {
        if !self.extensions.contains(&subject) {
            self.extensions.push(subject);
        }
    }

    /// Records an ignored attribute or element.
    pub fn name(&mut self, name: &[u8]) {
        self.names.0 += 1;
        self.names.1.get_or_insert_with(|| excerpt(name));
    }

    /// Records metadata with an unknown name.
    pub fn note(&mut self, name: &str) {
        self.notes.0 += 1;
        self.notes.1.get_or_insert_with(|| excerpt(name.as_bytes()));
    }

    /// Records another warning, unless it was recorded before.
    pub fn add(&mut self, warning: &str) {
        if !self.other.iter().any(|known| known == warning) {
            self.other.push(warning.to_owned());
        }
    }

    /// All warnings.
    pub fn finish(self) -> Vec<String> {
        let mut warnings = self.other;
        if !self.extensions.is_empty() {
            let (some, more) = self.extensions.split_at(self.extensions.len().min(5));
            let more = if more.is_empty() { String::new() } else { format!(" and {} more", more.len()) };
            warnings.push(format!("the content of unsupported 3MF extensions was ignored: {}{more}", some.join(", ")));
        }
        if let (count, Some(first)) = self.names {
            warnings.push(format!(
                "attributes or elements that do not belong to 3MF were ignored: {count}, the first '{first}'"
            ));
        }
        if let (count, Some(first)) = self.notes {
            warnings.push(format!(
                "metadata with names that 3MF does not define and no namespace was kept: {count}, the first '{first}'"
            ));
        }
        warnings
    }
}
