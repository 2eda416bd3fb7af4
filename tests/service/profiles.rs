//! Process profiles: their lists, the profiles of tenants, and jobs that are checked against a process.

use std::path::Path;

use meshmend::jobs::{NewProfile, TenantProfile};
use meshmend::printing::profile::ProcessLimits;
use reqwest::{Method, RequestBuilder};
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start};
use crate::support::access::{create_key, meshmend, send, start_with_keys};
use crate::support::receiver::{Receiver, Reply};
use crate::support::stores::{Bench, on_each_store};

on_each_store! {
    a_tenants_profiles_are_its_own_and_no_more_than_may_be,
    a_profile_is_replaced_or_deleted_only_as_expected,
}

fn profile(name: &str, free_wall_mm: f64) -> NewProfile {
    let limits = ProcessLimits {
        based_on: Some("sls".to_owned()),
        free_wall_mm: Some(free_wall_mm),
        ..ProcessLimits::default()
    };
    NewProfile::new(name, limits).expect("valid")
}

fn names(profiles: &[TenantProfile]) -> Vec<&str> {
    profiles.iter().map(|profile| profile.name.as_str()).collect()
}

async fn a_tenants_profiles_are_its_own_and_no_more_than_may_be(bench: Bench) {
    let store = bench.store.as_ref();
    let add = async |tenant, name| store.add_profile(tenant, &profile(name, 1.2), 2).await.expect("a result");
    let added = add("shop", "strong").await.expect("added");
    assert_eq!((added.version, added.limits.based_on.as_deref()), (1, Some("sls-pa12")));
    assert_eq!(added.created_at, added.updated_at);
    assert_eq!(add("shop", "strong").await, None, "the name is taken");
    assert!(add("bakery", "strong").await.is_some(), "the name is free for another tenant");
    assert!(add("shop", "fine").await.is_some());
    assert_eq!(add("shop", "third").await, None, "two are the maximum");
    assert_eq!(names(&store.profiles("shop").await.expect("a list")), ["fine", "strong"]);
    assert_eq!(names(&store.profiles("bakery").await.expect("a list")), ["strong"]);
    assert_eq!(store.profile("shop", "strong").await.expect("a result"), Some(added));
    assert_eq!(store.profile("bakery", "fine").await.expect("a result"), None);
    assert!(!store.delete_profile("bakery", "fine", None).await.expect("a result"));
    assert_eq!(store.profiles("shop").await.expect("a list").len(), 2);
}

async fn a_profile_is_replaced_or_deleted_only_as_expected(bench: Bench) {
    let store = bench.store.as_ref();
    let replace = async |wall, expected: Option<&TenantProfile>| {
        store.replace_profile("shop", &profile("strong", wall), expected).await.expect("a result")
    };
    assert_eq!(replace(1.1, None).await, None, "there is none");
    let first = store.add_profile("shop", &profile("strong", 1.2), 9).await.expect("a result").expect("added");
    bench.advance(std::time::Duration::from_secs(1));
    let second = replace(1.3, Some(&first)).await.expect("replaced");
    assert_eq!((second.version, second.limits.free_wall_mm), (2, Some(1.3)));
    assert!(second.updated_at > first.updated_at && second.created_at == first.created_at);
    assert_eq!(replace(1.4, Some(&first)).await, None, "it has changed since");
    assert_eq!(replace(1.5, None).await.expect("replaced").version, 3);
    assert!(!store.delete_profile("shop", "strong", Some(&second)).await.expect("a result"));
    assert!(store.delete_profile("shop", "strong", None).await.expect("a result"));
    let again = store.add_profile("shop", &profile("strong", 1.2), 9).await.expect("a result").expect("added");
    assert_eq!(replace(1.6, Some(&first)).await, None, "the profile that was expected is gone");
    assert_eq!(store.profile("shop", "strong").await.expect("a result"), Some(again));
}

/// A request to a path of `/v1/profiles`.
fn to(api: &Api, method: Method, name: &str) -> RequestBuilder {
    api.http.request(method, format!("{}/v1/profiles/{name}", api.url))
}

