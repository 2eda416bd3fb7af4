//! Jobs with alternatives: how they are listed, and how one is taken without repairing again.

use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::files;
use crate::server::{Api, Start, stored_files};
use crate::support::FILES_PER_JOB;

#[tokio::test]
async fn an_alternative_is_listed_and_taken_by_its_id_as_often_as_asked() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::hollow_box(), json!({"max_tier": 2, "alternatives": true})).await;
    let job = api.finished(&id).await;
    assert_eq!((&job["status"], &job["outcome"]), (&json!("succeeded"), &json!("already_printable")), "{job}");
    let offered = job["alternatives"]["offered"].as_array().expect("a list");
    let of = |field: &str| offered.iter().map(|offered| offered[field].clone()).collect::<Vec<Value>>();
    assert_eq!(
        (of("id"), of("is_default")),
        (vec![json!("default"), json!("voids-fill")], vec![json!(true), json!(false)])
    );
    assert_eq!(job["report"]["alternatives"], job["alternatives"], "the report and the job agree");
    for name in ["model-voids-fill", "report-voids-fill.json", "after-voids-fill.png", "change-voids-fill.glb"] {
        assert!(job["artifacts"][name].is_object(), "{name} is not in {}", job["artifacts"]);
    }
    let default = api.artifact(&id, "model").await;
    let filled = api.artifact(&id, "model-voids-fill").await;
    assert_ne!(default, filled);
    for (name, bytes) in [("model", &default), ("model-voids-fill", &filled)] {
        assert_eq!(job["artifacts"][name]["sha256"], hex::encode(Sha256::digest(bytes)), "{name}");
    }
    for _ in 0..2 {
        assert_eq!(api.artifact(&id, "model?choice=voids-fill").await, filled);
        assert_eq!(api.artifact(&id, "model?choice=default").await, default);
    }
    let report: Value =
        serde_json::from_slice(&api.artifact(&id, "report-full.json?choice=voids-fill").await).expect("JSON");
    assert_eq!((&report["outcome"], &report["options"]["voids"]), (&json!("repaired"), &json!("fill")));
    assert!(api.artifact(&id, "after.png?choice=voids-fill").await.starts_with(b"\x89PNG"));
    let filled_change = api.artifact(&id, "change.glb?choice=voids-fill").await;
    assert!(filled_change.starts_with(b"glTF"));
    assert_eq!(api.job(&id).await["alternatives"], job["alternatives"], "taking one changes nothing");
    let listed = api.get("/v1/jobs").send().await.expect("a response").json::<Value>().await.expect("JSON");
    assert!(listed["jobs"][0].get("alternatives").is_none(), "lists are short");
    assert_eq!(stored_files(data.path(), &id).len(), FILES_PER_JOB + 4);
    assert_ne!(api.artifact(&id, "change.glb").await, filled_change, "each result shows its own changes");
}

#[tokio::test]
async fn an_unknown_choice_is_refused_with_the_choices_of_the_job() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::hollow_box(), json!({"max_tier": 2, "alternatives": true, "pictures": false})).await;
    api.finished(&id).await;
    for (path, detail) in [
        ("model?choice=islands-drop", "Its choices are: default, voids-fill."),
        ("log.txt?choice=voids-fill", "An alternative has no artifact 'log.txt'."),
    ] {
        let response = api.get(&format!("/v1/jobs/{id}/artifacts/{path}")).send().await.expect("a response");
        assert_eq!(response.status(), 404);
        let problem: Value = response.json().await.expect("JSON");
        assert_eq!(problem["code"], "artifact_not_found");
        assert!(problem["detail"].as_str().is_some_and(|text| text.contains(detail)), "{problem}");
    }
    let plain = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    let job = api.finished(&plain).await;
    assert!(job.get("alternatives").is_none() && job["report"].get("alternatives").is_none(), "{job}");
}
