//! Vertex/Face text, the format of meshalyzer, DReAMM and MCell: one line `Vertex i x y z` or `Face j v1 v2 v3` for each element.
//!
//! Numbers count from 1. They may have gaps and come in any order, and a face may refer to a vertex that no line defines.

use std::fmt::Write as _;

use glam::DVec3;

use super::errors::{ReadError, ReadErrorKind, excerpt};
use super::text::{Text, Word, integer};
use super::{Format, Limits, ReadMesh};
use crate::mesh::{Numbering, OmittedFace, Soup};

/// Maximum number of faces with missing vertices, and of missing vertices, whose numbers are recorded.
const MAX_RECORDED: usize = 10_000;

/// Whether the first line is a `Vertex` or `Face` line.
pub(super) fn starts_with_element(head: &[u8]) -> bool {
    let mut text = Text::new(head).with_comments();
    let keyword = text.word().is_some_and(|word| word.is("vertex") || word.is("face"));
    keyword && text.word_on_line().is_some_and(|word| integer(word.bytes).is_some())
}

/// Reads a file. Faces that refer to a missing vertex are dropped and counted.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<ReadMesh, ReadError> {
    let mut reader = Reader {
        text: Text::new(bytes).with_comments(),
        limits: *limits,
        positions: Vec::new(),
        numbers: Vec::new(),
        vertices_contiguous: true,
        faces: Vec::new(),
        face_numbers: Vec::new(),
        faces_contiguous: true,
        unknown: None,
    };
    while let Some(keyword) = reader.text.word() {
        reader.line(keyword)?;
    }
    reader.finish(bytes)
}

struct Reader<'a> {
    text: Text<'a>,
    limits: Limits,
    positions: Vec<DVec3>,
    /// The number of each vertex.
    numbers: Vec<u32>,
    vertices_contiguous: bool,
    /// The vertex numbers of each face.
    faces: Vec<[u32; 3]>,
    /// The number of each face.
    face_numbers: Vec<u32>,
    faces_contiguous: bool,
    /// Number of lines that are neither `Vertex` nor `Face`, and the first word of the first such line.
    unknown: Option<(u64, String)>,
}

impl<'a> Reader<'a> {
    fn line(&mut self, keyword: Word<'a>) -> Result<(), ReadError> {
        if keyword.is("vertex") {
            self.limits.check_vertices(self.positions.len() as u64 + 1)?;
            let number = self.element(keyword, "the number of a vertex")?;
            let mut position = [0.0; 3];
            for value in &mut position {
                let word = self.word(keyword, "a coordinate of a vertex")?;
                *value = self.text.number(word, "a coordinate of a vertex")?;
            }
            self.positions.push(DVec3::from_array(position));
            self.numbers.push(number);
            self.vertices_contiguous &= number as usize == self.positions.len();
            self.text.skip_line();
        } else if keyword.is("face") {
            self.limits.check_faces(self.faces.len() as u64 + 1)?;
            let number = self.element(keyword, "the number of a face")?;
            let mut corners = [0; 3];
            for corner in &mut corners {
                *corner = self.element(keyword, "the number of a vertex")?;
            }
            if let Some(word) = self.text.word_on_line() {
                return Err(self.text.error(
                    ReadErrorKind::Malformed,
                    word.at,
                    format!(
                        "found '{}' after the three vertices of a face; split polygons into triangles and export again",
                        excerpt(word.bytes)
                    ),
                ));
            }
            self.faces.push(corners);
            self.face_numbers.push(number);
            self.faces_contiguous &= number as usize == self.faces.len();
        } else {
            let (count, _) = self.unknown.get_or_insert_with(|| (0, excerpt(keyword.bytes)));
            *count += 1;
            self.text.skip_line();
        }
        Ok(())
    }

