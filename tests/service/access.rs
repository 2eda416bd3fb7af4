//! Access keys, browser tokens and tenants: who may do what, and what other tenants cannot see.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use meshmend::access::{
    AccessKey, KeyKind, KeyQuery, NewKey, Scope, Secret, SecretHash, SystemIds, TenantChange, TenantClass, TenantLimits,
};
use meshmend::jobs::{ClassLoad, ListQuery, Store};
use reqwest::Method;
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Program, Start};
use crate::support::access::{ALL_SCOPES, create_key, meshmend, send, start_with_keys};
use crate::support::stores::{Bench, on_each_store};

on_each_store! {
    a_key_is_found_by_its_secret_until_it_expires_or_is_revoked,
    a_token_is_invalid_without_the_key_that_created_it,
    tenants_take_turns_however_many_jobs_one_of_them_has,
    a_tenants_retries_take_turns_with_another_tenants_new_jobs,
    no_more_of_a_tenants_jobs_run_than_may,
    lists_counts_and_positions_are_a_tenants_own,
    a_change_of_a_tenant_keeps_the_settings_that_it_does_not_name,
    keys_and_tenants_are_listed_in_pages,
    queued_and_running_jobs_are_counted_by_tenant_class,
}

fn new_key(life_s: Option<u64>, parent: Option<String>) -> NewKey {
    NewKey {
        tenant: "shop".parse().expect("a name"),
        kind: if parent.is_some() { KeyKind::Browser } else { KeyKind::Api },
        label: "till".into(),
        scopes: "jobs:read,tokens".parse().expect("scopes"),
        origin: parent.as_ref().map(|_| "https://shop.example".to_owned()),
        max_bytes: Some(1000),
        life_s,
        parent,
    }
}

async fn create_key_in(store: &dyn Store, key: NewKey) -> (String, SecretHash) {
    let token = Secret::new(key.kind, &SystemIds).hash();
    (store.create_key(key, &token).await.expect("a key").id, token)
}

async fn is_valid(store: &dyn Store, token: &SecretHash) -> bool {
    store.find_key(token).await.expect("a result").is_some()
}

async fn keys_of(store: &dyn Store, tenant: Option<&str>) -> Vec<AccessKey> {
    let tenant = tenant.map(|name| name.parse().expect("a name"));
    store.keys(KeyQuery { tenant, limit: 10, ..KeyQuery::default() }).await.expect("a result").items
}

async fn a_key_is_found_by_its_secret_until_it_expires_or_is_revoked(bench: Bench) {
    let store = bench.store.as_ref();
    let (id, token) = create_key_in(store, new_key(None, None)).await;
    let (_, short) = create_key_in(store, new_key(Some(60), None)).await;
    let (key, limits) = store.find_key(&token).await.expect("a result").expect("a key");
    assert_eq!(limits, TenantLimits::default());
    assert_eq!(
        (key.id.as_str(), key.tenant.as_str(), key.label.as_str(), key.max_bytes),
        (id.as_str(), "shop", "till", Some(1000))
    );
    assert!(key.scopes.has(Scope::Tokens) && !key.scopes.has(Scope::JobsWrite));
    assert!(!is_valid(store, &SecretHash::of("mm_key_guess")).await);
    assert!(is_valid(store, &short).await);
    bench.advance(Duration::from_secs(60));
    assert!(!is_valid(store, &short).await);
    assert!(key.last_used_at.is_none());
    store.touch_key(&id).await.expect("noted");
    let own = TenantLimits { requests_per_minute: Some(60), ..TenantLimits::default() };
    store.change_tenant(&key.tenant, TenantChange::to_limits(own)).await.expect("set");
    let (key, limits) = store.find_key(&token).await.expect("a result").expect("a key");
    assert!(key.last_used_at.is_some());
    assert_eq!(limits, own, "a key comes with its tenant's limits");
    assert!(store.revoke_key(&id).await.expect("a result"));
    assert!(!store.revoke_key(&id).await.expect("a result"));
    assert!(!is_valid(store, &token).await);
    assert_eq!(keys_of(store, Some("shop")).await.len(), 2);
    assert_eq!(keys_of(store, Some("other")).await, []);
}

