//! Pictures are drawn once, on the first request for one of them, and never delay a job.

use std::collections::BTreeMap;
use std::time::Duration;

use meshmend::jobs::{Artifact, Artifacts, Claim, Completion, JobId, Status, StoreError, StoredFile};
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start, signal, stored_files, until};
use crate::support::FILES_PER_JOB;
use crate::support::stores::{Bench, on_each_store};

on_each_store! {
    pictures_are_claimed_when_they_are_asked_for_and_published_by_the_last_hold,
    pictures_of_a_job_that_was_deleted_are_not_drawn,
    tenants_take_turns_with_their_pictures,
}

const HOLD: Duration = Duration::from_secs(30);

fn picture(file: Option<&str>) -> Artifact {
    let file = file.map(|key| StoredFile { key: key.into(), bytes: 3, sha256: "00".into() });
    Artifact { filename: "a.png".into(), media_type: "image/png".into(), file }
}

fn artifacts(pictures: [(&str, Option<&str>); 3]) -> Artifacts {
    pictures.into_iter().map(|(name, key)| (name.to_owned(), picture(key))).collect()
}

/// A finished job with two pictures to draw.
async fn finished_job(bench: &Bench, tenant: &str) -> JobId {
    bench.submit_of(tenant).await;
    let claim = bench.claim().await.expect("a job");
    let artifacts = artifacts([("model", Some("jobs/model")), ("before.png", None), ("after.png", None)]);
    bench.store.complete(&claim.lease, Completion { report: Bench::report(), artifacts }).await.expect("completed");
    claim.job.id
}

async fn claimed(bench: &Bench) -> Option<Claim> {
    bench.store.claim_drawings(HOLD).await.expect("a result")
}

async fn pictures_are_claimed_when_they_are_asked_for_and_published_by_the_last_hold(bench: Bench) {
    let id = finished_job(&bench, "shop").await;
    assert!(claimed(&bench).await.is_none(), "no picture was requested");
    for _ in 0..2 {
        bench.store.request_drawings(id).await.expect("noted");
    }
    let lost = claimed(&bench).await.expect("pictures to draw");
    assert_eq!((lost.job.id, lost.lease.attempt, lost.job.status), (id, 1, Status::Succeeded));
    assert!(claimed(&bench).await.is_none(), "only one process draws at a time");
    bench.advance(HOLD - Duration::from_secs(1));
    bench.store.hold_drawings(&lost.lease, HOLD).await.expect("held");
    bench.advance(HOLD - Duration::from_secs(1));
    assert!(claimed(&bench).await.is_none(), "the lease was extended");
    bench.advance(HOLD);
    let held = claimed(&bench).await.expect("the hold ran out");
    assert_eq!(held.lease.attempt, 2);
    let drawn = || BTreeMap::from([("before.png".to_owned(), picture(Some("jobs/before")))]);
    let late = bench.store.finish_drawings(&lost.lease, drawn()).await;
    assert!(matches!(late, Err(StoreError::LeaseLost)), "{late:?}");
    assert!(matches!(bench.store.hold_drawings(&lost.lease, HOLD).await, Err(StoreError::LeaseLost)));
    let before = bench.get(id).await;
    let job = bench.store.finish_drawings(&held.lease, drawn()).await.expect("published");
    let expected = BTreeMap::from([
        ("before.png".to_owned(), picture(Some("jobs/before"))),
        ("model".to_owned(), picture(Some("jobs/model"))),
    ]);
    assert_eq!(
        (&job.artifacts, job.version),
        (&expected, before.version + 1),
        "a picture that could not be drawn does not exist"
    );
    assert_eq!(bench.get(id).await.artifacts, expected);
    assert!(claimed(&bench).await.is_none());
}

async fn pictures_of_a_job_that_was_deleted_are_not_drawn(bench: Bench) {
    let (first, second) = (finished_job(&bench, "shop").await, finished_job(&bench, "shop").await);
    bench.store.request_drawings(first).await.expect("noted");
    assert!(bench.store.purge(first).await.expect("a result"));
    assert!(claimed(&bench).await.is_none());
    bench.store.request_drawings(second).await.expect("noted");
    let held = claimed(&bench).await.expect("pictures to draw");
    assert!(bench.store.purge(second).await.expect("a result"));
    let late = bench.store.finish_drawings(&held.lease, Artifacts::new()).await;
    assert!(matches!(late, Err(StoreError::LeaseLost)), "{late:?}");
    assert!(bench.get(second).await.artifacts.is_empty());
}

