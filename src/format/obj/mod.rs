//! Wavefront OBJ: polygons as text ("Advanced Visualizer Manual", appendix B1). Vertices, faces and normals are read, and optionally
//! colours.
//!
//! Objects (`o`) and groups (`g`) are read as one mesh, because they often share vertices and are rarely separate bodies.

mod mtl;
mod paint;
mod write;

use glam::DVec3;

use super::content::{MeshAndPaint, ReadMesh};
use super::errors::{ReadError, ReadErrorKind, excerpt};
use super::faces::{CollectedFaces, FaceCollector, NO_INDEX};
use super::formats::Format;
use super::limits::{Limits, ReadOptions};
use super::paint::MeshPaint;
use super::sidecar::Sidecars;
use super::text::{Text, Word, integer, number};
use crate::mesh::{CornerNormals, Soup};
use paint::{PaintStatements, field_index};
pub(super) use write::{write, write_painted};

/// Statements without line continuation, because the names in them may end in a backslash.
const NAMES: [&str; 5] = ["o", "g", "usemap", "maplib", "shadow_obj"];

/// Statements that do not affect the surface, or that belong to free-form surfaces.
const IGNORED: [&str; 27] = [
    "s",
    "mg",
    "vp",
    "cstype",
    "deg",
    "bmat",
    "step",
    "parm",
    "trim",
    "hole",
    "scrv",
    "sp",
    "end",
    "con",
    "bevel",
    "c_interp",
    "d_interp",
    "lod",
    "trace_obj",
    "ctech",
    "stech",
    "bsp",
    "bzp",
    "cdc",
    "cdp",
    "res",
    "call",
];

/// Reader of OBJ.
struct Reader<'a> {
    text: Text<'a>,
    limits: Limits,
    positions: Vec<DVec3>,
    faces: FaceCollector,
    corners: Vec<u32>,
    /// Normals of `vn` statements; zeros if malformed.
    normals: Vec<[f32; 3]>,
    /// Normal indices of `corners`.
    corner_normals: Vec<u32>,
    /// Paint statements read so far; `None` if colours are not requested.
    statements: Option<PaintStatements<'a>>,
    /// Texture coordinate indices of `corners`.
    corner_coordinates: Vec<u32>,
    /// The largest vertex index used before its vertex was read, and the byte offset of its face.
    max_forward: Option<(u32, usize)>,
    face_statements: u64,
    lines: u64,
    points: u64,
    free_form: u64,
    unknown: u64,
    first_unknown: Option<Word<'a>>,
}

/// Reads OBJ. Colours are read if `sidecars` is given.
pub(super) fn read(
    bytes: &[u8],
    options: &ReadOptions,
    sidecars: Option<&Sidecars<'_>>,
) -> Result<MeshAndPaint, ReadError> {
    let mut reader = Reader {
        text: Text::new(bytes).with_comments().with_continued_lines(),
        limits: options.limits,
        positions: Vec::new(),
        faces: FaceCollector::new(options, 0),
        corners: Vec::new(),
        normals: Vec::new(),
        corner_normals: Vec::new(),
        statements: sidecars.map(|sidecars| PaintStatements::new(options.limits, sidecars.has_archive())),
        corner_coordinates: Vec::new(),
        max_forward: None,
        face_statements: 0,
        lines: 0,
        points: 0,
        free_form: 0,
        unknown: 0,
        first_unknown: None,
    };
    while let Some(word) = reader.text.word() {
        reader.statement(word)?;
    }
    reader.finish(sidecars)
}

