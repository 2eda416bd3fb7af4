//! Hostile archives and sidecar files. `threemf/archive.rs` tests the archive itself too.

use std::time::{Duration, Instant};

use meshmend::format::{Limits, ReadErrorKind, ReadOptions, read, read_scene};
use proptest::prelude::*;

use super::{PNG, TRIANGLE, assert_no, clean, colors, mesh, read_files};
use crate::support::archives::{headers, overwrite, package, replaced};

fn in_time<T>(run: impl FnOnce() -> T) -> T {
    let begin = Instant::now();
    let answer = run();
    assert!(begin.elapsed() < Duration::from_secs(5), "took {:?}", begin.elapsed());
    answer
}

#[test]
fn an_archive_that_unpacks_to_far_more_is_refused_unread() {
    let bomb = vec![b' '; 65 << 20];
    let bytes = package(&[("a.obj", TRIANGLE), ("bomb.txt", &bomb)]);
    assert!(bytes.len() < 100_000);
    assert_no(&bytes, ReadErrorKind::TooLarge, &["over the limit of 67108864"]);
    // The model in the archive is subject to the size limit of a file.
    let long = [TRIANGLE, &vec![b'\n'; 100_000]].concat();
    let bytes = package(&[("a.obj", &long)]);
    let limits = Limits { max_bytes: 20_000, ..Limits::default() };
    let error = read(&bytes, &limits).unwrap_err();
    assert!(error.kind == ReadErrorKind::TooLarge && error.detail.contains("a.obj has 100032 bytes"), "{error}");
}

#[test]
fn more_entries_than_any_model_has_are_refused() {
    let names: Vec<String> = (0..10_001).map(|n| format!("{n}.txt")).collect();
    let files: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), &b""[..])).collect();
    assert_no(&package(&files), ReadErrorKind::TooLarge, &["more than 10000 entries"]);
    // The maximum number of entries is searched quickly, though no name shows which entry is the model.
    let unnamed: Vec<String> = (0..9_999).map(|n| format!("{n}")).collect();
    let mut files: Vec<(&str, &[u8])> = unnamed.iter().map(|name| (name.as_str(), &b"just words"[..])).collect();
    files.push(("thing", TRIANGLE));
    in_time(|| clean(&files));
}

#[test]
fn entries_that_overlap_lead_out_or_are_there_twice_are_refused() {
    let bytes = package(&[("aa/model.obj", TRIANGLE), ("bb/other.txt", b"x")]);
    let mut overlapping = bytes.clone();
    let (local, _) = headers(&bytes, "aa/model.obj");
    let (_, central) = headers(&bytes, "bb/other.txt");
    overwrite(&mut overlapping, central + 42, &(local as u32).to_le_bytes());
    assert_no(&overlapping, ReadErrorKind::Malformed, &["overlap"]);
    for out in ["../model.obj", "C:/model.obj", "///model.obj"] {
        let bytes = replaced(bytes.clone(), "aa/model.obj", out);
        assert_no(&bytes, ReadErrorKind::Malformed, &["points outside", "model.obj"]);
    }
    assert_no(&package(&[("a.obj", TRIANGLE), ("A.OBJ", TRIANGLE)]), ReadErrorKind::Malformed, &["two entries"]);
}

#[test]
fn a_model_that_is_encrypted_or_damaged_is_refused_and_a_side_file_left_out() {
    let obj = [&b"mtllib c.mtl\nusemtl red\n"[..], TRIANGLE].concat();
    let bytes = package(&[("model.obj", &obj), ("c.mtl", b"newmtl red\nKd 1 0 0\n")]);
    let with = |name: &str, change: &dyn Fn(&mut [u8], usize, usize)| {
        let mut bytes = bytes.clone();
        let (local, central) = headers(&bytes, name);
        change(&mut bytes, local, central);
        bytes
    };
    let encrypt = |bytes: &mut [u8], local: usize, central: usize| {
        bytes[local + 6] |= 1;
        bytes[central + 8] |= 1;
    };
    let miscount = |bytes: &mut [u8], local: usize, central: usize| {
        overwrite(bytes, local + 14, &[1; 4]);
        overwrite(bytes, central + 16, &[1; 4]);
    };
    assert_no(&with("model.obj", &encrypt), ReadErrorKind::UnsupportedFormat, &["model.obj is encrypted"]);
    assert_no(&with("model.obj", &miscount), ReadErrorKind::Malformed, &["model.obj can't be unpacked"]);
    for change in [&encrypt as &dyn Fn(&mut [u8], usize, usize), &miscount] {
        let file = read_scene(&with("c.mtl", change), &ReadOptions::default()).unwrap();
        assert!(mesh(&file).paint.is_empty());
        assert!(file.warnings.iter().any(|warning| warning.contains("'c.mtl'")), "{:?}", file.warnings);
    }
}

