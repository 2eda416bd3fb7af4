//! Several processes on one PostgreSQL database, and outages of the database.

use std::path::Path;
use std::time::Duration;

use meshmend::access::SystemIds;
use meshmend::format::Format;
use meshmend::jobs::{
    Artifacts, Completion, Input, JobId, JobOptions, JobStore, NewJob, PostgresStore, QueueStore, RetryPolicy, Store,
};
use serde_json::{Value, json};
use sqlx::PgPool;

use crate::files;
use crate::postgres::Postgres;
use crate::server::{Api, Start, stored_files, until};
use crate::support::FILES_PER_JOB;
use crate::support::receiver::{Receiver, Reply};
use crate::support::stores::Bench;

fn serve<'a>(data: &'a Path, cluster: &Postgres) -> Start<'a> {
    Start::serve(data).env("MESHMEND_DATABASE_URL", &cluster.url()).env("MESHMEND_NO_WORKERS", "true")
}

fn work<'a>(data: &'a Path, cluster: &Postgres) -> Start<'a> {
    Start::work(data).env("MESHMEND_DATABASE_URL", &cluster.url())
}

#[tokio::test]
async fn changes_in_the_database_notify_every_process() {
    let cluster = Postgres::start();
    let open = || PostgresStore::open("postgres", 4, None, RetryPolicy::default());
    assert!(open().await.is_err(), "no address");
    let url = cluster.url();
    let open = || PostgresStore::open(&url, 4, None, RetryPolicy::default());
    let (one, other) = (open().await.expect("a store"), open().await.expect("another"));
    let mut changes = other.notifier().listen();
    let id = JobId::new(&SystemIds);
    let input = Input { key: "k".into(), name: "a.stl".into(), bytes: 684, sha256: "00".into(), format: Format::Stl };
    // The listener may not be ready for the first job; then the next job notifies it.
    let mut all = vec![id];
    let notified = async {
        loop {
            let id = *all.last().expect("one");
            one.submit(NewJob::new(id, "shop", vec![input.clone()], JobOptions::default())).await.expect("noted");
            match tokio::time::timeout(Duration::from_secs(1), changes.recv()).await {
                Ok(changed) => break changed.expect("a ring"),
                Err(_) => all.push(JobId::new(&SystemIds)),
            }
        }
    };
    let changed = tokio::time::timeout(Duration::from_secs(30), notified).await.expect("it rings");
    assert!(all.contains(&changed));
    tokio::time::timeout(Duration::from_secs(5), other.notifier().work()).await.expect("it rings for work");
}

/// The write-ahead log's position, and how far it is flushed to disk.
async fn written_and_synced(pool: &PgPool) -> (i64, i64) {
    let found = "SELECT (pg_current_wal_insert_lsn() - '0/0')::bigint, (pg_current_wal_flush_lsn() - '0/0')::bigint";
    sqlx::query_as(found).fetch_one(pool).await.expect("a response")
}

#[tokio::test]
async fn promised_writes_wait_for_fsync_and_claims_do_not() {
    let cluster = Postgres::start();
    let url = cluster.url();
    // Otherwise the WAL writer also flushes commits that do not wait for it.
    let looking = PgPool::connect(&url).await.expect("a connection");
    for statement in ["ALTER SYSTEM SET wal_writer_delay = '10s'", "SELECT pg_reload_conf()"] {
        sqlx::query(statement).execute(&looking).await.expect("a superuser");
    }
    let store = PostgresStore::open(&url, 2, None, RetryPolicy::default()).await.expect("a store");
    let lease = Duration::from_secs(60);
    let mut waited = [0; 4];
    for _ in 0..20 {
        let (before, _) = written_and_synced(&looking).await;
        store.submit(Bench::job("shop")).await.expect("accepted");
        let (submitted, synced) = written_and_synced(&looking).await;
        waited[0] += u32::from(synced > before);
        let claim = store.claim("a worker", lease, 1).await.expect("a response").expect("a job");
        let (claimed, synced) = written_and_synced(&looking).await;
        waited[1] += u32::from(synced > submitted);
        store.heartbeat(&claim.lease, lease, None).await.expect("ours");
        let (beaten, synced) = written_and_synced(&looking).await;
        waited[2] += u32::from(synced > claimed);
        let completion = Completion { report: Bench::report(), artifacts: Artifacts::new() };
        store.complete(&claim.lease, completion).await.expect("ours");
        waited[3] += u32::from(written_and_synced(&looking).await.1 > beaten);
    }
    let [submits, claims, heartbeats, ends] = waited;
    assert_eq!((submits, ends), (20, 20));
    // A checkpoint may happen in between.
    assert!(claims < 10 && heartbeats < 10, "{waited:?}");
}

