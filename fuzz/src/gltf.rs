//! glTF's reader and writer on any bytes: a GLB file, or a document as text with its buffer in it.

use meshmend::format::{Format, Limits, ReadOptions, read_scene, write_scene};

const LIMITS: Limits = Limits { max_bytes: 1 << 20, max_faces: 4000, max_vertices: 12_000 };

/// Reads the bytes, and writes what was read twice.
///
/// # Panics
/// Where a reader or writer panics, or what is written can't be read, or reads as something else.
pub fn gltf(bytes: &[u8]) {
    let first = match read_scene(bytes, &ReadOptions::within(LIMITS)) {
        Ok(first) if first.format == Format::Glb => first,
        Ok(_) => return,
        Err(error) => return assert!(!error.detail.is_empty() && error.detail.len() < 700, "{error}"),
    };
    // What is larger than f32, or more places than may be, can't be written.
    let Ok(written) = write_scene(&first.scene, Format::Glb) else { return };
    let second = read_scene(&written, &ReadOptions::default())
        .unwrap_or_else(|error| panic!("what is written is refused: {error}"));
    let again = write_scene(&second.scene, Format::Glb);
    assert!(again.as_ref() == Ok(&written), "what is written reads as something else");
}
