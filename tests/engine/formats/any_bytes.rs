//! Every reader gives a result or an error for any bytes, and in linear time.

use std::time::{Duration, Instant};

use meshmend::format::{Format, Limits, ReadErrorKind, read, sniff, write};
use meshmend::mesh::Soup;
use proptest::prelude::*;

use super::tetrahedron;

/// Asserts what holds for any input: reading ends soon, indices are in range, an error has a message, and the head of
/// the file gives the same format as the whole.
#[track_caller]
fn assert_holds_up(bytes: &[u8]) {
    let begin = Instant::now();
    let answer = read(bytes, &Limits::default());
    assert!(begin.elapsed() < Duration::from_secs(5), "took {:?}", begin.elapsed());
    let sniffed = sniff(&bytes[..bytes.len().min(4096)], Some(bytes.len() as u64));
    match answer {
        Ok(mesh) => {
            // The format in an archive depends on its end.
            let is_archive = matches!(sniffed, Ok(Format::ThreeMf | Format::Zip));
            assert!(is_archive || sniffed == Ok(mesh.format), "{sniffed:?}");
            assert!(!mesh.soup.faces.is_empty());
            assert!(mesh.soup.faces.len() <= bytes.len());
            let count = mesh.soup.positions.len() as u32;
            assert!(mesh.soup.faces.iter().flatten().all(|&v| v < count));
            assert!(mesh.warnings.len() <= 6);
        }
        Err(error) => {
            assert!(!error.detail.is_empty() && error.detail.len() < 600, "{error}");
            let by_name = matches!(
                error.kind,
                ReadErrorKind::Empty | ReadErrorKind::UnknownFormat | ReadErrorKind::UnsupportedFormat
            );
            assert!(by_name || sniffed.is_ok(), "{error}");
        }
    }
}

/// A valid file in each dialect.
fn files() -> Vec<Vec<u8>> {
    let soup: Soup = tetrahedron();
    let mut files: Vec<Vec<u8>> = Format::ALL.iter().map(|&f| write(&soup, f).unwrap()).collect();
    files.push(super::ascii_stl(&soup, "x").into_bytes());
    files.push(b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\nproperty list uchar int vertex_indices\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n5 0 1 2 -1 3\n".to_vec());
    files.push(b"COFF\n5 2 0\n0 0 0 1 1 1\n4 0 0 1 1 1\n1 1 0 1 1 1\n0 4 0 1 1 1\n9 9 9 0 0 0\n4 0 1 2 3\n5 0 1 4 2 3 255 0 0\n".to_vec());
    files.push(b"o x\nv 0 0 0\nv 4 0 0\nv 1 1 0\nv 0 4 0\nvt 0 0\nf 1/1 2/1 3/1 4/1\nf -4 -3 \\\n-1\nl 1 2\n".to_vec());
    files.push(b"Face 7 3 1 2\nVertex 3 0 0 0\nVertex 1 1 0 0\nVertex 2 0 1 0\nFace 9 1 2 8\n".to_vec());
    files
}

/// Keywords of the formats.
const WORDS: [&str; 39] = [
    "solid",
    "facet",
    "normal",
    "outer",
    "loop",
    "vertex",
    "endloop",
    "endfacet",
    "endsolid",
    "\n",
    "\r\n",
    " ",
    "v",
    "f",
    "Vertex 1 0 0 0\n",
    "Face 1",
    "Face 1 1 1 1\n",
    "vt",
    "l",
    "OFF",
    "COFF",
    "4OFF",
    "ply\n",
    "format ascii 1.0\n",
    "element vertex 3\n",
    "element face 1\n",
    "property float x\n",
    "property list uchar int vertex_indices\n",
    "end_header\n",
    "0",
    "1",
    "-1",
    "3",
    "1e999",
    "nan",
    "99999999999",
    "#",
    "\\\n",
    "1/2/3",
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn arbitrary_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        assert_holds_up(&bytes);
    }

    #[test]
    fn arbitrary_words_are_answered(
        start in 0..WORDS.len(),
        words in prop::collection::vec(0..WORDS.len(), 0..120),
        apart in any::<bool>(),
    ) {
        let mut text = WORDS[start].to_owned();
        for word in words {
            if apart {
                text.push(' ');
            }
            text += WORDS[word];
        }
        assert_holds_up(text.as_bytes());
    }

    #[test]
    fn damaged_files_are_answered(
        file in 0..13_usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4_u8), 1..8),
        end in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        let mut bytes = files().swap_remove(file);
        for (at, value, what) in changes {
            let at = at.index(bytes.len());
            match what {
                0 => bytes[at] = value,
                1 => bytes.insert(at, value),
                2 => { bytes.remove(at); }
                _ => bytes[at] ^= 1 << (value % 8),
            }
            if bytes.is_empty() {
                break;
            }
        }
        if cut && !bytes.is_empty() {
            bytes.truncate(end.index(bytes.len()));
        }
        assert_holds_up(&bytes);
    }
}

#[test]
fn files_cut_off_anywhere_are_answered() {
    for file in files() {
        for end in 0..=file.len() {
            assert_holds_up(&file[..end]);
        }
    }
}

#[test]
fn files_with_any_one_byte_changed_are_answered() {
    for file in files() {
        for at in 0..file.len() {
            for value in [0, 0x0A, b' ', b'-', b'9', b'#', b'\\', 0x7F, 0xFF] {
                let mut bytes = file.clone();
                bytes[at] = value;
                assert_holds_up(&bytes);
            }
        }
    }
}

/// Megabytes of repetitions that could make a reader scan the same bytes many times.
#[test]
fn long_repetitions_take_linear_time() {
    let start = |head: &str, part: &str| [head.as_bytes(), &part.as_bytes().repeat(3_000_000 / part.len())].concat();
    for (head, part) in [
        ("solid x\n", "facet "),
        ("solid x\n", "facet normal "),
        ("solid x\n", "solid "),
        ("solid x\n", "solid\n"),
        ("solid x\n", "solid facet\n\n"),
        ("solid x\n", "endsolid facet "),
        ("solid x\n", "x "),
        ("solid x\n", "\n"),
        ("solid ", "x"),
        ("v 0 0 0\n", "f 1 1 1\n"),
        ("v 0 0 0\nf", " 1"),
        ("v 0 0 0\n", "\\\n"),
        ("v 0 0 0\n", "#\n"),
        ("v 0 0 0\n", "f -1 9 9 9\n"),
        ("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n", "f 1 3 2 4 1 3 2 4 1 2\n"),
        ("Vertex 1 0 0 0\n", "Face 1 1 1 1\n"),
        ("Vertex 2 0 0 0\n", "Vertex 1 0 0 0\n"),
        ("Face 1 9 9 9\n", "Face 1 8 7 6\n"),
        ("Vertex 1 0 0 0\n", "x\n"),
        ("OFF\n", "\n"),
        ("OFF\n", "#"),
        ("OFF\n1 1 0\n0 0 0\n999999999 ", "0 "),
        ("ply\n", "comment\n"),
        ("ply\nformat ascii 1.0\n", "element x 0\n"),
        ("ply\nformat ascii 1.0\nelement x 9000000000000000000\n", "property list int int y\n"),
        ("ply\nformat ascii 1.0\nelement x 1\n", "property char y\n"),
        ("ply\n", "x\n"),
        ("", "\n"),
        ("", "<"),
        ("", "{\""),
    ] {
        assert_holds_up(&start(head, part));
    }
}
