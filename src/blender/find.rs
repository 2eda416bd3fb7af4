use std::ffi::OsStr;
use std::fmt;
use std::io::ErrorKind;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::memory::{Slot, count, half_of_memory, prepare, take, usual_folder};
use super::process::{isolate, run};
use crate::repair::{RemesherInfo, monotonic_clock};

/// Where Blender is and what it may use.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BlenderConfig {
    /// Blender, or a Python whose `import bpy` works; a name without a slash is looked up on `PATH`. When given,
    /// nothing else is tried. The service takes it from `MESHMEND_BLENDER`.
    pub program: Option<PathBuf>,
    /// Existing folder in which each run makes a private folder of its own; the system's temporary folder if none.
    pub scratch: Option<PathBuf>,
    /// Most time for asking one program for its version.
    pub probe_time: Duration,
    /// Most memory in bytes that an action may take beyond what the program has taken when it is up; 0 for no limit.
    pub memory: u64,
    /// Most memory in bytes that all programs on this machine may take together, which is how many may run at once; half of
    /// the machine's if none.
    pub memory_together: Option<u64>,
    /// Folder of the locks by which all processes that may run a program here wait for one another; one for each user in `/tmp`
    /// if none.
    pub slots: Option<PathBuf>,
    /// Start the program as leader of a process group of its own. Not for a caller that ends its work by killing its
    /// process group.
    pub own_process_group: bool,
}

impl Default for BlenderConfig {
    fn default() -> Self {
        Self {
            program: None,
            scratch: None,
            probe_time: Duration::from_secs(60),
            memory: 4 << 30,
            memory_together: None,
            slots: None,
            own_process_group: false,
        }
    }
}

impl BlenderConfig {
    /// How many programs may run at once on this machine.
    #[must_use]
    pub fn at_once(&self) -> u32 {
        count(self.memory, self.memory_for_all())
    }

    /// Memory in bytes that all programs on this machine may take together.
    #[must_use]
    pub fn memory_for_all(&self) -> u64 {
        self.memory_together.unwrap_or_else(half_of_memory)
    }

    /// The programs that are tried, in order. None of them has been run.
    #[must_use]
    pub fn candidates(&self) -> Vec<PathBuf> {
        candidates(self, &std::env::var_os("PATH").unwrap_or_default())
    }

    /// Makes the locks by which programs wait for one another, and gives their folder: for a process that is about to lose
    /// the right to make them. Whoever may read them may lock them.
    ///
    /// # Errors
    /// The operating system's.
    pub fn prepare_slots(&self) -> std::io::Result<PathBuf> {
        let folder = self.slots_folder();
        prepare(&folder, self.at_once())?;
        Ok(folder)
    }

    /// The folder of the locks by which programs wait for one another.
    #[must_use]
    pub fn slots_folder(&self) -> PathBuf {
        self.slots.clone().unwrap_or_else(usual_folder)
    }

    /// Waits for the right to run one.
    pub(super) fn slot<S>(
        &self,
        waiting: &mut dyn FnMut(),
        watch: &mut dyn FnMut() -> Result<(), S>,
    ) -> std::io::Result<Result<Slot, S>> {
        take(&self.slots_folder(), self.at_once(), waiting, watch)
    }

    /// A new private folder; it is removed when the value is dropped.
    pub(super) fn scratch_folder(&self) -> std::io::Result<tempfile::TempDir> {
        let base = self.scratch.clone().unwrap_or_else(std::env::temp_dir);
        // The program runs inside it, so that a relative path would lead elsewhere.
        tempfile::Builder::new().prefix("meshmend-blender-").tempdir_in(std::path::absolute(base)?)
    }
}

/// A program that was looked at and can't be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rejected {
    /// The program.
    pub program: PathBuf,
    /// Why not.
    pub reason: String,
}

/// There is no Blender: which programs were tried, in order, and why each was passed over.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub struct BlenderMissing {
    /// The programs.
    pub tried: Vec<Rejected>,
}

impl fmt::Display for BlenderMissing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no usable Blender was found")?;
        for Rejected { program, reason } in &self.tried {
            write!(f, "; {} {reason}", program.display())?;
        }
        f.write_str("; install Blender 3.0 or later, or run scripts/install-blender.sh, or set MESHMEND_BLENDER to Blender or to a Python that has bpy")
    }
}

