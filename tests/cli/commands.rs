//! `meshmend compare`, `openapi`, `migrate` and `serve`: what they print and their exit codes.

use std::path::Path;

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

#[test]
fn the_stored_openapi_document_is_up_to_date() {
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("openapi/openapi.json");
    let workspace = Workspace::new();
    let kept = kept.to_str().expect("a path");
    assert_eq!(exit_code(&workspace.run(&["openapi", "--check", kept])), 0, "run 'make openapi'");
    workspace.put("stale.json", b"{}");
    assert_eq!(exit_code(&workspace.run(&["openapi", "--check", "stale.json"])), 1);
}

#[test]
fn migrate_makes_the_database_and_may_be_run_again() {
    let workspace = Workspace::new();
    for _ in 0..2 {
        let output = workspace.run(&["migrate", "--data-dir", "data"]);
        assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
    }
    assert!(workspace.path().join("data/meshmend.db").exists());
}

#[test]
fn a_port_in_use_is_reported_with_its_address() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address").to_string();
    let workspace = Workspace::new();
    let output = workspace.run(&["serve", "--data-dir", "data", "--listen", &address]);
    assert_eq!(exit_code(&output), 3);
    assert!(stderr(&output).contains(&format!("listen on {address}")), "{}", stderr(&output));
}
