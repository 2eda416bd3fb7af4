//! What all parts of a file may have together, counted before it is kept.

use super::xml::Xml;
use crate::format::Limits;
use crate::format::errors::{ReadError, ReadErrorKind};

/// Most objects, and most components and build items.
const OBJECTS: u64 = 100_000;
/// Most groups of colours and pictures, and most notes: those that are looked up one by one.
const RESOURCES: u64 = 10_000;
/// Most names and notes, in bytes.
const TEXT: u64 = 16 << 20;
/// Most model parts.
const PARTS: u64 = 1_000;

/// What has been kept so far.
pub(super) struct Budget {
    pub limits: Limits,
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
    pub fn new(limits: Limits) -> Self {
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
