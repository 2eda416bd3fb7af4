//! Retention of jobs and their files, and reuse of earlier results.

use std::collections::BTreeMap;
use std::time::Duration;

use meshmend::access::SystemIds;
use meshmend::jobs::{
    Artifact, Artifacts, Completion, FailureKind, JobId, ListQuery, NewJob, Reused, Status, StoredFile, StoredReport,
};
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start, make_old, stored_files, until};
use crate::support::stores::{Bench, on_each_store};

on_each_store! {
    old_jobs_expire_and_their_records_are_deleted_later,
    a_result_is_found_by_its_fingerprint_as_long_as_it_is_kept,
    a_job_that_is_given_a_result_has_ended_when_it_is_accepted,
}

const DAY: Duration = Duration::from_secs(24 * 3600);

fn artifacts(id: JobId) -> Artifacts {
    let artifact = Artifact {
        filename: "a-report.json".into(),
        media_type: "application/json".into(),
        file: Some(StoredFile { key: format!("jobs/{id}/t/report.json"), bytes: 2, sha256: "00".into() }),
    };
    BTreeMap::from([("report.json".to_owned(), artifact)])
}

async fn succeed(bench: &Bench) -> JobId {
    let claim = bench.claim().await.expect("a job");
    let id = claim.job.id;
    let completion = Completion { report: Bench::report(), artifacts: artifacts(id) };
    bench.store.complete(&claim.lease, completion).await.expect("completed");
    id
}

async fn old_jobs_expire_and_their_records_are_deleted_later(bench: Bench) {
    bench.submit().await;
    let old = succeed(&bench).await;
    bench.submit().await;
    let claim = bench.claim().await.expect("a job");
    bench.store.fail(&claim.lease, Bench::failure(FailureKind::Final)).await.expect("noted");
    bench.advance(DAY);
    bench.submit().await;
    let young = succeed(&bench).await;
    let waiting = bench.submit().await.id;
    assert_eq!(bench.store.expire(2 * DAY, 10).await.expect("a result"), []);
    assert_eq!(bench.store.expire(DAY, 1).await.expect("a result"), [old], "the oldest first, no more than requested");
    assert_eq!(bench.store.expire(DAY, 10).await.expect("a result"), [claim.job.id]);
    let expired = bench.get(old).await;
    assert_eq!(expired.status, Status::Expired);
    assert_eq!((expired.report, expired.artifacts.len(), expired.inputs[0].name.as_str()), (None, 0, ""));
    assert!(expired.outcome.is_some(), "the job's record is kept longer");
    assert_eq!(bench.get(young).await.status, Status::Succeeded);
    bench.advance(DAY);
    assert_eq!(bench.store.forget_jobs(3 * DAY).await.expect("a result"), 0);
    assert_eq!(bench.store.forget_jobs(2 * DAY).await.expect("a result"), 2);
    assert_eq!(bench.store.get(old).await.expect("a result"), None);
    assert_eq!(bench.get(young).await.status, Status::Succeeded, "a job that has not expired keeps its record");
    assert_eq!(bench.get(waiting).await.status, Status::Queued);
}

async fn a_result_is_found_by_its_fingerprint_as_long_as_it_is_kept(bench: Bench) {
    let job = NewJob { fingerprint: "f".into(), ..Bench::job("shop") };
    bench.store.submit(job).await.expect("accepted");
    let find = async |tenant, fingerprint| {
        bench.store.find_result(tenant, fingerprint).await.expect("a result").map(|job| job.id)
    };
    assert_eq!(find("shop", "f").await, None, "the job has not ended");
    let id = succeed(&bench).await;
    assert_eq!(find("shop", "f").await, Some(id));
    assert_eq!(find("other", "f").await, None);
    assert_eq!(find("shop", "g").await, None);
    bench.advance(DAY);
    bench.store.expire(DAY, 10).await.expect("a result");
    assert_eq!(find("shop", "f").await, None, "the job has expired");
}

async fn a_job_that_is_given_a_result_has_ended_when_it_is_accepted(bench: Bench) {
    bench.submit().await;
    let first = bench.get(succeed(&bench).await).await;
    let (id, report) = (JobId::new(&SystemIds), first.report.clone().expect("a report"));
    let (outcome, artifacts) = (first.outcome.expect("an outcome"), artifacts(id));
    let result = Reused { from: first.id, outcome, report, artifacts: artifacts.clone() };
    let mut job = Bench::job("shop");
    job.metadata.insert("order".into(), "17".into());
    let job = NewJob { id, result: Some(result), ..job };
    let accepted = bench.store.submit(job).await.expect("accepted");
    assert_eq!(accepted.status, Status::Succeeded);
    assert_eq!((accepted.reused_from, accepted.outcome), (Some(first.id), first.outcome));
    assert_eq!(accepted.report.as_ref().map(text), first.report.as_ref().map(text));
    assert_eq!(accepted.artifacts, artifacts);
    assert_eq!(accepted.metadata.get("order").map(String::as_str), Some("17"));
    assert_eq!(bench.claim().await, None);
    let all = ListQuery { tenant: "shop".into(), limit: 10, ..ListQuery::default() };
    assert_eq!(bench.store.list(all).await.expect("a result").items.len(), 2);
}

fn text(report: &StoredReport) -> String {
    serde_json::to_string(report).expect("JSON")
}