async fn a_change_of_a_tenant_keeps_the_settings_that_it_does_not_name(bench: Bench) {
    let name = "shop".parse().expect("a name");
    let change = async |change| bench.store.change_tenant(&name, change).await.expect("changed");
    let all = TenantLimits { max_queued: Some(5), max_running: Some(2), requests_per_minute: Some(60) };
    change(TenantChange { class: Some("gold".parse().ok()), ..TenantChange::to_limits(all) }).await;
    let changed = change(TenantChange { max_queued: Some(Some(9)), ..TenantChange::default() }).await;
    assert_eq!(changed.limits, TenantLimits { max_queued: Some(9), ..all });
    assert_eq!(changed.class.as_deref(), Some("gold"));
    let cleared = change(TenantChange { max_running: Some(None), ..TenantChange::default() }).await;
    assert_eq!(cleared.limits, TenantLimits { max_queued: Some(9), max_running: None, ..all });
    let cleared = change(TenantChange { class: Some(None), ..TenantChange::default() }).await;
    assert_eq!((cleared.class.as_deref(), cleared.limits.max_queued), (None, Some(9)));
    assert_eq!(bench.store.tenant("shop").await.expect("a result"), Some(cleared));
}

async fn keys_and_tenants_are_listed_in_pages(bench: Bench) {
    let store = bench.store.as_ref();
    let (first, _) = create_key_in(store, new_key(None, None)).await;
    let (second, _) = create_key_in(store, new_key(None, None)).await;
    create_key_in(store, NewKey { tenant: "bakery".parse().expect("a name"), ..new_key(None, None) }).await;
    let limits = TenantLimits { max_queued: Some(1), ..TenantLimits::default() };
    store.change_tenant(&"zoo".parse().expect("a name"), TenantChange::to_limits(limits)).await.expect("set");
    let page = |before| KeyQuery { tenant: "shop".parse().ok(), before, limit: 1, ..KeyQuery::default() };
    let newest = store.keys(page(None)).await.expect("a page");
    assert_eq!((newest.items[0].id.as_str(), newest.next.as_ref()), (second.as_str(), Some(&second)));
    let oldest = store.keys(page(newest.next)).await.expect("a page");
    assert_eq!((oldest.items[0].id.as_str(), oldest.next), (first.as_str(), None));
    let one = KeyQuery { id: Some(first.clone()), limit: 1, ..KeyQuery::default() };
    assert_eq!(store.keys(one).await.expect("a page").items[0].id, first);

    let page = store.tenants(None, 2).await.expect("a page");
    let names: Vec<_> = page.items.iter().map(|tenant| tenant.name.as_str()).collect();
    assert_eq!((names, page.next.as_deref()), (vec!["bakery", "shop"], Some("shop")));
    let page = store.tenants(page.next.as_deref(), 2).await.expect("a page");
    assert_eq!((page.items[0].name.as_str(), page.items[0].limits, page.next), ("zoo", limits, None));
    assert_eq!(store.tenant("nobody").await.expect("a result"), None);
}

async fn queued_and_running_jobs_are_counted_by_tenant_class(bench: Bench) {
    let gold: Option<TenantClass> = "gold".parse().ok();
    for tenant in ["big", "large"] {
        let name = tenant.parse().expect("a name");
        let change = TenantChange { class: Some(gold.clone()), ..TenantChange::default() };
        bench.store.change_tenant(&name, change).await.expect("set");
    }
    assert_eq!(bench.store.class_loads().await.expect("a result"), []);
    bench.submit_of("big").await;
    bench.advance(Duration::from_secs(3));
    bench.submit_of("large").await;
    bench.submit_of("small").await;
    bench.advance(Duration::from_secs(4));
    let load = |class: &str, queued, running, seconds| ClassLoad {
        class: class.into(),
        queued,
        running,
        wait: Duration::from_secs(seconds),
    };
    assert_eq!(bench.store.class_loads().await.expect("a result"), [load("gold", 2, 0, 7), load("standard", 1, 0, 4)]);
    assert_eq!(bench.claim().await.expect("a job").job.tenant, "big");
    assert_eq!(bench.store.class_loads().await.expect("a result"), [load("gold", 1, 1, 4), load("standard", 1, 0, 4)]);
    let tenants = bench.store.tenants(None, 10).await.expect("a result").items;
    let classes = tenants.iter().map(|tenant| (tenant.name.as_str(), tenant.class.as_deref()));
    assert_eq!(classes.collect::<Vec<_>>(), [("big", Some("gold")), ("large", Some("gold"))]);
}

