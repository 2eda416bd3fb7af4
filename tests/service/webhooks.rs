//! Webhooks: messages, retries, endpoints, secrets and target policy.

use std::path::Path;

use reqwest::{Method, RequestBuilder};
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Program, Start, signal, until};
use crate::support::access::{ALL_SCOPES, create_key, send, start_with_keys};
use crate::support::receiver::{Receiver, Reply};

/// A service that may send to receivers on this machine, and retries soon.
fn serve(data: &Path) -> Start<'_> {
    Start::serve(data)
        .env("MESHMEND_WEBHOOK_ALLOW_PRIVATE", "true")
        .arg("--webhook-timeout-s", "1")
        .arg("--webhook-retry-s", "0.05,0.05,0.05")
}

async fn register(api: &Api, url: &str) -> Value {
    let (status, endpoint) = send(api.post("/v1/webhook-endpoints").json(&json!({"url": url}))).await;
    assert_eq!(status, 201, "{endpoint}");
    endpoint
}

fn id(of: &Value) -> &str {
    of["id"].as_str().expect("an id")
}

async fn ping(api: &Api, endpoint: &Value) -> Value {
    let (status, delivery) = send(api.post(&format!("/v1/webhook-endpoints/{}/test", id(endpoint)))).await;
    assert_eq!(status, 202, "{delivery}");
    delivery
}

async fn deliveries(api: &Api, endpoint: &Value) -> Vec<Value> {
    let (status, page) = send(api.get(&format!("/v1/webhook-endpoints/{}/deliveries", id(endpoint)))).await;
    assert_eq!(status, 200, "{page}");
    page["deliveries"].as_array().expect("deliveries").clone()
}

/// Waits until the endpoint's only delivery has this status.
async fn settled(api: &Api, endpoint: &Value, status: &str) -> Value {
    until("the delivery is settled", async || {
        let mut all = deliveries(api, endpoint).await;
        assert!(all.len() <= 1, "{all:?}");
        all.pop().filter(|delivery| delivery["status"] == status)
    })
    .await
}

