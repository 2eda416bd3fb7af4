//! The contract of job stores, tested on each store.

use std::sync::Arc;
use std::sync::atomic::AtomicI64;
use std::time::Duration;

use meshmend::access::SystemIds;
use meshmend::context::Stage;
use meshmend::jobs::{
    Artifacts, CancelResult, Clock, Completion, Connections, FailureKind, JobId, JobOptions, JobProgress, JobStore,
    KEY_HOLD, KEY_LIFE, KeyState, ListQuery, NewJob, NewUpload, ProblemKind, QueueStore, RequestKey, RetentionStore,
    RetryPolicy, SqliteStore, Status, StoreError, UPLOAD_LIFE, UPLOAD_OPEN, UploadId,
};
use sqlx::sqlite::SqliteConnectOptions;

use crate::support::stores::{Bench, LEASE, ManualClock, on_each_store};

on_each_store! {
    jobs_are_claimed_in_the_order_they_came_and_each_only_once,
    concurrent_workers_never_claim_the_same_job,
    a_heartbeat_extends_the_lease_and_an_expired_lease_makes_the_job_claimable,
    every_write_of_a_stale_worker_loses,
    a_passing_failure_waits_longer_each_time_and_is_final_at_the_last_attempt,
    a_job_that_kills_its_workers_is_set_aside,
    a_released_job_is_charged_no_attempt,
    a_cancelled_job_is_taken_from_its_worker,
    a_final_failure_is_not_tried_again_and_can_not_be_cancelled,
    a_purged_job_keeps_its_name_and_loses_its_content,
    a_list_of_statuses_has_only_their_jobs_newest_first,
    the_queue_position_counts_those_ahead,
    the_longest_wait_counts_due_jobs_and_not_retries_that_are_not_due,
    each_change_grows_the_version_and_a_quiet_heartbeat_does_not,
    a_completion_whose_response_was_lost_may_be_repeated,
    a_key_is_held_by_one_request_until_it_is_accepted_given_back_or_late,
    an_upload_is_open_for_a_while_waits_for_longer_and_becomes_one_job_at_most,
    no_more_uploads_wait_than_may,
}

async fn jobs_are_claimed_in_the_order_they_came_and_each_only_once(bench: Bench) {
    let mut ids = Vec::new();
    for _ in 0..4 {
        ids.push(bench.submit().await.id);
        bench.advance(Duration::from_millis(1));
    }
    for id in ids {
        assert_eq!(bench.claim().await.expect("a job").job.id, id);
    }
    assert_eq!(bench.claim().await, None);
}

async fn concurrent_workers_never_claim_the_same_job(bench: Bench) {
    let bench = Arc::new(bench);
    for _ in 0..100 {
        bench.submit().await;
    }
    let workers: Vec<_> = (0..8)
        .map(|_| {
            let bench = Arc::clone(&bench);
            tokio::spawn(async move {
                let mut mine = Vec::new();
                while let Some(claim) = bench.claim().await {
                    mine.push(claim.job.id);
                }
                mine
            })
        })
        .collect();
    let mut all = Vec::new();
    for worker in workers {
        all.extend(worker.await.expect("no panic"));
    }
    all.sort();
    all.dedup();
    assert_eq!(all.len(), 100);
}

async fn a_heartbeat_extends_the_lease_and_an_expired_lease_makes_the_job_claimable(bench: Bench) {
    let job = bench.submit().await;
    let first = bench.claim().await.expect("a job");
    bench.advance(LEASE / 2);
    let progress = JobProgress { stage: Stage::Repair, tier: Some(1), percent: 40, estimate: None };
    bench.store.heartbeat(&first.lease, LEASE, Some(progress)).await.expect("still held");
    assert_eq!(bench.get(job.id).await.progress, Some(progress));
    bench.advance(LEASE / 2 + Duration::from_secs(1));
    assert!(bench.store.requeue_expired().await.expect("a result").is_empty(), "the heartbeat extended the lease");
    bench.advance(LEASE);
    let rescued = bench.store.requeue_expired().await.expect("a result");
    assert_eq!((rescued[0].id, rescued[0].status, rescued[0].crashes), (job.id, Status::Queued, 1));
    let second = bench.claim().await.expect("the job again");
    assert_eq!(second.lease.attempt, 2);
    assert_ne!(second.lease.token, first.lease.token);
}

