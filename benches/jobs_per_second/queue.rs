//! What the queue itself costs: everything that a job writes to and asks of the database, and nothing else of it.

use std::time::{Duration, Instant};

use meshmend::access::SystemIds;
use meshmend::context::Stage;
use meshmend::format::Format;
use meshmend::jobs::{
    Artifact, Artifacts, Completion, Input, JobId, JobOptions, JobProgress, JobReport, NewJob, Store, StoredFile,
};

const LEASE: Duration = Duration::from_secs(60);

/// Submits, claims, reports progress of and completes so many jobs, one after the other, and gives the times that they took, sorted.
pub async fn times(store: &dyn Store, jobs: usize, report: &JobReport) -> Vec<Duration> {
    let mut times = Vec::with_capacity(jobs);
    for _ in 0..jobs {
        let started = Instant::now();
        let id = JobId::new(&SystemIds);
        let input = Input {
            key: format!("uploads/{id}"),
            name: "model.stl".to_owned(),
            bytes: 584,
            sha256: "0".repeat(64),
            format: Format::Stl,
        };
        store.queued_counts("default").await.expect("an answer");
        store.submit(NewJob::new(id, "default", vec![input], JobOptions::default())).await.expect("accepted");
        let claim = store.claim("bench", LEASE, u32::MAX).await.expect("an answer").expect("a job");
        let progress = JobProgress { stage: Stage::Repair, tier: Some(1), percent: 50, estimate: None };
        store.heartbeat(&claim.lease, LEASE, Some(progress)).await.expect("ours");
        let artifacts = ["model", "report.json", "log.txt"].map(|name| {
            let key = format!("jobs/{id}/{}/{name}", claim.lease.token);
            let (filename, media_type) = (name.to_owned(), "application/octet-stream".to_owned());
            let file = Some(StoredFile { key, bytes: 684, sha256: "0".repeat(64) });
            (name.to_owned(), Artifact { filename, media_type, file })
        });
        let completion = Completion { report: report.clone(), artifacts: Artifacts::from(artifacts) };
        store.complete(&claim.lease, completion).await.expect("ours");
        times.push(started.elapsed());
    }
    times.sort_unstable();
    times
}
