use std::path::{Path, PathBuf};

/// The files and folders that a program needs beside those of the system: where it is installed, and the environment where it is
/// a Python. None that holds `private` is among them.
#[must_use]
pub fn installation(program: &Path, private: &Path) -> Vec<PathBuf> {
    let real = program.canonicalize().unwrap_or_else(|_| program.to_owned());
    let mut needed = vec![program.to_owned(), real.clone()];
    for path in [program, &real] {
        let Some(folder) = path.parent() else { continue };
        let Some(around) = folder.parent().filter(|_| folder.ends_with("bin")) else {
            needed.push(folder.to_owned());
            continue;
        };
        if around.join("pyvenv.cfg").is_file() {
            needed.push(around.to_owned());
        } else {
            // Not the folder around them, which may be somebody's home.
            needed.extend(["bin", "lib", "lib64", "share"].map(|name| around.join(name)));
        }
    }
    let holds_private = |path: &Path| path.canonicalize().is_ok_and(|path| private.starts_with(path));
    needed.retain(|path| !holds_private(path));
    needed.sort();
    needed.dedup();
    needed
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::*;

    fn file(path: &Path) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "").unwrap();
    }

    #[test]
    fn a_program_needs_the_folder_that_it_is_installed_in_and_the_one_behind_a_link() {
        let root = tempfile::tempdir().unwrap();
        let (real, link) = (root.path().join("blender-4.5/blender"), root.path().join("bin/blender"));
        file(&real);
        fs::create_dir(root.path().join("bin")).unwrap();
        symlink(&real, &link).unwrap();
        let needed = installation(&link, &root.path().join("data"));
        assert!(
            needed.contains(&root.path().join("blender-4.5")) && needed.contains(&root.path().join("lib")),
            "{needed:?}"
        );
        assert!(!needed.contains(&root.path().to_owned()), "{needed:?}");
    }

    #[test]
    fn a_python_needs_its_environment_and_the_library_of_the_python_behind_it() {
        let root = tempfile::tempdir().unwrap();
        let (real, link) = (root.path().join("python-3.11/bin/python3.11"), root.path().join("venv/bin/python"));
        file(&real);
        file(&root.path().join("venv/pyvenv.cfg"));
        fs::create_dir(root.path().join("venv/bin")).unwrap();
        symlink(&real, &link).unwrap();
        let needed = installation(&link, &root.path().join("data"));
        assert!(needed.contains(&root.path().join("venv")), "{needed:?}");
        assert!(needed.contains(&root.path().join("python-3.11/lib")), "{needed:?}");
    }

    #[test]
    fn a_folder_that_holds_what_is_private_is_not_given_for_a_program_in_it() {
        let root = tempfile::tempdir().unwrap();
        let program = root.path().join("data/blender");
        file(&program);
        let private = root.path().join("data").canonicalize().unwrap();
        assert_eq!(installation(&program, &private), [program.canonicalize().unwrap()]);
    }
}