async fn every_write_of_a_stale_worker_loses(bench: Bench) {
    let job = bench.submit().await;
    let stale = bench.claim().await.expect("a job").lease;
    bench.advance(LEASE + Duration::from_secs(1));
    bench.store.requeue_expired().await.expect("a result");
    bench.claim().await.expect("the job again");
    let before = bench.get(job.id).await;
    let lost = |result: Result<(), StoreError>| assert!(matches!(result, Err(StoreError::LeaseLost)), "{result:?}");
    lost(bench.store.heartbeat(&stale, LEASE, None).await);
    lost(bench.store.release(&stale).await);
    lost(bench.store.fail(&stale, Bench::failure(FailureKind::Final)).await.map(drop));
    let mut forged = stale.clone();
    forged.attempt = 2;
    lost(bench.store.heartbeat(&forged, LEASE, None).await);
    assert_eq!(bench.get(job.id).await, before);
}

async fn a_passing_failure_waits_longer_each_time_and_is_final_at_the_last_attempt(bench: Bench) {
    let job = bench.submit().await;
    let mut waited = Duration::ZERO;
    for attempt in 1..=bench.policy.max_attempts {
        let claim = bench.claim().await.expect("due");
        assert_eq!(claim.lease.attempt, attempt);
        let after = bench.store.fail(&claim.lease, Bench::failure(FailureKind::Transient)).await.expect("noted");
        if attempt == bench.policy.max_attempts {
            assert_eq!(after.status, Status::Failed);
            assert_eq!(after.problem.expect("a problem").detail, "why");
            break;
        }
        assert_eq!(after.status, Status::Queued);
        assert_eq!(bench.claim().await, None, "not due yet");
        let wait = Duration::from_millis(
            u64::try_from((after.run_at.unix_timestamp_nanos() / 1_000_000) as i64 - bench.clock.now_ms())
                .expect("later"),
        );
        assert!(wait >= waited, "{wait:?} after {waited:?}");
        waited = wait;
        bench.advance(wait);
    }
    assert_eq!(bench.get(job.id).await.crashes, 0, "crashes are counted separately");
}

async fn a_job_that_kills_its_workers_is_set_aside(bench: Bench) {
    let job = bench.submit().await;
    for crash in 1..=bench.policy.max_crashes {
        bench.claim().await.expect("claimable");
        bench.advance(LEASE + Duration::from_secs(1));
        let rescued = bench.store.requeue_expired().await.expect("a result");
        assert_eq!(rescued[0].crashes, crash);
    }
    let job = bench.get(job.id).await;
    assert_eq!(job.status, Status::Failed);
    assert_eq!(job.problem.expect("a problem").code, ProblemKind::WorkerLost);
    assert_eq!(bench.claim().await, None);
}

async fn a_released_job_is_charged_no_attempt(bench: Bench) {
    let job = bench.submit().await;
    let claim = bench.claim().await.expect("a job");
    bench.store.release(&claim.lease).await.expect("held");
    let after = bench.get(job.id).await;
    assert_eq!((after.status, after.attempt, after.crashes), (Status::Queued, 0, 0));
    let again = bench.claim().await.expect("the job again");
    assert_eq!(again.lease.attempt, 1);
    assert!(
        matches!(bench.store.release(&claim.lease).await, Err(StoreError::LeaseLost)),
        "the same attempt with another token"
    );
}

async fn a_cancelled_job_is_taken_from_its_worker(bench: Bench) {
    let job = bench.submit().await;
    let claim = bench.claim().await.expect("a job");
    assert!(matches!(bench.store.cancel(job.id).await.expect("a result"), Some(CancelResult::Canceled(_))));
    assert!(matches!(bench.store.heartbeat(&claim.lease, LEASE, None).await, Err(StoreError::LeaseLost)));
    assert!(matches!(bench.store.cancel(job.id).await.expect("a result"), Some(CancelResult::Canceled(_))));
    assert_eq!(bench.store.cancel(JobId::new(&SystemIds)).await.expect("a result"), None);
}

async fn a_final_failure_is_not_tried_again_and_can_not_be_cancelled(bench: Bench) {
    let job = bench.submit().await;
    let claim = bench.claim().await.expect("a job");
    let after = bench.store.fail(&claim.lease, Bench::failure(FailureKind::Final)).await.expect("noted");
    assert_eq!(after.status, Status::Failed);
    assert!(matches!(bench.store.cancel(job.id).await.expect("a result"), Some(CancelResult::AlreadyEnded(_))));
}

