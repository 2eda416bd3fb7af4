//! The contract of stores for webhooks, tested on each store.

use std::sync::Arc;
use std::time::Duration;

use meshmend::jobs::{
    Artifacts, Completion, DeliveryAttempt, DeliveryQuery, DeliveryResult, DeliveryStatus, DueDelivery, Endpoint,
    EndpointChange, FAILING, FailureKind, Job, JobEvent, JobId, NewEndpoint, NewJob, RedeliveryResult, Reused,
    SigningSecret, Status,
};
use serde_json::{Value, json};
use time::OffsetDateTime;

use crate::support::stores::{Bench, LEASE, on_each_store};

on_each_store! {
    every_end_of_a_job_creates_its_deliveries,
    a_job_s_end_and_its_messages_are_written_in_one_transaction,
    a_delivery_is_claimed_by_one_and_by_another_when_its_lease_ends,
    tenants_take_turns_and_hanging_receivers_delay_no_other_tenant,
    concurrent_dispatchers_never_claim_the_same_delivery,
    an_endpoint_is_disabled_when_it_responds_410_or_fails_for_days,
    finished_deliveries_are_sent_again_on_request,
    a_secret_that_was_replaced_is_known_beside_the_new_one,
    endpoints_belong_to_a_tenant_and_their_number_is_limited,
    messages_are_deleted_with_their_job_or_after_some_time,
}

const MOST: u32 = 100;

fn secret(text: &str) -> SigningSecret {
    SigningSecret::new(format!("whsec_{text}"))
}

fn new_endpoint(tenant: &str, events: &[JobEvent]) -> NewEndpoint {
    NewEndpoint {
        tenant: tenant.into(),
        url: "https://shop.example/hooks".into(),
        description: "orders".into(),
        events: events.to_vec(),
        secret: secret("Zmlyc3Q="),
    }
}

async fn endpoint(bench: &Bench, tenant: &str) -> Endpoint {
    let created = bench.store.create_endpoint(new_endpoint(tenant, &JobEvent::ALL), MOST).await;
    created.expect("a result").expect("an endpoint")
}

async fn claim(bench: &Bench) -> Option<DueDelivery> {
    bench.store.claim_delivery(LEASE, MOST).await.expect("a result")
}

fn attempt(status: u16) -> DeliveryAttempt {
    DeliveryAttempt { at: OffsetDateTime::UNIX_EPOCH, status: Some(status), error: None, milliseconds: 5 }
}

async fn settle(bench: &Bench, due: &DueDelivery, verdict: DeliveryResult) -> bool {
    bench.store.settle_delivery(due, attempt(500), verdict).await.expect("a result")
}

/// Cancels a new job of the tenant, which creates a delivery for each of its endpoints.
async fn cancel_new_job(bench: &Bench, tenant: &str) -> Job {
    let job = bench.submit_of(tenant).await;
    bench.store.cancel(job.id).await.expect("a result");
    job
}

async fn deliveries_of(bench: &Bench, tenant: &str) -> Vec<meshmend::jobs::Delivery> {
    let query = DeliveryQuery { tenant: tenant.into(), limit: 100, ..DeliveryQuery::default() };
    bench.store.deliveries(query).await.expect("a result").items
}

fn completion() -> Completion {
    Completion { report: Bench::report(), artifacts: Artifacts::new() }
}

