//! Jobs that a real Blender repairs; `make test` installs one.

use meshmend::format::{Limits, read};
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start};

#[tokio::test]
async fn a_model_beyond_tier_one_is_repaired_by_a_real_blender_and_its_report_says_how() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).real_blender().start();
    let api = Api::new(&program);
    let can: Value = api.get("/v1/capabilities").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!(can["tiers"][2]["available"], true, "these tests need a real Blender: {can}");
    let version = can["tiers"][2]["program"]["version"].clone();
    assert!(version.as_str().is_some_and(|v| v.contains('.')), "{can}");

    let id = api.submit(files::boxes_on_an_edge(), json!({"preset": "blender-remesh", "voxel_size": 0.05})).await;
    let job = api.finished(&id).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let report = &job["report"];
    let steps = report["steps"].as_array().expect("steps");
    let remesh = steps.iter().find(|s| s["action"] == "voxel_remesh").expect("the step");
    assert_eq!(remesh["status"], "done", "{remesh}");
    assert_eq!(remesh["program"]["version"], version);
    assert_eq!(remesh["voxel_size"], 0.05);
    assert_eq!(report["verified_from_output_bytes"], true);
    assert_eq!(report["after"]["boundary_edges"], 0, "{report}");
    let volume = report["after"]["volume"]["value"].as_f64().expect("a number");
    assert!((volume - 2.0).abs() < 0.2, "{volume}");
    let soup = read(&api.artifact(&id, "model").await, &Limits::default()).expect("a model").soup;
    // A remesh of two flat-sided boxes needs few faces.
    assert!(soup.faces.len() < 2000, "{}", soup.faces.len());
}

#[tokio::test]
async fn without_blender_the_best_result_is_returned_and_the_skipped_tier_is_named() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::boxes_on_an_edge(), json!({"preset": "fill-holes"})).await;
    let job = api.finished(&id).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let steps = job["report"]["steps"].as_array().expect("steps");
    let missing = steps.iter().filter(|s| s["tier"] == 3 && s["status"] == "skipped");
    assert!(missing.clone().count() > 0, "{steps:?}");
    for step in missing {
        assert!(step["note"].as_str().is_some_and(|note| note.contains("Blender")), "{step}");
    }
    assert!(!api.artifact(&id, "original").await.is_empty());
}
