//! The element `mesh` (core specification, 4.1). Files have millions of its child elements, so reading one allocates nothing.

use glam::DVec3;

use super::part::{ModelReader, Part, ShapeResource, UsedGroups, parse_index, unexpected_value};
use super::schema::{Namespace, number};
use super::xml::{Attribute, Tag, Xml};
use crate::format::errors::{ReadError, ReadErrorKind, excerpt};
use crate::mesh::Soup;
use crate::scene::{PAINTLESS, Paint};

/// Reads a mesh. `default` is the property group and entry of triangles without their own.
pub(super) fn read(
    reader: &mut ModelReader,
    xml: &mut Xml<'_>,
    tag: &Tag<'_>,
    default: Option<(u32, u32)>,
    part: &mut Part,
) -> Result<ShapeResource, ReadError> {
    xml.attributes(tag, |attribute| reader.ignore_attribute(xml, &attribute, false))?;
    let mut soup = Soup::default();
    let mut painter = Painter::new(default, &mut part.used_groups);
    xml.children(tag, |xml, tag| match tag.name() {
        b"vertices" if tag.space.is_core() => {
            xml.attributes(tag, |attribute| reader.ignore_attribute(xml, &attribute, false))?;
            xml.children(tag, |xml, tag| match tag.name() {
                b"vertex" if tag.space.is_core() => {
                    reader.budget.vertex()?;
                    soup.positions.push(vertex(reader, xml, tag)?);
                    Ok(())
                }
                _ => reader.ignore_element(xml, tag),
            })
        }
        b"triangles" if tag.space.is_core() => {
            xml.attributes(tag, |attribute| reader.ignore_attribute(xml, &attribute, false))?;
            let colored = tag.space == Namespace::Core;
            xml.children(tag, |xml, tag| match tag.name() {
                b"triangle" if tag.space.is_core() => {
                    reader.budget.face()?;
                    let triangle = triangle(reader, xml, tag)?;
                    let have = soup.positions.len();
                    if let Some(v) = triangle.corners.into_iter().find(|&v| v as usize >= have) {
                        let detail = format!("a triangle refers to vertex {v}, but its mesh has {have} vertices, counted from 0; export the model again");
                        return Err(xml.error(ReadErrorKind::IndexOutOfRange, detail));
                    }
                    if colored {
                        painter.paint(xml, &triangle, soup.faces.len())?;
                    }
                    soup.faces.push(triangle.corners);
                    Ok(())
                }
                _ => reader.ignore_element(xml, tag),
            })
        }
        _ => reader.ignore_element(xml, tag),
    })?;
    let paint = painter.finish(soup.faces.len());
    Ok(ShapeResource::Mesh { soup, paint })
}

fn vertex(reader: &mut ModelReader, xml: &Xml<'_>, tag: &Tag<'_>) -> Result<DVec3, ReadError> {
    let mut position = [None; 3];
    for attribute in tag.raw_attributes() {
        let attribute = attribute.map_err(|error| xml.malformed(error))?;
        let axis = match attribute.key.into_inner() {
            b"x" => 0,
            b"y" => 1,
            b"z" => 2,
            name => {
                other_attribute(reader, xml, name, &attribute.value)?;
                continue;
            }
        };
        let value = number(&attribute.value).ok_or_else(|| not_a_number(xml, &attribute.value))?;
        if position[axis].replace(value).is_some() {
            return Err(duplicate_attribute(xml, attribute.key.into_inner()));
        }
    }
    match position {
        [Some(x), Some(y), Some(z)] => Ok(DVec3::new(x, y, z)),
        _ => Err(xml.malformed("a vertex has fewer than three coordinates; export the model again")),
    }
}

/// A triangle element.
struct Triangle {
    corners: [u32; 3],
    group: Option<u32>,
    entries: [Option<u32>; 3],
}