    /// The next word on this line.
    fn word(&mut self, keyword: Word<'a>, expected: &str) -> Result<Word<'a>, ReadError> {
        match self.text.word_on_line() {
            Some(word) => Ok(word),
            None if self.text.remaining() == 0 => Err(self.text.ended(expected)),
            None => Err(self.text.error(
                ReadErrorKind::Malformed,
                keyword.at,
                format!("the line ends where {expected} was expected; export the model again"),
            )),
        }
    }

    /// The next word on this line as an element number.
    fn element(&mut self, keyword: Word<'a>, expected: &str) -> Result<u32, ReadError> {
        let word = self.word(keyword, expected)?;
        let number = self.text.integer(word, expected)?;
        u32::try_from(number).ok().filter(|&number| number > 0).ok_or_else(|| {
            self.text.error(
                ReadErrorKind::Malformed,
                word.at,
                format!(
                    "found '{}' where {expected} was expected; numbers must be from 1 to {}",
                    excerpt(word.bytes),
                    u32::MAX
                ),
            )
        })
    }

    fn finish(mut self, bytes: &[u8]) -> Result<ReadMesh, ReadError> {
        let given = self.faces.len();
        let mut numbering = Numbering {
            vertices_contiguous: self.vertices_contiguous,
            faces_contiguous: self.faces_contiguous,
            ..Numbering::default()
        };
        let sorted = self.sorted_numbers(bytes)?;
        let index_of = |number: u32| match &sorted {
            None => (number as usize <= self.positions.len()).then(|| number - 1),
            Some(sorted) => sorted.binary_search_by_key(&number, |&(n, _)| n).ok().map(|at| sorted[at].1),
        };
        let (mut missing, mut last) = (Vec::new(), DVec3::ZERO);
        let mut numbers = self.face_numbers.iter();
        let mut kept = Vec::with_capacity(self.face_numbers.len());
        self.faces.retain_mut(|face| {
            let number = numbers.next().copied().unwrap_or(0);
            let indices = face.map(index_of);
            missing.extend(face.iter().zip(indices).filter(|(_, index)| index.is_none()).map(|(&number, _)| number));
            if let [Some(a), Some(b), Some(c)] = indices {
                *face = [a, b, c];
                last = centroid(&self.positions, &indices).unwrap_or(last);
                kept.push(number);
                return true;
            }
            let at = centroid(&self.positions, &indices).unwrap_or(last);
            if numbering.omitted.len() < MAX_RECORDED {
                numbering.omitted.push(OmittedFace { number, at: at.to_array() });
            }
            false
        });
        missing.sort_unstable();
        missing.dedup();
        numbering.missing_vertices = missing.len() as u64;
        numbering.missing = missing.iter().copied().take(MAX_RECORDED).collect();
        if !self.faces_contiguous || kept.len() < given {
            numbering.face_numbers = kept;
        }
        if !self.vertices_contiguous {
            numbering.vertex_numbers = std::mem::take(&mut self.numbers);
        }
        numbering.faces_without_vertex = (given - self.faces.len()) as u64;
        if self.faces.is_empty() {
            return Err(ReadError::for_file(ReadErrorKind::NoFaces, self.no_faces(given)));
        }
        let mut warnings = Vec::new();
        if let Some(first) = missing.first() {
            warnings.push(format!(
                "vertices that faces refer to are missing: {}, the first is number {first}; faces dropped for this reason: {}",
                numbering.missing_vertices, numbering.faces_without_vertex
            ));
        }
        if let Some((count, word)) = &self.unknown {
            warnings.push(format!(
                "lines that begin with neither Vertex nor Face were ignored: {count}, the first begins with '{word}'"
            ));
        }
        let soup = Soup { positions: self.positions, faces: self.faces };
        let mesh = ReadMesh::of(soup, Format::Mesh, "Vertex/Face mesh");
        Ok(ReadMesh { numbering: Some(numbering), warnings, ..mesh })
    }

    /// Pairs of vertex number and index, sorted by number; `None` if the numbers run from 1 in order.
    fn sorted_numbers(&self, bytes: &[u8]) -> Result<Option<Vec<(u32, u32)>>, ReadError> {
        if self.vertices_contiguous {
            return Ok(None);
        }
        let mut sorted: Vec<(u32, u32)> = self.numbers.iter().copied().zip(0..).collect();
        sorted.sort_unstable();
        match sorted.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            None => Ok(Some(sorted)),
            Some(pair) => Err(self.duplicate_vertex(bytes, pair[1])),
        }
    }

    /// The error for a vertex number that is defined twice. The file is parsed again to find its line, so lines need not be stored.
    #[cold]
    fn duplicate_vertex(&self, bytes: &[u8], (number, index): (u32, u32)) -> ReadError {
        let mut text = Text::new(bytes).with_comments();
        let mut left = index;
        let mut at = 0;
        while let Some(word) = text.word() {
            if word.is("vertex") {
                at = word.at;
                if left == 0 {
                    break;
                }
                left -= 1;
            }
            text.skip_line();
        }
        text.error(
            ReadErrorKind::Malformed,
            at,
            format!(
                "vertex {number} is defined a second time; a number must name one vertex, so export the model again"
            ),
        )
    }

    fn no_faces(&self, given: usize) -> String {
        let vertices = self.positions.len();
        if given > 0 {
            format!(
                "all of the file's {given} faces refer to missing vertices; the file was split or damaged, so export the model again"
            )
        } else {
            format!(
                "the file holds {vertices} vertices and no faces, so it is a point cloud; reconstruct a surface from it first"
            )
        }
    }
}

/// The mean of the corners that exist and are finite; `None` if there is none.
fn centroid(positions: &[DVec3], indices: &[Option<u32>]) -> Option<DVec3> {
    let given = indices.iter().flatten().filter_map(|&v| positions.get(v as usize)).filter(|p| p.is_finite());
    let (sum, count) = given.fold((DVec3::ZERO, 0.0), |(sum, count), &p| (sum + p, count + 1.0));
    (count > 0.0 && sum.is_finite()).then(|| sum / count)
}

/// Writes vertices and faces, numbered from 1. Each f64 is the shortest decimal that parses to the same value.
pub(super) fn write(soup: &Soup) -> Vec<u8> {
    let mut text = String::with_capacity(64 * soup.positions.len() + 40 * soup.faces.len());
    // Writing to a String can't fail.
    for (p, number) in soup.positions.iter().zip(1u64..) {
        let _ = writeln!(text, "Vertex {number} {} {} {}", p.x, p.y, p.z);
    }
    for (face, number) in soup.faces.iter().zip(1u64..) {
        let [a, b, c] = face.map(|v| u64::from(v) + 1);
        let _ = writeln!(text, "Face {number} {a} {b} {c}");
    }
    text.into_bytes()
}
