//! `examples/repair.rs`, the example of the library.

#[path = "../../examples/repair.rs"]
mod repair;

use meshmend::format::{Limits, read};

use crate::files;

#[test]
fn the_library_s_example_repairs_a_file_and_prints_what_it_did() {
    let folder = tempfile::tempdir().expect("a folder");
    let (broken, repaired) = (folder.path().join("broken.stl"), folder.path().join("repaired.stl"));
    std::fs::write(&broken, files::broken_box()).expect("a file");
    let mut output = Vec::new();
    repair::repair_file(&broken, &repaired, &mut output).expect("a repair");
    let output = String::from_utf8(output).expect("text");
    assert!(output.contains("printable") && output.contains("holes closed: 1"), "{output}");
    let model = std::fs::read(&repaired).expect("the result");
    assert_eq!(read(&model, &Limits::default()).expect("a model").soup.faces.len(), 12);
}