async fn every_end_of_a_job_creates_its_deliveries(bench: Bench) {
    let store = &bench.store;
    let all = endpoint(&bench, "shop").await;
    let only_failures = new_endpoint("shop", &[JobEvent::Failed]);
    let only_failures = store.create_endpoint(only_failures, MOST).await.expect("a result").expect("an endpoint");
    let disabled = endpoint(&bench, "shop").await;
    let off = EndpointChange { enabled: Some(false), ..EndpointChange::default() };
    store.change_endpoint("shop", &disabled.id, off).await.expect("a result").expect("there");
    endpoint(&bench, "rival").await;

    let events_of = async |job: JobId| {
        let query = DeliveryQuery { tenant: "shop".into(), job: Some(job), limit: 10, ..DeliveryQuery::default() };
        let mut deliveries = store.deliveries(query).await.expect("a result").items;
        deliveries.sort_by(|a, b| a.id.cmp(&b.id));
        deliveries.into_iter().map(|d| (d.kind, d.endpoint.or(d.url).expect("a receiver"))).collect::<Vec<_>>()
    };
    let to = |kind: &str, whom: &[&str]| whom.iter().map(|id| (kind.to_owned(), (*id).to_owned())).collect::<Vec<_>>();

    let callback = Some("https://shop.example/one".to_owned());
    let with_callback = NewJob { callback_url: callback, ..Bench::job("shop") };
    let first = store.submit(with_callback).await.expect("accepted");
    assert_eq!(events_of(first.id).await, [], "the job has not ended");
    let held = bench.claim().await.expect("a job").lease;
    store.fail(&held, Bench::failure(FailureKind::Transient)).await.expect("noted");
    assert_eq!(events_of(first.id).await, [], "the delivery is retried");
    bench.advance(Duration::from_secs(600));
    let held = bench.claim().await.expect("the job again").lease;
    let done = store.complete(&held, completion()).await.expect("completed");
    assert_eq!(events_of(first.id).await, to("job.succeeded", &[&all.id, "https://shop.example/one"]));
    store.complete(&held, completion()).await.expect("completed before");
    assert_eq!(events_of(first.id).await.len(), 2, "no delivery is claimed twice");

    let failed = bench.submit().await;
    let held = bench.claim().await.expect("a job").lease;
    store.fail(&held, Bench::failure(FailureKind::Final)).await.expect("noted");
    assert_eq!(events_of(failed.id).await, to("job.failed", &[&all.id, &only_failures.id]));

    let lost = bench.submit().await;
    for _ in 0..bench.policy.max_crashes {
        assert_eq!(events_of(lost.id).await, []);
        bench.claim().await.expect("a job");
        bench.advance(LEASE + Duration::from_secs(1));
        store.requeue_expired().await.expect("a result");
    }
    assert_eq!(events_of(lost.id).await, to("job.failed", &[&all.id, &only_failures.id]));

    let stopped = cancel_new_job(&bench, "shop").await;
    store.cancel(stopped.id).await.expect("a result");
    assert_eq!(events_of(stopped.id).await, to("job.canceled", &[&all.id]));

    let (outcome, report) = (done.outcome.expect("an outcome"), done.report.clone().expect("a report"));
    let result = Some(Reused { from: done.id, outcome, report, artifacts: Artifacts::new() });
    let reused = store.submit(NewJob { result, ..Bench::job("shop") }).await.expect("accepted");
    assert_eq!(events_of(reused.id).await, to("job.succeeded", &[&all.id]));

    let due = claim(&bench).await.expect("due");
    let payload: Value = serde_json::from_str(&due.payload).expect("JSON");
    assert_eq!((&payload["type"], &payload["data"]["id"]), (&json!("job.succeeded"), &json!(first.id)));
    assert_eq!((&payload["data"]["status"], &payload["data"]["input"]["name"]), (&json!("succeeded"), &json!("a.stl")));
    assert!(deliveries_of(&bench, "rival").await.is_empty());
}

async fn a_job_s_end_and_its_messages_are_written_in_one_transaction(bench: Bench) {
    endpoint(&bench, "shop").await;
    let (running, waiting) = (bench.submit().await, bench.submit().await);
    let claim = bench.claim().await.expect("a job");
    assert_eq!(claim.job.id, running.id);
    bench
        .execute(
            "CREATE TRIGGER broken BEFORE INSERT ON webhook_deliveries BEGIN SELECT RAISE(ABORT, 'broken'); END",
            "CREATE FUNCTION broken() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN RAISE EXCEPTION 'broken'; END $$; \
             CREATE TRIGGER broken BEFORE INSERT ON webhook_deliveries FOR EACH ROW EXECUTE FUNCTION broken()",
        )
        .await;
    let before = bench.get(running.id).await;
    assert!(bench.store.complete(&claim.lease, completion()).await.is_err());
    assert!(bench.store.fail(&claim.lease, Bench::failure(FailureKind::Final)).await.is_err());
    assert!(bench.store.cancel(waiting.id).await.is_err());
    assert_eq!(bench.get(running.id).await, before, "its end is not stored either");
    assert_eq!(bench.get(waiting.id).await.status, Status::Queued);
    bench.execute("DROP TRIGGER broken", "DROP TRIGGER broken ON webhook_deliveries").await;
    bench.store.complete(&claim.lease, completion()).await.expect("completed");
    assert_eq!(deliveries_of(&bench, "shop").await.len(), 1);
}

