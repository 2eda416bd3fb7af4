//! The files through which the engine and the Blender script exchange meshes.

use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;

/// The first bytes of an exchange file. Then follow the counts of vertices and of faces as u64, three f32 per vertex, and three
/// u32 per face, all little-endian. The script has the same constant.
const MAGIC: [u8; 8] = *b"MMSOUP01";
const HEADER_BYTES: u64 = 24;
const ROW_BYTES: u64 = 12;

/// A mesh in Blender's precision.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct RawMesh {
    /// Vertex positions.
    pub(super) positions: Vec<[f32; 3]>,
    /// Triangles, as indices of vertices.
    pub(super) faces: Vec<[u32; 3]>,
}

/// Why a result file can't be used. The texts continue the sentence "the program ended, but ...".
#[derive(Debug, thiserror::Error)]
pub(super) enum ReadResultError {
    /// The file does not exist.
    #[error("left no result file")]
    Missing,
    /// The file's content is invalid.
    #[error("its result file {0}")]
    Malformed(String),
    /// The result has more faces than requested.
    #[error("its result has {0} faces")]
    TooManyFaces(u64),
    /// The file could not be read.
    #[error("its result file could not be read: {0}")]
    Io(#[from] io::Error),
}

/// Writes `mesh` to a new file.
pub(super) fn write(path: &Path, mesh: &RawMesh) -> io::Result<()> {
    let mut file = BufWriter::with_capacity(1 << 16, File::create_new(path)?);
    file.write_all(&MAGIC)?;
    file.write_all(&(mesh.positions.len() as u64).to_le_bytes())?;
    file.write_all(&(mesh.faces.len() as u64).to_le_bytes())?;
    for coordinate in mesh.positions.iter().flatten() {
        file.write_all(&coordinate.to_le_bytes())?;
    }
    for corner in mesh.faces.iter().flatten() {
        file.write_all(&corner.to_le_bytes())?;
    }
    file.into_inner().map_err(io::IntoInnerError::into_error)?.flush()
}

/// The largest size in bytes of a result with `max_faces` faces: three vertices per face at worst.
pub(super) fn max_bytes(max_faces: u64) -> u64 {
    max_faces.saturating_mul(4 * ROW_BYTES).saturating_add(HEADER_BYTES)
}

/// Reads a result as untrusted input. It must be a regular file; its counts must match its size before memory is allocated;
/// positions must be finite and corners in range.
pub(super) fn read(path: &Path, max_faces: u64) -> Result<RawMesh, ReadResultError> {
    let malformed = |reason: String| ReadResultError::Malformed(reason);
    // Opening a pipe would block, and a link could lead to another file.
    match fs::symlink_metadata(path) {
        Ok(metadata) if metadata.is_file() => {}
        Ok(_) => return Err(malformed("is not a regular file".to_owned())),
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(ReadResultError::Missing),
        Err(error) => return Err(error.into()),
    }
    let file = File::open(path)?;
    let size = file.metadata()?.len();
    if size < HEADER_BYTES {
        return Err(malformed(format!("has {size} bytes; expected at least {HEADER_BYTES}")));
    }
    let mut file = BufReader::with_capacity(1 << 16, file);
    if read_array::<8>(&mut file)? != MAGIC {
        return Err(malformed("does not begin with the expected bytes".to_owned()));
    }
    let vertices = u64::from_le_bytes(read_array(&mut file)?);
    let faces = u64::from_le_bytes(read_array(&mut file)?);
    if faces > max_faces {
        return Err(ReadResultError::TooManyFaces(faces));
    }
    let expected = vertices.checked_add(faces).and_then(|rows| rows.checked_mul(ROW_BYTES)?.checked_add(HEADER_BYTES));
    if expected != Some(size) || vertices > u64::from(u32::MAX) || size > max_bytes(max_faces).max(1 << 20) {
        return Err(malformed(format!("has {size} bytes, which does not match {vertices} vertices and {faces} faces")));
    }
    let mut mesh = RawMesh::default();
    for _ in 0..vertices {
        let position = read_row(&mut file)?.map(f32::from_le_bytes);
        if !position.iter().all(|c| c.is_finite()) {
            return Err(malformed(format!("has the non-finite position {position:?}")));
        }
        mesh.positions.push(position);
    }
    for _ in 0..faces {
        let face = read_row(&mut file)?.map(u32::from_le_bytes);
        if !face.iter().all(|&corner| u64::from(corner) < vertices) {
            return Err(malformed(format!("has the face {face:?}, but only {vertices} vertices")));
        }
        mesh.faces.push(face);
    }
    Ok(mesh)
}

fn read_array<const N: usize>(file: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn read_row(file: &mut impl Read) -> io::Result<[[u8; 4]; 3]> {
    let [a, b, c, d, e, f, g, h, i, j, k, l] = read_array(file)?;
    Ok([[a, b, c, d], [e, f, g, h], [i, j, k, l]])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> RawMesh {
        RawMesh { positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], faces: vec![[0, 1, 2]] }
    }

    fn read_bytes(bytes: &[u8], max_faces: u64) -> Result<RawMesh, ReadResultError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result");
        fs::write(&path, bytes).unwrap();
        read(&path, max_faces)
    }

    fn bytes_of(mesh: &RawMesh) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result");
        write(&path, mesh).unwrap();
        fs::read(path).unwrap()
    }

    #[test]
    fn a_written_mesh_is_read_back() {
        assert_eq!(read_bytes(&bytes_of(&triangle()), 1).unwrap(), triangle());
    }

    #[test]
    fn a_truncated_or_too_long_file_is_refused() {
        let whole = bytes_of(&triangle());
        for end in 0..whole.len() {
            let error = read_bytes(&whole[..end], 1).unwrap_err();
            assert!(matches!(error, ReadResultError::Malformed(_)), "cut at {end}: {error}");
        }
        let mut longer = whole;
        longer.push(0);
        assert!(matches!(read_bytes(&longer, 1), Err(ReadResultError::Malformed(_))));
    }

    #[test]
    fn huge_counts_are_refused_before_memory_is_allocated() {
        let mut bytes = bytes_of(&triangle());
        bytes[8..16].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(matches!(read_bytes(&bytes, 1), Err(ReadResultError::Malformed(_))));
        bytes[8..16].copy_from_slice(&(u64::MAX / 12).to_le_bytes());
        assert!(matches!(read_bytes(&bytes, 1), Err(ReadResultError::Malformed(_))));
    }

    #[test]
    fn a_header_alone_reports_too_many_faces() {
        let mut bytes = bytes_of(&triangle());
        bytes.truncate(24);
        bytes[16..24].copy_from_slice(&77u64.to_le_bytes());
        assert!(matches!(read_bytes(&bytes, 76), Err(ReadResultError::TooManyFaces(77))));
    }

    #[test]
    fn corners_out_of_range_and_non_finite_positions_are_refused() {
        let mut corner = triangle();
        corner.faces[0][1] = 3;
        assert!(matches!(read_bytes(&bytes_of(&corner), 1), Err(ReadResultError::Malformed(_))));
        let mut position = triangle();
        position.positions[2][1] = f32::NAN;
        assert!(matches!(read_bytes(&bytes_of(&position), 1), Err(ReadResultError::Malformed(_))));
    }

    #[test]
    fn a_missing_file_and_a_folder_give_different_errors() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(read(&folder.path().join("none"), 1), Err(ReadResultError::Missing)));
        assert!(matches!(read(folder.path(), 1), Err(ReadResultError::Malformed(_))));
    }
}