async fn put(api: &Api, name: &str, limits: Value) -> (u16, Value) {
    send(to(api, Method::PUT, name).json(&limits)).await
}

/// A box with these sides in millimetres.
fn cuboid(x: f32, y: f32, z: f32) -> Vec<u8> {
    files::stl(&files::BOX.map(|triangle| triangle.map(|[a, b, c]| [a * x, b * y, c * z])))
}

/// The result of one rule in a list of rules.
fn rule<'a>(rules: &'a Value, name: &str) -> &'a Value {
    let found = rules.as_array().expect("rules").iter().find(|rule| rule["rule"] == name);
    found.unwrap_or_else(|| panic!("{name} is not in {rules}"))
}

#[tokio::test]
async fn built_in_profiles_are_listed_with_the_sources_of_their_limits() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let (status, list) = send(api.get("/v1/profiles")).await;
    assert_eq!(status, 200);
    let profiles = list["profiles"].as_array().expect("profiles");
    assert!(profiles.len() >= 8 && profiles.iter().all(|one| one["built_in"] == true), "{list}");
    for one in profiles {
        let profile = &one["profile"];
        let wall = &profile["free_wall_mm"];
        assert!(wall["minimum"].as_f64() <= wall["limit"].as_f64(), "{profile}");
        let has_sources = wall["sources"].as_array().is_some_and(|sources| !sources.is_empty());
        assert_eq!(wall["basis"] == "sourced", has_sources, "{profile}");
        let (status, same) =
            send(api.get(&format!("/v1/profiles/{}", profile["name"].as_str().expect("a name")))).await;
        assert_eq!((status, &same), (200, one));
    }
    let (status, by_alias) = send(api.get("/v1/profiles/sls")).await;
    assert_eq!((status, &by_alias["profile"]["name"]), (200, &json!("sls-pa12")));
    assert!(by_alias["profile"]["free_wall_mm"]["sources"][0].as_str().is_some_and(|title| title.len() > 10));
    let (status, problem) = send(api.get("/v1/profiles/clay")).await;
    assert_eq!((status, &problem["code"]), (404, &json!("profile_not_found")));
}

#[tokio::test]
async fn a_profile_is_created_replaced_and_deleted_under_preconditions() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let limits = json!({"based_on": "sls", "title": "Our SLS", "free_wall_mm": 1.4, "max_faces": 1e6});
    let created = to(&api, Method::PUT, "our-sls").json(&limits).send().await.expect("a response");
    assert_eq!(created.status(), 201);
    let tag = created.headers()["etag"].to_str().expect("text").to_owned();
    let view: Value = created.json().await.expect("JSON");
    assert_eq!((&view["built_in"], &view["limits"]["based_on"]), (&json!(false), &json!("sls-pa12")));
    let profile = &view["profile"];
    assert_eq!((&profile["name"], &profile["title"]), (&json!("our-sls"), &json!("Our SLS")));
    assert_eq!(
        (&profile["free_wall_mm"]["limit"], &profile["free_wall_mm"]["basis"]),
        (&json!(1.4), &json!("requested"))
    );
    assert_eq!(profile["gap_mm"]["basis"], "sourced", "the other limits stay");
    let unchanged = api.get("/v1/profiles/our-sls").header("if-none-match", &tag).send().await.expect("a response");
    assert_eq!(unchanged.status(), 304);

    let with = |name: &str, value: &str| to(&api, Method::PUT, "our-sls").json(&limits).header(name, value);
    let (status, problem) = send(with("if-none-match", "*")).await;
    assert_eq!((status, &problem["code"]), (412, &json!("precondition_failed")));
    let replaced = with("if-match", &tag).send().await.expect("a response");
    assert_eq!(replaced.status(), 200);
    assert_ne!(replaced.headers()["etag"].to_str().expect("text"), tag);
    assert_eq!(send(with("if-match", &tag)).await.0, 412);
    let stale = to(&api, Method::DELETE, "our-sls").header("if-match", &tag);
    assert_eq!(send(stale).await.0, 412);
    assert_eq!(send(to(&api, Method::DELETE, "our-sls")).await.0, 204);
    assert_eq!(send(to(&api, Method::DELETE, "our-sls")).await.0, 404);
    assert_eq!(send(with("if-match", "*")).await.0, 412, "there is nothing to replace");
}

