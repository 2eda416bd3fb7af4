//! Routes outside jobs: health, capabilities, metrics, the API's document, and trailing slashes.

use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start};

#[tokio::test]
async fn health_capabilities_metrics_and_documentation_answer() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    assert_eq!(api.get("/livez").send().await.expect("a response").status(), 200);
    let ready: Value = api.get("/readyz").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!(ready["ready"], true);
    assert_eq!(ready["checks"]["store"], "ok");
    assert!(ready["checks"]["blender"].as_str().expect("text").starts_with("missing"), "{ready}");
    let can: Value = api.get("/v1/capabilities").send().await.expect("a response").json().await.expect("JSON");
    let available: Vec<_> = can["tiers"].as_array().expect("tiers").iter().map(|tier| &tier["available"]).collect();
    assert_eq!(available, [true, true, false]);
    assert!(can["tiers"][2]["detail"].as_str().is_some_and(|text| text.contains("/nonexistent/blender")), "{can}");
    assert_eq!(can["presets"].as_array().map(Vec::len), Some(8));
    assert_eq!(can["input_formats"], json!(["stl", "obj", "ply", "off", "mesh", "glb", "3mf", "zip"]));

    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    api.finished(&id).await;
    let metrics = api.get("/metrics").send().await.expect("a response").text().await.expect("text");
    for line in [
        "meshmend_jobs{status=\"succeeded\"} 1",
        "meshmend_jobs_submitted_total{reused=\"false\"} 1",
        "meshmend_step_seconds_bucket",
    ] {
        assert!(metrics.contains(line), "{line} is not in\n{metrics}");
    }

    let codes: Value = api.get("/problems").send().await.expect("a response").json().await.expect("JSON");
    for code in codes.as_array().expect("codes") {
        let path = format!("/problems/{}", code["code"].as_str().expect("a code"));
        let one: Value = api.get(&path).send().await.expect("a response").json().await.expect("JSON");
        assert_eq!(&one, code);
    }
}

#[tokio::test]
async fn the_interactive_document_needs_nothing_from_elsewhere() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let page = api.get("/docs/api/").send().await.expect("a response").text().await.expect("text");
    assert!(page.contains("swagger-ui"), "{page}");
    assert!(!page.contains("://"), "every address is of this service: {page}");
    for file in page.split(['"', '\'']).filter_map(|word| word.strip_prefix("./")) {
        let answer = api.get(&format!("/docs/api/{file}")).send().await.expect("a response");
        assert_eq!(answer.status(), 200, "{file}");
    }
    let served: Value = api.get("/openapi.json").send().await.expect("a response").json().await.expect("JSON");
    let kept: Value = serde_json::from_str(include_str!("../../openapi/openapi.json")).expect("JSON");
    assert_eq!(served, kept);
    assert_eq!(served["openapi"], "3.1.0");
}

#[tokio::test]
async fn a_trailing_slash_changes_nothing_of_an_address() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    let posted = api.post("/v1/jobs/?max_tier=1").body(files::broken_box()).send().await.expect("a response");
    assert_eq!(posted.status(), 202);
    let job: Value = posted.json().await.expect("a job");
    let page: Value = api.get("/v1/jobs/?limit=5").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!(page["jobs"][0]["id"], job["id"]);
    for path in ["/docs/", "/docs/api/", "/"] {
        assert_eq!(api.get(path).send().await.expect("a response").status(), 200, "{path}");
    }
}
