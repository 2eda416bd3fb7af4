//! OFF: element counts, vertices and polygons as text (Geomview manual, "OFF: OFF Files").

use std::fmt::Write as _;

use glam::DVec3;

use super::content::{Polygons, ReadMesh};
use super::errors::{ReadError, ReadErrorKind, excerpt};
use super::faces::FaceCollector;
use super::formats::Format;
use super::limits::ReadOptions;
use super::text::{Text, Word};
use crate::mesh::Soup;

/// Minimum bytes of a vertex (`0 0 0` and a line end) and of a face (`0` and a line end).
const MIN_VERTEX_BYTES: u64 = 6;
const MIN_FACE_BYTES: u64 = 2;

/// Reads text OFF with any of its prefixes, such as COFF and NOFF.
pub(super) fn read(bytes: &[u8], options: &ReadOptions) -> Result<ReadMesh, ReadError> {
    let limits = &options.limits;
    let mut text = Text::new(bytes).with_comments();
    let mut warnings = Vec::new();
    let Some(first) = text.word() else { return Err(text.ended("the keyword OFF")) };
    let (dialect, count) = if is_off_keyword(first.bytes) {
        (dialect(&text, first)?, None)
    } else {
        warnings.push("the file does not start with the keyword OFF; it was read as OFF".to_owned());
        ("OFF".to_owned(), Some(first))
    };
    let vertices = match count {
        Some(word) => count_of(&text, word, "vertices")?,
        None => next_count(&mut text, "vertices")?,
    };
    let counts_at = text.at();
    let faces = next_count(&mut text, "faces")?;
    // The edge count may be missing, and nothing uses it.
    text.skip_line();

    let remaining = text.remaining() as u64;
    let min_bytes = vertices.saturating_mul(MIN_VERTEX_BYTES).saturating_add(faces.saturating_mul(MIN_FACE_BYTES));
    // The last line may have no line end.
    if min_bytes > remaining + 2 {
        return Err(text.error(
            ReadErrorKind::Truncated,
            counts_at,
            format!(
                "the header counts {vertices} vertices and {faces} faces, but {remaining} bytes can't hold them; the file is cut off or damaged, so export the model again"
            ),
        ));
    }
    limits.check_vertices(vertices)?;
    limits.check_faces(faces)?;
    let positions = read_vertices(&mut text, vertices)?;
    let (soup_faces, polygons) = read_faces(&mut text, &positions, faces, options, &mut warnings)?;
    if text.word().is_some() {
        warnings.push("text after the last face was ignored".to_owned());
    }
    if soup_faces.is_empty() {
        let detail = if vertices > 0 && faces == 0 {
            format!(
                "the OFF file holds {vertices} vertices and no faces, so it is a point cloud; reconstruct a surface from it first"
            )
        } else if faces > 0 {
            format!("none of the OFF file's {faces} faces has three or more corners; export the model again")
        } else {
            "the OFF file holds no vertices and no faces; export the model again".to_owned()
        };
        return Err(ReadError::for_file(ReadErrorKind::NoFaces, detail));
    }
    let soup = Soup { positions, faces: soup_faces };
    Ok(ReadMesh { polygons, warnings, ..ReadMesh::of(soup, Format::Off, dialect) })
}

/// Whether a word is `OFF` with the prefixes that the Geomview manual allows: `[ST][C][N][4][n]OFF`.
pub(super) fn is_off_keyword(word: &[u8]) -> bool {
    let Some((prefix, keyword)) = word.split_at_checked(word.len().saturating_sub(3)) else { return false };
    if !keyword.eq_ignore_ascii_case(b"off") {
        return false;
    }
    let mut rest = prefix;
    for part in [&b"ST"[..], b"C", b"N", b"4", b"n"] {
        if rest.len() >= part.len() && rest[..part.len()].eq_ignore_ascii_case(part) {
            rest = &rest[part.len()..];
        }
    }
    rest.is_empty()
}

