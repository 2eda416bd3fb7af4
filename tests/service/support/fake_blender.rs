//! Scripts that answer like Blender when asked for their version.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// A script that sleeps when it is given work.
pub fn hanging_blender(folder: &Path) -> PathBuf {
    fake_blender(folder, "sleep 600")
}

/// A script that runs one line of shell when it is given work.
pub fn fake_blender(folder: &Path, work: &str) -> PathBuf {
    let path = folder.join("blender");
    let script = format!("#!/bin/sh\ncase \"$*\" in *--version*) echo 'Blender 3.4.1'; exit 0;; esac\n{work}\n");
    std::fs::write(&path, script).expect("a file");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).expect("permissions");
    path
}
