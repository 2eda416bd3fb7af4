use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;

/// First bytes of a file that goes to or comes from the script; then the counts of vertices and of faces as u64, three
/// f32 a vertex, three u32 a face, all little-endian. The script has the same constant.
const MAGIC: [u8; 8] = *b"MMSOUP01";
const HEADER_BYTES: u64 = 24;
const ROW_BYTES: u64 = 12;

/// A mesh as Blender keeps it.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct RawMesh {
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) faces: Vec<[u32; 3]>,
}

/// Why a result file is no result.
#[derive(Debug, thiserror::Error)]
pub(super) enum ReadResultError {
    #[error("it left no result file")]
    Missing,
    #[error("its result file {0}")]
    Malformed(String),
    #[error("{0} faces")]
    TooManyFaces(u64),
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

/// Most bytes that a result with `most_faces` faces may have: three vertices a face at worst.
pub(super) fn most_bytes(most_faces: u64) -> u64 {
    most_faces.saturating_mul(4 * ROW_BYTES).saturating_add(HEADER_BYTES)
}

/// Reads a result. Nothing is believed: it must be a plain file, its counts must agree with its size before anything
/// is allocated, positions must be finite and corners in range.
pub(super) fn read(path: &Path, most_faces: u64) -> Result<RawMesh, ReadResultError> {
    let malformed = |what: String| ReadResultError::Malformed(what);
    // Opening a pipe would block, and a link could lead anywhere.
    match fs::symlink_metadata(path) {
        Ok(found) if found.is_file() => {}
        Ok(_) => return Err(malformed("is no plain file".to_owned())),
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
        return Err(malformed("does not begin as agreed".to_owned()));
    }
    let vertices = u64::from_le_bytes(read_array(&mut file)?);
    let faces = u64::from_le_bytes(read_array(&mut file)?);
    if faces > most_faces {
        return Err(ReadResultError::TooManyFaces(faces));
    }
    let expected = vertices.checked_add(faces).and_then(|rows| rows.checked_mul(ROW_BYTES)?.checked_add(HEADER_BYTES));
    if expected != Some(size) || vertices > u64::from(u32::MAX) || size > most_bytes(most_faces).max(1 << 20) {
        return Err(malformed(format!("has {size} bytes, which disagrees with {vertices} vertices and {faces} faces")));
    }
    let mut mesh = RawMesh::default();
    for _ in 0..vertices {
        let position = read_row(&mut file)?.map(f32::from_le_bytes);
        if !position.iter().all(|c| c.is_finite()) {
            return Err(malformed(format!("has a position that is not finite, {position:?}")));
        }
        mesh.positions.push(position);
    }
    for _ in 0..faces {
        let face = read_row(&mut file)?.map(u32::from_le_bytes);
        if !face.iter().all(|&corner| u64::from(corner) < vertices) {
            return Err(malformed(format!("has a face {face:?} with only {vertices} vertices")));
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

    fn read_bytes(bytes: &[u8], most_faces: u64) -> Result<RawMesh, ReadResultError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result");
        fs::write(&path, bytes).unwrap();
        read(&path, most_faces)
    }

    fn bytes_of(mesh: &RawMesh) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result");
        write(&path, mesh).unwrap();
        fs::read(path).unwrap()
    }

    #[test]
    fn what_is_written_is_read() {
        assert_eq!(read_bytes(&bytes_of(&triangle()), 1).unwrap(), triangle());
    }

    #[test]
    fn a_file_cut_anywhere_or_with_bytes_to_spare_is_refused() {
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
    fn huge_counts_are_refused_before_anything_is_allocated() {
        let mut bytes = bytes_of(&triangle());
        bytes[8..16].copy_from_slice(&u64::MAX.to_le_bytes());
        assert!(matches!(read_bytes(&bytes, 1), Err(ReadResultError::Malformed(_))));
        bytes[8..16].copy_from_slice(&(u64::MAX / 12).to_le_bytes());
        assert!(matches!(read_bytes(&bytes, 1), Err(ReadResultError::Malformed(_))));
    }

    #[test]
    fn a_header_alone_tells_that_there_are_too_many_faces() {
        let mut bytes = bytes_of(&triangle());
        bytes.truncate(24);
        bytes[16..24].copy_from_slice(&77u64.to_le_bytes());
        assert!(matches!(read_bytes(&bytes, 76), Err(ReadResultError::TooManyFaces(77))));
    }

    #[test]
    fn corners_out_of_range_and_positions_that_are_not_finite_are_refused() {
        let mut corner = triangle();
        corner.faces[0][1] = 3;
        assert!(matches!(read_bytes(&bytes_of(&corner), 1), Err(ReadResultError::Malformed(_))));
        let mut position = triangle();
        position.positions[2][1] = f32::NAN;
        assert!(matches!(read_bytes(&bytes_of(&position), 1), Err(ReadResultError::Malformed(_))));
    }

    #[test]
    fn no_file_and_a_folder_in_its_place_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(read(&folder.path().join("none"), 1), Err(ReadResultError::Missing)));
        assert!(matches!(read(folder.path(), 1), Err(ReadResultError::Malformed(_))));
    }
}