#[tokio::test]
async fn the_same_bytes_and_options_are_repaired_once() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let options = json!({"max_tier": 2});
    let first = api.submit(files::broken_box(), options.clone()).await;
    let first = api.finished(&first).await;
    assert_eq!((&first["outcome"], &first["reused_from"]), (&json!("repaired"), &Value::Null));

    let again = api.try_submit("other name.stl", files::broken_box(), options.clone()).await;
    assert_eq!(again.status(), 202);
    let again: Value = again.json().await.expect("a job");
    assert_eq!((&again["status"], &again["outcome"]), (&json!("succeeded"), &json!("repaired")));
    assert_eq!(again["reused_from"], first["id"]);
    assert_eq!(again["quote"], first["quote"]);
    assert_eq!(api.job(again["id"].as_str().expect("an id")).await["report"], first["report"]);
    assert_eq!(again["artifacts"]["model"]["filename"], "other name-repaired.stl");
    let (one, other) = (first["id"].as_str().expect("an id"), again["id"].as_str().expect("an id"));
    let model = api.artifact(one, "model").await;
    assert_eq!(api.artifact(other, "model").await, model);
    let deleted = api.delete(&format!("/v1/jobs/{one}")).send().await.expect("a response");
    assert_eq!(deleted.status(), 204);
    assert_eq!(api.artifact(other, "model").await, model, "each job has its own files");

    for (file, options) in [(files::broken_box(), json!({"max_tier": 1})), (files::whole_box(), options.clone())] {
        let id = api.submit(file, options).await;
        assert_eq!(api.finished(&id).await["reused_from"], Value::Null);
    }
    let asked = api.post("/v1/jobs?max_tier=2").header("cache-control", "no-cache").body(files::broken_box());
    let anew: Value = asked.send().await.expect("a response").json().await.expect("a job");
    assert_eq!((&anew["status"], &anew["reused_from"]), (&json!("queued"), &Value::Null));
}

#[tokio::test]
async fn a_jobs_notes_come_back_with_it_and_wrong_ones_are_refused() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    let form = |notes: &str| {
        let part = reqwest::multipart::Part::bytes(files::broken_box()).file_name("a.stl");
        reqwest::multipart::Form::new().part("file", part).text("metadata", notes.to_owned())
    };
    let response = api.post("/v1/jobs").multipart(form(r#"{"order": "17"}"#)).send().await.expect("a response");
    let job: Value = response.json().await.expect("a job");
    assert_eq!(job["metadata"], json!({"order": "17"}));
    let id = job["id"].as_str().expect("an id");
    assert_eq!(api.job(id).await["metadata"], json!({"order": "17"}));
    let raw = api.post("/v1/jobs?metadata=%7B%22a%22%3A%22b%22%7D").body(files::broken_box());
    let raw: Value = raw.send().await.expect("a response").json().await.expect("a job");
    assert_eq!(raw["metadata"], json!({"a": "b"}));
    let many: BTreeMap<String, String> = (0..51).map(|n| (n.to_string(), String::new())).collect();
    let long = format!(r#"{{"a": "{}"}}"#, "x".repeat(9000));
    for wrong in ["[]", "{\"a\": 1}", "{", &serde_json::to_string(&many).expect("JSON"), &long] {
        let response = api.post("/v1/jobs").multipart(form(wrong)).send().await.expect("a response");
        assert_eq!(response.status(), 422, "{wrong}");
        let problem: Value = response.json().await.expect("a problem");
        assert!(problem["detail"].as_str().is_some_and(|detail| detail.contains("metadata")), "{problem}");
    }
}

#[tokio::test]
async fn an_expired_job_is_reported_as_expired_and_its_files_are_deleted() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--retain-results-h", "0").start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1, "pictures": false})).await;
    let ended = api.finished(&id).await;
    assert_eq!(ended["expires_at"], ended["finished_at"]);
    program.kill();
    // A worker begins with a sweep.
    let program = Start::serve(data.path()).arg("--retain-results-h", "0").start();
    let api = Api::new(&program);
    let job = until("the job has expired", async || {
        let job = api.job(&id).await;
        (job["status"] == "expired" && stored_files(data.path(), &id).is_empty()).then_some(job)
    })
    .await;
    assert_eq!((&job["report"], &job["artifacts"]), (&Value::Null, &json!({})));
    let response = api.get(&format!("/v1/jobs/{id}/artifacts/model")).send().await.expect("a response");
    assert_eq!(response.status(), 410);
    let problem: Value = response.json().await.expect("a problem");
    assert_eq!(problem["code"], "job_expired");
}

#[tokio::test]
async fn files_of_a_stale_attempt_are_swept_and_the_result_stays() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1, "pictures": false})).await;
    api.finished(&id).await;
    let of_result = stored_files(data.path(), &id);
    program.kill();
    // The state after a stale worker is killed before it deletes its files, while another attempt completed the job.
    let lost = data.path().join("files/jobs").join(&id).join("lost");
    std::fs::create_dir(&lost).expect("a folder");
    std::fs::write(lost.join("model"), "half of it").expect("a file");
    make_old(&data.path().join("files"));
    let _program = Start::serve(data.path()).start();
    until("the stale attempt's file is deleted", async || (!lost.exists()).then_some(())).await;
    assert_eq!(stored_files(data.path(), &id), of_result);
}
