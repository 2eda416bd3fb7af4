//! Shutdown of a server: it serves reads until its jobs have ended, and accepts nothing new.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Program, Start, until};

/// Sends SIGTERM and waits until the process has seen it.
async fn terminate(program: &Program) {
    program.terminate();
    until("the process stops", async || program.log().contains("stopping: ").then_some(())).await;
}

#[tokio::test]
async fn during_shutdown_reads_are_served_and_new_jobs_are_refused_with_a_time_to_retry() {
    let data = tempfile::tempdir().expect("a folder");
    let mut program = Start::serve(data.path()).env("FAILPOINTS", "child-inspect=sleep(4000)").start();
    let api = Api::new(&program);
    let upload: Value = api.post("/v1/uploads").send().await.expect("a response").json().await.expect("an upload");
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    until("the job runs", async || (!program.job_children().is_empty()).then_some(())).await;
    terminate(&program).await;

    assert_eq!(api.job(&id).await["status"], "running");
    let ready = api.get("/readyz").send().await.expect("a response");
    assert_eq!(ready.status(), 503);
    assert_eq!(ready.json::<Value>().await.expect("JSON")["checks"]["service"], "stopping");
    let put = upload["put"]["url"].as_str().expect("an address");
    for request in [
        api.post("/v1/jobs").body(files::broken_box()),
        api.delete(&format!("/v1/jobs/{id}")),
        api.http.put(format!("{}{put}", api.url)).body(files::broken_box()),
    ] {
        let refused = request.send().await.expect("a response");
        assert_eq!(refused.status(), 503);
        assert_eq!(refused.headers()["content-type"], "application/problem+json");
        assert_eq!(refused.headers()["retry-after"], "5");
        let problem: Value = refused.json().await.expect("a problem");
        assert_eq!(problem["code"], "unavailable", "{problem}");
    }
    let ended = api.get(&format!("/v1/jobs/{id}?wait=30")).send().await.expect("a response");
    assert_eq!(ended.json::<Value>().await.expect("a job")["status"], "succeeded");
    assert_eq!(program.wait(), Some(0));
    assert!(api.get("/livez").send().await.is_err(), "nothing listens anymore");
}

#[tokio::test]
async fn when_the_grace_period_ends_a_process_closes_its_listener_and_releases_its_job() {
    let data = tempfile::tempdir().expect("a folder");
    let start = Start::serve(data.path()).env("FAILPOINTS", "child-inspect=sleep(600000)");
    let mut program = start.arg("--shutdown-grace-s", "2").start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    until("the job runs", async || (!program.job_children().is_empty()).then_some(())).await;
    terminate(&program).await;
    assert_eq!(api.get("/livez").send().await.expect("a response").status(), 200);
    assert_eq!(program.wait(), Some(0));
    let next = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let job = Api::new(&next).job(&id).await;
    assert_eq!((&job["status"], &job["attempt"]), (&json!("queued"), &json!(0)), "{job}");
}

#[tokio::test]
async fn a_process_without_jobs_waits_for_no_client_that_follows_a_job() {
    let data = tempfile::tempdir().expect("a folder");
    let mut program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    let followed = api.get(&format!("/v1/jobs/{id}/events")).send().await.expect("a response");
    let started = Instant::now();
    program.terminate();
    assert_eq!(program.wait(), Some(0));
    assert!(
        started.elapsed() < Duration::from_secs(10),
        "the shutdown took {:?} of a grace period of 20 s",
        started.elapsed()
    );
    drop(followed);
}
