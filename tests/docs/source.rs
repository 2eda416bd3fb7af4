//! What the code says of its enums, since a document of the API has no room for it.

use std::path::{Path, PathBuf};

use crate::pages::root;

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let files = entries.flat_map(|path| if path.is_dir() { rust_files(&path) } else { vec![path] });
    files.filter(|path| path.extension().is_some_and(|it| it == "rs")).collect()
}

/// What is said of each variant of an enum, in the order of the code.
pub fn variants(name: &str) -> Vec<String> {
    let before = format!("pub enum {name} {{\n");
    let texts = rust_files(&root().join("src")).into_iter().map(|path| std::fs::read_to_string(path).unwrap());
    let found: Vec<_> = texts.filter_map(|text| Some(text.split_once(&before)?.1.to_owned())).collect();
    assert_eq!(found.len(), 1, "enums {name}");
    let body = found[0].split("\n}").next().unwrap();
    let mut docs = Vec::new();
    let mut said = String::new();
    for line in body.lines().map(str::trim) {
        if let Some(words) = line.strip_prefix("///") {
            said.push_str(words);
        } else if !line.starts_with('#') && !line.is_empty() {
            docs.push(std::mem::take(&mut said).trim().to_owned());
        }
    }
    assert!(docs.iter().all(|it| !it.is_empty()), "{name}: {docs:?}");
    docs
}
