//! 3MF's reader and writer on any bytes: an archive, or the text of a model, which is packed first.

use meshmend::format::{Format, Limits, ReadOptions, read_scene, write_scene};

use super::archive::pack;

const LIMITS: Limits = Limits { max_bytes: 1 << 20, max_faces: 4000, max_vertices: 12_000 };

const RELATIONSHIPS: &[u8] = b"<Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\"><Relationship Id=\"r\" Target=\"/3D/3dmodel.model\" Type=\"http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel\"/></Relationships>";

/// Reads the bytes, and writes what was read twice.
///
/// # Panics
/// Where a reader or writer panics, or what is written can't be read, or reads as something else.
pub fn threemf(bytes: &[u8]) {
    let packed = if bytes.starts_with(b"PK") {
        bytes.to_owned()
    } else {
        pack(&[("_rels/.rels", RELATIONSHIPS), ("3D/3dmodel.model", bytes)])
    };
    // Almost any bytes are binary STL, which keeps numbers that are not finite.
    let first = match read_scene(&packed, &ReadOptions::within(LIMITS)) {
        Ok(first) if first.format == Format::ThreeMf => first,
        _ => return,
    };
    let written = write_scene(&first.scene, Format::ThreeMf).expect("what was read has only finite numbers");
    let second = read_scene(&written, &ReadOptions::default())
        .unwrap_or_else(|error| panic!("what is written is refused: {error}"));
    let again = write_scene(&second.scene, Format::ThreeMf).expect("what was read has only finite numbers");
    assert!(written == again, "what is written reads as something else");
}