async fn a_delivery_is_claimed_by_one_and_by_another_when_its_lease_ends(bench: Bench) {
    let store = &bench.store;
    let endpoint = endpoint(&bench, "shop").await;
    let job = cancel_new_job(&bench, "shop").await;
    let first = claim(&bench).await.expect("due");
    assert_eq!(
        (first.url.as_str(), first.tries, first.endpoint.as_ref()),
        (endpoint.url.as_str(), 1, Some(&endpoint.id))
    );
    assert_eq!(claim(&bench).await, None);
    bench.advance(LEASE);
    let second = claim(&bench).await.expect("due again");
    assert_eq!((&second.id, &second.message, &second.payload), (&first.id, &first.message, &first.payload));
    assert_eq!(second.tries, 2);
    settle(&bench, &first, DeliveryResult::Gone).await;
    assert_eq!(deliveries_of(&bench, "shop").await[0].status, DeliveryStatus::Pending, "the first claim has expired");
    let known = store.endpoint("shop", &endpoint.id).await.expect("a result").expect("there");
    assert_eq!((known.disabled, known.failing_since), (None, None));

    settle(&bench, &second, DeliveryResult::RetryAfter(Duration::from_secs(60))).await;
    assert_eq!(claim(&bench).await, None, "the delivery waits");
    bench.advance(Duration::from_secs(59));
    assert_eq!(claim(&bench).await, None, "the delivery waits");
    bench.advance(Duration::from_secs(1));
    let third = claim(&bench).await.expect("due");
    assert_eq!((third.tries, third.attempts.len()), (3, 1));
    store.settle_delivery(&third, attempt(204), DeliveryResult::Delivered).await.expect("a result");
    bench.advance(10 * LEASE);
    assert_eq!(claim(&bench).await, None, "the message was delivered");
    let delivery = &deliveries_of(&bench, "shop").await[0];
    assert_eq!((delivery.status, delivery.job), (DeliveryStatus::Delivered, Some(job.id)));
    let statuses: Vec<_> = delivery.attempts.iter().map(|attempt| attempt.status).collect();
    assert_eq!(statuses, [Some(500), Some(204)]);
}

async fn tenants_take_turns_and_hanging_receivers_delay_no_other_tenant(bench: Bench) {
    for tenant in ["busy", "calm"] {
        endpoint(&bench, tenant).await;
    }
    for tenant in ["busy", "busy", "busy", "busy", "calm", "calm"] {
        cancel_new_job(&bench, tenant).await;
        bench.advance(Duration::from_millis(5));
    }
    let mut order = Vec::new();
    while let Some(due) = bench.store.claim_delivery(LEASE, 3).await.expect("a result") {
        order.push(due.tenant);
    }
    assert_eq!(order, ["busy", "calm", "busy", "calm", "busy"], "the fourth delivery to the busy endpoint has to wait");
}

async fn concurrent_dispatchers_never_claim_the_same_delivery(bench: Bench) {
    endpoint(&bench, "shop").await;
    for _ in 0..40 {
        cancel_new_job(&bench, "shop").await;
    }
    let bench = Arc::new(bench);
    let dispatchers: Vec<_> = (0..6)
        .map(|_| {
            let bench = Arc::clone(&bench);
            tokio::spawn(async move {
                let mut mine = Vec::new();
                while let Some(due) = claim(&bench).await {
                    settle(&bench, &due, DeliveryResult::Delivered).await;
                    mine.push(due.id);
                }
                mine
            })
        })
        .collect();
    let mut all = Vec::new();
    for dispatcher in dispatchers {
        all.extend(dispatcher.await.expect("no panic"));
    }
    assert_eq!(all.len(), 40);
    all.sort();
    all.dedup();
    assert_eq!(all.len(), 40);
}

