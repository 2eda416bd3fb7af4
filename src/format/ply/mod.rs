//! PLY: elements with named properties, as text or as binary of either byte order (Turk, "The PLY Polygon File Format", 1994).
//!
//! `header` parses the declaration of the elements, and `values` reads their numbers. This module builds the mesh and its colours.

mod header;
mod values;
mod write;

use std::ops::Range;

use glam::DVec3;

use super::content::{MeshAndPaint, Polygons, ReadMesh};
use super::errors::{ReadError, ReadErrorKind};
use super::faces::FaceCollector;
use super::formats::Format;
use super::limits::ReadOptions;
use super::paint::{MeshPaint, PaletteBuilder, byte};
use crate::mesh::{CornerNormals, Soup};
use crate::scene::{PAINTLESS, Paint};
use header::{Element, Encoding, Header, Meaning, PropertyType, Role, Row, Scalar};
use values::{AsciiValues, BinaryValues, Values, list_length};
pub(super) use write::{write, write_painted};

/// Reads PLY of any encoding; `painted` tells whether to read colours.
pub(super) fn read(bytes: &[u8], options: &ReadOptions, painted: bool) -> Result<MeshAndPaint, ReadError> {
    let header = Header::read(bytes)?;
    header.check_counts(bytes.len(), &options.limits)?;
    let body = header.body;
    let ReadElements { soup, normals, polygons, paints, warnings } = match header.encoding {
        Encoding::Ascii => ElementReader::new(AsciiValues::new(bytes, body), options, painted).read(&header)?,
        Encoding::BinaryLittleEndian => {
            ElementReader::new(BinaryValues::<true>::new(bytes, body), options, painted).read(&header)?
        }
        Encoding::BinaryBigEndian => {
            ElementReader::new(BinaryValues::<false>::new(bytes, body), options, painted).read(&header)?
        }
    };
    if soup.faces.is_empty() {
        return Err(no_faces(&header));
    }
    let dialect = header.encoding.dialect().to_owned();
    let mesh = ReadMesh { normals, polygons, warnings, ..ReadMesh::of(soup, Format::Ply, dialect) };
    Ok(MeshAndPaint { mesh, paints })
}

/// The error for a file without triangles.
fn no_faces(header: &Header) -> ReadError {
    let count = |role| header.elements.iter().filter(|e| e.role == role).map(|e| e.count).sum::<u64>();
    let (vertices, faces) = (count(Role::Vertices), count(Role::Faces) + count(Role::Strips));
    let detail = if faces > 0 {
        format!("none of the PLY file's {faces} faces has three or more corners; export the model again")
    } else if vertices > 0 {
        format!(
            "the PLY file holds {vertices} vertices and no faces, so it is a point cloud; reconstruct a surface from it first"
        )
    } else {
        "the PLY file holds no vertices and no faces; export the model again".to_owned()
    };
    ReadError::for_file(ReadErrorKind::NoFaces, detail)
}

/// The initial value of a colour. Files without the `alpha` property have opaque colours.
const OPAQUE: [u8; 4] = [0, 0, 0, 255];

/// A colour component as a byte. Floats range from 0 to 1, integers up to the largest value of their type.
fn component_byte(scalar: Scalar, value: f64) -> u8 {
    byte(match scalar {
        Scalar::F32 | Scalar::F64 => value,
        Scalar::U16 => value / 65535.0,
        _ => value / 255.0,
    })
}

/// The result of reading all elements.
struct ReadElements {
    soup: Soup,
    normals: Option<CornerNormals>,
    polygons: Polygons,
    paints: MeshPaint,
    warnings: Vec<String>,
}

/// Reads the elements, in the order in which the header declares them.
struct ElementReader<V> {
    values: V,
    options: ReadOptions,
    positions: Vec<DVec3>,
    /// One normal for each vertex, if the header declares all three components.
    normals: Vec<[f32; 3]>,
    /// The header's vertex count, against which indices are checked. Faces may come before vertices.
    vertices: u64,
    corners: Vec<u32>,
    /// Number of strip triangles that repeat a vertex.
    degenerate: u64,
    /// The colours read so far; `None` if colours are not requested.
    colors: Option<Colors>,
}

impl<V: Values> ElementReader<V> {
    fn new(values: V, options: &ReadOptions, painted: bool) -> Self {
        let (positions, normals, corners) = (Vec::new(), Vec::new(), Vec::new());
        let colors = painted.then(Colors::default);
        Self { values, options: *options, positions, normals, vertices: 0, corners, degenerate: 0, colors }
    }

