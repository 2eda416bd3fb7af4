use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use meshmend::format::{Format, sniff};

/// Bytes that are enough to tell a format.
const HEAD: u64 = 4096;

/// A file to look at.
pub struct Input {
    pub path: PathBuf,
    /// Whether somebody meant it: it was given, or its name ends as a model's does. Other files of a folder only look
    /// like models and may turn out to be none.
    pub named: bool,
}

/// The files that were given, folders replaced by the models in them, in order of their names.
pub fn inputs(given: &[PathBuf]) -> Result<Vec<Input>, String> {
    let mut all = Vec::new();
    for path in given {
        if path.is_dir() {
            let found = models_in(path).map_err(|e| format!("{}: {e}", path.display()))?;
            if found.is_empty() {
                return Err(format!("{}: there is no model in this folder", path.display()));
            }
            all.extend(found);
        } else {
            all.push(Input { path: path.clone(), named: true });
        }
    }
    Ok(all)
}

fn models_in(folder: &Path) -> std::io::Result<Vec<Input>> {
    let mut paths = std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<std::io::Result<Vec<_>>>()?;
    paths.retain(|path| path.is_file());
    paths.sort();
    let inputs = paths.into_iter().map(|path| Input { named: has_ending(&path), path });
    Ok(inputs.filter(|input| input.named || looks_like_a_model(&input.path)).collect())
}

fn has_ending(path: &Path) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    Format::ALL.iter().any(|format| ending.eq_ignore_ascii_case(format.extension()))
}

fn looks_like_a_model(path: &Path) -> bool {
    let Ok(file) = File::open(path) else { return false };
    let length = file.metadata().ok().map(|it| it.len());
    let mut head = Vec::new();
    file.take(HEAD).read_to_end(&mut head).is_ok() && sniff(&head, length).is_ok()
}