async fn an_endpoint_is_disabled_when_it_responds_410_or_fails_for_days(bench: Bench) {
    let store = &bench.store;
    let gone = endpoint(&bench, "shop").await;
    for _ in 0..2 {
        cancel_new_job(&bench, "shop").await;
    }
    let due = claim(&bench).await.expect("due");
    assert!(settle(&bench, &due, DeliveryResult::Gone).await);
    let known = store.endpoint("shop", &gone.id).await.expect("a result").expect("there");
    assert!(known.disabled.is_some_and(|(_, why)| why.contains("410")));
    assert_eq!(claim(&bench).await, None, "nothing more is sent to the endpoint");
    assert!(deliveries_of(&bench, "shop").await.iter().all(|delivery| delivery.status == DeliveryStatus::Failed));
    cancel_new_job(&bench, "shop").await;
    assert_eq!(deliveries_of(&bench, "shop").await.len(), 2, "a disabled endpoint gets no messages");
    let on = EndpointChange { enabled: Some(true), ..EndpointChange::default() };
    let known = store.change_endpoint("shop", &gone.id, on).await.expect("a result").expect("there");
    assert_eq!((known.disabled, known.failing_since), (None, None));

    let wait = FAILING / 4;
    cancel_new_job(&bench, "shop").await;
    let mut disabled = Vec::new();
    for _ in 0..5 {
        let due = claim(&bench).await.expect("due");
        disabled.push(settle(&bench, &due, DeliveryResult::RetryAfter(wait)).await);
        bench.advance(wait);
    }
    assert_eq!(disabled, [false, false, false, false, true], "five days after the first failure");
    let on = EndpointChange { enabled: Some(true), ..EndpointChange::default() };
    store.change_endpoint("shop", &gone.id, on).await.expect("a result").expect("there");
    cancel_new_job(&bench, "shop").await;
    for verdict in [DeliveryResult::RetryAfter(FAILING), DeliveryResult::Delivered] {
        let due = claim(&bench).await.expect("due");
        assert!(!settle(&bench, &due, verdict).await);
        bench.advance(FAILING - Duration::from_secs(1));
        cancel_new_job(&bench, "shop").await;
    }
    let due = claim(&bench).await.expect("due");
    assert!(!settle(&bench, &due, DeliveryResult::Failed).await, "the last success reset the count of failures");
}

async fn finished_deliveries_are_sent_again_on_request(bench: Bench) {
    let store = &bench.store;
    let endpoint = endpoint(&bench, "shop").await;
    cancel_new_job(&bench, "shop").await;
    let again = async |tenant: &str, id: &str| store.redeliver(tenant, id).await.expect("a result");
    for verdict in
        [DeliveryResult::Failed, DeliveryResult::Delivered, DeliveryResult::RetryAfter(Duration::from_secs(3600))]
    {
        let due = claim(&bench).await.expect("due");
        assert_eq!(due.tries, 1);
        settle(&bench, &due, verdict).await;
        assert_eq!(claim(&bench).await, None);
        assert_eq!(again("rival", &due.id).await, RedeliveryResult::Unknown);
        assert_eq!(again("shop", &due.id).await, RedeliveryResult::Due);
    }
    let late = claim(&bench).await.expect("due");
    assert_eq!(late.tries, 2, "the delivery was still pending, so its attempts continue");
    assert_eq!(again("shop", &late.id).await, RedeliveryResult::Due);
    let due = claim(&bench).await.expect("due though it is under way");
    settle(&bench, &late, DeliveryResult::Delivered).await;
    assert_eq!(deliveries_of(&bench, "shop").await[0].status, DeliveryStatus::Pending);
    settle(&bench, &due, DeliveryResult::Failed).await;
    let off = EndpointChange { enabled: Some(false), ..EndpointChange::default() };
    store.change_endpoint("shop", &endpoint.id, off).await.expect("a result").expect("there");
    assert_eq!(again("shop", &due.id).await, RedeliveryResult::Disabled);
    assert_eq!(store.send_ping("shop", &endpoint.id).await.expect("a result"), None);
}

