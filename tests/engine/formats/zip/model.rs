//! Which file of a ZIP archive is the model.

use meshmend::format::{Format, Limits, ReadErrorKind, ReadOptions, read, read_scene, sniff, write};
use meshmend::repair::Options;

use super::super::{corners, tetrahedron};
use super::{TRIANGLE, assert_no, clean, mesh, read_files};
use crate::support::archives::package;
use crate::support::repair_bytes;

const NO: ReadErrorKind = ReadErrorKind::UnsupportedFormat;

#[test]
fn a_single_model_of_any_format_is_read() {
    for format in Format::ALL.into_iter().filter(|&format| format != Format::Zip) {
        let alone = write(&tetrahedron(), format).unwrap();
        let bytes = package(&[("parts/thing", &alone)]);
        let named = package(&[(&format!("parts/thing.{}", format.extension()), &alone)]);
        for bytes in [&named, &bytes] {
            // Without the file name an archive that looks like 3MF could be an office document.
            if format == Format::ThreeMf && bytes != &named {
                assert_no(bytes, NO, &["no supported model"]);
                continue;
            }
            let found = read(bytes, &Limits::default()).unwrap();
            let expected = read(&alone, &Limits::default()).unwrap();
            assert_eq!(found.format, if format == Format::Obj { Format::Zip } else { format });
            assert_eq!(found.dialect, format!("{} in a ZIP archive", expected.dialect));
            assert_eq!((&found.soup, &found.normals), (&expected.soup, &expected.normals));
            let scene = read_scene(bytes, &ReadOptions::default()).unwrap();
            assert_eq!((scene.format, &scene.dialect), (found.format, &found.dialect));
            assert_eq!(corners(&scene.scene.placed(9).unwrap().soup), corners(&expected.soup));
            assert_eq!(found.warnings, Vec::<String>::new());
        }
    }
}

#[test]
fn common_sidecar_files_are_not_taken_for_models() {
    let file = clean(&[
        ("__MACOSX/._thing.obj", b"v 1 2 3\nf 1 1 1\n"),
        (".DS_Store", TRIANGLE),
        ("thing/.hidden/other.obj", TRIANGLE),
        ("thing/README.txt", b"v 1 2 3 is a vertex"),
        ("thing/LICENSE.pdf", b"%PDF-1.7"),
        ("thing/photo.jpg", b"\xFF\xD8\xFF"),
        ("thing/notes", b"just words"),
        ("thing/thing.obj", TRIANGLE),
        ("thing/thing.mtl", b"newmtl x\n"),
    ]);
    assert_eq!((file.format, mesh(&file).soup.faces.len()), (Format::Zip, 1));
    assert_eq!(file.dialect, "OBJ in a ZIP archive");
}

#[test]
fn a_model_is_recognized_by_its_content_whatever_its_name() {
    let stl = write(&tetrahedron(), Format::Stl).unwrap();
    assert_eq!(read_files(&[("thing.obj", &stl)]).unwrap().format, Format::Stl);
    // A file with a model's extension is preferred to one that only looks like a model.
    let read = clean(&[("points", TRIANGLE), ("thing.STL", &stl)]);
    assert_eq!(read.format, Format::Stl);
    // A game engine (OGRE) also uses the extension `.mesh`.
    assert_eq!(clean(&[("game.mesh", b"[MeshSerializer_v1.100]"), ("thing.stl", &stl)]).format, Format::Stl);
}

#[test]
fn several_models_are_named_and_none_is_taken() {
    let stl = write(&tetrahedron(), Format::Stl).unwrap();
    let bytes = package(&[("a.stl", &stl), ("b/c.obj", TRIANGLE)]);
    assert_no(&bytes, NO, &["2 models", "a.stl, b/c.obj", "send each"]);
    let names: Vec<String> = (0..50).map(|number| format!("{number}{}.obj", "x".repeat(200))).collect();
    let files: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), TRIANGLE)).collect();
    assert_no(&package(&files), NO, &["50 models", "and 46 more"]);
}