    /// Reads all elements. [`Header::check_counts`] must have accepted the header.
    fn read(mut self, header: &Header) -> Result<ReadElements, ReadError> {
        let count = |role| header.elements.iter().filter(|e| e.role == role).map(|e| e.count).sum::<u64>();
        self.vertices = count(Role::Vertices);
        // A face takes at least one byte, so the capacity is at most a few times the file's size.
        let mut faces = FaceCollector::new(&self.options, usize::try_from(count(Role::Faces)).unwrap_or(0));
        for element in &header.elements {
            match element.role {
                Role::Vertices => self.read_vertices(element)?,
                Role::Faces | Role::Strips => self.read_faces(element, &mut faces)?,
                Role::Other => self.values.skip_element(element)?,
            }
        }
        let painted = self.colors.is_some();
        let mut warnings = header.warnings.clone();
        let (faces, polygons) = faces.finish(&self.positions, &mut warnings);
        if self.degenerate > 0 {
            warnings.push(format!("degenerate triangles that join triangle strips were dropped: {}", self.degenerate));
        }
        warnings.extend(self.values.trailing_warning());
        let paints = self.colors.map(|colors| colors.paint(&faces)).unwrap_or_default();
        if header.has_texture && painted {
            warnings.push(
                "the texture coordinates of faces were dropped; to keep the texture, send 3MF, GLB, or OBJ with its textures in a ZIP archive"
                    .to_owned(),
            );
        }
        let normals = (!self.normals.is_empty()).then_some(CornerNormals::OfVertices(self.normals));
        Ok(ReadElements { soup: Soup { positions: self.positions, faces }, normals, polygons, paints, warnings })
    }

    fn read_vertices(&mut self, element: &Element) -> Result<(), ReadError> {
        let count = usize::try_from(element.count).unwrap_or(0);
        self.positions.reserve_exact(count);
        let has_normals = element.has_normals();
        if has_normals {
            self.normals.reserve_exact(count);
        }
        let has_colors = element.has_colors() && self.colors.is_some();
        for row in element.rows() {
            let (mut position, mut normal) = (DVec3::ZERO, DVec3::ZERO);
            let mut color = OPAQUE;
            for property in &element.properties {
                match (property.value_type, property.meaning) {
                    (PropertyType::Scalar(scalar), Meaning::Coordinate(k)) => {
                        position[k] = self.values.read_number(scalar, row)?;
                    }
                    (PropertyType::Scalar(scalar), Meaning::Normal(k)) if has_normals => {
                        normal[k] = self.values.read_optional(scalar, row)?;
                    }
                    (PropertyType::Scalar(scalar), Meaning::Color(k)) if has_colors => {
                        color[k] = component_byte(scalar, self.values.read_optional(scalar, row)?);
                    }
                    (PropertyType::Scalar(scalar), _) => self.values.skip(scalar, 1, row)?,
                    (PropertyType::List { count, item }, _) => {
                        let length = list_length(&mut self.values, count, row)?;
                        self.values.skip(item, length, row)?;
                    }
                }
            }
            self.positions.push(position);
            if has_normals {
                self.normals.push(normal.as_vec3().to_array());
            }
            if let Some(colors) = self.colors.as_mut().filter(|_| has_colors) {
                colors.of_vertices.push(color);
            }
        }
        Ok(())
    }

    fn read_faces(&mut self, element: &Element, faces: &mut FaceCollector) -> Result<(), ReadError> {
        let has_colors = element.has_colors() && self.colors.is_some();
        for row in element.rows() {
            let (first, mut color) = (faces.len(), OPAQUE);
            // Of several index lists, the first counts.
            let mut has_indices = false;
            for property in &element.properties {
                match property.value_type {
                    PropertyType::Scalar(scalar) => match property.meaning {
                        Meaning::Color(k) if has_colors => {
                            color[k] = component_byte(scalar, self.values.read_optional(scalar, row)?);
                        }
                        _ => self.values.skip(scalar, 1, row)?,
                    },
                    PropertyType::List { count, item } => {
                        let length = list_length(&mut self.values, count, row)?;
                        if has_indices || property.meaning != Meaning::Indices {
                            self.values.skip(item, length, row)?;
                            continue;
                        }
                        has_indices = true;
                        if length > self.values.max_left(item) {
                            return Err(self.values.error(
                                ReadErrorKind::Truncated,
                                format!(
                                    "'{}' {} of {} lists {length} vertices, more than the file can hold; the file is cut off or damaged, so send it again",
                                    element.name, row.number, element.count
                                ),
                            ));
                        }
                        if element.role == Role::Strips {
                            self.strips(row, item, length, faces)?;
                        } else {
                            self.polygon(row, item, length, faces)?;
                        }
                    }
                }
            }
            if let Some(colors) = self.colors.as_mut().filter(|_| has_colors) {
                colors.of_triangles(first..faces.len(), color);
            }
        }
        Ok(())
    }

