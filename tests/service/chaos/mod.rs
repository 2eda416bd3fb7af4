//! Random faults while clients submit: every accepted job ends exactly once, and its webhook is delivered.
//!
//! Long run: `MESHMEND_KILLS=500 cargo test --features failpoints --test service -- --ignored --nocapture chaos`.
//! `MESHMEND_KILL_SEED` chooses other faults.

mod clients;
mod random;
mod service;

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use futures::StreamExt;
use reqwest::Client;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use crate::server::until;
use crate::support::audit::Audit;
use clients::Clients;
use random::Random;
use service::{Files, Service};

async fn get(http: &Client, url: String) -> reqwest::Response {
    let response = http.get(url).timeout(Duration::from_secs(10)).send().await.expect("a response");
    assert_eq!(response.status(), 200);
    response
}

/// The status of a finished job; asserts that its files are intact.
async fn outcome(http: &Client, base: &str, id: &str) -> String {
    let job: Value = get(http, format!("{base}/v1/jobs/{id}")).await.json().await.expect("a job");
    let code = job["problem"]["code"].as_str().unwrap_or_default();
    if job["status"] == "succeeded" {
        for (name, artifact) in job["artifacts"].as_object().expect("files") {
            let file = get(http, format!("{base}/v1/jobs/{id}/artifacts/{name}")).await;
            let hash = hex::encode(Sha256::digest(file.bytes().await.expect("bytes")));
            // Pictures have no hash.
            assert!(artifact["sha256"].is_null() || artifact["sha256"] == json!(hash), "{id} {name}");
        }
        assert!(job["artifacts"]["model"].is_object(), "{job}");
    } else {
        // Its worker or child was killed three times.
        assert!(["crashed", "worker_lost"].contains(&code), "{job}");
    }
    format!("{} {code}", job["status"].as_str().expect("text"))
}

async fn run_with_faults(files: Files, kills: usize, seed: u64) {
    let began = Instant::now();
    let mut random = Random(seed);
    let mut service = Service::start(files, &mut random).await;
    let audit = Audit::begin(&service.cluster.url()).await;
    meshmend::tls::use_ring();
    let (http, base) = (Client::new(), format!("http://{}", service.addresses()[0]));
    let endpoint = http.post(format!("{base}/v1/webhook-endpoints")).json(&json!({"url": service.receiver.url}));
    assert_eq!(endpoint.send().await.expect("a response").status(), 201);
    let mut clients = Clients::start(service.addresses());
    // Every victim is hit once before any is hit again.
    let (mut hits, mut deck) = (BTreeMap::new(), Vec::new());
    for _ in 0..kills {
        tokio::time::sleep(Duration::from_millis(50 + random.below(350) as u64)).await;
        if deck.is_empty() {
            deck = service.victims();
        }
        let victim = deck.swap_remove(random.below(deck.len()));
        *hits.entry(victim).or_insert(0) += 1;
        service.hit(victim, &mut random).await;
    }
    tokio::time::sleep(Duration::from_secs(1)).await;
    let accepted = clients.stop().await;
    assert!(accepted.len() > kills / 4, "only {} jobs were accepted", accepted.len());

    audit.at_rest().await;
    let mut outcomes: BTreeMap<String, usize> = BTreeMap::new();
    let mut asked = futures::stream::iter(&accepted).map(|id| outcome(&http, &base, id)).buffer_unordered(16);
    while let Some(outcome) = asked.next().await {
        *outcomes.entry(outcome).or_default() += 1;
    }
    let ended = audit.ended_once(&accepted).await;
    let messages = audit.delivered_once(&service.receiver).await;
    let owned = audit.owned().await;
    let stored: BTreeSet<_> = service.files().into_iter().collect();
    assert!(stored.is_superset(&owned), "lost: {:?}", owned.difference(&stored));
    service.sweep();
    until("nothing is left that no job owns", async || {
        (service.files().into_iter().collect::<BTreeSet<_>>() == owned).then_some(())
    })
    .await;
    service.stop();
    let line = format!(
        "{kills} kills (seed {seed}, {files:?}) {hits:?} in {:.0} s: {} accepted, {ended} jobs ended once each, {outcomes:?}, {} refused; \
         {ended} ends told by {messages} messages; {} files, {} swept away",
        began.elapsed().as_secs_f64(),
        accepted.len(),
        clients.load.refused.load(Ordering::Relaxed),
        owned.len(),
        stored.len() - owned.len()
    );
    let _ = writeln!(std::io::stderr(), "{line}");
}

#[tokio::test(flavor = "multi_thread")]
async fn no_job_is_lost_or_done_twice_by_a_dozen_kills() {
    run_with_faults(Files::Folder, 10, 7).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_job_is_lost_or_done_twice_by_a_dozen_kills_with_its_files_in_a_bucket() {
    run_with_faults(Files::Bucket, 14, 7).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes"]
async fn no_job_is_lost_or_done_twice_by_hundreds_of_kills() {
    let number =
        |name: &str, otherwise: u64| std::env::var(name).ok().and_then(|n| n.parse().ok()).unwrap_or(otherwise);
    let kills = usize::try_from(number("MESHMEND_KILLS", 500)).expect("a number");
    run_with_faults(Files::Bucket, kills, number("MESHMEND_KILL_SEED", 1)).await;
}