async fn tenants_take_turns_with_their_pictures(bench: Bench) {
    for _ in 0..2 {
        bench.store.request_drawings(finished_job(&bench, "busy").await).await.expect("noted");
        bench.advance(Duration::from_secs(1));
    }
    bench.store.request_drawings(finished_job(&bench, "calm").await).await.expect("noted");
    let mut turns = Vec::new();
    while let Some(claim) = claimed(&bench).await {
        turns.push(claim.job.tenant);
    }
    assert_eq!(turns, ["busy", "calm", "busy"]);
}

#[tokio::test]
async fn pictures_are_drawn_when_one_is_asked_for_and_each_is_listed_typed_and_served() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    let job = api.finished(&id).await;
    assert_eq!(stored_files(data.path(), &id).len(), FILES_PER_JOB, "no picture was requested");
    let mut names = vec!["log.txt", "model", "report-full.json", "report.json"];
    for (name, media_type, magic) in [
        ("before.png", "image/png", b"\x89PNG".as_slice()),
        ("after.png", "image/png", b"\x89PNG"),
        ("defects.glb", "model/gltf-binary", b"glTF"),
        ("defects.ply", "application/octet-stream", b"ply\n"),
        ("change.png", "image/png", b"\x89PNG"),
        ("change.glb", "model/gltf-binary", b"glTF"),
        ("change.ply", "application/octet-stream", b"ply\n"),
    ] {
        let listed = &job["artifacts"][name];
        assert_eq!((&listed["media_type"], listed.get("bytes")), (&json!(media_type), None), "{job}");
        let response = api.get(&format!("/v1/jobs/{id}/artifacts/{name}")).send().await.expect("a response");
        assert_eq!(
            (response.status().as_u16(), &response.headers()["content-type"]),
            (200, &media_type.parse().expect("a value"))
        );
        assert!(response.headers()["content-disposition"].to_str().expect("text").contains(&format!("-{name}\"")));
        let bytes = response.bytes().await.expect("bytes");
        assert!(bytes.starts_with(magic), "{name}");
        assert_eq!(api.job(&id).await["artifacts"][name]["bytes"], bytes.len());
        names.push(name);
    }
    names.sort_unstable();
    let kept: Vec<&String> = job["artifacts"].as_object().expect("files").keys().collect();
    assert_eq!(kept, names, "only these pictures were announced");
    assert_ne!(api.artifact(&id, "before.png").await, api.artifact(&id, "after.png").await);
    assert_eq!(program.log().matches("drawn").count(), 1, "all pictures are drawn in one run:\n{}", program.log());
}

#[tokio::test]
async fn a_result_that_is_given_again_has_all_pictures_whether_drawn_before_or_not() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let first = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    api.finished(&first).await;
    let plain = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    assert_eq!(api.finished(&plain).await["reused_from"], json!(first));
    let picture = api.artifact(&first, "after.png").await;
    let drawn = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    assert_eq!(
        api.finished(&drawn).await["artifacts"].get("after.png").and_then(|picture| picture.get("bytes")),
        None,
        "the second job's picture is not drawn yet"
    );
    assert_eq!(api.artifact(&plain, "after.png").await, picture);
    assert_eq!(api.artifact(&drawn, "after.png").await, picture);
}

#[tokio::test]
async fn drawing_that_is_killed_is_tried_again_and_given_up_in_the_end() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("FAILPOINTS", "child-draw=sleep(600000)").start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    api.finished(&id).await;
    let asked = tokio::spawn({
        let (api, id) = (api.clone(), id.clone());
        async move { api.artifact(&id, "before.png").await }
    });
    let child = until("the child draws", async || program.job_children().first().copied()).await;
    signal(child, "KILL");
    assert!(asked.await.expect("a result").starts_with(b"\x89PNG"), "the second attempt starts at once");
    assert_eq!(api.job(&id).await["status"], "succeeded");
}

#[tokio::test]
async fn pictures_that_can_never_be_drawn_are_no_longer_listed() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    api.finished(&id).await;
    // Damage the stored upload, so that it cannot be read again.
    let upload = data.path().join("files/uploads").join(&id);
    std::fs::write(upload, b"not what it was").expect("written");
    let response = api.get(&format!("/v1/jobs/{id}/artifacts/before.png")).send().await.expect("a response");
    let (status, problem): (u16, Value) = (response.status().as_u16(), response.json().await.expect("JSON"));
    assert_eq!((status, &problem["code"]), (404, &json!("artifact_not_found")), "{problem}");
    let job = api.job(&id).await;
    let names: Vec<&String> = job["artifacts"].as_object().expect("files").keys().collect();
    assert_eq!(names, ["log.txt", "model", "report-full.json", "report.json"]);
}