async fn a_purged_job_keeps_its_name_and_loses_its_content(bench: Bench) {
    let job = bench.submit().await;
    bench.claim().await.expect("a job");
    assert!(bench.store.purge(job.id).await.expect("a result"));
    let after = bench.get(job.id).await;
    assert!(after.purged);
    assert_eq!((after.status, after.inputs.len()), (Status::Canceled, 2));
    for (before, input) in job.inputs.iter().zip(after.inputs) {
        assert_eq!((input.name.as_str(), input.sha256.as_str(), input.key), ("", "", before.key.clone()));
    }
    assert!(
        bench
            .store
            .list(ListQuery { tenant: "shop".into(), limit: 10, ..ListQuery::default() })
            .await
            .expect("a result")
            .items
            .is_empty()
    );
    assert!(!bench.store.purge(JobId::new(&SystemIds)).await.expect("a result"));
}

async fn a_list_of_statuses_has_only_their_jobs_newest_first(bench: Bench) {
    let mut jobs = Vec::new();
    for _ in 0..3 {
        jobs.push(bench.submit().await.id);
        bench.advance(Duration::from_millis(5));
    }
    bench.claim().await.expect("the first job");
    bench.store.cancel(jobs[1]).await.expect("a result");
    let list = async |statuses: &[Status], limit| {
        let query = ListQuery { tenant: "shop".into(), statuses: statuses.to_vec(), limit, ..ListQuery::default() };
        let page = bench.store.list(query).await.expect("a page");
        page.items.iter().map(|job| job.id).collect::<Vec<_>>()
    };
    assert_eq!(list(&[Status::Queued], 10).await, [jobs[2]]);
    assert_eq!(list(&[Status::Canceled], 10).await, [jobs[1]]);
    assert!(list(&[Status::Failed], 10).await.is_empty());
    assert_eq!(list(&[Status::Running, Status::Queued], 10).await, [jobs[2], jobs[0]]);
    assert_eq!(list(&[], 2).await, [jobs[2], jobs[1]]);
    bench.submit().await;
    assert_eq!(list(&[Status::Queued], 1).await.len(), 1);
}

async fn the_queue_position_counts_those_ahead(bench: Bench) {
    let mut jobs = Vec::new();
    for _ in 0..3 {
        jobs.push(bench.submit().await);
        bench.advance(Duration::from_millis(5));
    }
    for (ahead, job) in jobs.iter().enumerate() {
        assert_eq!(bench.store.queue_position(job).await.expect("a result"), Some(ahead as u64));
    }
    bench.claim().await.expect("a job");
    assert_eq!(bench.store.queue_position(&jobs[2]).await.expect("a result"), Some(1));
    let running = bench.get(jobs[0].id).await;
    assert_eq!(bench.store.queue_position(&running).await.expect("a result"), None);
}

async fn the_longest_wait_counts_due_jobs_and_not_retries_that_are_not_due(bench: Bench) {
    let wait = async || bench.store.longest_wait().await.expect("a result");
    assert_eq!(wait().await, Duration::ZERO);
    bench.submit().await;
    bench.advance(Duration::from_secs(3));
    bench.submit().await;
    bench.advance(Duration::from_secs(2));
    assert_eq!(wait().await, Duration::from_secs(5));
    let first = bench.claim().await.expect("a job");
    assert_eq!(wait().await, Duration::from_secs(2));
    bench.claim().await.expect("a job");
    assert_eq!(wait().await, Duration::ZERO);
    bench.store.fail(&first.lease, Bench::failure(FailureKind::Transient)).await.expect("noted");
    assert_eq!(wait().await, Duration::ZERO);
    let Connections { busy, idle, most } = bench.store.connections();
    assert!(busy + idle >= 1 && busy + idle <= most, "{busy} {idle} {most}");
}

async fn each_change_grows_the_version_and_a_quiet_heartbeat_does_not(bench: Bench) {
    let job = bench.submit().await;
    let claim = bench.claim().await.expect("a job");
    assert!(claim.job.version > job.version);
    let progress = JobProgress { stage: Stage::Inspect, tier: None, percent: 5, estimate: None };
    bench.store.heartbeat(&claim.lease, LEASE, Some(progress)).await.expect("held");
    let news = bench.get(job.id).await.version;
    assert!(news > claim.job.version);
    bench.store.heartbeat(&claim.lease, LEASE, None).await.expect("held");
    bench.store.heartbeat(&claim.lease, LEASE, Some(progress)).await.expect("held");
    assert_eq!(bench.get(job.id).await.version, news);
}