    fn polygon(&mut self, row: Row<'_>, item: Scalar, length: u64, faces: &mut FaceCollector) -> Result<(), ReadError> {
        self.options.limits.check_faces(length.saturating_sub(2))?;
        self.corners.clear();
        for _ in 0..length {
            let index = self.values.read_integer(item, row)?;
            let vertex = self.vertex(index, row)?;
            self.corners.push(vertex);
        }
        faces.polygon(&self.positions, &self.corners)
    }

    /// Reads triangle strips, separated by -1. Every second triangle of a strip has reversed orientation.
    fn strips(&mut self, row: Row<'_>, item: Scalar, length: u64, faces: &mut FaceCollector) -> Result<(), ReadError> {
        let mut last = [0; 2];
        let mut in_strip = 0_u64;
        for _ in 0..length {
            let index = self.values.read_integer(item, row)?;
            if index == -1 {
                in_strip = 0;
                continue;
            }
            let vertex = self.vertex(index, row)?;
            if in_strip >= 2 {
                let [a, b] = last;
                if a == b || b == vertex || a == vertex {
                    self.degenerate += 1;
                } else if in_strip.is_multiple_of(2) {
                    faces.triangle([a, b, vertex])?;
                } else {
                    faces.triangle([b, a, vertex])?;
                }
            }
            last = [last[1], vertex];
            in_strip += 1;
        }
        Ok(())
    }

    /// Checks a vertex index.
    #[inline]
    fn vertex(&self, index: i64, row: Row<'_>) -> Result<u32, ReadError> {
        match u32::try_from(index) {
            Ok(vertex) if u64::from(vertex) < self.vertices => Ok(vertex),
            _ => Err(self.out_of_range(index, row)),
        }
    }

    #[cold]
    fn out_of_range(&self, index: i64, row: Row<'_>) -> ReadError {
        self.values.error(
            ReadErrorKind::IndexOutOfRange,
            format!(
                "'{}' {} of {} refers to vertex {index}, but the file has {} vertices, counted from 0; export the model again",
                row.element.name, row.number, row.element.count, self.vertices
            ),
        )
    }
}

/// The colours of vertices and triangles. If vertices have colours, those of triangles are ignored.
#[derive(Default)]
struct Colors {
    /// One colour for each vertex; empty if vertices have none.
    of_vertices: Vec<[u8; 4]>,
    /// One colour for each triangle, up to the last triangle that has one.
    of_triangles: Vec<Option<[u8; 4]>>,
}

impl Colors {
    /// Sets the colour of a range of triangles. Ranges must be in ascending order.
    fn of_triangles(&mut self, triangles: Range<usize>, color: [u8; 4]) {
        self.of_triangles.resize(triangles.start, None);
        self.of_triangles.resize(triangles.end, Some(color));
    }

    /// The paint of all triangles.
    fn paint(self, triangles: &[[u32; 3]]) -> MeshPaint {
        let mut palettes = PaletteBuilder::default();
        let of_faces = if !self.of_vertices.is_empty() {
            let entries: Vec<u32> = self.of_vertices.iter().map(|&color| palettes.color(color).1).collect();
            let palette = palettes.colors();
            triangles.iter().map(|corners| Paint { palette, at: corners.map(|v| entries[v as usize]) }).collect()
        } else if self.of_triangles.is_empty() {
            Vec::new()
        } else {
            let mut paint = |color| {
                let (palette, entry) = palettes.color(color);
                Paint { palette, at: [entry; 3] }
            };
            let colors = self.of_triangles.iter().copied().chain(std::iter::repeat(None));
            triangles.iter().zip(colors).map(|(_, color)| color.map_or(PAINTLESS, &mut paint)).collect()
        };
        MeshPaint { of_faces, palettes: palettes.finish(), textures: Vec::new() }
    }
}