#[test]
fn an_archive_without_a_model_names_what_is_in_it() {
    let bytes = package(&[("a.txt", b"words"), ("b.png", super::PNG)]);
    assert_no(&bytes, NO, &["no supported model", "a.txt, b.png", "add one STL, OBJ"]);
    let office = package(&[("[Content_Types].xml", b"<Types/>"), ("word/document.xml", b"<w/>")]);
    assert_no(&office, ReadErrorKind::Malformed, &["_rels/.rels"]);
}

#[test]
fn a_model_that_can_not_be_read_says_why() {
    assert_no(&package(&[("a.stl", b"hello world")]), ReadErrorKind::UnknownFormat, &["a.stl", "'hello world'"]);
    let step = package(&[("a.obj", b"ISO-10303-21;\nHEADER;")]);
    assert_no(&step, NO, &["a.obj", "STEP"]);
    let error = read_files(&[("x/a.obj", b"v 0 0 0\nf 1 2 3\n")]).unwrap_err();
    assert_eq!(
        (error.kind, error.place),
        (ReadErrorKind::IndexOutOfRange, Some(meshmend::format::FileLocation::Line(2)))
    );
    assert!(error.detail.starts_with("in the archive's file x/a.obj: a face refers to vertex 3"), "{error}");
}

#[test]
fn an_archive_in_an_archive_is_not_opened() {
    let inner = package(&[("a.obj", TRIANGLE)]);
    assert_no(&package(&[("inner.zip", &inner)]), NO, &["no supported model", "inner.zip"]);
    assert_no(&package(&[("inner.obj", &inner)]), NO, &["inner.obj", "another ZIP archive"]);
    assert_no(&package(&[("inner.3mf", &inner)]), NO, &["inner.3mf", "no 3MF model"]);
}

#[test]
fn an_archive_with_a_3mf_model_is_3mf_whatever_comes_first_in_it() {
    let parts = [
        ("model.obj", TRIANGLE),
        ("_rels/.rels", b"<Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\"><Relationship Id=\"r\" Type=\"http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel\" Target=\"/a.model\"/></Relationships>"),
        ("a.model", b"<model xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\"><resources><object id=\"1\"><mesh><vertices><vertex x=\"0\" y=\"0\" z=\"0\"/><vertex x=\"1\" y=\"0\" z=\"0\"/><vertex x=\"0\" y=\"1\" z=\"0\"/></vertices><triangles><triangle v1=\"0\" v2=\"1\" v3=\"2\"/></triangles></mesh></object></resources><build><item objectid=\"1\"/></build></model>"),
    ];
    let filler = "x".repeat(5000);
    for first in ["a", filler.as_str()] {
        let mut files: Vec<(&str, &[u8])> = vec![("first.txt", first.as_bytes())];
        files.extend(parts);
        let result = read_files(&files).unwrap();
        assert_eq!((result.format, result.dialect.as_str()), (Format::ThreeMf, "3MF"));
    }
    let mut stored = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let plain = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, content) in [("first.txt", filler.as_bytes())].into_iter().chain(parts) {
        stored.start_file(name, plain).unwrap();
        std::io::Write::write_all(&mut stored, content).unwrap();
    }
    let bytes = stored.finish().unwrap().into_inner();
    assert_eq!(sniff(&bytes, None), Ok(Format::Zip), "the head of the file shows no more");
    assert_eq!(read_scene(&bytes, &ReadOptions::default()).unwrap().format, Format::ThreeMf);
}

#[test]
fn a_result_is_never_the_archive_instead_of_its_model() {
    let stl = write(&tetrahedron(), Format::Stl).unwrap();
    let bytes = package(&[("thing.stl", &stl)]);
    let repaired = repair_bytes(&bytes, &Options::default(), None).unwrap();
    assert_eq!(
        (repaired.format, sniff(&repaired.bytes, Some(repaired.bytes.len() as u64))),
        (Format::Stl, Ok(Format::Stl))
    );
}