async fn a_completion_whose_response_was_lost_may_be_repeated(bench: Bench) {
    let job = bench.submit().await;
    let first = bench.claim().await.expect("a job").lease;
    let failed = bench.store.fail(&first, Bench::failure(FailureKind::Transient)).await.expect("noted");
    let again = bench.store.fail(&first, Bench::failure(FailureKind::Transient)).await.expect("noted before");
    assert_eq!((failed.status, again), (Status::Queued, failed.clone()));
    bench.advance(Duration::from_secs(600));
    let second = bench.claim().await.expect("the job again").lease;
    let completion = Completion { report: Bench::report(), artifacts: Artifacts::new() };
    let done = bench.store.complete(&second, completion.clone()).await.expect("ended");
    assert_eq!(bench.store.complete(&second, completion.clone()).await.expect("ended before"), done);
    bench.store.release(&second).await.expect("the end stands, and the worker keeps its files");
    assert_eq!(bench.get(job.id).await.version, done.version, "nothing was written twice");
    let late = bench.store.complete(&first, completion).await;
    assert!(matches!(late, Err(StoreError::LeaseLost)), "{late:?}");
}

async fn a_key_is_held_by_one_request_until_it_is_accepted_given_back_or_late(bench: Bench) {
    let [first, second] = [JobId::new(&SystemIds), JobId::new(&SystemIds)];
    let hold = async |job| bench.store.hold_key("shop", "k", job).await.expect("a result");
    let submit = async |id, fingerprint: &str| {
        let key = Some(RequestKey { key: "k".into(), fingerprint: fingerprint.into() });
        let inputs = bench.submit().await.inputs;
        bench.store.submit(NewJob { key, ..NewJob::new(id, "shop", inputs, JobOptions::default()) }).await
    };
    assert_eq!((hold(first).await, hold(second).await), (KeyState::Held, KeyState::InUse));
    bench.advance(KEY_HOLD / 2);
    assert_eq!(hold(first).await, KeyState::Held, "the key is held longer");
    bench.advance(KEY_HOLD / 2 + Duration::from_secs(1));
    assert_eq!(hold(second).await, KeyState::InUse);
    bench.store.release_key("shop", "k", second).await.expect("a result");
    assert_eq!(hold(second).await, KeyState::InUse, "only its holder releases the key");
    bench.advance(KEY_HOLD);
    assert_eq!(hold(second).await, KeyState::Held, "the first request is too late");
    assert!(matches!(submit(first, "a").await, Err(StoreError::KeyLost)));
    assert_eq!(bench.store.get(first).await.expect("a result"), None);
    submit(second, "b").await.expect("accepted");
    assert_eq!(hold(first).await, KeyState::Used { fingerprint: "b".into(), job: second });
    bench.store.release_key("shop", "k", second).await.expect("a result");
    assert!(matches!(hold(second).await, KeyState::Used { .. }), "the key of an accepted request is not released");
    assert_eq!(bench.store.forget_keys().await.expect("a result"), 0);
    bench.advance(KEY_LIFE);
    assert_eq!(bench.store.forget_keys().await.expect("a result"), 1);
    assert_eq!(hold(first).await, KeyState::Held);
    bench.store.release_key("shop", "k", first).await.expect("a result");
    assert_eq!(hold(second).await, KeyState::Held);
}

fn new_upload() -> NewUpload {
    let (tenant, name, token) = ("default".to_owned(), Some("a.stl".to_owned()), Some("00".to_owned()));
    NewUpload { id: UploadId::new(&SystemIds), tenant, name, token_sha256: token }
}