#[tokio::test]
async fn an_invalid_profile_is_refused_by_the_name_of_its_field() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    for (name, limits, field) in [
        ("mine", json!({"free_wall_mm": 1}), Some("based_on")),
        ("mine", json!({"based_on": "clay"}), Some("based_on")),
        ("mine", json!({"based_on": "sls", "free_wall_mm": -1}), Some("free_wall_mm")),
        ("mine", json!({"based_on": "sls", "gap_mm": "wide"}), Some("gap_mm")),
        ("mine", json!({"based_on": "sls", "gap": 1}), Some("gap")),
        ("mine", json!({"based_on": "sls", "escape_hole_count": 5e9}), Some("escape_hole_count")),
        ("mine", json!({"based_on": "sls", "title": "x".repeat(101)}), Some("title")),
        ("sls-pa12", json!({"based_on": "sls"}), None),
        ("SLS", json!({"based_on": "sls"}), None),
        ("my%20sls", json!({"based_on": "sls"}), None),
    ] {
        let (status, problem) = put(&api, name, limits).await;
        assert_eq!((status, problem["errors"][0]["field"].as_str()), (422, field), "{problem}");
        assert!(
            problem["detail"].as_str().is_some_and(|text| text.contains(field.unwrap_or(name)) || field.is_none()),
            "{problem}"
        );
    }
    for number in 0..50 {
        assert_eq!(put(&api, &format!("p{number}"), json!({"based_on": "sls"})).await.0, 201);
    }
    let (status, problem) = put(&api, "one-more", json!({"based_on": "sls"})).await;
    assert_eq!((status, &problem["code"]), (409, &json!("too_many_profiles")));
    assert_eq!(put(&api, "p7", json!({"based_on": "tpu"})).await.0, 200, "an existing one can be replaced");
}

#[tokio::test]
async fn a_tenants_profile_is_used_at_submission_and_hidden_from_others() {
    let data = tempfile::tempdir().expect("a folder");
    let scopes = "jobs:read,jobs:write,tokens";
    let (shop, bakery) = (create_key(data.path(), "shop", scopes), create_key(data.path(), "bakery", scopes));
    let program = start_with_keys(Start::serve(data.path()));
    let api = Api::new(&program);
    let limits = json!({"based_on": "sls-pa12", "build_volume_mm": [30, 30, 30], "part_volume_mm3": 5});
    let put = to(&api, Method::PUT, "small").json(&limits);
    assert_eq!(send(put.bearer_auth(&shop)).await.0, 201);
    let (status, list) = send(api.get("/v1/profiles").bearer_auth(&bakery)).await;
    assert!(status == 200 && !list.to_string().contains("\"small\""), "{list}");
    assert_eq!(send(api.get("/v1/profiles/small").bearer_auth(&bakery)).await.0, 404);
    assert_eq!(send(to(&api, Method::DELETE, "small").bearer_auth(&bakery)).await.0, 404);
    let token = json!({"origin": "https://shop.example"});
    let (_, token) = send(api.post("/v1/browser-tokens").bearer_auth(&shop).json(&token)).await;
    let token = token["token"].as_str().expect("a token");
    let from_page = |request: RequestBuilder| send(request.bearer_auth(token).header("origin", "https://shop.example"));
    assert!(from_page(api.get("/v1/profiles")).await.1.to_string().contains("\"small\""));
    let (status, problem) = from_page(to(&api, Method::PUT, "small").json(&limits)).await;
    assert_eq!((status, &problem["code"]), (403, &json!("forbidden")));

    let submit = |key: &str, query: &str| {
        send(api.post(&format!("/v1/jobs?mode=analyze&{query}")).bearer_auth(key).body(cuboid(40., 20., 20.)))
    };
    let (status, problem) = submit(&bakery, "process=small").await;
    assert_eq!((status, &problem["errors"][0]["field"]), (422, &json!("process")), "{problem}");
    let query = r#"process=small&process_limits={"part_volume_mm3":7,"title":"Once"}"#;
    let (status, job) = submit(&shop, query).await;
    assert_eq!(status, 202, "{job}");
    assert_eq!(send(to(&api, Method::DELETE, "small").bearer_auth(&shop)).await.0, 204);
    let path = format!("/v1/jobs/{}?wait=60", job["id"].as_str().expect("an id"));
    let (_, job) = send(api.get(&path).bearer_auth(&shop)).await;
    let resolved = &job["options"]["process_limits"];
    assert_eq!((&job["options"]["process"], &resolved["based_on"]), (&json!("small"), &json!("sls-pa12")), "{job}");
    assert_eq!((&resolved["part_volume_mm3"], &resolved["title"]), (&json!(7.0), &json!("Once")));
    let readiness = &job["quote"]["print_ready"];
    assert_eq!((&readiness["process"], &readiness["ready"]), (&json!("small"), &json!(false)), "{job}");
    let build = rule(&readiness["rules"], "build_volume");
    assert_eq!((&build["result"], &build["limit"], &build["measured"]), (&json!("fail"), &json!(30.0), &json!(40.0)));
    assert_eq!(rule(&readiness["rules"], "part_volume")["limit"], 7.0);
    assert_eq!(submit(&shop, "process=small").await.0, 422, "the profile is gone");
}