async fn a_secret_that_was_replaced_is_known_beside_the_new_one(bench: Bench) {
    let store = &bench.store;
    let endpoint = endpoint(&bench, "shop").await;
    let day = Duration::from_secs(24 * 3600);
    let rotated = store.rotate_endpoint("shop", &endpoint.id, &secret("c2Vjb25k"), day).await;
    let secrets = rotated.expect("a result").expect("there").secrets;
    let (old, until) = secrets.previous.clone().expect("the old one");
    assert_eq!((&secrets.current, old), (&secret("c2Vjb25k"), secret("Zmlyc3Q=")));
    assert_eq!(until.unix_timestamp(), 1_800_000_000 + 24 * 3600);
    cancel_new_job(&bench, "shop").await;
    assert_eq!(claim(&bench).await.expect("due").secrets, Some(secrets));
    assert_eq!(store.rotate_endpoint("rival", &endpoint.id, &secret("eA=="), day).await.expect("a result"), None);

    let callback_url = Some("https://other.example/".to_owned());
    let job = store.submit(NewJob { callback_url, ..Bench::job("other") }).await.expect("accepted");
    store.cancel(job.id).await.expect("a result");
    let due = claim(&bench).await.expect("due");
    assert_eq!((due.secrets.as_ref(), due.endpoint.as_ref()), (None, None), "there is none yet");
    let first = store.callback_secrets("other", &secret("YQ==")).await.expect("secrets");
    let same = store.callback_secrets("other", &secret("Yg==")).await.expect("secrets");
    assert_eq!((&first.current, &same), (&secret("YQ=="), &first));
    let new = store.rotate_callback_secret("other", &secret("Yw=="), day).await.expect("secrets");
    assert_eq!((&new.current, new.previous.as_ref().map(|(old, _)| old)), (&secret("Yw=="), Some(&secret("YQ=="))));
    assert_eq!(store.rotate_callback_secret("new", &secret("ZA=="), day).await.expect("secrets").previous, None);
    settle(&bench, &due, DeliveryResult::RetryAfter(Duration::ZERO)).await;
    assert_eq!(claim(&bench).await.expect("due").secrets, Some(new));
}

async fn endpoints_belong_to_a_tenant_and_their_number_is_limited(bench: Bench) {
    let store = &bench.store;
    let own = endpoint(&bench, "shop").await;
    let more = store.create_endpoint(new_endpoint("shop", &JobEvent::ALL), 1).await.expect("a result");
    assert_eq!(more, None);
    let theirs = store.create_endpoint(new_endpoint("rival", &JobEvent::ALL), 1).await.expect("a result");
    let theirs = theirs.expect("each has its own");
    assert_eq!(store.endpoints("shop").await.expect("a result"), std::slice::from_ref(&own));
    let change = EndpointChange {
        url: Some("https://shop.example/new".into()),
        events: Some(vec![JobEvent::Failed]),
        ..EndpointChange::default()
    };
    assert_eq!(store.change_endpoint("shop", &theirs.id, change.clone()).await.expect("a result"), None);
    assert_eq!(store.endpoint("shop", &theirs.id).await.expect("a result"), None);
    assert_eq!(store.send_ping("shop", &theirs.id).await.expect("a result"), None);
    assert!(!store.delete_endpoint("shop", &theirs.id).await.expect("a result"));
    let changed = store.change_endpoint("shop", &own.id, change).await.expect("a result").expect("there");
    assert_eq!(
        (changed.url.as_str(), changed.events.as_slice()),
        ("https://shop.example/new", &[JobEvent::Failed][..])
    );
    assert_eq!(changed.description, own.description);

    assert!(store.send_ping("shop", &own.id).await.expect("a result").is_some());
    let due = claim(&bench).await.expect("whatever it is told of");
    assert_eq!((due.url.as_str(), due.tenant.as_str()), ("https://shop.example/new", "shop"));
    assert!(due.payload.contains("\"ping\""), "{}", due.payload);
    assert!(store.delete_endpoint("shop", &own.id).await.expect("a result"));
    assert!(deliveries_of(&bench, "shop").await.is_empty());
    assert!(!settle(&bench, &due, DeliveryResult::Gone).await, "the delivery is deleted with its endpoint");
}

async fn messages_are_deleted_with_their_job_or_after_some_time(bench: Bench) {
    let store = &bench.store;
    endpoint(&bench, "shop").await;
    let (kept, deleted) = (cancel_new_job(&bench, "shop").await, cancel_new_job(&bench, "shop").await);
    let due = claim(&bench).await.expect("due");
    bench.advance(Duration::from_secs(5));
    let backlog = store.backlog().await.expect("a result");
    assert_eq!((backlog.pending, backlog.overdue), (2, Duration::from_secs(5)));
    assert!(store.purge(deleted.id).await.expect("a result"));
    let left: Vec<_> = deliveries_of(&bench, "shop").await.into_iter().map(|delivery| delivery.job).collect();
    assert_eq!(left, [Some(kept.id)]);
    settle(&bench, &due, DeliveryResult::Delivered).await;
    assert_eq!(store.backlog().await.expect("a result").pending, 0);
    bench.advance(Duration::from_secs(60));
    assert_eq!(store.forget_messages(Duration::from_secs(3600)).await.expect("a result"), 0);
    assert_eq!(store.forget_messages(Duration::from_secs(60)).await.expect("a result"), 1);
    assert!(deliveries_of(&bench, "shop").await.is_empty());
}
