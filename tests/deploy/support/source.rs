//! Files of the repository.

use std::path::{Path, PathBuf};

use serde_json::Value;

pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

pub fn text(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The documents of a YAML file.
pub fn yaml(path: &str) -> Vec<Value> {
    serde_saphyr::from_multiple(&text(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Every file in a folder and its subfolders.
pub fn files(folder: &str) -> Vec<PathBuf> {
    let entries =
        std::fs::read_dir(root().join(folder)).expect("a folder").map(|entry| entry.expect("an entry").path());
    let inner = |path: &Path| path.strip_prefix(root()).expect("inside").to_str().expect("UTF-8").to_owned();
    entries.flat_map(|path| if path.is_dir() { files(&inner(&path)) } else { vec![path] }).collect()
}

/// The path and text of every file in docker/ and deploy/.
pub fn shipped() -> Vec<(String, String)> {
    let files = files("deploy").into_iter().chain(files("docker"));
    let read = |path: PathBuf| (path.display().to_string(), std::fs::read_to_string(&path).expect("text"));
    files.map(read).collect()
}

/// The names in a text that begin with `prefix`; `goes_on` says which characters may follow.
pub fn names<'a>(text: &'a str, prefix: &str, goes_on: fn(char) -> bool) -> Vec<&'a str> {
    let found = text.match_indices(prefix).filter(|(at, _)| !text[..*at].ends_with(|c: char| goes_on(c)));
    found
        .map(|(at, _)| {
            let rest = &text[at..];
            &rest[..rest.find(|c: char| !goes_on(c)).unwrap_or(rest.len())]
        })
        .collect()
}

pub fn strings(list: &Value) -> Vec<String> {
    list.as_array().into_iter().flatten().map(|item| item.as_str().expect("a string").to_owned()).collect()
}