impl<'a> Reader<'a> {
    /// Reads one statement.
    fn statement(&mut self, word: Word<'a>) -> Result<(), ReadError> {
        match word.bytes {
            b"v" => return self.vertex(word),
            b"f" | b"fo" => return self.face(word),
            b"vn" => self.normal(),
            b"vt" => {
                if let Some(statements) = &mut self.statements {
                    statements.texture_coordinate(&mut self.text);
                }
            }
            b"usemtl" | b"mtllib" => {
                let name = self.text.rest_of_line();
                match &mut self.statements {
                    Some(statements) if word.bytes == b"usemtl" => statements.material(name, self.faces.len()),
                    Some(statements) => statements.library(name),
                    None => {}
                }
                return Ok(());
            }
            b"l" => self.lines += 1,
            b"p" => self.points += 1,
            b"curv" | b"curv2" | b"surf" => self.free_form += 1,
            _ if NAMES.iter().any(|name| word.bytes == name.as_bytes()) => {
                self.text.skip_line();
                return Ok(());
            }
            _ if IGNORED.iter().any(|name| word.bytes == name.as_bytes()) => {}
            _ => {
                self.unknown += 1;
                self.first_unknown.get_or_insert(word);
                self.text.skip_line();
                return Ok(());
            }
        }
        self.text.skip_statement();
        Ok(())
    }

    fn vertex(&mut self, keyword: Word<'a>) -> Result<(), ReadError> {
        self.limits.check_vertices(self.positions.len() as u64 + 1)?;
        let mut position = [0.0; 3];
        for (k, value) in position.iter_mut().enumerate() {
            let Some(word) = self.text.word_on_line() else {
                return Err(self.text.error(
                    ReadErrorKind::Malformed,
                    keyword.at,
                    format!("a vertex has {k} coordinates, but needs 3; export the model again"),
                ));
            };
            *value = self.text.number(word, "a coordinate of a vertex")?;
        }
        self.positions.push(DVec3::from_array(position));
        if let Some(statements) = &mut self.statements {
            statements.color(self.positions.len() - 1, &mut self.text);
        }
        self.text.skip_statement();
        Ok(())
    }

    /// Reads a normal. A malformed normal is no error, because the surface does not need normals. Normals over the vertex limit are
    /// ignored.
    fn normal(&mut self) {
        if self.limits.check_vertices(self.normals.len() as u64 + 1).is_err() {
            return;
        }
        let mut normal = [0.0; 3];
        for value in &mut normal {
            let Some(number) = self.text.word_on_line().and_then(|word| number(word.bytes)) else {
                normal = [0.0; 3];
                break;
            };
            #[expect(clippy::cast_possible_truncation, reason = "only the direction is of use")]
            {
                *value = number as f32;
            }
        }
        self.normals.push(normal);
    }

    fn face(&mut self, keyword: Word<'a>) -> Result<(), ReadError> {
        self.corners.clear();
        self.corner_normals.clear();
        self.corner_coordinates.clear();
        self.face_statements += 1;
        while let Some(word) = self.text.word_on_line() {
            let index = self.vertex_index(word)?;
            self.corners.push(index);
            if let Some(normal) = self.normal_index(word) {
                self.corner_normals.resize(self.corners.len() - 1, NO_INDEX);
                self.corner_normals.push(normal);
            }
            if let Some(place) =
                self.statements.as_ref().and_then(|statements| statements.texture_coordinate_index(word))
            {
                self.corner_coordinates.resize(self.corners.len() - 1, NO_INDEX);
                self.corner_coordinates.push(place);
            }
            // Checked here so that one face can't exceed the limit for all faces.
            self.limits.check_faces((self.corners.len() as u64).saturating_sub(2))?;
            if index as usize >= self.positions.len() && self.max_forward.is_none_or(|(most, _)| index > most) {
                self.max_forward = Some((index, keyword.at));
            }
        }
        for numbers in [&mut self.corner_normals, &mut self.corner_coordinates] {
            if !numbers.is_empty() {
                numbers.resize(self.corners.len(), NO_INDEX);
            }
        }
        self.faces.polygon_with(&self.positions, &self.corners, [&self.corner_normals, &self.corner_coordinates])
    }

    /// The normal index of a corner `v//vn` or `v/vt/vn`; `None` if it has none. The normal may come later in the file or not at all.
    fn normal_index(&self, word: Word<'_>) -> Option<u32> {
        field_index(word, 2, self.normals.len())
    }