#[tokio::test]
async fn a_repeated_request_gets_its_job_after_the_profile_has_changed() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    assert_eq!(put(&api, "2024", json!({"based_on": "sls", "free_wall_mm": 2})).await.0, 201);
    let submit = || {
        let request = api.post("/v1/jobs?process=2024").header("idempotency-key", "one");
        send(request.body(cuboid(20., 20., 20.)))
    };
    let (status, first) = submit().await;
    assert_eq!((status, &first["options"]["process_limits"]["free_wall_mm"]), (202, &json!(2.0)), "{first}");
    assert_eq!(put(&api, "2024", json!({"based_on": "sls", "free_wall_mm": 3})).await.0, 200);
    let (status, again) = submit().await;
    assert_eq!((status, &again["id"]), (202, &first["id"]), "{again}");
}

#[tokio::test]
async fn wrong_options_about_the_process_are_refused_by_their_names() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    for (options, field) in [
        (json!({"process": "clay"}), "process"),
        (json!({"process": 4}), "process"),
        (json!({"process": "sls", "process_limits": {"gap_mm": -1}}), "process_limits.gap_mm"),
        (json!({"process": "sls", "process_limits": {"gap": 1}}), "process_limits.gap"),
        (json!({"process_limits": {"gap_mm": 1}}), "process_limits"),
        (json!({"process": "sls", "process_limits": {"based_on": "clay"}}), "process_limits.based_on"),
        (json!({"min_wall": 0}), "min_wall"),
        (json!({"interior": "melt"}), "interior"),
        (json!({"islands": "sink"}), "islands"),
        (json!({"voids": "open"}), "voids"),
        (json!({"thicken_to_process": true}), "thicken_to_process"),
        (json!({"target_height_mm": 9, "target_longest_mm": 9}), "target_longest_mm"),
        (json!({"require": "print_ready"}), "require"),
        (json!({"mode": "analyze", "process": "clay"}), "process"),
        (json!({"mode": "analyze", "min_wall": 1}), "min_wall"),
    ] {
        let response = api.try_submit("a.stl", files::whole_box(), options.clone()).await;
        assert_eq!(response.status(), 422, "{options}");
        let problem: Value = response.json().await.expect("JSON");
        assert_eq!(problem["errors"][0]["field"], field, "{options}: {problem}");
    }
}

