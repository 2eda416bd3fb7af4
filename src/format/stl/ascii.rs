//! Reader of ASCII STL.

use glam::DVec3;

use super::facets::{FacetNormals, mesh_of};
use crate::format::ReadMesh;
use crate::format::errors::{ReadError, ReadErrorKind, excerpt};
use crate::format::limits::Limits;
use crate::format::text::{Text, Word, number};
use crate::mesh::Soup;

/// The facet that is being read from ASCII STL.
#[derive(Default)]
struct Facet {
    /// Byte offset of the facet's keyword; `None` between facets.
    begin: Option<usize>,
    corners: [DVec3; 3],
    normal: [f32; 3],
    count: usize,
    /// Whether `endloop` or `endfacet` was read.
    closed: bool,
}

/// Reads the words of the text.
struct AsciiReader<'a> {
    text: Text<'a>,
    limits: Limits,
    positions: Vec<DVec3>,
    normals: FacetNormals,
    facet: Facet,
    solids: u64,
    /// Whether the last solid was closed by `endsolid`.
    is_closed: bool,
    /// Number of words that do not belong to STL, and the first of them.
    unknown_count: u64,
    first_unknown: Option<Word<'a>>,
}

pub(super) fn read_ascii(bytes: &[u8], limits: &Limits) -> Result<ReadMesh, ReadError> {
    let mut reader = AsciiReader {
        text: Text::new(bytes),
        limits: *limits,
        positions: Vec::new(),
        normals: FacetNormals::default(),
        facet: Facet::default(),
        solids: 0,
        is_closed: true,
        unknown_count: 0,
        first_unknown: None,
    };
    while let Some(word) = reader.text.word() {
        if !reader.statement(word)? {
            break;
        }
    }
    reader.finish()
}

impl<'a> AsciiReader<'a> {
    /// Reads one keyword with its arguments; `false` if the file ends within them.
    fn statement(&mut self, word: Word<'a>) -> Result<bool, ReadError> {
        if word.is("vertex") {
            return self.vertex(word);
        } else if word.is("facet") {
            self.end_facet(word)?;
            self.facet = Facet { begin: Some(word.at), ..Facet::default() };
            self.normal();
        } else if word.is("endloop") {
            self.facet.closed = true;
        } else if word.is("endfacet") {
            if self.facet.begin.is_none() {
                self.count_unknown(word);
            } else {
                self.facet.closed = true;
                self.end_facet(word)?;
            }
        } else if word.is("solid") {
            self.end_facet(word)?;
            self.solids += 1;
            self.is_closed = false;
            self.skip_name();
        } else if word.is("endsolid") {
            self.end_facet(word)?;
            self.is_closed = true;
            self.skip_name();
        } else if !word.is("outer") && !word.is("loop") && !word.is("end") {
            self.count_unknown(word);
        }
        Ok(true)
    }

    fn count_unknown(&mut self, word: Word<'a>) {
        self.unknown_count += 1;
        self.first_unknown.get_or_insert(word);
    }

    fn vertex(&mut self, keyword: Word<'a>) -> Result<bool, ReadError> {
        let mut corner = [0.0; 3];
        for value in &mut corner {
            let Some(word) = self.text.word() else { return Ok(false) };
            *value = match self.text.number(word, "a coordinate of a vertex") {
                Ok(number) => number,
                // A truncated file can end within a number or within the next keyword.
                Err(_) if self.text.remaining() == 0 => return Ok(false),
                Err(error) => return Err(error),
            };
        }
        if self.facet.begin.is_none() {
            return Err(self.text.error(
                ReadErrorKind::Malformed,
                keyword.at,
                "this vertex is outside a facet; the keyword 'facet' was expected before it, so export the model again",
            ));
        }
        if let Some(slot) = self.facet.corners.get_mut(self.facet.count) {
            // STL stores f32. Rounding makes ASCII and binary files of one model equal.
            #[expect(clippy::cast_possible_truncation, reason = "rounding is meant")]
            let rounded = corner.map(|value| f64::from(value as f32));
            *slot = DVec3::from_array(rounded);
        }
        self.facet.count += 1;
        Ok(true)
    }

