//! The configuration of Blender, and the search for a usable program.

use std::ffi::OsStr;
use std::fmt;
use std::io::ErrorKind;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::memory::{Slot, count, default_folder, half_of_memory, prepare, take};
use super::process::{isolate, run};
use crate::repair::{RemesherInfo, monotonic_clock};

/// The Blender program to use, and the resources that it may use.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BlenderConfig {
    /// Blender, or a Python in which `import bpy` works. A name without a slash is looked up on `PATH`. If set, no other program is
    /// tried. The service reads the path from `MESHMEND_BLENDER`.
    pub program: Option<PathBuf>,
    /// The existing folder in which each run creates its private folder; by default the system's temporary folder.
    pub scratch: Option<PathBuf>,
    /// The time limit for asking a program for its version.
    pub probe_time: Duration,
    /// The most memory that an action may use beyond that of the started program, in bytes; 0 for no limit.
    pub memory: u64,
    /// The most memory that all programs on this machine may use together, in bytes, which limits how many run at once. By default half
    /// of the machine's memory.
    pub memory_together: Option<u64>,
    /// The folder of the slot files by which all processes on this machine share the memory; by default a folder of this user in `/tmp`.
    pub slots: Option<PathBuf>,
    /// Start the program as the leader of its own process group. Not for a caller that ends its work by killing its process group.
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
    /// The number of programs that may run at once on this machine.
    #[must_use]
    pub fn at_once(&self) -> u32 {
        count(self.memory, self.memory_for_all())
    }

    /// The memory that all programs on this machine may use together, in bytes.
    #[must_use]
    pub fn memory_for_all(&self) -> u64 {
        self.memory_together.unwrap_or_else(half_of_memory)
    }

    /// The programs to try, in order, without running them.
    #[must_use]
    pub fn candidates(&self) -> Vec<PathBuf> {
        candidates(self, &std::env::var_os("PATH").unwrap_or_default())
    }

    /// Creates the slot files and returns their folder, for a process that is about to lose the right to create files there. Read access
    /// is enough to lock them.
    ///
    /// # Errors
    /// The operating system's error.
    pub fn prepare_slots(&self) -> std::io::Result<PathBuf> {
        let folder = self.slots_folder();
        prepare(&folder, self.at_once())?;
        Ok(folder)
    }

    /// The folder of the slot files.
    #[must_use]
    pub fn slots_folder(&self) -> PathBuf {
        self.slots.clone().unwrap_or_else(default_folder)
    }

    /// Waits for a slot.
    pub(super) fn slot<S>(
        &self,
        waiting: &mut dyn FnMut(),
        watch: &mut dyn FnMut() -> Result<(), S>,
    ) -> std::io::Result<Result<Slot, S>> {
        take(&self.slots_folder(), self.at_once(), waiting, watch)
    }

    /// A new private folder, which is removed when the value is dropped.
    pub(super) fn scratch_folder(&self) -> std::io::Result<tempfile::TempDir> {
        let base = self.scratch.clone().unwrap_or_else(std::env::temp_dir);
        // The program runs in this folder, so that a relative path would be resolved wrongly.
        tempfile::Builder::new().prefix("meshmend-blender-").tempdir_in(std::path::absolute(base)?)
    }
}

/// A program that was tried and can't be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rejected {
    /// The program.
    pub program: PathBuf,
    /// The reason, as a predicate of the program's name.
    pub reason: String,
}

/// No usable Blender was found.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub struct BlenderMissing {
    /// The programs that were tried, in order.
    pub tried: Vec<Rejected>,
}

impl fmt::Display for BlenderMissing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no usable Blender was found")?;
        for Rejected { program, reason } in &self.tried {
            write!(f, "; {} {reason}", program.display())?;
        }
        f.write_str(
            "; install Blender 3.0 or later, or run scripts/install-blender.sh, or set MESHMEND_BLENDER to Blender or to a \
             Python that has bpy",
        )
    }
}

