//! PLY: elements of named properties, as text or binary of either byte order (Turk, "The PLY Polygon File Format", 1994).

mod elements;
mod header;
mod values;

use super::errors::{ReadError, ReadErrorKind};
use super::{Format, ReadMesh, ReadOptions};
use crate::mesh::Soup;
use elements::{Elements, Read};
use header::{Encoding, Header, Role};
use values::{AsciiValues, BinaryValues};

/// Reads PLY of any encoding.
pub(super) fn read(bytes: &[u8], options: &ReadOptions) -> Result<ReadMesh, ReadError> {
    let header = Header::read(bytes)?;
    header.check_counts(bytes.len(), &options.limits)?;
    let body = header.body;
    let Read { soup, normals, polygons, warnings } = match header.encoding {
        Encoding::Ascii => Elements::new(AsciiValues::new(bytes, body), options).read(&header)?,
        Encoding::BinaryLittleEndian => Elements::new(BinaryValues::<true>::new(bytes, body), options).read(&header)?,
        Encoding::BinaryBigEndian => Elements::new(BinaryValues::<false>::new(bytes, body), options).read(&header)?,
    };
    if soup.faces.is_empty() {
        return Err(no_faces(&header));
    }
    Ok(ReadMesh {
        soup,
        format: Format::Ply,
        dialect: header.encoding.dialect().to_owned(),
        numbering: None,
        normals,
        polygons,
        warnings,
    })
}

fn no_faces(header: &Header) -> ReadError {
    let count = |role| header.elements.iter().filter(|e| e.role == role).map(|e| e.count).sum::<u64>();
    let (vertices, faces) = (count(Role::Vertices), count(Role::Faces) + count(Role::Strips));
    let detail = if faces > 0 {
        format!("none of the PLY file's {faces} faces has three corners; export the model again")
    } else if vertices > 0 {
        format!(
            "the PLY file holds {vertices} vertices and no faces: it is a point cloud; make a surface from it first"
        )
    } else {
        "the PLY file holds no vertices and no faces; export the model again".to_owned()
    };
    ReadError::whole(ReadErrorKind::NoFaces, detail)
}

/// Writes little-endian PLY: coordinates as `float` if each is exactly an f32, else as `double`.
pub(super) fn write(soup: &Soup) -> Vec<u8> {
    #[expect(clippy::cast_possible_truncation, reason = "the very question")]
    let single = soup
        .positions
        .iter()
        .all(|p| p.to_array().into_iter().all(|x| x.is_nan() || f64::from(x as f32).to_bits() == x.to_bits()));
    let kind = if single { "float" } else { "double" };
    // Signed indices are what readers know best.
    let index = if soup.positions.len() > i32::MAX as usize { "uint" } else { "int" };
    let header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment meshmend\nelement vertex {}\nproperty {kind} x\nproperty {kind} y\nproperty {kind} z\nelement face {}\nproperty list uchar {index} vertex_indices\nend_header\n",
        soup.positions.len(),
        soup.faces.len()
    );
    let vertex = if single { 12 } else { 24 };
    let mut bytes = Vec::with_capacity(header.len() + vertex * soup.positions.len() + 13 * soup.faces.len());
    bytes.extend_from_slice(header.as_bytes());
    for value in soup.positions.iter().flat_map(|p| p.to_array()) {
        if single {
            #[expect(clippy::cast_possible_truncation, reason = "exact, as checked")]
            bytes.extend_from_slice(&(value as f32).to_le_bytes());
        } else {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
    }
    for face in &soup.faces {
        bytes.push(3);
        for v in face {
            bytes.extend_from_slice(&v.to_le_bytes());
        }
    }
    bytes
}
