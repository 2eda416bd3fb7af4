//! ZIP archives, and changes to their headers after "APPNOTE.TXT - .ZIP File Format Specification", section 4.3.

use std::io::{Cursor, Write};

/// An archive of these files.
pub fn package(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        zip.start_file(*name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn positions(bytes: &[u8], pattern: &[u8]) -> Vec<usize> {
    (0..bytes.len()).filter(|&at| bytes[at..].starts_with(pattern)).collect()
}

/// The offsets of a file's local header and of its entry in the central directory.
pub fn headers(bytes: &[u8], name: &str) -> (usize, usize) {
    let of = |signature: &[u8], to_name: usize| {
        positions(bytes, signature).into_iter().find(|at| bytes[at + to_name..].starts_with(name.as_bytes())).unwrap()
    };
    (of(b"PK\x03\x04", 30), of(b"PK\x01\x02", 46))
}

pub fn overwrite(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes[at..at + value.len()].copy_from_slice(value);
}

/// The bytes with every occurrence of `from` replaced by `to`, which must be as long.
pub fn replaced(mut bytes: Vec<u8>, from: &str, to: &str) -> Vec<u8> {
    for at in positions(&bytes, from.as_bytes()) {
        overwrite(&mut bytes, at, to.as_bytes());
    }
    bytes
}