    /// Reads `normal` and its numbers, as far as they are present.
    fn normal(&mut self) {
        let mut ahead = self.text.clone();
        let Some(word) = ahead.word() else { return };
        if !word.is("normal") {
            return;
        }
        self.text = ahead.clone();
        // Some exporters omit the numbers or write other words. None of these words is a keyword that can follow.
        let mut normal = [f32::NAN; 3];
        for value in &mut normal {
            match ahead.word() {
                Some(word) if !is_keyword(word) => {
                    self.text = ahead.clone();
                    #[expect(clippy::cast_possible_truncation, reason = "STL's numbers have 32 bits")]
                    {
                        *value = number(word.bytes).map_or(f32::NAN, |x| x as f32);
                    }
                }
                _ => return,
            }
        }
        if normal.iter().all(|x| x.is_finite()) {
            self.facet.normal = normal;
        }
    }

    /// Skips the name of a solid: the rest of the line, but not facets on the same line.
    fn skip_name(&mut self) {
        let mut ahead = self.text.clone();
        while let Some(word) = ahead.word_on_line() {
            if word.is("facet") && ahead.clone().word().is_some_and(|next| next.is("normal")) {
                return;
            }
            if word.is("endsolid") {
                return;
            }
            self.text = ahead.clone();
        }
    }

    /// Ends the current facet, if there is one.
    fn end_facet(&mut self, next: Word<'_>) -> Result<(), ReadError> {
        let Some(begin) = self.facet.begin.take() else { return Ok(()) };
        if self.facet.count != 3 {
            return Err(self.text.error(
                ReadErrorKind::Malformed,
                if self.facet.count > 3 { next.at } else { begin },
                format!(
                    "a facet has {} vertices, but STL requires 3; export the model again, or as OBJ if it has polygons",
                    self.facet.count
                ),
            ));
        }
        self.limits.check_faces(self.positions.len() as u64 / 3 + 1)?;
        self.limits.check_vertices(self.positions.len() as u64 + 3)?;
        #[expect(clippy::cast_possible_truncation, reason = "limits keep the number of positions below 2^32")]
        self.normals.add((self.positions.len() / 3) as u32, self.facet.normal, self.facet.corners);
        self.positions.extend(self.facet.corners);
        Ok(())
    }

    fn finish(mut self) -> Result<ReadMesh, ReadError> {
        let mut warnings = Vec::new();
        if let Some(begin) = self.facet.begin
            && self.facet.count == 3
            && self.facet.closed
        {
            self.end_facet(Word { bytes: b"", at: begin })?;
        }
        let complete = self.positions.len() / 3;
        if self.facet.begin.is_some() {
            if complete == 0 {
                return Err(self.text.ended("the rest of the first facet"));
            }
            warnings.push(format!(
                "the file ends within a facet and was probably cut off; the {complete} complete facets before it were read"
            ));
        } else if !self.is_closed && complete > 0 {
            warnings.push("the file ends without 'endsolid' and may have been cut off".to_owned());
        }
        if self.positions.is_empty() {
            return Err(ReadError::for_file(
                ReadErrorKind::NoFaces,
                "the ASCII STL file holds no facet; export the model again",
            ));
        }
        if self.solids > 1 {
            warnings.push(format!("the file holds {} solids; all were read as one model", self.solids));
        }
        if let Some(first) = self.first_unknown {
            warnings.push(format!(
                "words that do not belong to STL were ignored: {}, the first '{}'",
                self.unknown_count,
                excerpt(first.bytes)
            ));
        }
        let corners = self.positions.as_chunks::<3>().0;
        let soup = Soup::from_corners(corners.len(), |face| corners[face]);
        Ok(mesh_of(soup, "ASCII STL", self.normals, warnings))
    }
}

fn is_keyword(word: Word<'_>) -> bool {
    ["outer", "loop", "vertex", "endloop", "endfacet", "facet", "endsolid"].iter().any(|k| word.is(k))
}