fn triangle(reader: &mut ModelReader, xml: &Xml<'_>, tag: &Tag<'_>) -> Result<Triangle, ReadError> {
    let mut corners = [None; 3];
    let mut entries = [None; 3];
    let mut group = None;
    for attribute in tag.raw_attributes() {
        let attribute = attribute.map_err(|error| xml.malformed(error))?;
        let slot = match attribute.key.into_inner() {
            b"v1" => &mut corners[0],
            b"v2" => &mut corners[1],
            b"v3" => &mut corners[2],
            b"p1" => &mut entries[0],
            b"p2" => &mut entries[1],
            b"p3" => &mut entries[2],
            b"pid" => &mut group,
            name => {
                other_attribute(reader, xml, name, &attribute.value)?;
                continue;
            }
        };
        if slot.replace(parse_index(xml, &attribute.value)?).is_some() {
            return Err(duplicate_attribute(xml, attribute.key.into_inner()));
        }
    }
    match corners {
        [Some(a), Some(b), Some(c)] => Ok(Triangle { corners: [a, b, c], group, entries }),
        _ => Err(xml.malformed("a triangle has fewer than three corners; export the model again")),
    }
}

/// Handles an attribute that the core specification does not define for vertices and triangles.
#[cold]
fn other_attribute(reader: &mut ModelReader, xml: &Xml<'_>, key: &[u8], value: &[u8]) -> Result<(), ReadError> {
    let (space, name) = match key.iter().position(|&b| b == b':') {
        Some(colon) if &key[..colon] != b"xmlns" => (xml.space(&key[..colon])?, &key[colon + 1..]),
        None if key != b"xmlns" => (Namespace::None, key),
        _ => return Ok(()),
    };
    reader.ignore_attribute(xml, &Attribute { space, name, value }, true)
}

#[cold]
fn duplicate_attribute(xml: &Xml<'_>, name: &[u8]) -> ReadError {
    xml.malformed(format_args!("an element has the attribute '{}' twice; export the model again", excerpt(name)))
}

#[cold]
fn not_a_number(xml: &Xml<'_>, value: &[u8]) -> ReadError {
    match value.contains(&b',') {
        true => xml.malformed("a coordinate has a decimal comma; export the model with decimal points"),
        false => unexpected_value(xml, "a coordinate of a vertex", value),
    }
}

/// Collects the paint of triangles. Until the palettes are built, `palette` is an index into [`UsedGroups::groups`].
struct Painter<'p> {
    default: Option<(u32, u32)>,
    groups: &'p mut UsedGroups,
    /// The property group that was used last, and its index.
    last: Option<(u32, u32)>,
    paint: Vec<Paint>,
}

impl<'p> Painter<'p> {
    fn new(default: Option<(u32, u32)>, groups: &'p mut UsedGroups) -> Self {
        Self { default, groups, last: None, paint: Vec::new() }
    }

    /// The index of a property group.
    fn palette(&mut self, group: u32) -> u32 {
        match self.last {
            Some((last, palette)) if last == group => palette,
            _ => {
                let palette = self.groups.number(group);
                self.last = Some((group, palette));
                palette
            }
        }
    }

    /// The paint of triangles without their own.
    fn of_default(&mut self) -> Paint {
        match self.default {
            Some((group, entry)) => Paint { palette: self.palette(group), at: [entry; 3] },
            None => PAINTLESS,
        }
    }

    /// Adds the paint of the triangle with the index `face`.
    fn paint(&mut self, xml: &Xml<'_>, triangle: &Triangle, face: usize) -> Result<(), ReadError> {
        let [Some(p1), p2, p3] = triangle.entries else {
            if !self.paint.is_empty() {
                let default = self.of_default();
                self.paint.push(default);
            }
            return Ok(());
        };
        let Some(group) = triangle.group.or(self.default.map(|(group, _)| group)) else {
            return Err(xml.malformed(
                "a triangle has a p1, but neither the triangle nor its object has a pid; export the model again",
            ));
        };
        if self.paint.is_empty() {
            let default = self.of_default();
            self.paint.resize(face, default);
        }
        let palette = self.palette(group);
        self.paint.push(Paint { palette, at: [p1, p2.unwrap_or(p1), p3.unwrap_or(p1)] });
        Ok(())
    }

    /// The paint of all triangles; empty if none is painted.
    fn finish(mut self, faces: usize) -> Vec<Paint> {
        let default = self.of_default();
        if !self.paint.is_empty() || default != PAINTLESS {
            self.paint.resize(faces, default);
        }
        self.paint
    }
}
