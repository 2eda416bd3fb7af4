//! PLY: elements of named properties, as text or binary of either byte order (Turk, "The PLY Polygon File Format", 1994).

mod colors;
mod elements;
mod header;
mod values;
mod write;

use super::content::Painted;
use super::errors::{ReadError, ReadErrorKind};
use super::{Format, ReadMesh, ReadOptions};
use elements::{Elements, Read};
use header::{Encoding, Header, Role};
use values::{AsciiValues, BinaryValues};
pub(super) use write::{write, write_painted};

/// Reads PLY of any encoding, with its colours where they are asked for.
pub(super) fn read(bytes: &[u8], options: &ReadOptions, painted: bool) -> Result<Painted, ReadError> {
    let header = Header::read(bytes)?;
    header.check_counts(bytes.len(), &options.limits)?;
    let body = header.body;
    let Read { soup, normals, polygons, paints, warnings } = match header.encoding {
        Encoding::Ascii => Elements::new(AsciiValues::new(bytes, body), options, painted).read(&header)?,
        Encoding::BinaryLittleEndian => {
            Elements::new(BinaryValues::<true>::new(bytes, body), options, painted).read(&header)?
        }
        Encoding::BinaryBigEndian => {
            Elements::new(BinaryValues::<false>::new(bytes, body), options, painted).read(&header)?
        }
    };
    if soup.faces.is_empty() {
        return Err(no_faces(&header));
    }
    let dialect = header.encoding.dialect().to_owned();
    let mesh = ReadMesh { normals, polygons, warnings, ..ReadMesh::of(soup, Format::Ply, dialect) };
    Ok(Painted { mesh, paints })
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
