use std::collections::BTreeSet;
use std::path::Path;

/// Names for the drawings of several files in one folder.
#[derive(Debug, Default)]
pub struct Prefixes {
    used: BTreeSet<String>,
}

impl Prefixes {
    /// What the names of a file's drawings begin with: its name without ending, and a number where that is taken. Names
    /// that differ in case only count as equal, as they do on some disks.
    pub fn of(&mut self, path: &Path) -> String {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut prefix = format!("{stem}-");
        let mut number = 1;
        while !self.used.insert(prefix.to_lowercase()) {
            number += 1;
            prefix = format!("{stem}-{number}-");
        }
        prefix
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_files_share_a_prefix() {
        let mut prefixes = Prefixes::default();
        let given = ["a/x.stl", "b/X.obj", "x-2.stl", "x", "x.2.stl"].map(|path| prefixes.of(Path::new(path)));
        assert_eq!(given, ["x-", "X-2-", "x-2-2-", "x-3-", "x.2-"]);
    }
}
