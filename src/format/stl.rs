//! STL: facets without vertex indices, as 50-byte records or as text (3D Systems, "StereoLithography Interface Specification", 1989).

use glam::DVec3;

use super::errors::{ReadError, ReadErrorKind, WriteError, excerpt};
use super::limits::{Limits, SNIFFED_BYTES};
use super::text::{Text, Word, number};
use super::{Format, ReadMesh};
use crate::mesh::{CornerNormals, Soup};

/// Size of the binary header in bytes: 80 bytes of free text and the facet count.
const HEADER_BYTES: usize = 84;
/// Size of a binary facet in bytes: a normal, three corners, and two bytes without an agreed meaning.
const FACET_BYTES: usize = 50;

/// Size of the smallest binary file with a facet, in bytes.
pub(super) const MIN_BINARY_BYTES: usize = HEADER_BYTES + FACET_BYTES;

/// Whether a file of this length has exactly as many facets as its header counts.
pub(super) fn length_fits(head: &[u8], length: Option<u64>) -> bool {
    let (Some(count), Some(length)) = (declared_facets(head), length) else { return false };
    length == HEADER_BYTES as u64 + FACET_BYTES as u64 * u64::from(count)
}

/// The facet count in a binary header.
fn declared_facets(head: &[u8]) -> Option<u32> {
    head.get(80..HEADER_BYTES)?.try_into().ok().map(u32::from_le_bytes)
}

/// Whether the first bytes start as ASCII STL does, and continue with facets or at least without binary data.
pub(super) fn starts_as_text(head: &[u8]) -> bool {
    let mut text = Text::new(head);
    let Some(first) = text.word() else { return false };
    if !first.is("solid") && !first.is("facet") {
        return false;
    }
    // A binary file's header can contain `solid` and even `facet`, but never `vertex` with a number.
    while let Some(word) = text.word() {
        if word.is("vertex") && text.clone().word().is_some_and(|next| number(next.bytes).is_some()) {
            return true;
        }
        if word.is("endsolid") {
            return true;
        }
    }
    !head.contains(&0)
}

/// Whether facets may follow a header with a wrong count: at least one record, and 90 % of the numbers of plausible magnitude.
pub(super) fn looks_like_facets(head: &[u8]) -> bool {
    let facets = head.get(HEADER_BYTES..).unwrap_or_default().chunks_exact(FACET_BYTES);
    let mut numbers = 0_u32;
    let mut usual = 0_u32;
    for facet in facets {
        for value in facet[..48].chunks_exact(4).map(float) {
            let size = value.abs();
            numbers += 1;
            usual += u32::from(size == 0.0 || (1e-20..1e20).contains(&size) || value.is_nan());
        }
    }
    numbers > 0 && usual * 10 >= numbers * 9
}

/// The f32 at the start of four little-endian bytes.
fn float(bytes: &[u8]) -> f32 {
    f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
}

/// Reads binary or ASCII STL.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<ReadMesh, ReadError> {
    let head = &bytes[..bytes.len().min(SNIFFED_BYTES)];
    if !length_fits(head, Some(bytes.len() as u64)) && starts_as_text(head) {
        read_ascii(bytes, limits)
    } else {
        read_binary(bytes, limits)
    }
}

/// How many facets to read, if the header declares `declared` and `length` bytes follow it.
fn facets_to_read(declared: u32, length: usize, warnings: &mut Vec<String>) -> Result<usize, ReadError> {
    let (whole, rest) = (length / FACET_BYTES, length % FACET_BYTES);
    let count = usize::try_from(declared).unwrap_or(usize::MAX);
    if count > whole {
        if whole == 0 {
            return Err(ReadError::at_byte(
                ReadErrorKind::Truncated,
                HEADER_BYTES + length,
                format!(
                    "the header counts {declared} facets, but the file ends before the first facet is complete; send the file again"
                ),
            ));
        }
        let cut = if rest > 0 { ", and the last facet is cut off" } else { "" };
        warnings.push(format!(
            "the header counts {declared} facets, but the file has bytes for {whole}{cut}; the {whole} complete facets were read"
        ));
        Ok(whole)
    } else if count == 0 && whole > 0 {
        warnings
            .push(format!("the header counts 0 facets, but bytes for {whole} facets follow; {whole} facets were read"));
        if rest > 0 {
            warnings.push(format!("{rest} bytes after the last complete facet were ignored"));
        }
        Ok(whole)
    } else if count == 0 {
        Err(ReadError::for_file(
            ReadErrorKind::NoFaces,
            "the STL file counts 0 facets and holds none; export the model again",
        ))
    } else {
        let left = length - count * FACET_BYTES;
        if left >= FACET_BYTES {
            warnings.push(format!(
                "the header counts {declared} facets, but bytes for {whole} follow; {declared} facets were read and {left} bytes ignored"
            ));
        } else if left > 0 {
            warnings.push(format!("{left} bytes after the last facet were ignored"));
        }
        Ok(count)
    }
}

