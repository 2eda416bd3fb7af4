//! What a model part says, with its own numbers for resources; and what all parts share while they are read: what may be kept, and what was
//! read past.

use std::collections::HashMap;

use glam::DAffine3;

use super::schema::{Space, index, subject};
use super::xml::{Attribute, Tag, Xml};
use crate::format::errors::{ReadError, ReadErrorKind, shown};
use crate::format::limits::Limits;
use crate::mesh::Soup;
use crate::scene::{Material, Note, ObjectKind, Paint, Unit, Wrap};

/// A model part.
#[derive(Default)]
pub(super) struct Part {
    pub name: String,
    pub unit: Option<Unit>,
    pub notes: Vec<Note>,
    pub textures: Vec<TextureResource>,
    pub groups: Vec<Group>,
    pub objects: Vec<ObjectResource>,
    pub items: Vec<Placed>,
    pub painted_by: PaintedBy,
}

/// The groups that objects name, numbered as they come: until palettes are made, these numbers are [`Paint::palette`].
#[derive(Default)]
pub(super) struct PaintedBy {
    pub groups: Vec<u32>,
    numbers: HashMap<u32, u32>,
}

impl PaintedBy {
    /// The number of a group.
    pub fn number(&mut self, group: u32) -> u32 {
        let next = u32::try_from(self.groups.len()).unwrap_or(u32::MAX);
        let number = *self.numbers.entry(group).or_insert(next);
        if number == next {
            self.groups.push(group);
        }
        number
    }
}

pub(super) struct ObjectResource {
    pub id: u32,
    pub name: Option<String>,
    pub part_number: Option<String>,
    pub kind: ObjectKind,
    pub notes: Vec<Note>,
    pub shape: ShapeResource,
}

pub(super) enum ShapeResource {
    Mesh { soup: Soup, paint: Vec<Paint> },
    Components(Vec<Placed>),
}

/// An object in a place: a component or a build item.
pub(super) struct Placed {
    /// The part that has the object, where it is another one.
    pub path: Option<String>,
    pub id: u32,
    pub transform: DAffine3,
    pub part_number: Option<String>,
    pub notes: Vec<Note>,
}

pub(super) struct TextureResource {
    pub id: u32,
    pub path: String,
    pub media_type: &'static str,
    pub wrap_u: Wrap,
    pub wrap_v: Wrap,
    pub nearest: bool,
}

/// What triangles are painted with.
pub(super) struct Group {
    pub id: u32,
    pub kind: GroupKind,
}

pub(super) enum GroupKind {
    Materials(Vec<Material>),
    Colors(Vec<[u8; 4]>),
    Places {
        texture: u32,
        places: Vec<[f64; 2]>,
    },
    /// Mixtures of materials of one group; a row of `shares` a mixture, as long as `materials`.
    Composites {
        of: u32,
        materials: Vec<u32>,
        shares: Vec<f64>,
    },
    /// Entries of several groups on one another; a row of `entries` each, as long as `of`.
    Layers {
        of: Vec<u32>,
        entries: Vec<u32>,
    },
}

/// Reads model parts.
pub(super) struct ModelReader {
    pub budget: Budget,
    pub warnings: Warnings,
}

impl ModelReader {
    pub fn new(limits: Limits) -> Self {
        Self { budget: Budget::new(limits), warnings: Warnings::default() }
    }

    /// A value that is kept.
    pub fn text(&mut self, xml: &Xml<'_>, value: &[u8]) -> Result<String, ReadError> {
        self.budget.text(value.len(), xml)?;
        xml.string(value)
    }

    /// Passes an attribute over that is not read here. The schema does not let other namespaces everywhere (core specification, 2.3.2).
    pub fn passed(&mut self, xml: &Xml<'_>, attribute: &Attribute<'_>, others: bool) -> Result<(), ReadError> {
        match attribute.space {
            // Identifiers of the production extension among them.
            Space::Production | Space::Material if others => Ok(()),
            Space::Other(_) if others => {
                self.warnings.extension(subject(xml.uri(attribute.space)));
                Ok(())
            }
            Space::None | Space::Core | Space::Draft => {
                self.warnings.name(attribute.name);
                Ok(())
            }
            _ => {
                let detail = format!(
                    "the attribute '{}' is of a namespace that is forbidden here; export the model again",
                    shown(attribute.name)
                );
                Err(xml.malformed(detail))
            }
        }
    }

    /// Passes an element over that is not read here.
    pub fn unknown(&mut self, xml: &Xml<'_>, tag: &Tag<'_>) -> Result<(), ReadError> {
        match tag.space {
            Space::Other(_) => self.warnings.extension(subject(xml.uri(tag.space))),
            Space::SchemaInstance | Space::Xml => {
                let detail = format!(
                    "the element <{}> is of a namespace that is forbidden in 3MF; export the model again",
                    shown(tag.name())
                );
                return Err(xml.malformed(detail));
            }
            _ => self.warnings.name(tag.name()),
        }
        Ok(())
    }
}