    /// The vertex index of a corner `v`, `v/vt`, `v//vn` or `v/vt/vn`, counted from 0.
    fn vertex_index(&self, word: Word<'_>) -> Result<u32, ReadError> {
        let end = word.bytes.iter().position(|&b| b == b'/').unwrap_or(word.bytes.len());
        let Some(number) = integer(&word.bytes[..end]) else {
            return Err(self.text.error(
                ReadErrorKind::Malformed,
                word.at,
                format!(
                    "found '{}' in a face where a vertex number such as 7, 7/1 or 7/1/3 was expected; export the model again",
                    excerpt(word.bytes)
                ),
            ));
        };
        let have = self.positions.len() as i64;
        let index = if number > 0 { number - 1 } else { have.saturating_add(number) };
        if number == 0 || index < 0 || index >= i64::from(u32::MAX) {
            return Err(self.out_of_range(number, have, word.at));
        }
        // The range was checked above.
        Ok(u32::try_from(index).unwrap_or(u32::MAX))
    }

    fn out_of_range(&self, number: i64, have: i64, at: usize) -> ReadError {
        let detail = match number {
            0 => "a face refers to vertex 0, but OBJ counts vertices from 1; export the model again".to_owned(),
            ..0 => format!(
                "a face refers to vertex {number}, counted backwards, but only {have} vertices come before it; export the model again"
            ),
            _ => format!("a face refers to vertex {number}, but the file has {have} vertices; export the model again"),
        };
        self.text.error(ReadErrorKind::IndexOutOfRange, at, detail)
    }

    fn finish(self, sidecars: Option<&Sidecars<'_>>) -> Result<MeshAndPaint, ReadError> {
        let have = self.positions.len();
        if let Some((most, at)) = self.max_forward
            && most as usize >= have
        {
            return Err(self.out_of_range(i64::from(most) + 1, have as i64, at));
        }
        if self.faces.is_empty() {
            return Err(self.no_faces());
        }
        let mut warnings = Vec::new();
        let CollectedFaces { faces, normals: corner_normals, texture_coordinates, polygons } =
            self.faces.finish_with_all(&self.positions, &mut warnings);
        let has_normals = !self.normals.is_empty() && !corner_normals.is_empty();
        let normals = has_normals.then_some(CornerNormals::OfCorners { normals: self.normals, faces: corner_normals });
        if self.lines + self.points > 0 {
            warnings
                .push(format!("lines and points, which form no surface, were dropped: {}", self.lines + self.points));
        }
        if self.free_form > 0 {
            warnings.push(format!(
                "free-form curves and surfaces were dropped: {}; convert them to polygons if they belong to the model",
                self.free_form
            ));
        }
        if let Some(first) = self.first_unknown {
            warnings.push(format!(
                "lines that do not belong to OBJ were ignored: {}, the first begins with '{}'",
                self.unknown,
                excerpt(first.bytes)
            ));
        }
        let paints = match (self.statements, sidecars) {
            (Some(statements), Some(sidecars)) => {
                statements.paint(&faces, &texture_coordinates, sidecars, &mut warnings)
            }
            _ => MeshPaint::default(),
        };
        let soup = Soup { positions: self.positions, faces };
        let dialect = "OBJ".to_owned();
        let mesh = ReadMesh { normals, polygons, warnings, ..ReadMesh::of(soup, Format::Obj, dialect) };
        Ok(MeshAndPaint { mesh, paints })
    }

    fn no_faces(&self) -> ReadError {
        let vertices = self.positions.len();
        let detail = if self.free_form > 0 {
            format!(
                "the OBJ file holds {} free-form curves or surfaces and no polygons; convert them to polygons in the program that made the file",
                self.free_form
            )
        } else if self.face_statements > 0 {
            format!(
                "none of the OBJ file's {} faces has three or more corners; export the model again",
                self.face_statements
            )
        } else if self.lines + self.points > 0 {
            "the OBJ file holds lines or points and no faces; export the model as polygons".to_owned()
        } else if vertices > 0 {
            format!(
                "the OBJ file holds {vertices} vertices and no faces, so it is a point cloud; reconstruct a surface from it first"
            )
        } else {
            "the OBJ file holds no vertices and no faces; export the model again".to_owned()
        };
        ReadError::for_file(ReadErrorKind::NoFaces, detail)
    }
}
