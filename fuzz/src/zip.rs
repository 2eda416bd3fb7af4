//! The reader and writer of OBJ with its side files on any bytes: an archive, or the texts of a model and its materials, which are packed first.

use meshmend::format::{Format, Limits, ReadOptions, read, read_scene, write_scene};

use super::archive::pack;

const LIMITS: Limits = Limits { max_bytes: 1 << 20, max_faces: 4000, max_vertices: 12_000 };

/// What stands between the texts of a model and of its materials.
const BETWEEN: &[u8] = b"\n---\n";

/// Reads the bytes, with colours and without, and writes what was read twice.
///
/// # Panics
/// Where a reader or writer panics; colours change the shape; or what is written can't be read, or reads as something else.
pub fn zip(bytes: &[u8]) {
    let packed = if bytes.starts_with(b"PK") { bytes.to_owned() } else { pack_texts(bytes) };
    let first = read_scene(&packed, &ReadOptions::within(LIMITS));
    let bare = read(&packed, &LIMITS);
    let (first, bare) = match (first, bare) {
        (Ok(first), Ok(bare)) => (first, bare),
        (Err(_), Err(error)) => {
            assert!(!error.detail.is_empty() && error.detail.len() < 700, "{error}");
            return;
        }
        // Parts in their places may be more than the parts.
        (Ok(first), Err(error)) => return assert!(first.scene.items.len() > 1, "{error}"),
        (Err(error), Ok(_)) => panic!("refused for its colours: {error}"),
    };
    assert_eq!(first.format, bare.format);
    for format in [Format::Zip, Format::Ply] {
        let Ok(written) = write_scene(&first.scene, format) else { continue };
        let second = read_scene(&written, &ReadOptions::default())
            .unwrap_or_else(|error| panic!("{format:?} that is written is refused: {error}"));
        assert_eq!((second.format, second.scene.placed_faces()), (format, bare.soup.faces.len() as u64));
        assert!(second.warnings.is_empty(), "{:?}", second.warnings);
        let again = write_scene(&second.scene, format);
        assert!(again.as_ref() == Ok(&written), "{format:?} that is written reads as something else");
    }
}

fn pack_texts(texts: &[u8]) -> Vec<u8> {
    let cut = texts.windows(BETWEEN.len()).position(|it| it == BETWEEN);
    let (model, materials) = match cut {
        Some(at) => (&texts[..at], &texts[at + BETWEEN.len()..]),
        None => (texts, &b""[..]),
    };
    pack(&[("m/model.obj", model), ("m/c.mtl", materials), ("p.png", b"\x89PNG\r\n\x1A\n")])
}