#[tokio::test]
async fn any_server_sends_the_webhooks_and_only_one_sends_each() {
    let (cluster, data) = (Postgres::start(), tempfile::tempdir().expect("a folder"));
    let start = || serve(data.path(), &cluster).env("MESHMEND_WEBHOOK_ALLOW_PRIVATE", "true").start();
    let (one, _other) = (start(), start());
    let _worker = work(data.path(), &cluster).start();
    let api = Api::new(&one);
    let receiver = Receiver::start(&[Reply::Status(204)]).await;
    let created =
        api.post("/v1/webhook-endpoints").json(&json!({"url": receiver.url})).send().await.expect("a response");
    let endpoint: Value = created.json().await.expect("an endpoint");
    let mut jobs = Vec::new();
    for tier in [1, 2, 1, 2, 1, 2] {
        jobs.push(json!(api.submit(files::broken_box(), json!({"max_tier": tier, "pictures": false})).await));
    }
    receiver.got(jobs.len()).await;
    until("all is delivered", async || {
        let metrics = api.get("/metrics").send().await.expect("a response").text().await.expect("text");
        metrics.contains("meshmend_webhook_backlog 0").then_some(())
    })
    .await;
    let seen = receiver.seen();
    assert!(seen.iter().all(|message| message.verifies(&endpoint["secret"])));
    let mut job_ids: Vec<Value> = seen.iter().map(|message| message.json()["data"]["id"].clone()).collect();
    job_ids.sort_by_key(Value::to_string);
    jobs.sort_by_key(Value::to_string);
    assert_eq!(job_ids, jobs, "each once");
}

#[tokio::test]
async fn one_process_serves_and_another_one_works() {
    let (cluster, data) = (Postgres::start(), tempfile::tempdir().expect("a folder"));
    let server = serve(data.path(), &cluster).start();
    let api = Api::new(&server);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    assert_eq!(api.job(&id).await["status"], "queued", "no worker runs yet");
    let _worker = work(data.path(), &cluster).start();
    let job = api.finished(&id).await;
    assert_eq!((&job["status"], &job["outcome"]), (&json!("succeeded"), &json!("repaired")), "{job}");
    assert_eq!(api.artifact(&id, "model").await.len(), 84 + 50 * 12);
}

#[tokio::test]
async fn a_database_outage_at_any_step_of_a_worker_loses_no_job() {
    for pause in ["worker-claimed", "child-tier1", "worker-publish", "worker-complete"] {
        let (mut cluster, data) = (Postgres::start(), tempfile::tempdir().expect("a folder"));
        let server = serve(data.path(), &cluster).start();
        let api = Api::new(&server);
        let worker = work(data.path(), &cluster).env("FAILPOINTS", &format!("{pause}=1*sleep(2000)")).start();
        let waiting = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
        until("the worker has it", async || (api.job(&waiting).await["status"] == "running").then_some(())).await;
        cluster.kill();
        if pause == "child-tier1" {
            let refused = api.try_submit("b.stl", files::broken_box(), json!({"max_tier": 1})).await;
            assert_eq!(refused.status(), 503);
            assert_eq!(refused.headers()["retry-after"], "5");
            assert_eq!(refused.json::<Value>().await.expect("a problem")["code"], "unavailable");
        }
        cluster.restart();
        let job = api.finished(&waiting).await;
        assert_eq!((&job["status"], &job["outcome"]), (&json!("succeeded"), &json!("repaired")), "{pause} {job}");
        let next = api.submit(files::broken_box(), json!({"max_tier": 2})).await;
        assert_eq!(api.finished(&next).await["status"], "succeeded", "{pause}");
        until("no file of a failed attempt is left", async || {
            (stored_files(data.path(), &waiting).len() == FILES_PER_JOB).then_some(())
        })
        .await;
        assert!(!worker.log().contains("panicked"), "{}", worker.log());
    }
}