async fn a_token_is_invalid_without_the_key_that_created_it(bench: Bench) {
    let store = bench.store.as_ref();
    let (id, _) = create_key_in(store, new_key(None, None)).await;
    let (_, token) = create_key_in(store, new_key(Some(60), Some(id.clone()))).await;
    assert!(is_valid(store, &token).await);
    assert_eq!(keys_of(store, None).await.len(), 1, "tokens are not API keys");
    assert!(store.revoke_key(&id).await.expect("a result"));
    assert!(!is_valid(store, &token).await);
    assert_eq!(store.forget_tokens().await.expect("a result"), 0);
    bench.advance(Duration::from_secs(61));
    assert_eq!(store.forget_tokens().await.expect("a result"), 1);
}

async fn tenants_take_turns_however_many_jobs_one_of_them_has(bench: Bench) {
    for _ in 0..1000 {
        bench.submit_of("busy").await;
    }
    for tenant in ["calm", "calm", "quiet"] {
        bench.advance(Duration::from_millis(5));
        bench.submit_of(tenant).await;
    }
    let mut served = Vec::new();
    // One worker: nothing runs when it claims a job.
    for _ in 0..8 {
        bench.advance(Duration::from_millis(5));
        let claim = bench.claim().await.expect("a job");
        served.push(claim.job.tenant.clone());
        bench.store.fail(&claim.lease, Bench::failure(meshmend::jobs::FailureKind::Final)).await.expect("noted");
    }
    assert_eq!(served, ["busy", "calm", "quiet", "busy", "calm", "busy", "busy", "busy"]);
    // Many workers: the tenant with the fewest running jobs is next.
    for tenant in ["calm", "calm"] {
        bench.submit_of(tenant).await;
    }
    let mut running = Vec::new();
    for _ in 0..6 {
        running.push(bench.claim().await.expect("a job").job.tenant);
    }
    assert_eq!(running.iter().filter(|tenant| *tenant == "calm").count(), 2);
    assert_eq!(running[..4].iter().filter(|tenant| *tenant == "busy").count(), 2);
}

async fn a_tenants_retries_take_turns_with_another_tenants_new_jobs(bench: Bench) {
    // Every job of one tenant was claimed once and released.
    let mut leases = Vec::new();
    for _ in 0..3 {
        bench.submit_of("retried").await;
        leases.push(bench.claim().await.expect("a job").lease);
    }
    for lease in leases {
        bench.store.release(&lease).await.expect("held");
    }
    for _ in 0..3 {
        bench.submit_of("new").await;
    }
    let mut served = Vec::new();
    for _ in 0..6 {
        bench.advance(Duration::from_millis(5));
        let claim = bench.claim().await.expect("a job");
        served.push(claim.job.tenant.clone());
        bench.store.fail(&claim.lease, Bench::failure(meshmend::jobs::FailureKind::Final)).await.expect("noted");
    }
    assert_eq!(served, ["new", "retried", "new", "retried", "new", "retried"]);
}

async fn no_more_of_a_tenants_jobs_run_than_may(bench: Bench) {
    for tenant in ["a", "a", "a", "b", "b", "b"] {
        bench.submit_of(tenant).await;
    }
    let limits = TenantLimits { max_running: Some(2), ..TenantLimits::default() };
    bench.store.change_tenant(&"b".parse().expect("a name"), TenantChange::to_limits(limits)).await.expect("set");
    assert_eq!(bench.store.limits("b").await.expect("a result"), limits);
    assert_eq!(bench.store.limits("a").await.expect("a result"), TenantLimits::default());
    let mut running: BTreeMap<String, u32> = BTreeMap::new();
    while let Some(claim) = bench.store.claim("worker", crate::support::stores::LEASE, 1).await.expect("a result") {
        *running.entry(claim.job.tenant).or_default() += 1;
    }
    assert_eq!(running, BTreeMap::from([("a".to_owned(), 1), ("b".to_owned(), 2)]));
}