/// The oldest version whose remesh modifier and exact boolean are those of the script.
const OLDEST: (u32, u32) = (3, 0);
/// Kind of a program that is Blender itself.
const BLENDER: &str = "blender";
/// Kind of a Python that has Blender as a module.
pub(super) const BPY: &str = "bpy";
/// The private environment that the install script makes.
const ENVIRONMENT_PYTHON: &str = ".venv-blender/bin/python";
/// Leaves without Python's teardown, which crashes in some builds of bpy.
const ASK_BPY: &str = "import os, sys, bpy; print('bpy', bpy.app.version_string); sys.stdout.flush(); os._exit(0)";

/// Looks for a program: the configured one alone, or else `blender` on `PATH`, then a Python in `.venv-blender` next to
/// the working folder's files, then next to the executable. Each is asked for its version.
pub(super) fn find(config: &BlenderConfig) -> Result<RemesherInfo, BlenderMissing> {
    let mut tried = Vec::new();
    for program in config.candidates() {
        let reason = match probe(&program, config) {
            Ok(info) => return Ok(info),
            Err(reason) => reason,
        };
        tried.push(Rejected { program, reason });
    }
    Err(BlenderMissing { tried })
}

/// What to ask, in order. A configured program is asked even where there is none, so that the answer names it.
fn candidates(config: &BlenderConfig, path: &OsStr) -> Vec<PathBuf> {
    if let Some(program) = &config.program {
        let named = if program.components().count() > 1 || program.is_absolute() {
            std::path::absolute(program).ok()
        } else {
            on_path(program, path)
        };
        return vec![named.unwrap_or_else(|| program.clone())];
    }
    let beside_files = std::env::current_dir().ok();
    let beside_program = std::env::current_exe().ok().and_then(|program| program.parent().map(Path::to_path_buf));
    let mut found: Vec<PathBuf> = on_path(Path::new("blender"), path).into_iter().collect();
    for folder in [beside_files, beside_program].into_iter().flatten() {
        let python = folder.join(ENVIRONMENT_PYTHON);
        if is_program(&python) && !found.contains(&python) {
            found.push(python);
        }
    }
    found
}

/// Entries that are empty or relative mean the working folder, which may hold anyone's files.
fn on_path(name: &Path, path: &OsStr) -> Option<PathBuf> {
    std::env::split_paths(path)
        .filter(|folder| folder.is_absolute())
        .map(|folder| folder.join(name))
        .find(|p| is_program(p))
}

fn is_program(path: &Path) -> bool {
    path.metadata().is_ok_and(|found| found.is_file() && found.permissions().mode() & 0o111 != 0)
}

/// Asks a program what it is.
fn probe(program: &Path, config: &BlenderConfig) -> Result<RemesherInfo, String> {
    let answer = ask(program, &["--version"], config)?;
    let line = |start: &str| answer.iter().find_map(|line| line.strip_prefix(start)).map(str::to_owned);
    let (kind, version) = if let Some(version) = line("Blender ") {
        (BLENDER, version)
    } else if line("Python ").is_some() {
        let answer = ask(program, &["-I", "-c", ASK_BPY], config)?;
        match answer.iter().find_map(|line| line.strip_prefix("bpy ")) {
            Some(version) => (BPY, version.to_owned()),
            None => return Err(format!("is a Python without bpy ({})", last(&answer))),
        }
    } else {
        return Err(format!("is neither Blender nor Python: --version answers '{}'", last(&answer)));
    };
    // Without a suffix such as LTS.
    let version = version.split_whitespace().next().unwrap_or_default().to_owned();
    match parse_version(&version) {
        Some(found) if found >= OLDEST => {}
        Some(_) => return Err(format!("is version {version}; expected 3.0 or later")),
        None => return Err(format!("has a version that can't be read, '{version}'")),
    }
    Ok(RemesherInfo { kind: kind.to_owned(), version, program: program.display().to_string() })
}

