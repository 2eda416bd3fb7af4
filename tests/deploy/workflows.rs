//! .github/workflows: a linter finds no fault, and each `make` target exists.

use std::process::Command;

use crate::support::source::{files, root, text};
use crate::support::tools::tool;

#[test]
fn a_linter_finds_no_fault_in_the_workflows() {
    let Some(lint) = tool("actionlint") else { return };
    let checked = Command::new(lint).args(files(".github/workflows")).current_dir(root()).output().expect("it runs");
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stdout));
}

#[test]
fn every_target_that_a_workflow_makes_exists() {
    let makefile = text("Makefile");
    let mut seen = 0;
    for workflow in files(".github/workflows") {
        let text = std::fs::read_to_string(&workflow).expect("text");
        for target in text.lines().filter_map(|line| line.trim().strip_prefix("- run: make ")) {
            assert!(makefile.contains(&format!("\n{target}:")), "{}: there is no {target}", workflow.display());
            seen += 1;
        }
    }
    assert!(seen > 5, "{seen}");
}