async fn lists_counts_and_positions_are_a_tenants_own(bench: Bench) {
    for _ in 0..3 {
        bench.submit_of("a").await;
    }
    let own = bench.submit_of("b").await;
    assert_eq!(bench.store.queue_position(&own).await.expect("a result"), Some(0));
    let queued = bench.store.queued_counts("b").await.expect("a result");
    assert_eq!((queued.all, queued.of_tenant), (4, 1));
    let query = ListQuery { tenant: "b".into(), limit: 10, ..ListQuery::default() };
    let listed = bench.store.list(query.clone()).await.expect("a result").items;
    assert_eq!(listed.iter().map(|job| job.id).collect::<Vec<_>>(), [own.id]);
    let of_a_key = ListQuery { api_key_id: Some("key_1".into()), ..query };
    assert_eq!(bench.store.list(of_a_key).await.expect("a result").items, []);
}

fn guarded(data: &Path) -> Program {
    start_with_keys(Start::serve(data))
}

/// Every documented operation that requires a key.
fn guarded_operations() -> Vec<(Method, String)> {
    let document: Value = serde_json::from_str(include_str!("../../openapi/openapi.json")).expect("JSON");
    let mut operations = Vec::new();
    for (path, methods) in document["paths"].as_object().expect("paths") {
        for (method, operation) in methods.as_object().expect("methods") {
            if operation["security"].as_array().is_some_and(|security| !security.is_empty()) {
                let path = path.replace("{id}", "job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a").replace("{name}", "model");
                operations.push((method.to_uppercase().parse().expect("a method"), path));
            }
        }
    }
    assert!(operations.iter().filter(|(_, path)| path.starts_with("/v1/")).count() >= 27);
    operations
}

#[tokio::test]
async fn the_service_requires_a_valid_key_for_every_guarded_operation() {
    let data = tempfile::tempdir().expect("a folder");
    let good = create_key(data.path(), "shop", ALL_SCOPES);
    let gone = create_key(data.path(), "shop", ALL_SCOPES);
    let listed = meshmend(data.path(), &["keys", "list", "--json", "--tenant", "shop"]);
    assert!(!listed.contains(&good) && !listed.contains(&good[7..]), "{listed}");
    let last: Value = serde_json::from_str(listed.lines().last().expect("a line")).expect("JSON");
    meshmend(data.path(), &["keys", "revoke", last["id"].as_str().expect("an id")]);
    let program = guarded(data.path());
    let api = Api::new(&program);
    for (method, path) in guarded_operations() {
        let request = || api.http.request(method.clone(), format!("{}{path}", api.url));
        let wrong = format!("mm_key_{}", "0".repeat(64));
        for refused in [
            request(),
            request().bearer_auth(&gone),
            request().bearer_auth(wrong),
            request().basic_auth("a", Some(&good)),
        ] {
            let (status, problem) = send(refused).await;
            assert_eq!((status, &problem["code"]), (401, &json!("unauthorized")), "{method} {path}: {problem}");
        }
        let (status, _) = send(request().bearer_auth(&good)).await;
        assert!(![401, 403].contains(&status), "{method} {path}: {status}");
    }
    for open in ["/livez", "/readyz", "/openapi.json", "/problems"] {
        assert_eq!(api.get(open).send().await.expect("a response").status(), 200, "{open}");
    }
    assert!(!program.log().contains(&good[7..]), "no secret is logged");
}

#[tokio::test]
async fn each_operation_needs_its_scope() {
    let data = tempfile::tempdir().expect("a folder");
    let keys: BTreeMap<&str, String> = ["jobs:read", "jobs:write", "webhooks", "tokens", "metrics", "admin"]
        .map(|scope| (scope, create_key(data.path(), "shop", scope)))
        .into();
    let program = guarded(data.path());
    let api = Api::new(&program);
    for (method, path) in guarded_operations() {
        let needed = match (method.as_str(), path.as_str()) {
            (_, "/metrics") => "metrics",
            (_, "/v1/capabilities") => continue,
            ("GET", path) if path.starts_with("/v1/profiles") => continue,
            (_, "/v1/browser-tokens") => "tokens",
            (_, path) if path.starts_with("/v1/webhook-") => "webhooks",
            (_, path) if path.starts_with("/v1/keys") || path.starts_with("/v1/tenants") => "admin",
            ("GET", _) => "jobs:read",
            _ => "jobs:write",
        };
        for (scope, key) in &keys {
            let request = api.http.request(method.clone(), format!("{}{path}", api.url));
            let (status, problem) = send(request.bearer_auth(key)).await;
            assert_eq!(status != 403, *scope == needed, "{method} {path} with {scope}: {status} {problem}");
            assert!(status != 403 || problem["code"] == "forbidden");
        }
    }
}

