//! The service's verdict on results that are not printable, and the file that it returns.

use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start};
use crate::support::receiver::{Receiver, Reply};

#[tokio::test]
async fn a_job_that_requires_a_printable_result_fails_with_a_report_and_without_a_model() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_WEBHOOK_ALLOW_PRIVATE", "true").start();
    let api = Api::new(&program);
    let receiver = Receiver::start(&[Reply::Status(204)]).await;
    let endpoint = api.post("/v1/webhook-endpoints").json(&json!({"url": receiver.url})).send().await;
    assert_eq!(endpoint.expect("a response").status(), 201);
    let id = api.submit(files::open_sheet(), json!({"max_tier": 2, "require": "printable"})).await;
    let job = api.finished(&id).await;
    assert_eq!((&job["status"], &job["outcome"]), (&json!("failed"), &json!("unrepairable")), "{job}");
    assert_eq!(job["problem"]["code"], "not_printable");
    let detail = job["problem"]["detail"].as_str().expect("text");
    let summary = job["report"]["summary"].as_str().expect("text");
    assert!(detail.contains("require=printable") && detail.contains(summary), "{detail}");
    assert_eq!(job["report"]["outcome"], "unrepairable");
    assert_eq!(job["report"]["verdict"]["file"], "none");
    for name in ["model", "original"] {
        assert!(job["artifacts"].get(name).is_none(), "{job}");
        let response = api.get(&format!("/v1/jobs/{id}/artifacts/{name}")).send().await.expect("a response");
        assert_eq!(response.status(), 404);
    }
    let stored: Value = serde_json::from_slice(&api.artifact(&id, "report.json").await).expect("JSON");
    assert_eq!(stored, job["report"]);
    assert!(job["artifacts"]["before.png"].is_object() && job["artifacts"]["log.txt"].is_object(), "{job}");

    let message = receiver.got(1).await.remove(0).json();
    assert_eq!(
        (&message["type"], &message["data"]["problem"]["code"]),
        (&json!("job.failed"), &json!("not_printable"))
    );
    assert_eq!((&message["data"]["outcome"], &message["data"]["printable"]), (&json!("unrepairable"), &json!(false)));
    assert!(message["data"]["artifacts"].get("model").is_none(), "{message}");
    let metrics = api.get("/metrics").send().await.expect("a response").text().await.expect("text");
    let line = "meshmend_attempts_total{status=\"failed\",outcome=\"unrepairable\"} 1";
    assert!(metrics.contains(line), "{line} is not in\n{metrics}");
}

#[tokio::test]
async fn an_unrepaired_job_offers_its_upload_and_no_model() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    // Even if another format is requested, the file is the upload itself.
    for options in [json!({"max_tier": 2}), json!({"max_tier": 2, "output": "obj"})] {
        let id = api.submit(files::open_sheet(), options).await;
        let job = api.finished(&id).await;
        assert_eq!((&job["status"], &job["outcome"]), (&json!("succeeded"), &json!("unrepairable")), "{job}");
        assert_eq!(job["report"]["verdict"]["file"], "original");
        assert!(job["artifacts"].get("model").is_none(), "{job}");
        assert_eq!(job["artifacts"]["original"]["filename"], "model.stl");
        assert_eq!(job["artifacts"]["original"]["media_type"], "model/stl");
        assert_eq!(api.artifact(&id, "original").await, files::open_sheet());
    }
}

#[tokio::test]
async fn requiring_a_printable_result_does_not_change_a_printable_one() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1, "require": "printable"})).await;
    let job = api.finished(&id).await;
    assert_eq!((&job["status"], &job["outcome"]), (&json!("succeeded"), &json!("repaired")), "{job}");
    let verdict = &job["report"]["verdict"];
    assert_eq!(verdict["proven"], json!(["closed", "manifold", "outward", "no_intersections"]));
    assert_eq!((&verdict["printable"], &verdict["passes"]), (&json!(true), &json!(true)));
    assert!(job["artifacts"]["model"].is_object(), "{job}");
}

#[tokio::test]
async fn an_unknown_requirement_is_refused_with_the_list_of_known_ones() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let response = api.try_submit("a.stl", files::broken_box(), json!({"require": "gold"})).await;
    assert_eq!(response.status(), 422);
    let problem: Value = response.json().await.expect("JSON");
    let detail = problem["detail"].as_str().expect("text");
    for words in ["require", "gold", "`any`", "`printable`", "`print_ready`"] {
        assert!(detail.contains(words), "{detail}");
    }
}
