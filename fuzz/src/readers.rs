//! Each reader on any bytes.

use meshmend::format::{
    Format, Limits, ReadError, ReadErrorKind, ReadMesh, ReadOptions, read, read_with, sniff, write,
};
use meshmend::mesh::Soup;

/// How many first bytes tell the format.
const HEAD: usize = 4096;

/// Reads the bytes, if they are a file of this format, and says whether they are.
///
/// # Panics
/// Where a reader panics; answers a mesh that is none, is over the limits or is not the same when it is written and read; or an
/// error that says nothing.
pub fn read_as(format: Format, bytes: &[u8]) -> bool {
    let head = sniff(&bytes[..bytes.len().min(HEAD)], Some(bytes.len() as u64));
    if head != Ok(format) {
        return false;
    }
    let defaults = Limits::default();
    // What the file is told apart by does not depend on limits, and where it is within them neither does the mesh.
    let whole = read(bytes, &defaults);
    hold_to_its_word(format, bytes, &whole);
    let tight = Limits { max_faces: 7, max_vertices: 12, ..defaults };
    let within = read_with(bytes, &ReadOptions { limits: tight, twist_angle_deg: 0.0 });
    match &within {
        Ok(mesh) => {
            assert!(mesh.soup.faces.len() <= 7 && mesh.soup.positions.len() <= 21, "over the limits: {mesh:?}");
            assert!(whole.is_ok(), "what is read under tight limits is refused under wide ones: {whole:?}");
        }
        Err(error) => assert!(whole.is_err() || error.kind == ReadErrorKind::TooLarge, "{error}"),
    }
    true
}

fn hold_to_its_word(format: Format, bytes: &[u8], answer: &Result<ReadMesh, ReadError>) {
    let mesh = match answer {
        Ok(mesh) => mesh,
        Err(error) => {
            assert!(!error.detail.is_empty() && error.detail.len() < 600, "{error}");
            return;
        }
    };
    assert_eq!(mesh.format, format);
    assert!(!mesh.soup.faces.is_empty() && mesh.soup.faces.len() <= bytes.len());
    let count = mesh.soup.positions.len() as u32;
    assert!(mesh.soup.faces.iter().flatten().all(|&v| v < count));
    assert!(mesh.warnings.len() <= 6 && !mesh.dialect.is_empty());
    for to in Format::ALL {
        written_and_read(&mesh.soup, to);
    }
}

/// STL and glTF are of single precision, so it is the same from the second time on.
fn written_and_read(soup: &Soup, to: Format) {
    let Ok(once) = write(soup, to) else {
        let says_all = matches!(to, Format::Obj | Format::Ply | Format::Off | Format::Mesh | Format::Zip);
        assert!(!says_all, "{to:?} can say every mesh");
        return;
    };
    let again = read(&once, &Limits::default()).unwrap_or_else(|error| panic!("{to:?} that was written: {error}"));
    assert_eq!(again.format, to);
    match to {
        // STL has no vertices but of faces, and glTF's stand in the order of the faces that use them.
        Format::Stl | Format::Glb => assert_eq!(again.soup.faces.len(), soup.faces.len()),
        _ => assert_eq!((&again.soup.faces, again.soup.positions.len()), (&soup.faces, soup.positions.len()), "{to:?}"),
    }
    assert!(write(&again.soup, to).as_ref() == Ok(&once), "{to:?} is another file the second time");
}