#[tokio::test]
async fn a_tenant_sees_nothing_of_anothers_jobs() {
    let data = tempfile::tempdir().expect("a folder");
    let (own, other) = (create_key(data.path(), "shop", ALL_SCOPES), create_key(data.path(), "rival", ALL_SCOPES));
    let program = guarded(data.path());
    let api = Api::new(&program);
    let submit = async |key: &str| {
        let request = api.post("/v1/jobs?max_tier=1").bearer_auth(key).header("idempotency-key", "same");
        let (status, job) = send(request.body(files::broken_box())).await;
        assert_eq!(status, 202);
        (job["id"].as_str().expect("an id").to_owned(), job)
    };
    let (id, _) = submit(&own).await;
    loop {
        let (_, job) = send(api.get(&format!("/v1/jobs/{id}?wait=20")).bearer_auth(&own)).await;
        if job["status"] == "succeeded" {
            break;
        }
    }
    let none = "job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a";
    for (method, path) in [
        (Method::GET, "/v1/jobs/ID"),
        (Method::GET, "/v1/jobs/ID/events"),
        (Method::GET, "/v1/jobs/ID/artifacts/model"),
        (Method::POST, "/v1/jobs/ID/cancel"),
        (Method::DELETE, "/v1/jobs/ID"),
    ] {
        let ask_for = async |id: &str| {
            let path = path.replace("ID", id);
            let (status, mut problem) =
                send(api.http.request(method.clone(), format!("{}{path}", api.url)).bearer_auth(&other)).await;
            problem["request_id"] = Value::Null;
            (status, problem.to_string().replace(id, "ID"))
        };
        let theirs = ask_for(&id).await;
        assert_eq!(theirs.0, 404, "{method} {path}");
        assert_eq!(theirs, ask_for(none).await, "the response is the same as for a job that never existed");
    }
    let (_, page) = send(api.get("/v1/jobs").bearer_auth(&other)).await;
    assert_eq!(page["jobs"], json!([]));
    // Neither the same idempotency key nor an upload of the same bytes leads to another tenant's job.
    let (theirs, job) = submit(&other).await;
    assert_ne!(theirs, id);
    assert_eq!(job["reused_from"], Value::Null);
    let (again, _) = submit(&own).await;
    assert_eq!(again, id);
}