#[tokio::test]
async fn a_receiver_gets_a_verifiable_message_about_a_job_s_end() {
    let data = tempfile::tempdir().expect("a folder");
    let program = serve(data.path()).start();
    let api = Api::new(&program);
    let receiver = Receiver::start(&[Reply::Status(204)]).await;
    let endpoint = register(&api, &receiver.url).await;
    let part = reqwest::multipart::Part::bytes(files::broken_box()).file_name("box.stl");
    let form = reqwest::multipart::Form::new().part("file", part).text("metadata", r#"{"order": "17"}"#);
    let (_, job) = send(api.post("/v1/jobs").multipart(form.text("options", r#"{"max_tier": 1}"#))).await;
    let message = receiver.got(1).await.remove(0);
    assert!(message.verifies(&endpoint["secret"]), "{message:?}");
    assert!(!message.verifies(&json!("whsec_c29tZSBvdGhlciBzZWNyZXQgb2YgYSBnb29kIHNpemU=")));
    assert_eq!(message.headers["content-type"], "application/json");
    let job = api.job(id(&job)).await;
    let event = message.json();
    assert_eq!((&event["type"], &event["timestamp"]), (&json!("job.succeeded"), &job["finished_at"]));
    let data = &event["data"];
    for field in ["id", "status", "outcome", "created_at", "finished_at", "metadata", "problem"] {
        assert_eq!(data[field], job[field], "{field}");
    }
    let kinds: Vec<&Value> = job["report"]["assumptions"]
        .as_array()
        .expect("assumptions")
        .iter()
        .map(|assumption| &assumption["kind"])
        .collect();
    assert_eq!(
        (&data["printable"], &data["red_flags"], data["assumptions"].as_array().map(Vec::len)),
        (&json!(true), &json!([]), Some(kinds.len())),
    );
    assert_eq!(data["input"], json!({"name": "box.stl", "sha256": job["input"]["sha256"]}));
    for (name, file) in job["artifacts"].as_object().expect("files") {
        for field in ["href", "bytes", "sha256"] {
            // The job omits the hash of pictures.
            assert!(file[field].is_null() || data["artifacts"][name][field] == file[field], "{name}");
        }
    }
    let model = api.get(data["artifacts"]["model"]["href"].as_str().expect("an address")).send().await;
    assert_eq!(model.expect("a response").status(), 200, "the result exists when the webhook arrives");

    let delivery = settled(&api, &endpoint, "delivered").await;
    assert_eq!((&delivery["webhook_id"], &delivery["job"]), (&json!(message.id()), &job["id"]));
    assert_eq!((&delivery["attempts"][0]["status"], &delivery["next_attempt_at"]), (&json!(204), &Value::Null));
    // The same bytes again: the job ends at once, with a message of its own.
    let again = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    let second = receiver.got(2).await.remove(1);
    assert_eq!((&second.json()["data"]["id"], second.verifies(&endpoint["secret"])), (&json!(again), true));
    let metrics = api.get("/metrics").send().await.expect("a response").text().await.expect("text");
    for line in ["meshmend_webhook_deliveries_total{result=\"delivered\"}", "meshmend_webhook_backlog 0"] {
        assert!(metrics.contains(line), "{line} is not in\n{metrics}");
    }
    assert!(!program.log().contains(&endpoint["secret"].as_str().expect("a secret")[6..]), "no secret is logged");
}

#[tokio::test]
async fn both_secrets_sign_after_a_rotation() {
    let data = tempfile::tempdir().expect("a folder");
    let program = serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    let receiver = Receiver::start(&[Reply::Status(200)]).await;
    let endpoint = register(&api, &receiver.url).await;
    let (status, rotated) = send(api.post(&format!("/v1/webhook-endpoints/{}/rotate", id(&endpoint)))).await;
    assert_eq!(status, 200);
    assert_ne!(rotated["secret"], endpoint["secret"]);
    assert!(rotated["previous_secret_until"].is_string());
    let (_, shown) = send(api.get(&format!("/v1/webhook-endpoints/{}", id(&endpoint)))).await;
    assert_eq!(shown["secret"], Value::Null, "the secret is shown once");
    ping(&api, &endpoint).await;
    let message = receiver.got(1).await.remove(0);
    assert_eq!(message.json()["type"], "ping");
    assert!(message.verifies(&rotated["secret"]) && message.verifies(&endpoint["secret"]));

    let (_, callbacks) = send(api.get("/v1/webhook-secret")).await;
    let (_, new) = send(api.post("/v1/webhook-secret/rotate")).await;
    assert_ne!(callbacks["secret"], new["secret"]);
    assert_eq!(send(api.get("/v1/webhook-secret")).await.1, new);
    let url = format!("/v1/jobs?callback_url={}", receiver.url.replace(':', "%3A").replace('/', "%2F"));
    let (_, job) = send(api.post(&url).body(files::broken_box())).await;
    send(api.post(&format!("/v1/jobs/{}/cancel", id(&job)))).await;
    let messages = receiver.got(3).await.split_off(1);
    assert!(messages.iter().all(|message| message.json()["type"] == "job.canceled"));
    assert_eq!(messages[0].id(), messages[1].id(), "one message, for the endpoint and for the callback");
    let by_callback = messages.iter().find(|message| message.verifies(&new["secret"])).expect("one for the callback");
    assert!(by_callback.verifies(&callbacks["secret"]) && !by_callback.verifies(&rotated["secret"]));
    let (_, of_job) = send(api.get(&format!("/v1/webhook-deliveries?job={}", id(&job)))).await;
    let urls: Vec<_> = of_job["deliveries"].as_array().expect("both").iter().map(|d| &d["callback_url"]).collect();
    assert!(urls.len() == 2 && urls.contains(&&json!(receiver.url)), "{of_job}");
}

#[tokio::test]
async fn failed_deliveries_are_retried_then_given_up_and_resent_on_request() {
    let data = tempfile::tempdir().expect("a folder");
    let program = serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    let elsewhere = Receiver::start(&[Reply::Status(200)]).await;
    let replies = [
        Reply::Status(500),
        Reply::Redirect(elsewhere.url.clone()),
        Reply::Hang,
        Reply::Status(404),
        Reply::Status(200),
    ];
    let receiver = Receiver::start(&replies).await;
    let endpoint = register(&api, &receiver.url).await;
    ping(&api, &endpoint).await;
    let failed = settled(&api, &endpoint, "failed").await;
    let attempts = failed["attempts"].as_array().expect("attempts");
    let errors: Vec<_> = attempts.iter().map(|attempt| attempt["error"].as_str().expect("an error")).collect();
    assert_eq!(
        errors,
        [
            "The receiver responded with 500.",
            "The receiver responded with 307; redirects are not followed.",
            "No response within 1 s.",
            "The receiver responded with 404."
        ]
    );
    assert!(elsewhere.seen().is_empty());
    let (_, known) = send(api.get(&format!("/v1/webhook-endpoints/{}", id(&endpoint)))).await;
    assert!(known["failing_since"].is_string() && known["enabled"] == true, "{known}");

    let (status, again) = send(api.post(&format!("/v1/webhook-deliveries/{}/redeliver", id(&failed)))).await;
    assert_eq!((status, &again["id"]), (202, &failed["id"]));
    let delivered = settled(&api, &endpoint, "delivered").await;
    assert_eq!(delivered["attempts"].as_array().map(Vec::len), Some(5));
    let seen = receiver.seen();
    assert_eq!(seen.len(), 5);
    for message in &seen {
        assert_eq!((message.id(), message.verifies(&endpoint["secret"])), (seen[0].id(), true));
        assert_eq!(message.body, seen[0].body);
    }
    let (_, known) = send(api.get(&format!("/v1/webhook-endpoints/{}", id(&endpoint)))).await;
    assert_eq!(known["failing_since"], Value::Null);
}

#[tokio::test]
async fn a_receiver_that_responds_410_gets_no_messages_until_it_is_enabled_again() {
    let data = tempfile::tempdir().expect("a folder");
    let program = serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    let receiver = Receiver::start(&[Reply::Status(410), Reply::Status(200)]).await;
    let endpoint = register(&api, &receiver.url).await;
    let path = format!("/v1/webhook-endpoints/{}", id(&endpoint));
    let delivery = ping(&api, &endpoint).await;
    let known = until("the endpoint is disabled", async || {
        let (_, known) = send(api.get(&path)).await;
        (known["enabled"] == false).then_some(known)
    })
    .await;
    assert!(known["disabled_reason"].as_str().is_some_and(|why| why.contains("410")), "{known}");
    for refused in [format!("{path}/test"), format!("/v1/webhook-deliveries/{}/redeliver", id(&delivery))] {
        let (status, problem) = send(api.post(&refused)).await;
        assert_eq!((status, &problem["code"]), (409, &json!("webhook_disabled")), "{refused}");
    }
    let change = |body: Value| send(api.http.request(Method::PATCH, format!("{}{path}", api.url)).json(&body));
    let (status, known) = change(json!({"enabled": true, "description": "tills"})).await;
    assert_eq!((status, &known["enabled"], &known["description"]), (200, &json!(true), &json!("tills")));
    ping(&api, &endpoint).await;
    receiver.got(2).await;
    assert_eq!(change(json!({"enabled": false})).await.1["disabled_reason"], "The tenant disabled the endpoint.");
    for wrong in [json!({"url": "ftp://a"}), json!({"events": []}), json!({"description": "a\nb"})] {
        assert_eq!(change(wrong.clone()).await.0, 422, "{wrong}");
    }
    assert_eq!(change(json!({"events": ["ping"]})).await.0, 400, "there is no such event");
    assert_eq!(send(api.delete(&path)).await.0, 204);
    assert_eq!(send(api.get(&path)).await.0, 404);
}

#[tokio::test]
async fn webhooks_to_private_addresses_are_refused_unless_the_operator_allows_them() {
    let data = tempfile::tempdir().expect("a folder");
    let receiver = Receiver::start(&[Reply::Status(200)]).await;
    let program = serve(data.path()).env("MESHMEND_NO_WORKERS", "true").env("MESHMEND_NO_WEBHOOKS", "true").start();
    let api = Api::new(&program);
    let endpoint = register(&api, &receiver.url).await;
    ping(&api, &endpoint).await;
    program.kill();
    // A new target policy applies to existing endpoints and callbacks too.
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").arg("--webhook-retry-s", "0.05").start();
    let api = Api::new(&program);
    let failed = settled(&api, &endpoint, "failed").await;
    assert_eq!(failed["attempts"][0]["error"], "The URL must begin with https://.");
    for wrong in [
        receiver.url.as_str(),
        "https://127.0.0.1/",
        "https://2130706433/",
        "https://0x7f.1/",
        "https://[::ffff:10.0.0.1]/",
        "https://169.254.169.254/latest/meta-data",
        "https://localhost/",
        "https://shop.example:25/",
        "https://me:secret@shop.example/",
        "shop",
    ] {
        let (status, problem) = send(api.post("/v1/webhook-endpoints").json(&json!({"url": wrong}))).await;
        assert_eq!((status, &problem["code"]), (422, &json!("invalid_options")), "{wrong}");
        assert!(problem["detail"].as_str().is_some_and(|why| why.starts_with("`url` ")), "{problem}");
        let part = reqwest::multipart::Part::bytes(files::broken_box()).file_name("a.stl");
        let form = reqwest::multipart::Form::new().part("file", part).text("callback_url", wrong.to_owned());
        let (status, problem) = send(api.post("/v1/jobs").multipart(form)).await;
        assert_eq!((status, &problem["code"]), (422, &json!("invalid_options")), "{wrong}");
    }
    assert!(receiver.seen().is_empty());
}

#[tokio::test]
async fn deliveries_pending_when_the_service_was_killed_are_sent_after_its_restart() {
    let data = tempfile::tempdir().expect("a folder");
    let receiver = Receiver::start(&[Reply::Hang, Reply::Status(200)]).await;
    let kill = |program: Program| {
        signal(program.pid(), "KILL");
        drop(program);
    };
    // Killed between the end of a job and its delivery.
    let program = serve(data.path()).env("MESHMEND_NO_WEBHOOKS", "true").start();
    let api = Api::new(&program);
    let endpoint = register(&api, &receiver.url).await;
    let job = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    api.finished(&job).await;
    let waiting = settled(&api, &endpoint, "pending").await;
    assert_eq!((&waiting["job"], &waiting["attempts"]), (&json!(job), &json!([])));
    kill(program);
    // Killed while a delivery is under way.
    let program = serve(data.path()).start();
    receiver.got(1).await;
    kill(program);
    let program = serve(data.path()).start();
    let api = Api::new(&program);
    let messages = receiver.got(2).await;
    settled(&api, &endpoint, "delivered").await;
    for message in &messages {
        assert_eq!((message.id(), &message.json()["data"]["id"]), (messages[0].id(), &json!(job)));
        assert_eq!(json!(message.id()), waiting["webhook_id"]);
    }
    assert_eq!(receiver.seen().len(), 2);
}

#[tokio::test]
async fn webhooks_are_sent_by_https_if_the_certificate_is_trusted() {
    let data = tempfile::tempdir().expect("a folder");
    let (authority, other) = (data.path().join("authority.pem"), data.path().join("other.pem"));
    let receiver = Receiver::start_tls(&[Reply::Status(200)], &authority).await;
    let stranger = Receiver::start_tls(&[Reply::Status(200)], &other).await;
    let program = serve(data.path())
        .env("MESHMEND_NO_WORKERS", "true")
        .env("SSL_CERT_FILE", authority.to_str().expect("a path"))
        .start();
    let api = Api::new(&program);
    let (trusted, untrusted) = (register(&api, &receiver.url).await, register(&api, &stranger.url).await);
    ping(&api, &trusted).await;
    ping(&api, &untrusted).await;
    assert!(receiver.got(1).await[0].verifies(&trusted["secret"]));
    let failed = settled(&api, &untrusted, "failed").await;
    let error = failed["attempts"][0]["error"].as_str().expect("an error");
    assert!(error.contains("certificate"), "{error}");
    assert!(stranger.seen().is_empty());
}

#[tokio::test]
async fn a_tenant_sees_and_changes_nothing_of_anothers_webhooks() {
    let data = tempfile::tempdir().expect("a folder");
    let receiver = Receiver::start(&[Reply::Status(200)]).await;
    let (own, other) = (create_key(data.path(), "shop", ALL_SCOPES), create_key(data.path(), "rival", ALL_SCOPES));
    let program = start_with_keys(serve(data.path()).env("MESHMEND_NO_WORKERS", "true"));
    let api = Api::new(&program);
    let make = |key: &str| send(api.post("/v1/webhook-endpoints").bearer_auth(key).json(&json!({"url": receiver.url})));
    let (_, endpoint) = make(&own).await;
    let (_, delivery) =
        send(api.post(&format!("/v1/webhook-endpoints/{}/test", id(&endpoint))).bearer_auth(&own)).await;
    receiver.got(1).await;
    let request = |method: &str, path: &str| -> RequestBuilder {
        let request = api.http.request(method.parse().expect("a method"), format!("{}{path}", api.url));
        request.bearer_auth(&other).json(&json!({}))
    };
    for (method, path) in [
        ("GET", "/v1/webhook-endpoints/ID"),
        ("PATCH", "/v1/webhook-endpoints/ID"),
        ("DELETE", "/v1/webhook-endpoints/ID"),
        ("POST", "/v1/webhook-endpoints/ID/rotate"),
        ("POST", "/v1/webhook-endpoints/ID/test"),
        ("GET", "/v1/webhook-endpoints/ID/deliveries"),
        ("POST", "/v1/webhook-deliveries/ID/redeliver"),
    ] {
        let ask_for = async |id: &str| {
            let (status, mut problem) = send(request(method, &path.replace("ID", id))).await;
            problem["request_id"] = Value::Null;
            (status, problem.to_string().replace(id, "ID"))
        };
        let theirs = ask_for(id(if path.contains("deliveries/ID") { &delivery } else { &endpoint })).await;
        assert_eq!(theirs.0, 404, "{method} {path}");
        let prefix = if path.contains("deliveries/ID") { "whd" } else { "we" };
        assert_eq!(
            theirs,
            ask_for(&format!("{prefix}_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")).await,
            "the same response as if there were none"
        );
        let (status, _) = send(request(method, &path.replace("ID", "%00"))).await;
        assert_eq!(status, 404, "{method} {path}");
    }
    assert_eq!(send(request("GET", "/v1/webhook-endpoints")).await.1, json!({"endpoints": []}));
    assert_eq!(send(request("GET", "/v1/webhook-deliveries")).await.1, json!({"deliveries": [], "next": null}));
    let (_, theirs) = send(request("GET", "/v1/webhook-secret")).await;
    let (_, ours) = send(api.get("/v1/webhook-secret").bearer_auth(&own)).await;
    assert_ne!(theirs["secret"], ours["secret"]);

    for _ in 1..20 {
        assert_eq!(make(&own).await.0, 201);
    }
    let (status, problem) = make(&own).await;
    assert_eq!((status, &problem["code"]), (409, &json!("too_many_webhooks")));
    assert_eq!(make(&other).await.0, 201);
    // A job sends messages only to its own tenant's endpoints.
    let (_, job) = send(api.post("/v1/jobs").bearer_auth(&other).body(files::broken_box())).await;
    send(api.post(&format!("/v1/jobs/{}/cancel", id(&job))).bearer_auth(&other)).await;
    let (_, page) = send(request("GET", "/v1/webhook-deliveries")).await;
    assert_eq!(page["deliveries"].as_array().map(Vec::len), Some(1));
    let (_, page) = send(api.get("/v1/webhook-deliveries").bearer_auth(&own)).await;
    assert_eq!(page["deliveries"].as_array().map(Vec::len), Some(1), "the test's own");
}

#[tokio::test]
async fn the_log_of_deliveries_is_read_page_by_page() {
    let data = tempfile::tempdir().expect("a folder");
    let program = serve(data.path()).env("MESHMEND_NO_WORKERS", "true").env("MESHMEND_NO_WEBHOOKS", "true").start();
    let api = Api::new(&program);
    let endpoint = register(&api, "http://127.0.0.1:9/").await;
    let mut sent = Vec::new();
    for _ in 0..5 {
        sent.insert(0, ping(&api, &endpoint).await["id"].clone());
    }
    let path = format!("/v1/webhook-endpoints/{}/deliveries", id(&endpoint));
    let (mut read, mut cursor) = (Vec::new(), String::new());
    loop {
        let (_, page) = send(api.get(&format!("{path}?limit=2{cursor}"))).await;
        read.extend(page["deliveries"].as_array().expect("deliveries").iter().map(|delivery| delivery["id"].clone()));
        let Some(next) = page["next"].as_str() else { break };
        cursor = format!("&cursor={next}");
    }
    assert_eq!(read, sent);
    for wrong in ["?limit=0", "?limit=201", "?cursor=x", "?cursor=whd_%00", "?colour=red"] {
        assert_eq!(send(api.get(&format!("{path}{wrong}"))).await.0, 400, "{wrong}");
    }
    assert_eq!(send(api.get("/v1/webhook-deliveries?job=17")).await.0, 404);
}