/// The oldest version whose remesh modifier and exact boolean the script supports.
const OLDEST: (u32, u32) = (3, 0);
/// The kind of Blender itself.
const BLENDER: &str = "blender";
/// The kind of a Python with Blender as a module.
pub(super) const BPY: &str = "bpy";
/// The Python of the environment that the install script creates.
const ENVIRONMENT_PYTHON: &str = ".venv-blender/bin/python";
/// Prints bpy's version, and exits without Python's teardown, which crashes in some builds of bpy.
const ASK_BPY: &str = "import os, sys, bpy; print('bpy', bpy.app.version_string); sys.stdout.flush(); os._exit(0)";

/// Looks for a program: only the configured one, or else `blender` on `PATH`, then a Python in `.venv-blender` in the working folder,
/// then one next to the executable. Each is asked for its version.
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

/// The programs to try, in order. A configured program is included even if it does not exist, so that the error names it.
fn candidates(config: &BlenderConfig, path: &OsStr) -> Vec<PathBuf> {
    if let Some(program) = &config.program {
        let named = if program.components().count() > 1 || program.is_absolute() {
            std::path::absolute(program).ok()
        } else {
            on_path(program, path)
        };
        return vec![named.unwrap_or_else(|| program.clone())];
    }
    let working_folder = std::env::current_dir().ok();
    let program_folder = std::env::current_exe().ok().and_then(|program| program.parent().map(Path::to_path_buf));
    let mut found: Vec<PathBuf> = on_path(Path::new("blender"), path).into_iter().collect();
    for folder in [working_folder, program_folder].into_iter().flatten() {
        let python = folder.join(ENVIRONMENT_PYTHON);
        if is_program(&python) && !found.contains(&python) {
            found.push(python);
        }
    }
    found
}

/// Looks a name up on `PATH`. Skips empty and relative entries: they mean the working folder, which may hold untrusted files.
fn on_path(name: &Path, path: &OsStr) -> Option<PathBuf> {
    std::env::split_paths(path)
        .filter(|folder| folder.is_absolute())
        .map(|folder| folder.join(name))
        .find(|p| is_program(p))
}

fn is_program(path: &Path) -> bool {
    path.metadata().is_ok_and(|found| found.is_file() && found.permissions().mode() & 0o111 != 0)
}

/// Asks a program for its kind and version.
fn probe(program: &Path, config: &BlenderConfig) -> Result<RemesherInfo, String> {
    let output = ask(program, &["--version"], config)?;
    let line = |start: &str| output.iter().find_map(|line| line.strip_prefix(start)).map(str::to_owned);
    let (kind, version) = if let Some(version) = line("Blender ") {
        (BLENDER, version)
    } else if line("Python ").is_some() {
        let output = ask(program, &["-I", "-c", ASK_BPY], config)?;
        match output.iter().find_map(|line| line.strip_prefix("bpy ")) {
            Some(version) => (BPY, version.to_owned()),
            None => return Err(format!("is a Python without bpy ({})", last(&output))),
        }
    } else {
        return Err(format!("is neither Blender nor Python: --version prints '{}'", last(&output)));
    };
    // Drops a suffix such as LTS.
    let version = version.split_whitespace().next().unwrap_or_default().to_owned();
    match parse_version(&version) {
        Some(found) if found >= OLDEST => {}
        Some(_) => return Err(format!("is version {version}; expected 3.0 or later")),
        None => return Err(format!("has an unreadable version, '{version}'")),
    }
    Ok(RemesherInfo { kind: kind.to_owned(), version, program: program.display().to_string() })
}

/// The lines that a program prints. An error if the program fails or exceeds its time limit.
fn ask(program: &Path, arguments: &[&str], config: &BlenderConfig) -> Result<Vec<String>, String> {
    let scratch = config.scratch_folder().map_err(|error| format!("was not run: no scratch folder ({error})"))?;
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
        Ok(Err(())) => Err(format!("did not print its version within {} s", config.probe_time.as_secs_f64())),
        Ok(Ok(status)) if !status.success() => Err(format!("failed to print its version ({status}: {})", last(&lines))),
        Ok(Ok(_)) => Ok(lines),
    }
}