#[tokio::test]
async fn a_page_with_a_token_uploads_from_its_origin_and_sees_only_its_own_jobs() {
    let data = tempfile::tempdir().expect("a folder");
    let owner = create_key(data.path(), "shop", ALL_SCOPES);
    let program = guarded(data.path());
    let api = Api::new(&program);
    let make = async |body: Value| send(api.post("/v1/browser-tokens").bearer_auth(&owner).json(&body)).await;
    let asked = json!({"origin": "https://Shop.example/", "max_bytes": 2000, "expires_in_s": 60});
    let (status, token) = make(asked).await;
    assert_eq!(status, 201, "{token}");
    assert_eq!((&token["origin"], &token["max_bytes"]), (&json!("https://shop.example"), &json!(2000)));
    let secret = token["token"].as_str().expect("a token").to_owned();
    for wrong in [
        json!({"origin": "shop.example"}),
        json!({"origin": "https://shop.example", "scopes": ["metrics"]}),
        json!({"origin": "https://shop.example", "expires_in_s": 1}),
        json!({"origin": "https://shop.example", "max_bytes": 0}),
    ] {
        assert_eq!(make(wrong.clone()).await.0, 422, "{wrong}");
    }
    assert_eq!(make(json!({"origin": "https://shop.example", "colour": 1})).await.0, 400);

    let preflight = api.http.request(Method::OPTIONS, format!("{}/v1/jobs", api.url));
    let preflight = preflight.header("origin", "https://shop.example").header("access-control-request-method", "POST");
    let response = preflight.send().await.expect("a response");
    assert_eq!(
        (response.status(), response.headers()["access-control-allow-origin"].as_bytes()),
        (reqwest::StatusCode::NO_CONTENT, &b"*"[..])
    );
    assert!(response.headers()["access-control-allow-headers"].to_str().expect("text").contains("authorization"));

    let post = |origin: &str, bytes: Vec<u8>| {
        api.post("/v1/jobs?max_tier=1").bearer_auth(&secret).header("origin", origin).body(bytes)
    };
    let response = post("https://shop.example", files::broken_box()).send().await.expect("a response");
    assert_eq!(response.status(), 202);
    assert_eq!(response.headers()["access-control-allow-origin"], "https://shop.example");
    let job: Value = response.json().await.expect("a job");
    let (status, problem) = send(post("https://evil.example", files::broken_box())).await;
    assert_eq!((status, &problem["code"]), (403, &json!("origin_not_allowed")));
    assert_eq!(send(post("https://shop.example", vec![b' '; 2_000_000])).await.0, 413);
    let (status, _) = send(
        api.post("/v1/browser-tokens").bearer_auth(&secret).header("origin", "https://shop.example").json(&json!({})),
    )
    .await;
    assert_eq!(status, 403, "a token cannot create tokens");

    let look = |id: &Value, secret: &str| {
        api.get(&format!("/v1/jobs/{}", id.as_str().expect("an id")))
            .bearer_auth(secret)
            .header("origin", "https://shop.example")
    };
    assert_eq!(send(look(&job["id"], &secret)).await.0, 200);
    assert_eq!(send(look(&job["id"], &owner)).await.0, 200, "the tenant's own server sees the job too");
    let (_, own) = send(api.post("/v1/jobs?max_tier=1").bearer_auth(&owner).body(files::whole_box())).await;
    assert_eq!(send(look(&own["id"], &secret)).await.0, 404);
    let (_, page) = send(api.get("/v1/jobs").bearer_auth(&secret).header("origin", "https://shop.example")).await;
    assert_eq!(page["jobs"].as_array().map(Vec::len), Some(1));
}

/// Whether a page of that origin may read a response and its `retry-after` header.
fn is_readable(response: &reqwest::Response, origin: &str) -> bool {
    let header = |name| response.headers().get(name).and_then(|value| value.to_str().ok()).unwrap_or_default();
    header("access-control-allow-origin") == origin && header("access-control-expose-headers").contains("retry-after")
}

#[tokio::test]
async fn allowed_origins_may_read_responses_and_other_origins_only_their_refusal() {
    let data = tempfile::tempdir().expect("a folder");
    let owner = create_key(data.path(), "shop", ALL_SCOPES);
    let program = guarded(data.path());
    let api = Api::new(&program);
    let token = json!({"origin": "https://shop.example"});
    let (_, token) = send(api.post("/v1/browser-tokens").bearer_auth(&owner).json(&token)).await;
    let secret = token["token"].as_str().expect("a token");
    let upload = api.post("/v1/uploads").bearer_auth(secret).header("origin", "https://shop.example");
    let (_, upload) = send(upload.json(&json!({"name": "box.stl"}))).await;
    let put = upload["put"]["url"].as_str().expect("an address");
    let wrong = format!("{put}x");
    for (path, status) in [(wrong.as_str(), 404), (put, 204), (put, 409)] {
        let request = api.http.put(format!("{}{path}", api.url)).header("origin", "https://shop.example");
        let response = request.body(files::broken_box()).send().await.expect("a response");
        assert_eq!(response.status(), status);
        assert!(is_readable(&response, "*"), "{status}: {:?}", response.headers());
    }
    let source = json!({"source": {"upload_id": upload["id"]}, "options": {"max_tier": 1}});
    let submit = api.post("/v1/jobs").bearer_auth(secret).header("origin", "https://shop.example").json(&source);
    let (status, job) = send(submit).await;
    assert_eq!(status, 202, "{job}");
    let path = format!("/v1/jobs/{}", job["id"].as_str().expect("an id"));
    let ended = api.get(&format!("{path}/events")).bearer_auth(secret).header("origin", "https://shop.example");
    let ended = ended.send().await.expect("a response");
    assert!(is_readable(&ended, "https://shop.example"), "{:?}", ended.headers());
    assert!(ended.text().await.expect("events").contains("event: done"));
    let asked = [
        (Method::GET, "/v1/capabilities".to_owned(), 200),
        (Method::POST, "/v1/uploads".to_owned(), 201),
        (Method::POST, "/v1/jobs".to_owned(), 400),
        (Method::GET, path.clone(), 200),
        (Method::GET, format!("{path}?wait=1"), 200),
        (Method::GET, format!("{path}/events"), 200),
        (Method::GET, format!("{path}/artifacts/model"), 200),
        (Method::GET, format!("{path}/artifacts/defects.glb"), 200),
        (Method::POST, format!("{path}/cancel"), 409),
        (Method::GET, "/v1/jobs/job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a".to_owned(), 404),
    ];
    for (method, path, status) in asked {
        for (origin, status) in [("https://shop.example", status), ("https://evil.example", 403)] {
            let request = api.http.request(method.clone(), format!("{}{path}", api.url));
            let response = request.bearer_auth(secret).header("origin", origin).send().await.expect("a response");
            assert_eq!(response.status(), status, "{method} {path} from {origin}");
            assert!(is_readable(&response, origin), "{method} {path} from {origin}: {:?}", response.headers());
        }
        for bearer in [owner.as_str(), "mm_key_unknown"] {
            let request = api.http.request(method.clone(), format!("{}{path}", api.url)).bearer_auth(bearer);
            let response = request.header("origin", "https://shop.example").send().await.expect("a response");
            assert!(
                !response.headers().contains_key("access-control-allow-origin"),
                "{method} {path}: a key is not for use in pages"
            );
        }
    }
}