#[test]
fn an_archive_that_was_cut_off_is_answered_wherever_that_was() {
    let bytes = package(&[("model.obj", TRIANGLE), ("c.mtl", b"newmtl red\n")]);
    for end in 4..bytes.len() {
        let error = read_scene(&bytes[..end], &ReadOptions::default()).unwrap_err();
        assert!(error.kind == ReadErrorKind::Truncated && error.detail.contains("send it again"), "{end}: {error}");
    }
}

#[test]
fn an_invalid_library_is_ignored() {
    let obj = |library: &str| [format!("mtllib {library}\nusemtl red\n").as_bytes(), TRIANGLE].concat();
    for (library, content) in [
        ("m.obj", &b""[..]),
        ("c.mtl", b"mtllib c.mtl\nmtllib m.obj\n"),
        ("c.mtl", b"\xFF\xFE\0newmtl\nnewmtl \nKd\nmap_Kd\nmap_Kd -clamp\nTr\nd -halo\n"),
        ("c.mtl", PNG),
    ] {
        let result = read_files(&[("m.obj", &obj(library)), ("c.mtl", content)]).unwrap();
        assert_eq!(
            (mesh(&result).soup.faces.len(), mesh(&result).paint.len(), result.warnings.len()),
            (1, 0, 1),
            "{:?}",
            result.warnings
        );
    }
}

#[test]
fn libraries_without_end_are_read_in_good_time() {
    let mtl = [b"newmtl red\nKd 1 0 0\n".as_slice(), &b"newmtl x\nKd 0 0 0\n".repeat(50_000)].concat();
    let words = format!("mtllib {}\n", "c.mtl ".repeat(200_000));
    let lines: String = (0..100_000).map(|number| format!("mtllib x{number}.mtl\n")).collect();
    for statements in [words, lines, "mtllib c.mtl\n".repeat(100_000)] {
        let obj = [statements.as_bytes(), b"usemtl red\n", TRIANGLE].concat();
        let result = in_time(|| read_files(&[("m.obj", &obj), ("c.mtl", &mtl)]).unwrap());
        assert_eq!(mesh(&result).soup.faces.len(), 1);
        assert!(result.warnings.iter().all(|warning| warning.len() < 300), "{:?}", result.warnings);
    }
}

#[test]
fn places_and_materials_without_end_are_read_in_good_time_within_the_limits() {
    let mtl: &[u8] = b"newmtl wood\nKd 1 0 0\nmap_Kd wood.png\n";
    let obj = [
        &b"mtllib c.mtl\nusemtl wood\nv 0 0 0\nv 1 0 0\nv 0 1 0\n"[..],
        &b"vt 0 0\n".repeat(1_000_000),
        b"f 1/1 2/2 3/3\nf 1/1 2/2 3/4\n",
    ]
    .concat();
    let bytes = package(&[("m.obj", &obj), ("c.mtl", mtl), ("wood.png", PNG)]);
    let limits = Limits { max_vertices: 3, ..Limits::default() };
    let result = in_time(|| read_scene(&bytes, &ReadOptions::within(limits)).unwrap());
    assert_eq!(colors(&result), [None, Some([[255, 0, 0, 255]; 3])], "the fourth texture coordinate is over the limit");
    let changes =
        "usemtl wood\nusemtl x\nusemtl\n".repeat(300_000) + &"usemtl wood\nf 1 2 3\nusemtl y\nf 1 2 3\n".repeat(50_000);
    let names: String = (0..200_000).map(|number| format!("usemtl {number}\nf 1 2 3\n")).collect();
    for more in [changes, names] {
        let obj = [b"mtllib c.mtl\n", TRIANGLE, more.as_bytes()].concat();
        let result = in_time(|| read_files(&[("m.obj", &obj), ("c.mtl", mtl), ("wood.png", PNG)]).unwrap());
        assert!(result.warnings.len() <= 2, "{:?}", result.warnings);
    }
}

