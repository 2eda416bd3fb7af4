//! The service behaves as its OpenAPI document says. `make check-api` tests more, with random requests.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Program, Start};

fn document() -> Value {
    serde_json::from_str(include_str!("../../openapi/openapi.json")).expect("JSON")
}

fn keys(object: &Value) -> BTreeSet<&str> {
    object.as_object().expect("an object").keys().map(String::as_str).collect()
}

fn service(data: &tempfile::TempDir) -> (Program, Api) {
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    (program, api)
}

async fn status(api: &Api, path: &str, body: Value) -> u16 {
    api.post(path).json(&body).send().await.expect("a response").status().as_u16()
}

#[tokio::test]
async fn every_file_of_a_job_comes_as_a_media_type_that_is_documented() {
    let data = tempfile::tempdir().expect("a folder");
    let (_program, api) = service(&data);
    let document = document();
    let documented = &document["paths"]["/v1/jobs/{id}/artifacts/{name}"]["get"]["responses"];
    let mut seen = BTreeSet::new();
    for options in [json!({"output": "stl"}), json!({"output": "obj"}), json!({"mode": "analyze"})] {
        let id = api.submit(files::broken_box(), options).await;
        for name in keys(&api.finished(&id).await["artifacts"]) {
            for (range, status) in [("lines=1-2", "200"), ("bytes=0-0", "206")] {
                let request = api.get(&format!("/v1/jobs/{id}/artifacts/{name}")).header("range", range);
                let response = request.send().await.expect("a response");
                assert_eq!(response.status().as_str(), status, "{name}");
                let media_type = response.headers()["content-type"].to_str().expect("text").split(';').next();
                let media_type = media_type.expect("a type").to_owned();
                assert!(!documented[status]["content"][&media_type].is_null(), "{name} is {media_type}");
                seen.insert(media_type);
            }
        }
    }
    assert_eq!(seen, keys(&documented["200"]["content"]).into_iter().map(str::to_owned).collect());
}

#[tokio::test]
async fn each_event_of_a_job_has_the_fields_that_are_documented() {
    let data = tempfile::tempdir().expect("a folder");
    let (_program, api) = service(&data);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    let events = api.get(&format!("/v1/jobs/{id}/events")).send().await.expect("a response");
    let text = events.text().await.expect("the stream ends");
    let document = document();
    let documented = keys(&document["components"]["schemas"]["StreamEvent"]["properties"]);
    for event in text.split("\n\n").filter(|event| !event.is_empty() && !event.starts_with(':')) {
        let fields: BTreeSet<&str> = event.lines().filter_map(|line| line.split(": ").next()).collect();
        assert_eq!(fields, documented, "{event}");
    }
    assert!(text.contains("event: done"), "{text}");
}

#[tokio::test]
async fn an_integer_may_be_written_with_a_decimal_point() {
    let data = tempfile::tempdir().expect("a folder");
    let (_program, api) = service(&data);
    for (bytes, expected) in [(json!(30.0), 201), (json!(3e3), 201), (json!(30.5), 400), (json!(-1.0), 400)] {
        assert_eq!(status(&api, "/v1/uploads", json!({"bytes": bytes})).await, expected, "{bytes}");
    }
    let most = u64::try_from(i64::MAX).expect("above zero");
    for (bytes, expected) in [(most, 413), (most + 1, 400)] {
        assert_eq!(
            status(&api, "/v1/uploads", json!({"bytes": bytes})).await,
            expected,
            "the format int64 ends at {most}"
        );
    }
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    for (wait, expected) in [("0", 200), ("-1", 400), (&most.to_string(), 200), (&(most + 1).to_string(), 400)] {
        let response = api.get(&format!("/v1/jobs/{id}?wait={wait}")).send().await.expect("a response");
        assert_eq!(response.status().as_u16(), expected, "{wait}");
    }
    for (seconds, expected) in [(json!(60.0), 201), (json!(null), 201), (json!(60.5), 400), (json!(1e99), 400)] {
        let token = json!({"origin": "https://shop.example", "expires_in_s": seconds, "max_bytes": 9.0});
        assert_eq!(status(&api, "/v1/browser-tokens", token).await, expected, "{seconds}");
    }
    let id = api.submit(files::broken_box(), json!({"max_tier": 1.0, "max_faces": 1e3})).await;
    let taken = api.finished(&id).await["options"].clone();
    assert_eq!((&taken["max_tier"], &taken["max_faces"]), (&json!(1), &json!(1000)));
    for (option, value) in [("max_tier", json!(1.5)), ("max_faces", json!(-4.0)), ("max_faces", json!(1e30))] {
        let refused = api.try_submit("a.stl", files::broken_box(), json!({option: value})).await;
        assert_eq!(refused.status(), 422, "{option} {value}");
    }
}