/// The last line, at most 200 characters of it.
fn last(lines: &[String]) -> String {
    lines.last().map(|line| line.chars().take(200).collect()).unwrap_or_default()
}

/// Major and minor number of a version such as `3.4.1`.
pub(super) fn parse_version(version: &str) -> Option<(u32, u32)> {
    let mut numbers = version.split('.').map(str::parse);
    Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
}

/// The files and folders that a program needs besides those of the system: its installation, and a Python's virtual environment. Omits
/// folders that contain `private`.
#[must_use]
pub fn installation(program: &Path, private: &Path) -> Vec<PathBuf> {
    let real = program.canonicalize().unwrap_or_else(|_| program.to_owned());
    let mut needed = vec![program.to_owned(), real.clone()];
    for path in [program, &real] {
        let Some(folder) = path.parent() else { continue };
        let Some(prefix) = folder.parent().filter(|_| folder.ends_with("bin")) else {
            needed.push(folder.to_owned());
            continue;
        };
        if prefix.join("pyvenv.cfg").is_file() {
            needed.push(prefix.to_owned());
        } else {
            // The prefix itself may be a home folder.
            needed.extend(["bin", "lib", "lib64", "share"].map(|name| prefix.join(name)));
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
    fn blenders_version_is_read_from_its_output() {
        let info =
            found("echo Color management: warning; echo 'Blender 4.5.15 LTS'; echo '  build date: 2026'").unwrap();
        assert_eq!((info.kind.as_str(), info.version.as_str()), ("blender", "4.5.15"));
    }

    #[test]
    fn a_python_with_bpy_is_recognized() {
        let info = found("case $1 in --version) echo Python 3.11.2;; -I) echo bpy 5.0.1;; esac").unwrap();
        assert_eq!((info.kind.as_str(), info.version.as_str()), ("bpy", "5.0.1"));
    }

    #[test]
    fn an_unusable_program_is_rejected_with_the_reason() {
        assert!(
            reason("case $1 in --version) echo Python 3.11.2;; *) echo no module >&2; exit 1;; esac")
                .contains("no module")
        );
        assert!(reason("case $1 in --version) echo Python 3.11.2;; esac").contains("without bpy"));
        assert!(reason("echo Blender 2.79.1").contains("expected 3.0 or later"));
        assert!(reason("echo Blender x.y").contains("unreadable version"));
        assert!(reason("echo GNU Hello").contains("neither Blender nor Python"));
        assert!(reason("echo broken library >&2; exit 127").contains("broken library"));
    }

    #[test]
    fn a_missing_program_is_named_with_advice() {
        let config = BlenderConfig { program: Some("/nowhere/blender".into()), ..BlenderConfig::default() };
        let message = find(&config).unwrap_err().to_string();
        assert!(message.contains("/nowhere/blender does not exist"), "{message}");
        assert!(message.contains("MESHMEND_BLENDER"), "{message}");
    }

    #[test]
    fn a_program_that_hangs_is_stopped_and_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let program = Some(program(folder.path(), "program", "sleep 600"));
        let config = BlenderConfig { program, probe_time: Duration::from_millis(300), ..BlenderConfig::default() };
        assert!(find(&config).unwrap_err().tried[0].reason.contains("did not print its version"));
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
    fn a_program_needs_its_installation_folder_and_the_target_of_its_link() {
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
    fn a_python_needs_its_environment_and_its_base_pythons_library() {
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
    fn a_folder_that_contains_private_data_is_omitted() {
        let root = tempfile::tempdir().unwrap();
        let program = root.path().join("data/blender");
        file(&program);
        let private = root.path().join("data").canonicalize().unwrap();
        assert_eq!(installation(&program, &private), [program.canonicalize().unwrap()]);
    }
}