#[test]
fn a_picture_that_many_materials_have_is_kept_once() {
    let picture = [PNG, &vec![7; 1 << 20]].concat();
    let materials: String = (0..2000).map(|number| format!("newmtl {number}\nmap_Kd p.png\n")).collect();
    let faces: String = (0..2000).map(|number| format!("usemtl {number}\nf 1/1 2/1 3/1\n")).collect();
    let obj = [&b"mtllib c.mtl\nvt 0 0\n"[..], TRIANGLE, faces.as_bytes()].concat();
    let result = in_time(|| clean(&[("m.obj", &obj), ("c.mtl", materials.as_bytes()), ("p.png", &picture)]));
    assert_eq!((result.scene.textures.len(), result.scene.palettes.len()), (1, 2000));
}

#[test]
fn pictures_of_gltf_that_name_one_file_over_and_over_are_bounded() {
    let picture = [PNG, &vec![7; 4 << 20]].concat();
    let many = |what: &dyn Fn(usize) -> String| (0..100).map(what).collect::<Vec<_>>().join(",");
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{}]}}],
        "materials":[{}],"textures":[{}],"images":[{}],"buffers":[{{"uri":"data:;base64,{}","byteLength":36}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}}],"accessors":[{{"bufferView":0,"componentType":5126,"type":"VEC3","count":3}},
        {{"componentType":5126,"type":"VEC2","count":3}}]}}"#,
        many(&|n| format!(r#"{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"material":{n}}}"#)),
        many(&|n| format!(r#"{{"pbrMetallicRoughness":{{"baseColorTexture":{{"index":{n}}}}}}}"#)),
        many(&|n| format!(r#"{{"source":{n}}}"#)),
        many(&|_| r#"{"uri":"p.png"}"#.to_owned()),
        "A".repeat(48),
    );
    let result = in_time(|| read_files(&[("s.gltf", json.as_bytes()), ("p.png", &picture)]).unwrap());
    let bytes: usize = result.scene.textures.iter().map(|texture| texture.bytes.len()).sum();
    assert!(bytes > 64 << 20 && bytes <= 128 << 20, "{bytes}");
    assert!(result.warnings.iter().any(|warning| warning.contains("'p.png'")), "{:?}", result.warnings);
}

/// Keywords of OBJ and MTL.
const WORDS: [&str; 28] = [
    "\n",
    "\n",
    "\nv",
    "\nvt",
    "\nf",
    "\nusemtl",
    "\nmtllib",
    "\nnewmtl",
    "\nKd",
    "\nd",
    "\nTr",
    "\nmap_Kd",
    "-clamp",
    "on",
    "-s",
    "c.mtl",
    "p.png",
    "a",
    "(null)",
    "color_FF0000",
    "0",
    "1",
    "-1",
    "0.5",
    "255",
    "nan",
    "1/1",
    "-1/-1/-1",
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn any_words_of_a_model_and_a_library_are_answered(
        obj in prop::collection::vec(0..WORDS.len(), 0..60),
        mtl in prop::collection::vec(0..WORDS.len(), 0..60),
    ) {
        let text = |words: &[usize]| words.iter().map(|&word| WORDS[word]).collect::<Vec<_>>().join(" ");
        let obj = [b"mtllib c.mtl\nvt 0 0\n", TRIANGLE, text(&obj).as_bytes()].concat();
        let whole = in_time(|| read_files(&[("m.obj", &obj), ("c.mtl", text(&mtl).as_bytes()), ("p.png", PNG)]));
        match (whole, read(&obj, &Limits::default())) {
            // Compared as text, since NaN is not equal to itself.
            (Ok(file), Ok(alone)) => prop_assert_eq!(format!("{:?}", mesh(&file).soup), format!("{:?}", alone.soup)),
            (Err(error), Err(alone)) => prop_assert_eq!((error.kind, error.place), (alone.kind, alone.place)),
            (one, other) => prop_assert!(false, "{:?} and {:?}", one, other),
        }
    }
}