fn read_binary(bytes: &[u8], limits: &Limits) -> Result<ReadMesh, ReadError> {
    let length = bytes.len();
    let Some(declared) = declared_facets(bytes) else {
        return Err(ReadError::at_byte(
            ReadErrorKind::Truncated,
            length,
            format!(
                "the file ends within the {HEADER_BYTES}-byte header of binary STL; it was cut off, so send it again"
            ),
        ));
    };
    let body = &bytes[HEADER_BYTES..];
    let mut warnings = Vec::new();
    let facets = facets_to_read(declared, body.len(), &mut warnings)?;
    limits.check_faces(facets as u64)?;
    limits.check_vertices(3 * facets as u64)?;
    let mut positions = Vec::with_capacity(3 * facets);
    let mut normals = FacetNormals::default();
    for (facet, number) in body.chunks_exact(FACET_BYTES).take(facets).zip(0..) {
        let [normal, corners @ ..] = [0, 12, 24, 36].map(|at| [0, 4, 8].map(|k| float(&facet[at + k..])));
        let corners = corners.map(|corner| DVec3::from_array(corner.map(f64::from)));
        positions.extend(corners);
        normals.add(number, normal, corners);
    }
    let (soup, dialect, normals) = (unindexed(positions), "binary STL".to_owned(), normals.finish());
    Ok(ReadMesh { normals, warnings, ..ReadMesh::of(soup, Format::Stl, dialect) })
}

/// Collects facet normals while they are read. A zero normal asks the reader to compute it, so it counts as absent. Normals that agree with
/// their corners carry no information, so only opposed normals are stored.
#[derive(Debug, Default)]
struct FacetNormals {
    opposed: Vec<(u32, [f32; 3])>,
    has_any: bool,
}

impl FacetNormals {
    /// Takes the normal of a facet; facets come in order.
    #[inline]
    fn add(&mut self, facet: u32, normal: [f32; 3], [a, b, c]: [DVec3; 3]) {
        if normal == [0.0; 3] {
            return;
        }
        self.has_any = true;
        // Products of f32 values neither overflow nor underflow in f64. Comparisons with not-a-number are false.
        if (b - a).cross(c - a).dot(DVec3::from_array(normal.map(f64::from))) < 0.0 {
            self.opposed.push((facet, normal));
        }
    }

    /// The collected normals; `None` if no facet had a normal.
    fn finish(self) -> Option<CornerNormals> {
        self.has_any.then_some(CornerNormals::OfFaces { opposed: self.opposed })
    }
}

/// A mesh with three positions for each face, in order.
fn unindexed(positions: Vec<DVec3>) -> Soup {
    // Limits keep the number of positions below 2^32.
    let count = u32::try_from(positions.len() / 3).unwrap_or(u32::MAX / 3);
    Soup { positions, faces: (0..count).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect() }
}

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

/// Reader of ASCII STL.
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

fn read_ascii(bytes: &[u8], limits: &Limits) -> Result<ReadMesh, ReadError> {
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
        let dialect = "ASCII STL".to_owned();
        let (soup, normals) = (unindexed(self.positions), self.normals.finish());
        Ok(ReadMesh { normals, warnings, ..ReadMesh::of(soup, Format::Stl, dialect) })
    }
}

fn is_keyword(word: Word<'_>) -> bool {
    ["outer", "loop", "vertex", "endloop", "endfacet", "facet", "endsolid"].iter().any(|k| word.is(k))
}

/// Writes binary STL. Normals are computed from the corners after rounding to f32.
///
/// # Errors
/// [`WriteError`] for more than `u32::MAX` faces, or for a coordinate that is not finite as f32.
pub(super) fn write(soup: &Soup) -> Result<Vec<u8>, WriteError> {
    let faces = soup.faces.len() as u64;
    let count = u32::try_from(faces).map_err(|_| WriteError::TooManyFaces { faces, max: u64::from(u32::MAX) })?;
    let mut bytes = Vec::with_capacity(HEADER_BYTES + FACET_BYTES * soup.faces.len());
    // The header must not start with `solid`, because some readers would take the file for ASCII.
    bytes.extend_from_slice(b"meshmend");
    bytes.resize(80, 0);
    bytes.extend_from_slice(&count.to_le_bytes());
    for (face, vertices) in soup.faces.iter().enumerate() {
        let corners = soup.corners(face).map(DVec3::as_vec3);
        if let Some(k) = corners.iter().position(|corner| !corner.is_finite()) {
            let exact = soup.corners(face)[k].to_array();
            #[expect(clippy::cast_possible_truncation, reason = "tests whether the cast is finite")]
            let value = exact.into_iter().find(|&value| !(value as f32).is_finite()).unwrap_or(f64::NAN);
            return Err(WriteError::OutOfRange { vertex: vertices[k], value });
        }
        // Products of f32 values neither overflow nor underflow in f64.
        let [a, b, c] = corners.map(glam::Vec3::as_dvec3);
        let normal = (b - a).cross(c - a).normalize_or_zero().as_vec3();
        for corner in [normal].into_iter().chain(corners) {
            for value in corner.to_array() {
                bytes.extend_from_slice(&value.to_le_bytes());
            }
        }
        bytes.extend_from_slice(&[0, 0]);
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_binary_header_that_contains_solid_and_facet_is_not_text() {
        let mut head = b"solid of 12 facets".to_vec();
        head.resize(80, b' ');
        head.extend([7, 0, 0, 0].into_iter().chain([0; 200]));
        assert!(!starts_as_text(&head));
    }
}
