//! 3MF files whose ZIP headers are wrong.

use meshmend::format::{Limits, ReadErrorKind, ReadOptions, read_scene};

use super::{MESH, ROOT, assert_no, clean, file_with, model, package};
use crate::support::archives::{headers, overwrite, replaced};

fn text() -> String {
    model("", &format!("<object id=\"1\">{MESH}</object>"), "<item objectid=\"1\"/>")
}

#[test]
fn an_archive_that_unpacks_to_far_more_is_refused_unread() {
    let bomb = vec![b' '; 65 << 20];
    let bytes = file_with(&text(), &[("3D/bomb", &bomb)]);
    assert!(bytes.len() < 100_000);
    assert_no(&bytes, ReadErrorKind::TooLarge, "over the limit of 67108864");
    let limits = Limits { max_bytes: 1000, ..Limits::default() };
    let small = file_with(&text(), &[("3D/more", &vec![b' '; 10_000])]);
    let error = read_scene(&small, &ReadOptions::within(Limits { max_bytes: small.len() as u64, ..limits }));
    assert_eq!(error.unwrap_err().kind, ReadErrorKind::TooLarge);
}

#[test]
fn a_part_is_not_read_beyond_the_size_in_its_entry() {
    let mut bytes = file_with(&text(), &[]);
    let (local, central) = headers(&bytes, ROOT);
    for at in [local + 22, central + 24] {
        overwrite(&mut bytes, at, &100_u32.to_le_bytes());
    }
    let error = read_scene(&bytes, &ReadOptions::default()).unwrap_err();
    assert!(matches!(error.kind, ReadErrorKind::Malformed | ReadErrorKind::TooLarge), "{error}");
}

#[test]
fn a_size_of_64_bits_that_no_archive_has_is_refused() {
    let mut bytes = file_with(&text(), &[]);
    let (_, central) = headers(&bytes, ROOT);
    overwrite(&mut bytes, central + 24, &u32::MAX.to_le_bytes());
    let error = read_scene(&bytes, &ReadOptions::default()).unwrap_err();
    assert!(matches!(error.kind, ReadErrorKind::TooLarge | ReadErrorKind::Truncated), "{error}");
}

#[test]
fn a_checksum_that_is_wrong_is_found() {
    let mut bytes = file_with(&text(), &[]);
    let (local, central) = headers(&bytes, ROOT);
    for at in [local + 14, central + 16] {
        overwrite(&mut bytes, at, &1_u32.to_le_bytes());
    }
    assert_no(&bytes, ReadErrorKind::Malformed, "can't be unpacked");
}

#[test]
fn more_entries_than_any_model_has_are_refused() {
    let names: Vec<String> = (0..10_001).map(|n| format!("{n}")).collect();
    let parts: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), &b""[..])).collect();
    assert_no(&package(&parts), ReadErrorKind::TooLarge, "more than 10000 entries");
}

#[test]
fn entries_that_share_their_bytes_are_refused() {
    let mut bytes = file_with(&text(), &[("3D/other", b"x")]);
    let (local, _) = headers(&bytes, ROOT);
    let (_, central) = headers(&bytes, "3D/other");
    overwrite(&mut bytes, central + 42, &(local as u32).to_le_bytes());
    assert_no(&bytes, ReadErrorKind::Malformed, "overlap");
}

#[test]
fn names_that_lead_out_of_the_archive_are_refused() {
    let bytes = file_with(&text(), &[("aa/other", b"x")]);
    clean(&bytes);
    assert_no(
        &replaced(bytes.clone(), "aa/other", "../other"),
        ReadErrorKind::Malformed,
        "'../other' has a name that points outside",
    );
    assert_no(&replaced(bytes, "aa/other", "C:\\other"), ReadErrorKind::Malformed, "points outside");
}

#[test]
fn two_entries_of_one_name_are_refused() {
    let bytes = file_with(&text(), &[("3d/3dMODEL.model", b"x")]);
    assert_no(&bytes, ReadErrorKind::Malformed, "two entries");
    let bytes = file_with(&text(), &[("3D/3dmodem.model", b"x")]);
    assert_no(&replaced(bytes, "3dmodem", "3dmodel"), ReadErrorKind::Malformed, "two entries");
}

#[test]
fn encryption_and_unsupported_compression_are_named() {
    let bytes = file_with(&text(), &[]);
    let (local, central) = headers(&bytes, ROOT);
    let mut encrypted = bytes.clone();
    for at in [local + 6, central + 8] {
        encrypted[at] |= 1;
    }
    assert_no(&encrypted, ReadErrorKind::UnsupportedFormat, "is encrypted");
    let mut bzip2 = bytes;
    for at in [local + 8, central + 10] {
        overwrite(&mut bzip2, at, &12_u16.to_le_bytes());
    }
    assert_no(&bzip2, ReadErrorKind::UnsupportedFormat, "create the archive with the usual deflate");
}

#[test]
fn an_archive_that_was_cut_off_is_named() {
    let bytes = file_with(&text(), &[]);
    assert_no(&bytes[..bytes.len() / 2], ReadErrorKind::Truncated, "3MF file has no readable directory");
    assert_no(
        b"PK\x03\x04\x14\0\0\0\x08\0model.stl",
        ReadErrorKind::Truncated,
        "ZIP archive has no readable directory",
    );
}
