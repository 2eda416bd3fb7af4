//! The connection to PostgreSQL breaks at each statement of a job, and no job is lost.
//!
//! The statements are those from a job's upload to its webhook. The connection breaks before the server receives the
//! statement, or after the server has executed it and before its response arrives.

use std::time::{Duration, Instant};

use reqwest::Client;
use serde_json::{Value, json};

use crate::files;
use crate::postgres::Postgres;
use crate::proxy::{Proxy, Side};
use crate::server::{Start, until};
use crate::support::audit::Audit;
use crate::support::receiver::{Receiver, Reply};

/// Parts of statements that the test must cover.
const AMONG: [&str; 10] = [
    "INSERT INTO idempotency_keys",
    "INSERT INTO jobs",
    "COMMIT of INSERT INTO jobs",
    "SET status = 'running'",
    "SET lease_expires_at",
    "SET status = 'succeeded'",
    "COMMIT of INSERT INTO webhook_deliveries",
    "UPDATE webhook_deliveries SET tries = tries + 1",
    "COMMIT of UPDATE webhook_deliveries",
    "lease_expires_at <= meshmend_now($1) ORDER BY id FOR UPDATE SKIP LOCKED",
];

/// How long a repeated request may be refused: less than the time for which a dead server's request holds its key.
const REFUSED: Duration = Duration::from_secs(20);

/// Sends a model until it is accepted.
async fn submit(http: &Client, url: &str, key: &str) -> String {
    let sent = Instant::now();
    let id = until("the model is accepted", async || {
        let request = http.post(format!("{url}/v1/jobs?max_tier=1&pictures=false")).header("idempotency-key", key);
        let response =
            request.header("cache-control", "no-cache").body(files::broken_box()).send().await.expect("a response");
        let status = response.status().as_u16();
        assert!([202, 409, 503].contains(&status), "{status} {:?}", response.text().await);
        if status != 202 {
            return None;
        }
        let job: Value = response.json().await.expect("a job");
        Some(job["id"].as_str().expect("an id").to_owned())
    })
    .await;
    assert!(sent.elapsed() < REFUSED, "the idempotency key was in use for {:?}", sent.elapsed());
    id
}

async fn break_at_each_statement(side: Side) {
    meshmend::tls::use_ring();
    let (cluster, data) = (Postgres::start(), tempfile::tempdir().expect("a folder"));
    let proxy = Proxy::start(&cluster);
    let receiver = Receiver::start(&[Reply::Status(204)]).await;
    let program = Start::serve(data.path())
        .env("MESHMEND_DATABASE_URL", &proxy.url())
        .env("MESHMEND_WEBHOOK_ALLOW_PRIVATE", "true")
        .arg("--workers", "1")
        .arg("--webhook-timeout-s", "0.3")
        .arg("--webhook-retry-s", "0.1,0.1,0.1,0.1")
        // Long enough for a heartbeat.
        .env("FAILPOINTS", "child-tier1=1*sleep(300)")
        .start();
    let audit = Audit::begin(&cluster.url()).await;
    let http = Client::new();
    let endpoint = http.post(format!("{}/v1/webhook-endpoints", program.url)).json(&json!({"url": receiver.url}));
    assert_eq!(endpoint.send().await.expect("a response").status(), 201);

    // The first job runs among the statements of the program's start, which are not repeated soon.
    let mut accepted = vec![submit(&http, &program.url, "first").await];
    audit.at_rest().await;
    proxy.forget();
    accepted.push(submit(&http, &program.url, "second").await);
    audit.at_rest().await;
    let statements = until("all statements of a job and of periodic work were executed", async || {
        let seen = proxy.seen();
        AMONG.iter().all(|part| seen.iter().any(|statement| statement.contains(part))).then_some(seen)
    })
    .await;
    for (number, statement) in statements.iter().enumerate() {
        proxy.cut_at(statement, side);
        accepted.push(submit(&http, &program.url, &number.to_string()).await);
        until(&format!("it breaks at {statement}"), async || proxy.has_cut().then_some(())).await;
        audit.at_rest().await;
    }
    let failed: Vec<String> = sqlx::query_scalar("SELECT id FROM jobs WHERE status <> 'succeeded'")
        .fetch_all(&audit.pool)
        .await
        .expect("a response");
    assert_eq!(failed, [""; 0]);
    assert_eq!(audit.ended_once(&accepted).await, accepted.len(), "no request created two jobs");
    audit.delivered_once(&receiver).await;
    assert!(!program.log().contains("panicked"), "{}", program.log());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_that_breaks_before_any_statement_costs_no_job() {
    break_at_each_statement(Side::Before).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_that_breaks_after_any_statement_costs_no_job_and_repeats_none() {
    break_at_each_statement(Side::After).await;
}