async fn an_upload_is_open_for_a_while_waits_for_longer_and_becomes_one_job_at_most(bench: Bench) {
    let uploads = [new_upload(), new_upload()];
    for upload in &uploads {
        let noted = bench.store.add_upload(upload.clone(), 10).await.expect("a result").expect("noted");
        assert_eq!((&noted.upload, noted.is_open, noted.job), (upload, true, None));
        assert_eq!(noted.created_at.unix_timestamp_nanos() / 1_000_000, i128::from(bench.clock.now_ms()));
    }
    let find = async |upload: &NewUpload| bench.store.upload(upload.id).await.expect("a result");
    let submit = async |id, upload: UploadId| {
        let inputs = bench.submit().await.inputs;
        let job = NewJob { upload: Some(upload), ..NewJob::new(id, "default", inputs, JobOptions::default()) };
        bench.store.submit(job).await
    };
    let [used, unused] = &uploads;
    bench.advance(UPLOAD_OPEN - Duration::from_millis(1));
    assert!(find(used).await.expect("there").is_open);
    bench.advance(Duration::from_millis(1));
    assert!(!find(used).await.expect("there").is_open);
    let [first, second] = [JobId::new(&SystemIds), JobId::new(&SystemIds)];
    submit(first, used.id).await.expect("accepted");
    for upload in [used.id, UploadId::new(&SystemIds)] {
        assert!(matches!(submit(second, upload).await, Err(StoreError::UploadTaken)));
        assert_eq!(bench.store.get(second).await.expect("a result"), None);
    }
    assert_eq!(find(used).await.expect("there").job, Some(first));
    assert_eq!(bench.store.forget_uploads().await.expect("a result"), 0);
    bench.advance(UPLOAD_LIFE - UPLOAD_OPEN);
    assert_eq!(find(unused).await, None);
    assert!(matches!(submit(second, unused.id).await, Err(StoreError::UploadTaken)));
    assert_eq!(find(used).await.expect("the request may be repeated").job, Some(first));
    assert_eq!(bench.store.forget_uploads().await.expect("a result"), 1);
    bench.advance(KEY_LIFE);
    assert_eq!(bench.store.forget_uploads().await.expect("a result"), 1);
    assert_eq!(find(used).await, None);
}

async fn no_more_uploads_wait_than_may(bench: Bench) {
    let add = async || bench.store.add_upload(new_upload(), 2).await.expect("a result");
    let first = add().await.expect("noted").upload.id;
    bench.advance(Duration::from_secs(60));
    assert!(add().await.is_some() && add().await.is_none());
    let inputs = bench.submit().await.inputs;
    let job =
        NewJob { upload: Some(first), ..NewJob::new(JobId::new(&SystemIds), "default", inputs, JobOptions::default()) };
    bench.store.submit(job).await.expect("accepted");
    assert!(add().await.is_some() && add().await.is_none(), "one became a job");
    bench.advance(UPLOAD_LIFE);
    assert!(add().await.is_some(), "all other uploads have expired");
}

#[tokio::test]
async fn jobs_of_the_first_version_are_read_claimed_and_purged() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("jobs.db");
    let first = folder.path().join("migrations");
    std::fs::create_dir(&first).expect("a folder");
    std::fs::write(first.join("0001_jobs.sql"), include_str!("../../migrations/sqlite/0001_jobs.sql")).expect("a file");
    let old = sqlx::SqlitePool::connect_with(SqliteConnectOptions::new().filename(&path).create_if_missing(true));
    let old = old.await.expect("a database");
    sqlx::migrate::Migrator::new(first).await.expect("a migration").run(&old).await.expect("tables");
    let (queued, done) = (JobId::new(&SystemIds), JobId::new(&SystemIds));
    for (id, status, finished, report) in
        [(queued, "queued", None, None), (done, "succeeded", Some(2), Some("{\"version\":1}"))]
    {
        sqlx::query(
            "INSERT INTO jobs (id, status, created_at, run_at, finished_at, input, input_key, options, report) VALUES \
             (?, ?, 1, 1, ?, '{\"name\":\"a.stl\",\"bytes\":84,\"sha256\":\"00\",\"format\":\"stl\"}', ?, \
              '{\"max_tier\":2}', ?)",
        )
        .bind(id.to_string())
        .bind(status)
        .bind(finished)
        .bind(format!("uploads/{id}"))
        .bind(report)
        .execute(&old)
        .await
        .expect("a row");
    }
    old.close().await;

    let clock = Arc::new(ManualClock(AtomicI64::new(1_800_000_000_000)));
    let store = SqliteStore::open(&path, clock, RetryPolicy::default()).await.expect("brought up to date");
    let claim = store.claim("worker", LEASE, u32::MAX).await.expect("a result").expect("the old job");
    let input = &claim.job.inputs[0];
    assert_eq!((claim.job.id, claim.job.inputs.len()), (queued, 1));
    assert_eq!((input.key.clone(), input.name.as_str(), input.bytes), (format!("uploads/{queued}"), "a.stl", 84));
    assert!(matches!(&claim.job.options, JobOptions::Repair(options) if options.max_tier == 2));
    let report = store.get(done).await.expect("readable").expect("there").report.expect("the old report");
    let report = serde_json::to_value(report).expect("JSON");
    assert_eq!(report, serde_json::json!({"mode": "repair", "version": 1}));
    assert!(store.purge(done).await.expect("a result"));
    assert_eq!(store.get(done).await.expect("readable").expect("there").inputs[0].name, "");
}
