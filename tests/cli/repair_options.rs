//! `meshmend repair`: its notes on options that had no effect.

use crate::files;
use crate::support::{Workspace, exit_code, stderr};

#[test]
fn an_option_that_was_not_applied_is_in_the_last_lines() {
    let workspace = Workspace::new();
    workspace.put("box.stl", &files::stl(&files::BOX));
    let output =
        workspace.run(&["repair", "box.stl", "-o", "out.stl", "--nested", "alternate", "--stitch-distance", "0.5"]);
    assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
    let lines = stderr(&output);
    let last: Vec<&str> = lines.trim_end().lines().rev().take(2).collect();
    assert_eq!(last[0], "  note: `nested=alternate` had nothing to do: no part had to be reoriented");
    assert_eq!(last[1], "  note: `stitch_distance=0.5` had nothing to do: no crack is this narrow");
    assert_eq!(workspace.get("out.stl"), workspace.get("box.stl"));
}

#[test]
fn a_length_below_zero_is_refused_with_the_name_of_its_option() {
    let workspace = Workspace::new();
    workspace.put("box.stl", &files::stl(&files::BOX));
    let output = workspace.run(&["repair", "box.stl", "-o", "out.stl", "--merge-distance=-1"]);
    assert_eq!(exit_code(&output), 2, "{}", stderr(&output));
    assert!(stderr(&output).contains("`merge_distance` must be"), "{}", stderr(&output));
}