/// A value that is none of what was expected.
#[cold]
pub(super) fn not_a(xml: &Xml<'_>, expected: &str, value: &[u8]) -> ReadError {
    xml.malformed(format_args!("found '{}' where {expected} was expected; export the model again", shown(value)))
}

/// The index in a value.
pub(super) fn index_in(xml: &Xml<'_>, value: &[u8]) -> Result<u32, ReadError> {
    index(value).ok_or_else(|| not_a(xml, "a whole number", value))
}

/// Most objects, and most components and build items.
const OBJECTS: u64 = 100_000;
/// Most groups of colours and pictures, and most notes: those that are looked up one by one.
const RESOURCES: u64 = 10_000;
/// Most names and notes, in bytes.
const TEXT: u64 = 16 << 20;
/// Most model parts.
const PARTS: u64 = 1_000;

/// What all parts of a file may have together, counted before it is kept.
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

    #[inline]
    pub fn vertex(&mut self) -> Result<(), ReadError> {
        self.vertices += 1;
        self.limits.check_vertices(self.vertices)
    }

    #[inline]
    pub fn face(&mut self) -> Result<(), ReadError> {
        self.faces += 1;
        self.limits.check_faces(self.faces)
    }

    pub fn object(&mut self, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.objects, 1, OBJECTS, "objects", xml)
    }

    /// A component or a build item.
    pub fn placed(&mut self, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.placed, 1, OBJECTS, "components and build items", xml)
    }

    pub fn note(&mut self, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.notes, 1, RESOURCES, "notes", xml)
    }

    /// A group of colours, or a picture.
    pub fn resource(&mut self, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.resources, 1, RESOURCES, "resources of colours", xml)
    }

    /// Colours, places in textures, materials, and what mixes them: as many as there may be vertices.
    pub fn entries(&mut self, number: usize, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.entries, number as u64, self.limits.max_vertices, "colours and places in textures", xml)
    }

    pub fn text(&mut self, bytes: usize, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.text, bytes as u64, TEXT, "bytes of names and notes", xml)
    }

    pub fn part(&mut self, xml: &Xml<'_>) -> Result<(), ReadError> {
        count(&mut self.parts, 1, PARTS, "model parts", xml)
    }
}

#[inline]
fn count(sum: &mut u64, more: u64, most: u64, what: &str, xml: &Xml<'_>) -> Result<(), ReadError> {
    *sum = sum.saturating_add(more);
    if *sum <= most {
        return Ok(());
    }
    let detail = format!("the file has more than {most} {what}; simplify the model before you send it");
    Err(xml.error(ReadErrorKind::TooLarge, detail))
}

/// What was read past, told once each.
#[derive(Default)]
pub(super) struct Warnings {
    /// What extensions that are not read are about.
    extensions: Vec<String>,
    /// Names of attributes and elements that 3MF does not know: how many, and the first.
    names: (u64, Option<String>),
    notes: (u64, Option<String>),
    other: Vec<String>,
}

impl Warnings {
    /// Something of an extension was passed over.
    pub fn extension(&mut self, subject: String) {
        if !self.extensions.contains(&subject) {
            self.extensions.push(subject);
        }
    }

    /// An attribute or element was passed over.
    pub fn name(&mut self, name: &[u8]) {
        self.names.0 += 1;
        self.names.1.get_or_insert_with(|| shown(name));
    }

    /// A note has a name that 3MF does not know.
    pub fn note(&mut self, name: &str) {
        self.notes.0 += 1;
        self.notes.1.get_or_insert_with(|| shown(name.as_bytes()));
    }

    /// Something else, unless it was told before.
    pub fn tell(&mut self, warning: &str) {
        if !self.other.iter().any(|told| told == warning) {
            self.other.push(warning.to_owned());
        }
    }

    pub fn finish(self) -> Vec<String> {
        let mut warnings = self.other;
        if !self.extensions.is_empty() {
            let (some, more) = self.extensions.split_at(self.extensions.len().min(5));
            let more = if more.is_empty() { String::new() } else { format!(" and {} more", more.len()) };
            warnings.push(format!("what extensions of 3MF say was left out: {}{more}", some.join(", ")));
        }
        if let (count, Some(first)) = self.names {
            warnings.push(format!(
                "attributes or elements that are no part of 3MF were left out: {count}, the first '{first}'"
            ));
        }
        if let (count, Some(first)) = self.notes {
            warnings.push(format!(
                "notes with names that are no part of 3MF and have no namespace were kept: {count}, the first '{first}'"
            ));
        }
        warnings
    }
}
