//! `examples/repair.rs`, the example of the library.

#[path = "../../examples/repair.rs"]
mod repair;

use meshmend::format::{Limits, read};

use crate::files;

#[test]
fn the_example_of_the_library_repairs_a_file_and_tells_what_it_did() {
    let folder = tempfile::tempdir().expect("a folder");
    let (broken, repaired) = (folder.path().join("broken.stl"), folder.path().join("repaired.stl"));
    std::fs::write(&broken, files::broken_box()).expect("a file");
    let mut told = Vec::new();
    repair::repair_file(&broken, &repaired, &mut told).expect("a repair");
    let told = String::from_utf8(told).expect("text");
    assert!(told.contains("printable") && told.contains("holes closed: 1"), "{told}");
    let model = std::fs::read(&repaired).expect("the result");
    assert_eq!(read(&model, &Limits::default()).expect("a model").soup.faces.len(), 12);
}
