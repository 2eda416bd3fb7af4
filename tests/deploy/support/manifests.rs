//! deploy/kubernetes, parsed.

use serde_json::Value;

use super::source::{strings, yaml};

pub const FOLDER: &str = "deploy/kubernetes";

/// Every object, including the example secret.
pub fn objects() -> Vec<Value> {
    let [kustomization] = yaml(&format!("{FOLDER}/kustomization.yaml")).try_into().expect("one document");
    let files = strings(&kustomization["resources"]).into_iter().chain(["secret.example.yaml".to_owned()]);
    files.flat_map(|file| yaml(&format!("{FOLDER}/{file}"))).collect()
}
