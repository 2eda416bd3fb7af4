//! STL: facets without vertex indices, as 50-byte records or as text (3D Systems, "StereoLithography Interface Specification", 1989).

mod ascii;
mod facets;

use glam::DVec3;

use ascii::read_ascii;
use facets::{FacetNormals, mesh_of};

use super::ReadMesh;
use super::errors::{ReadError, ReadErrorKind, WriteError};
use super::limits::{Limits, SNIFFED_BYTES};
use super::text::{Text, number};
use crate::math::threads;
use crate::mesh::Soup;

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
    let facet = |number: usize| &body[number * FACET_BYTES..(number + 1) * FACET_BYTES];
    let corners = |number: usize| {
        let floats = |at: usize| [0, 4, 8].map(|k| f64::from(float(&facet(number)[at + k..])));
        [12, 24, 36].map(|at| DVec3::from_array(floats(at)))
    };
    let normals = threads::map_chunks(facets, |range| {
        let mut normals = FacetNormals::default();
        for number in range {
            let normal = [0, 4, 8].map(|at| float(&facet(number)[at..]));
            // Limits keep the number of facets below 2^32.
            normals.add(u32::try_from(number).unwrap_or(u32::MAX), normal, corners(number));
        }
        normals
    });
    let normals = normals.into_iter().fold(FacetNormals::default(), FacetNormals::and);
    let soup = Soup::from_corners(facets, corners);
    Ok(mesh_of(soup, "binary STL", normals, warnings))
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
    let written = threads::map_chunks(soup.faces.len(), |range| {
        let mut bytes = Vec::with_capacity(FACET_BYTES * range.len());
        range.into_iter().try_for_each(|face| write_facet(soup, face, &mut bytes)).map(|()| bytes)
    });
    for facets in written {
        bytes.extend_from_slice(&facets?);
    }
    Ok(bytes)
}

/// Writes a face of a soup as a facet.
fn write_facet(soup: &Soup, face: usize, bytes: &mut Vec<u8>) -> Result<(), WriteError> {
    let corners = soup.corners(face).map(DVec3::as_vec3);
    if let Some(k) = corners.iter().position(|corner| !corner.is_finite()) {
        let exact = soup.corners(face)[k].to_array();
        #[expect(clippy::cast_possible_truncation, reason = "tests whether the cast is finite")]
        let value = exact.into_iter().find(|&value| !(value as f32).is_finite()).unwrap_or(f64::NAN);
        return Err(WriteError::OutOfRange { vertex: soup.faces[face][k], value });
    }
    // Products of f32 values neither overflow nor underflow in f64.
    let [a, b, c] = corners.map(glam::Vec3::as_dvec3);
    let normal = (b - a).cross(c - a).normalize_or_zero().as_vec3();
    for value in [normal].into_iter().chain(corners).flat_map(|vector| vector.to_array()) {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes.extend_from_slice(&[0, 0]);
    Ok(())
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