/// The lines that a program prints; an error where it does not end well in time.
fn ask(program: &Path, arguments: &[&str], config: &BlenderConfig) -> Result<Vec<String>, String> {
    let scratch = config.scratch_folder().map_err(|error| format!("was not asked: no scratch folder ({error})"))?;
    let mut command = Command::new(program);
    isolate(&mut command, scratch.path());
    command.args(arguments);
    let clock = monotonic_clock();
    let mut lines = Vec::new();
    let ended = run(
        &mut command,
        scratch.path(),
        config.own_process_group,
        &mut |line| lines.push(line.to_owned()),
        &mut || if clock() < config.probe_time { Ok(()) } else { Err(()) },
    );
    match ended {
        Err(error) if error.kind() == ErrorKind::NotFound => Err("does not exist".to_owned()),
        Err(error) => Err(format!("could not be started ({error})")),
        Ok(Err(())) => Err(format!("did not tell its version within {} s", config.probe_time.as_secs_f64())),
        Ok(Ok(status)) if !status.success() => Err(format!("failed when asked ({status}: {})", last(&lines))),
        Ok(Ok(_)) => Ok(lines),
    }
}

/// The last line, not too much of it.
fn last(lines: &[String]) -> String {
    lines.last().map(|line| line.chars().take(200).collect()).unwrap_or_default()
}

/// Major and minor number of a version such as `3.4.1`.
pub(super) fn parse_version(version: &str) -> Option<(u32, u32)> {
    let mut numbers = version.split('.').map(str::parse);
    Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
}

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
mod tests {
    use std::fs;
    use std::os::unix::fs::symlink;

    use super::*;

    fn program(folder: &Path, name: &str, text: &str) -> PathBuf {
        let path = folder.join(name);
        fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        path
    }

    fn found(text: &str) -> Result<RemesherInfo, BlenderMissing> {
        let folder = tempfile::tempdir().unwrap();
        let program = Some(program(folder.path(), "program", text));
        find(&BlenderConfig { program, probe_time: Duration::from_secs(20), ..BlenderConfig::default() })
    }

    fn reason(text: &str) -> String {
        found(text).unwrap_err().tried[0].reason.clone()
    }

    #[test]
    fn blender_tells_its_version() {
        let info =
            found("echo Color management: warning; echo 'Blender 4.5.15 LTS'; echo '  build date: 2026'").unwrap();
        assert_eq!((info.kind.as_str(), info.version.as_str()), ("blender", "4.5.15"));
    }

    #[test]
    fn a_python_with_bpy_is_told_from_blender() {
        let info = found("case $1 in --version) echo Python 3.11.2;; -I) echo bpy 5.0.1;; esac").unwrap();
        assert_eq!((info.kind.as_str(), info.version.as_str()), ("bpy", "5.0.1"));
    }

    #[test]
    fn a_program_that_is_of_no_use_is_rejected_with_the_reason() {
        assert!(
            reason("case $1 in --version) echo Python 3.11.2;; *) echo no module >&2; exit 1;; esac")
                .contains("no module")
        );
        assert!(reason("case $1 in --version) echo Python 3.11.2;; esac").contains("without bpy"));
        assert!(reason("echo Blender 2.79.1").contains("expected 3.0 or later"));
        assert!(reason("echo Blender x.y").contains("can't be read"));
        assert!(reason("echo GNU Hello").contains("neither Blender nor Python"));
        assert!(reason("echo broken library >&2; exit 127").contains("broken library"));
    }

    #[test]
    fn a_missing_program_is_named_together_with_what_to_do() {
        let config = BlenderConfig { program: Some("/nowhere/blender".into()), ..BlenderConfig::default() };
        let message = find(&config).unwrap_err().to_string();
        assert!(message.contains("/nowhere/blender does not exist"), "{message}");
        assert!(message.contains("MESHMEND_BLENDER"), "{message}");
    }

    #[test]
    fn a_program_that_hangs_when_asked_is_given_up() {
        let folder = tempfile::tempdir().unwrap();
        let program = Some(program(folder.path(), "program", "sleep 600"));
        let config = BlenderConfig { program, probe_time: Duration::from_millis(300), ..BlenderConfig::default() };
        assert!(find(&config).unwrap_err().tried[0].reason.contains("did not tell its version"));
    }

    #[test]
    fn a_bare_name_is_looked_up_in_the_absolute_folders_of_the_path() {
        let folder = tempfile::tempdir().unwrap();
        let expected = program(folder.path(), "blender", "");
        fs::write(folder.path().join("data"), "").unwrap();
        let path = std::env::join_paths([Path::new(""), Path::new("relative"), folder.path()]).unwrap();
        assert_eq!(on_path(Path::new("blender"), &path), Some(expected));
        assert_eq!(on_path(Path::new("data"), &path), None);
        assert_eq!(on_path(Path::new("blender"), OsStr::new("")), None);
    }

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
