//! Access keys, and programs that require them.

use std::path::Path;
use std::process::Command;

use reqwest::RequestBuilder;
use serde_json::Value;

use crate::server::{Program, Start};

pub const ALL_SCOPES: &str = "jobs:read,jobs:write,webhooks,tokens,metrics,admin";

/// Runs a command on a data folder and returns its standard output.
pub fn meshmend(data: &Path, args: &[&str]) -> String {
    let run = Command::new(env!("CARGO_BIN_EXE_meshmend")).args(args).arg("--data-dir").arg(data).output();
    let run = run.expect("the program runs");
    assert!(run.status.success(), "{args:?}: {}", String::from_utf8_lossy(&run.stderr));
    String::from_utf8(run.stdout).expect("text").trim().to_owned()
}

/// Creates a key and returns its secret.
pub fn create_key(data: &Path, tenant: &str, scopes: &str) -> String {
    meshmend(data, &["keys", "create", "--tenant", tenant, "--scopes", scopes])
}

/// Starts a program that requires keys.
pub fn start_with_keys(start: Start<'_>) -> Program {
    start.arg("--auth", "keys").start()
}

/// Sends a request and returns its status and its body, null where that is not JSON.
pub async fn send(request: RequestBuilder) -> (u16, Value) {
    let response = request.send().await.expect("a response");
    let status = response.status().as_u16();
    (status, response.json().await.unwrap_or(Value::Null))
}
