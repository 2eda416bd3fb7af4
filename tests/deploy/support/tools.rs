//! Programs that check the shipped files.

use std::io::Write;
use std::path::PathBuf;

use super::source::root;

/// A program of the environment that scripts/install-deploy-tools.sh makes; prints a note if there is none.
pub fn tool(name: &str) -> Option<PathBuf> {
    let tool = root().join(".venv-deploy/bin").join(name);
    if tool.exists() {
        return Some(tool);
    }
    let _ = writeln!(std::io::stderr(), "SKIPPED: {name} is missing; scripts/install-deploy-tools.sh installs it");
    None
}
