//! Settings, as `meshmend config` prints them.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde_json::Value;

/// The settings of a command line with these variables, or the message that rejects them.
pub fn config(line: &[String], variables: &BTreeMap<String, String>) -> Result<Value, String> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
    command.args(["config", "--format", "json"]).args(line).env_clear().envs(variables);
    let output = command.output().expect("it runs");
    if !output.status.success() {
        return Err(format!("{line:?}: {}", String::from_utf8_lossy(&output.stderr)));
    }
    Ok(serde_json::from_slice(&output.stdout).expect("JSON"))
}

/// The settings of a command line by variable; panics if the program rejects it.
pub fn settings(line: &[String], variables: &BTreeMap<String, String>) -> BTreeMap<String, String> {
    let config = config(line, variables).unwrap_or_else(|error| panic!("{error}"));
    let unknown = config["unknown_variables"].as_array().expect("a list");
    assert!(unknown.is_empty(), "{line:?}: nothing reads {unknown:?}");
    let settings = config["settings"].as_array().expect("a list").iter();
    settings
        .filter_map(|setting| Some((setting["variable"].as_str()?.to_owned(), setting["value"].as_str()?.to_owned())))
        .collect()
}

/// Every variable that a running service reads.
pub fn known_variables() -> BTreeSet<String> {
    let of = |verb: &str| {
        let config = config(&[verb.to_owned()], &BTreeMap::new()).expect("a command");
        let settings = config["settings"].as_array().expect("a list").clone();
        settings.into_iter().filter_map(|setting| Some(setting["variable"].as_str()?.to_owned())).collect::<Vec<_>>()
    };
    ["serve", "work", "migrate", "config"].into_iter().flat_map(of).collect()
}