#[tokio::test]
async fn limits_on_requests_and_queued_jobs_apply_to_each_tenant_separately() {
    let data = tempfile::tempdir().expect("a folder");
    let (busy, calm) = (create_key(data.path(), "busy", ALL_SCOPES), create_key(data.path(), "calm", ALL_SCOPES));
    meshmend(data.path(), &["tenants", "set", "busy", "--requests-per-minute", "5"]);
    meshmend(data.path(), &["tenants", "set", "calm", "--max-queued", "1"]);
    assert_eq!(meshmend(data.path(), &["tenants", "list", "--json"]).lines().count(), 2);
    let program = Start::serve(data.path()).arg("--auth", "keys").env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    for left in [4, 3, 2, 1, 0] {
        let response = api.get("/v1/jobs").bearer_auth(&busy).send().await.expect("a response");
        assert_eq!(response.status(), 200);
        assert_eq!(response.headers()["ratelimit-policy"], "\"tenant\";q=5;w=60");
        let state = response.headers()["ratelimit"].to_str().expect("text").to_owned();
        assert!(state.starts_with(&format!("\"tenant\";r={left};t=")), "{state}");
    }
    let response = api.get("/v1/jobs").bearer_auth(&busy).send().await.expect("a response");
    assert_eq!(response.status(), 429);
    let wait: u64 = response.headers()["retry-after"].to_str().expect("text").parse().expect("seconds");
    assert!((1..=13).contains(&wait), "{wait}");
    assert_eq!(response.json::<Value>().await.expect("a problem")["code"], "rate_limited");

    let submit = || api.post("/v1/jobs").bearer_auth(&calm).body(files::broken_box());
    let response = submit().send().await.expect("a response");
    assert_eq!(response.status(), 202);
    assert!(!response.headers().contains_key("ratelimit"), "without settings there are no limits");
    let (status, problem) = send(submit()).await;
    assert_eq!((status, &problem["code"]), (429, &json!("queue_full")));
}

#[tokio::test]
async fn a_service_without_auth_serves_only_its_own_pages() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let own = api.get("/v1/jobs").header("origin", &api.url).send().await.expect("a response");
    assert_eq!(own.status(), 200);
    for origin in ["https://evil.example", "null"] {
        let (status, problem) = send(api.post("/v1/jobs").header("origin", origin).body(files::broken_box())).await;
        assert_eq!((status, &problem["code"]), (403, &json!("origin_not_allowed")), "{origin}");
    }
    let wide = tempfile::tempdir().expect("a folder");
    let program = Start::serve_on("0.0.0.0:0", wide.path()).start();
    let url = program.url.replace("0.0.0.0", "127.0.0.1");
    let response = reqwest::get(format!("{url}/v1/jobs")).await.expect("a result");
    assert_eq!(response.status(), 401, "a server that other machines can reach requires keys");
}
