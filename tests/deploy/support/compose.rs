//! docker/compose.yaml, parsed.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

use super::source::yaml;

pub const FILE: &str = "docker/compose.yaml";

pub fn compose() -> Value {
    let [compose] = yaml(FILE).try_into().expect("one document");
    compose
}

pub fn services(compose: &Value) -> &Map<String, Value> {
    compose["services"].as_object().expect("services")
}

/// The variables of a service, with `secret` for each one taken from the environment.
pub fn variables(service: &Value) -> BTreeMap<String, String> {
    let variables = service["environment"].as_object().into_iter().flatten();
    variables
        .map(|(name, value)| {
            let value = value.as_str().expect("a string");
            let value = match (value.find("${"), value.find('}')) {
                (Some(from), Some(to)) => format!("{}secret{}", &value[..from], &value[to + 1..]),
                _ => value.to_owned(),
            };
            (name.clone(), value)
        })
        .collect()
}