#[tokio::test]
async fn a_thin_plate_that_must_be_print_ready_fails_without_a_model() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_WEBHOOK_ALLOW_PRIVATE", "true").start();
    let api = Api::new(&program);
    let receiver = Receiver::start(&[Reply::Status(204)]).await;
    let endpoint = api.post("/v1/webhook-endpoints").json(&json!({"url": receiver.url})).send().await;
    assert_eq!(endpoint.expect("a response").status(), 201);
    let options = json!({"process": "fdm-0.4", "require": "print_ready", "unit": "mm"});
    // Thinner than a free wall may be, and with less volume than a separate solid may have.
    let id = api.submit(cuboid(6., 6., 0.2), options).await;
    let job = api.finished(&id).await;
    assert_eq!((&job["status"], &job["problem"]["code"]), (&json!("failed"), &json!("not_print_ready")), "{job}");
    assert_eq!(job["outcome"], "already_printable");
    let detail = job["problem"]["detail"].as_str().expect("text");
    assert!(detail.contains("require=print_ready") && detail.contains("volume of separate solids"), "{detail}");
    assert_eq!(job["report"]["verdict"]["print_ready"], false);
    let volume = rule(&job["report"]["print_ready"]["rules"], "part_volume");
    assert_eq!((&volume["result"], &volume["count"]), (&json!("fail"), &json!(1)), "{volume}");
    assert!(volume["remedy"].is_string() && volume["places"][0]["at"].is_array(), "{volume}");
    for name in ["model", "original"] {
        assert!(job["artifacts"].get(name).is_none(), "{job}");
    }
    let message = receiver.got(1).await.remove(0).json();
    let data = &message["data"];
    assert_eq!((&data["problem"]["code"], &data["print_ready"]), (&json!("not_print_ready"), &json!(false)));
    assert_eq!((&data["printable"], &data["outcome"]), (&json!(true), &json!("already_printable")));
}

#[tokio::test]
async fn a_thick_box_that_must_be_print_ready_is_returned() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let options = json!({"process": "fdm-0.4", "require": "print_ready", "unit": "mm"});
    let id = api.submit(cuboid(20., 20., 20.), options).await;
    let job = api.finished(&id).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    assert_eq!(job["report"]["verdict"]["print_ready"], true);
    assert_eq!(job["quote"]["print_ready"]["ready"], true);
}

/// Runs a command on the data folder that must fail, and returns its message.
fn refused(data: &Path, args: &[&str]) -> String {
    let run =
        std::process::Command::new(env!("CARGO_BIN_EXE_meshmend")).args(args).arg("--data-dir").arg(data).output();
    let run = run.expect("the program runs");
    assert_eq!(run.status.code(), Some(2), "{args:?}");
    String::from_utf8(run.stderr).expect("text")
}

#[test]
fn an_operator_sets_lists_and_removes_the_profiles_of_tenants() {
    let data = tempfile::tempdir().expect("a folder");
    let file = data.path().join("limits.json");
    std::fs::write(&file, r#"{"based_on": "sls", "free_wall_mm": 1.4}"#).expect("written");
    let path = file.to_str().expect("text");
    let set = meshmend(data.path(), &["profiles", "set", "--tenant", "shop", "strong", path]);
    let set: Value = serde_json::from_str(&set).expect("JSON");
    assert_eq!((&set["name"], &set["limits"]["based_on"]), (&json!("strong"), &json!("sls-pa12")));
    let listed = meshmend(data.path(), &["profiles", "list", "--tenant", "shop", "--json"]);
    assert_eq!(serde_json::from_str::<Value>(&listed).expect("JSON"), set);
    assert!(meshmend(data.path(), &["profiles", "list", "--tenant", "shop"]).contains("strong"));
    assert!(!meshmend(data.path(), &["profiles", "list"]).contains("strong"), "another tenant's");
    std::fs::write(&file, r#"{"free_wall_mm": 1.4}"#).expect("written");
    let message = refused(data.path(), &["profiles", "set", "strong", path]);
    assert!(message.contains("limits.json") && message.contains("`based_on` is missing"), "{message}");
    assert!(refused(data.path(), &["profiles", "set", "sls", path]).contains("`sls-pa12`"));
    assert!(refused(data.path(), &["profiles", "remove", "strong"]).contains("'default'"));
    assert_eq!(meshmend(data.path(), &["profiles", "remove", "--tenant", "shop", "strong"]), "removed strong");
}
