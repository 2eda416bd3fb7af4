//! Claims and completions of jobs in a store, without files and repairs.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use futures::future::join_all;
use meshmend::access::SystemIds;
use meshmend::format::Format;
use meshmend::jobs::{
    Artifact, Artifacts, Completion, Input, JobId, JobOptions, JobReport, Lease, NewJob, Store, StoredFile,
};

use crate::work::box_report;

const LEASE: Duration = Duration::from_secs(600);
const AT_ONCE: usize = 4;

/// Submits jobs without their files.
pub async fn submit(store: &dyn Store, jobs: usize) {
    for _ in 0..jobs {
        let id = JobId::new(&SystemIds);
        let input = Input {
            key: format!("uploads/{id}"),
            name: "model.stl".to_owned(),
            bytes: 584,
            sha256: "0".repeat(64),
            format: Format::Stl,
        };
        store.submit(NewJob::new(id, "default", vec![input], JobOptions::default())).await.expect("accepted");
    }
}

/// Claims per second, and completions per second of the claimed jobs.
pub async fn rates(store: &dyn Store, time: Duration) -> (f64, f64) {
    let claimed = Mutex::new(Vec::new());
    let started = Instant::now();
    join_all((0..AT_ONCE).map(|_| claim(store, started + time, &claimed))).await;
    let claims = claimed.lock().expect("not poisoned").len();
    let per_second = |count: usize, since: Instant| count as f64 / since.elapsed().as_secs_f64();
    let claim_rate = per_second(claims, started);
    let report = box_report();
    let started = Instant::now();
    join_all((0..AT_ONCE).map(|_| complete(store, started + time, &claimed, &report))).await;
    let left = claimed.lock().expect("not poisoned").len();
    (claim_rate, per_second(claims - left, started))
}

async fn claim(store: &dyn Store, until: Instant, claimed: &Mutex<Vec<Lease>>) {
    while Instant::now() < until {
        let Some(claim) = store.claim("bench", LEASE, u32::MAX).await.expect("an answer") else { return };
        claimed.lock().expect("not poisoned").push(claim.lease);
    }
}

async fn complete(store: &dyn Store, until: Instant, claimed: &Mutex<Vec<Lease>>, report: &JobReport) {
    while Instant::now() < until {
        let next = claimed.lock().expect("not poisoned").pop();
        let Some(lease) = next else { return };
        let artifacts = ["model", "report.json", "log.txt"].map(|name| {
            let key = format!("jobs/{}/{}/{name}", lease.id, lease.token);
            let (filename, media_type) = (name.to_owned(), "application/octet-stream".to_owned());
            let file = Some(StoredFile { key, bytes: 684, sha256: "0".repeat(64) });
            (name.to_owned(), Artifact { filename, media_type, file })
        });
        let completion = Completion { report: report.clone(), artifacts: Artifacts::from(artifacts) };
        store.complete(&lease, completion).await.expect("ours");
    }
}
