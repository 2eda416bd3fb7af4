//! `meshmend openapi`, `migrate` and `serve`: what they print and their exit codes.

use std::path::Path;

use crate::support::{Workspace, exit_code, stderr};

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