#[tokio::test]
async fn an_array_is_not_taken_for_an_object() {
    let data = tempfile::tempdir().expect("a folder");
    let (_program, api) = service(&data);
    assert_eq!(status(&api, "/v1/uploads", json!([null, null])).await, 400);
    assert_eq!(status(&api, "/v1/browser-tokens", json!(["https://shop.example", null, null, null])).await, 400);
    assert_eq!(status(&api, "/v1/webhook-endpoints", json!(["https://shop.example/", null, ""])).await, 400);
    assert_eq!(status(&api, "/v1/jobs", json!({"source": ["upl_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a"]})).await, 400);
    assert_eq!(
        status(&api, "/v1/jobs", json!({"source": {"upload_id": "upl_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a"}})).await,
        404
    );
}

#[tokio::test]
async fn options_of_an_upload_may_be_null_as_documented() {
    let data = tempfile::tempdir().expect("a folder");
    let (_program, api) = service(&data);
    let upload: Value = api.post("/v1/uploads").send().await.expect("a response").json().await.expect("an upload");
    let address = format!("{}{}", api.url, upload["put"]["url"].as_str().expect("an address"));
    let sent = api.http.put(address).body(files::broken_box()).send().await.expect("a response");
    assert_eq!(sent.status(), 204);
    let job = json!({"source": {"upload_id": upload["id"]}, "options": null, "name": null, "callback_url": null});
    assert_eq!(status(&api, "/v1/jobs", job).await, 202);
    assert_ne!(
        document()["paths"]["/v1/uploads"]["post"]["requestBody"]["required"],
        true,
        "the request body is optional"
    );
}

#[tokio::test]
async fn a_page_may_be_given_the_scopes_that_are_documented_and_no_others() {
    let data = tempfile::tempdir().expect("a folder");
    let (_program, api) = service(&data);
    let document = document();
    let schemas = &document["components"]["schemas"];
    let of = |name: &str| schemas[name]["enum"].as_array().expect("names").clone();
    let documented = of("BrowserScope");
    for scope in of("Scope") {
        let token = json!({"origin": "https://shop.example", "scopes": [scope]});
        let expected = if documented.contains(&scope) { 201 } else { 422 };
        assert_eq!(status(&api, "/v1/browser-tokens", token).await, expected, "{scope}");
    }
}

fn without_null(schema: &mut Value) {
    if let Some(types) = schema["type"].as_array() {
        schema["type"] = types.iter().find(|kind| *kind != "null").expect("a type").clone();
    }
    if let Some(variants) = schema["oneOf"].as_array().filter(|variants| variants.contains(&json!({"type": "null"}))) {
        *schema = variants.iter().find(|variant| *variant != &json!({"type": "null"})).expect("a type").clone();
    }
}

#[tokio::test]
async fn a_field_of_the_query_is_documented_as_in_a_body_and_read_as_documented() {
    let document = document();
    let fields = document["paths"]["/v1/jobs"]["post"]["parameters"].as_array().expect("fields").clone();
    let field = |name: &str| fields.iter().find(|field| field["name"] == name).expect("a field").clone();
    // A schema that includes another one is a list, with its own properties in one entry.
    let properties = |name: &str| {
        let schema = &document["components"]["schemas"][name];
        let entries = schema["allOf"].as_array().into_iter().flatten().chain([schema]);
        entries.filter_map(|entry| entry["properties"].as_object()).flatten().collect::<Vec<_>>()
    };
    let bodies = ["Options", "PrintOptions", "InspectOptions"].map(properties);
    let mut compared = 0;
    for (name, option) in bodies.into_iter().flatten() {
        let field = field(name);
        let schema =
            if field["schema"].is_null() { &field["content"]["application/json"]["schema"] } else { &field["schema"] };
        let mut expected = option.clone();
        // A query cannot express null, and a client that sent all defaults would send options of the other mode.
        if field["schema"].is_object() {
            without_null(&mut expected);
        }
        expected.as_object_mut().expect("a schema").remove("default");
        assert_eq!(schema, &expected, "{name}");
        compared += 1;
    }
    assert!(compared > 30, "{compared}");
    assert_eq!((&field("with")["explode"], &field("without")["explode"]), (&json!(false), &json!(false)));

    let data = tempfile::tempdir().expect("a folder");
    let (_program, api) = service(&data);
    let ways = [
        "with=remove_internal_faces,remove_debris&max_tier=1",
        "mode=analyze&up=[0,1,0]&build_volume=[9,9,9]&tolerances={}&metadata={\"order\":\"17\"}",
    ];
    for query in ways {
        let request = api.post(&format!("/v1/jobs?{query}")).body(files::broken_box());
        let response = request.send().await.expect("a response");
        let taken = response.status();
        assert_eq!(taken, 202, "{query}: {}", response.text().await.expect("text"));
    }
}