/// The dialect's name. Rejects binary OFF, and dialects whose vertices do not have three coordinates.
fn dialect(text: &Text<'_>, keyword: Word<'_>) -> Result<String, ReadError> {
    let name = String::from_utf8_lossy(keyword.bytes).into_owned();
    let prefix = &keyword.bytes[..keyword.bytes.len() - 3];
    // NOFF has normals, nOFF has n dimensions: only the letter's case differs.
    let of_n_dimensions = prefix.last() == Some(&b'n') && keyword.bytes.ends_with(b"OFF");
    if prefix.contains(&b'4') || of_n_dimensions {
        return Err(text.error(
            ReadErrorKind::UnsupportedFormat,
            keyword.at,
            format!(
                "the file is {name}, whose vertices do not have three coordinates; export OFF with three coordinates, or STL, OBJ or PLY"
            ),
        ));
    }
    let mut rest = text.clone();
    if rest.word_on_line().is_some_and(|word| word.is("binary")) {
        return Err(text.error(
            ReadErrorKind::UnsupportedFormat,
            keyword.at,
            "the file is binary OFF, which can't be read; export OFF as text, or STL, OBJ or PLY",
        ));
    }
    Ok(name.to_ascii_uppercase())
}

fn next_count(text: &mut Text<'_>, element: &str) -> Result<u64, ReadError> {
    let Some(word) = text.word() else { return Err(text.ended(&format!("the count of {element}"))) };
    count_of(text, word, element)
}

fn count_of(text: &Text<'_>, word: Word<'_>, element: &str) -> Result<u64, ReadError> {
    let count = text.integer(word, &format!("the count of {element}"))?;
    u64::try_from(count).map_err(|_| {
        text.error(
            ReadErrorKind::Malformed,
            word.at,
            format!("the count of {element} is {count}; a count can't be below zero, so export the model again"),
        )
    })
}

/// Reads the first three numbers of each line; colours, normals and texture coordinates may follow them.
fn read_vertices(text: &mut Text<'_>, count: u64) -> Result<Vec<DVec3>, ReadError> {
    // The caller has checked that the file is long enough for `count` vertices.
    let mut positions = Vec::with_capacity(usize::try_from(count).unwrap_or(0));
    for vertex in 0..count {
        let mut position = [0.0; 3];
        for value in &mut position {
            let Some(word) = text.word() else {
                return Err(text.ended(&format!("vertex {vertex} of {count}")));
            };
            *value = text.number(word, "a coordinate of a vertex")?;
        }
        text.skip_line();
        positions.push(DVec3::from_array(position));
    }
    Ok(positions)
}

/// Reads faces: a corner count and as many indices on each line; a colour may follow.
fn read_faces(
    text: &mut Text<'_>,
    positions: &[DVec3],
    count: u64,
    options: &ReadOptions,
    warnings: &mut Vec<String>,
) -> Result<(Vec<[u32; 3]>, Polygons), ReadError> {
    let capacity = count.min(text.remaining() as u64 / MIN_FACE_BYTES + 1);
    let mut faces = FaceCollector::new(options, usize::try_from(capacity).unwrap_or(0));
    let mut corners = Vec::new();
    for face in 0..count {
        let Some(word) = text.word() else {
            return Err(text.ended(&format!("face {face} of {count}")));
        };
        let size = count_of(text, word, "corners of a face")?;
        corners.clear();
        for _ in 0..size {
            let Some(word) = text.word() else {
                return Err(text.ended(&format!("a corner of face {face} of {count}")));
            };
            let index = text.integer(word, "the index of a vertex")?;
            match u32::try_from(index) {
                Ok(vertex) if (vertex as usize) < positions.len() => corners.push(vertex),
                _ => {
                    return Err(text.error(
                        ReadErrorKind::IndexOutOfRange,
                        word.at,
                        format!(
                            "face {face} refers to vertex {}, but the file has {} vertices, counted from 0; export the model again",
                            excerpt(word.bytes),
                            positions.len()
                        ),
                    ));
                }
            }
            options.limits.check_faces((corners.len() as u64).saturating_sub(2))?;
        }
        text.skip_line();
        faces.polygon(positions, &corners)?;
    }
    Ok(faces.finish(positions, warnings))
}

/// Writes OFF. Each f64 is the shortest decimal that parses to the same value.
pub(super) fn write(soup: &Soup) -> Vec<u8> {
    let mut text = String::with_capacity(32 + 48 * soup.positions.len() + 24 * soup.faces.len());
    // Writing to a String can't fail.
    let _ = writeln!(text, "OFF\n{} {} 0", soup.positions.len(), soup.faces.len());
    for p in &soup.positions {
        let _ = writeln!(text, "{} {} {}", p.x, p.y, p.z);
    }
    for [a, b, c] in &soup.faces {
        let _ = writeln!(text, "3 {a} {b} {c}");
    }
    text.into_bytes()
}
