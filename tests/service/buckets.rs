//! The service with its files in an S3-compatible store, with outages of the store at every step of a job.

use std::path::Path;

use serde_json::{Value, json};

use crate::files;
use crate::postgres::Postgres;
use crate::s3::S3;
use crate::server::{Api, Program, Start, until};
use crate::support::FILES_PER_JOB;

fn options() -> Value {
    json!({"max_tier": 1})
}

fn serve(data: &Path, bucket: &S3) -> Program {
    bucket.store_files_of(Start::serve(data)).start()
}

async fn succeeded(api: &Api, id: &str) -> Value {
    let job = api.finished(id).await;
    assert_eq!((&job["status"], &job["outcome"]), (&json!("succeeded"), &json!("repaired")), "{job}");
    assert_eq!(job["attempt"], 1, "{job}");
    assert_eq!(api.artifact(id, "model").await.len(), 84 + 50 * 12);
    job
}

/// Asserts that a response says that the store is unavailable and when to retry.
async fn assert_unavailable(response: reqwest::Response) {
    assert_eq!(response.status(), 503);
    assert_eq!(response.headers()["retry-after"], "5");
    assert_eq!(response.json::<Value>().await.expect("a problem")["code"], "unavailable");
}

#[tokio::test]
async fn processes_that_share_a_database_and_a_bucket_need_no_folder_in_common() {
    let (cluster, bucket) = (Postgres::start(), S3::start());
    let [of_server, of_worker] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
    let shared = |start| bucket.store_files_of(start).env("MESHMEND_DATABASE_URL", &cluster.url());
    let server = shared(Start::serve(of_server.path()).env("MESHMEND_NO_WORKERS", "true")).start();
    let _worker = shared(Start::work(of_worker.path())).start();
    let api = Api::new(&server);
    let id = api.submit(files::broken_box(), options()).await;
    let job = succeeded(&api, &id).await;
    assert_eq!(bucket.files().len(), FILES_PER_JOB, "{:?}", bucket.files());
    for (name, artifact) in job["artifacts"].as_object().expect("files") {
        let bytes = api.artifact(&id, name).await.len();
        assert!(artifact.get("bytes").is_none_or(|declared| *declared == bytes), "{name}");
    }
    assert!(bucket.files().len() > FILES_PER_JOB, "the worker drew the pictures that were requested");
    let range = api.get(&format!("/v1/jobs/{id}/artifacts/model")).header("range", "bytes=0-83").send().await;
    let range = range.expect("a response");
    assert_eq!((range.status().as_u16(), range.bytes().await.expect("bytes").len()), (206, 84));
    let deleted = api.delete(&format!("/v1/jobs/{id}")).send().await.expect("a response");
    assert_eq!(deleted.status(), 204);
    assert_eq!(bucket.files(), Vec::<String>::new());
    for data in [of_server, of_worker] {
        assert!(!data.path().join("files").exists());
    }
}

#[tokio::test]
async fn while_the_bucket_is_down_clients_are_told_when_to_retry_and_nothing_is_lost() {
    let (mut bucket, data) = (S3::start(), tempfile::tempdir().expect("a folder"));
    let program = serve(data.path(), &bucket);
    let api = Api::new(&program);
    let [kept, deleted] = [
        api.submit(files::broken_box(), options()).await,
        api.submit(files::broken_box(), json!({"max_tier": 2})).await,
    ];
    succeeded(&api, &kept).await;
    succeeded(&api, &deleted).await;
    let ready = async || api.get("/readyz").send().await.expect("a response").status().as_u16();
    assert_eq!(ready().await, 200);

    bucket.kill();
    assert_unavailable(api.try_submit("a.stl", files::broken_box(), options()).await).await;
    let model = format!("/v1/jobs/{kept}/artifacts/model");
    assert_unavailable(api.get(&model).send().await.expect("a response")).await;
    assert_unavailable(api.delete(&format!("/v1/jobs/{deleted}")).send().await.expect("a response")).await;
    assert_eq!(ready().await, 503);
    assert_eq!(api.job(&kept).await["status"], "succeeded", "requests that need no files still work");

    bucket.restart();
    assert_eq!(api.artifact(&kept, "model").await.len(), 84 + 50 * 12);
    assert_eq!(api.delete(&format!("/v1/jobs/{deleted}")).send().await.expect("a response").status(), 410);
    assert_eq!(
        bucket.files().len(),
        FILES_PER_JOB,
        "files of refused requests and deleted jobs are gone: {:?}",
        bucket.files()
    );
    assert_eq!(ready().await, 200);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1, "deadline_s": 60})).await;
    succeeded(&api, &id).await;
    assert_eq!(bucket.loose_parts(), 0);
}

#[tokio::test]
async fn a_bucket_outage_at_any_step_of_a_worker_costs_no_job_an_attempt() {
    for pause in ["worker-claimed", "child-tier1", "worker-publish"] {
        let (mut bucket, data) = (S3::start(), tempfile::tempdir().expect("a folder"));
        let start = Start::serve(data.path()).env("FAILPOINTS", &format!("{pause}=1*sleep(1000)"));
        let program = bucket.store_files_of(start).start();
        let api = Api::new(&program);
        let id = api.submit(files::broken_box(), options()).await;
        until("a worker has it", async || (api.job(&id).await["status"] == "running").then_some(())).await;
        if pause != "worker-claimed" {
            until("its files are fetched", async || program.log().contains("started child process").then_some(()))
                .await;
        }
        bucket.kill();
        until("the worker tries again", async || program.log().contains("transient failure; retrying").then_some(()))
            .await;
        bucket.restart();
        succeeded(&api, &id).await;
        assert_eq!(bucket.files().len(), FILES_PER_JOB, "{pause}: {:?}", bucket.files());
        assert!(!program.log().contains("panicked"), "{}", program.log());
    }
}

#[tokio::test]
async fn a_job_whose_upload_was_damaged_in_the_bucket_is_not_worked_on() {
    let (bucket, data) = (S3::start(), tempfile::tempdir().expect("a folder"));
    let start = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true");
    let server = bucket.store_files_of(start).start();
    let api = Api::new(&server);
    let id = api.submit(files::broken_box(), options()).await;
    let mut bytes = files::broken_box();
    bytes[100] ^= 1;
    std::fs::write(bucket.objects().join("uploads").join(&id), bytes).expect("damage");
    let worker = bucket.store_files_of(Start::work(data.path())).start();
    until("the worker has seen it", async || worker.log().contains("is damaged: its SHA-256").then_some(())).await;
    let job = until("the attempt has ended", async || {
        let job = api.job(&id).await;
        (job["status"] != "running").then_some(job)
    })
    .await;
    assert!(["queued", "failed"].contains(&job["status"].as_str().expect("a status")), "{job}");
    assert!(job["artifacts"].as_object().is_none_or(serde_json::Map::is_empty), "{job}");
}
