//! `meshmend compare`: what it prints and its exit code.

use serde_json::Value;

use crate::files;
use crate::support::{Workspace, exit_code, stderr};

#[test]
fn compare_prints_the_changes_and_its_exit_code_says_whether_the_shape_was_kept() {
    let workspace = Workspace::new();
    workspace.put("whole.stl", &files::whole_box());
    workspace.put("broken.stl", &files::broken_box());
    let same = workspace.run(&["compare", "whole.stl", "whole.stl"]);
    assert_eq!(exit_code(&same), 0, "{}", stderr(&same));
    let lines = String::from_utf8(same.stdout).expect("text");
    assert!(lines.contains("faithful                yes") && lines.contains("farthest at"), "{lines}");
    let changed = workspace.run(&["compare", "whole.stl", "broken.stl", "--json", "--samples", "500"]);
    assert_eq!(exit_code(&changed), 1, "{}", stderr(&changed));
    let value: Value = serde_json::from_slice(&changed.stdout).expect("JSON");
    assert_eq!(value["comparison"]["faithful"], false);
    assert_eq!(value["comparison"]["inside"]["points"], 500);
    assert!(value["comparison"]["lost"]["distance"]["max"].as_f64() > Some(0.1));
    assert_eq!(exit_code(&workspace.run(&["compare", "whole.stl", "missing.stl"])), 2);
}
