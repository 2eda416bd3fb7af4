//! `Idempotency-Key`: a repeated request creates no second job.

use std::path::Path;

use futures::StreamExt;
use reqwest::Response;
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start, stored_uploads, until};

async fn post(api: &Api, key: &str, model: Vec<u8>, options: &str) -> Response {
    let address = format!("/v1/jobs?name=a.stl{options}");
    let request = api.post(&address).header("content-type", "application/octet-stream").header("idempotency-key", key);
    request.body(model).send().await.expect("a response")
}

async fn id_of(response: Response) -> String {
    let status = response.status();
    let job: Value = response.json().await.expect("a job");
    assert_eq!(status, 202, "{job}");
    job["id"].as_str().expect("an id").to_owned()
}

async fn code_of(response: Response) -> (u16, String) {
    let status = response.status().as_u16();
    let problem: Value = response.json().await.expect("a problem");
    (status, problem["code"].as_str().unwrap_or_default().to_owned())
}

async fn only_one_upload_is_left(data: &Path) {
    until("only the first request's file is left", async || (stored_uploads(data) == 1).then_some(())).await;
}

#[tokio::test]
async fn the_same_request_with_the_same_key_makes_one_job_whatever_became_of_the_job() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let first = post(&api, "k-1", files::broken_box(), "&max_tier=1").await;
    assert!(!first.headers().contains_key("idempotency-replayed"));
    let id = id_of(first).await;
    api.finished(&id).await;
    // The IETF draft "The Idempotency-Key HTTP Header Field" writes keys in quotes.
    let again = post(&api, "\"k-1\"", files::broken_box(), "&max_tier=1").await;
    assert_eq!(again.headers()["idempotency-replayed"], "true");
    assert_eq!(again.headers()["location"], format!("/v1/jobs/{id}").as_str());
    assert_eq!(id_of(again).await, id);
    only_one_upload_is_left(data.path()).await;
    let list: Value = api.get("/v1/jobs").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!(list["jobs"].as_array().map(Vec::len), Some(1));
    // Another key, or none, makes another request.
    assert_ne!(id_of(post(&api, "k-2", files::broken_box(), "&max_tier=1").await).await, id);
    api.delete(&format!("/v1/jobs/{id}")).send().await.expect("a response");
    let gone = post(&api, "k-1", files::broken_box(), "&max_tier=1").await;
    assert_eq!(code_of(gone).await, (410, "job_deleted".to_owned()));
}

#[tokio::test]
async fn another_request_with_the_same_key_is_refused() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    let id = id_of(post(&api, "k", files::broken_box(), "").await).await;
    let reused = (422, "idempotency_key_reused".to_owned());
    assert_eq!(code_of(post(&api, "k", files::whole_box(), "").await).await, reused, "the file differs");
    assert_eq!(code_of(post(&api, "k", files::broken_box(), "&max_tier=1").await).await, reused, "the options differ");
    assert_eq!(id_of(post(&api, "k", files::broken_box(), "").await).await, id);
    only_one_upload_is_left(data.path()).await;
}

#[tokio::test]
async fn an_idempotency_key_is_taken_during_its_request_and_free_again_if_that_fails() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    let start = futures::stream::iter([Ok::<_, std::io::Error>(files::broken_box()[..100].to_vec())]);
    let slow = start.chain(futures::stream::pending());
    let request =
        api.post("/v1/jobs").header("content-type", "application/octet-stream").header("idempotency-key", "k");
    let request = request.body(reqwest::Body::wrap_stream(slow));
    let under_way = tokio::spawn(request.send());
    let uploads = data.path().join("files/uploads");
    until("the file's upload has begun", async || {
        std::fs::read_dir(&uploads).is_ok_and(|entries| entries.count() > 0).then_some(())
    })
    .await;
    let refused = post(&api, "k", files::broken_box(), "").await;
    assert_eq!(refused.headers()["retry-after"], "2");
    assert_eq!(code_of(refused).await, (409, "idempotency_key_in_use".to_owned()));
    under_way.abort();
    let no_model = post(&api, "other", b"no model".to_vec(), "").await;
    assert_eq!(no_model.status(), 415);
    until("both keys are free", async || {
        let responses =
            [post(&api, "k", files::broken_box(), "").await, post(&api, "other", files::broken_box(), "").await];
        responses.iter().all(|response| response.status() == 202).then_some(())
    })
    .await;
}

#[tokio::test]
async fn a_key_that_is_empty_too_long_or_given_twice_is_refused() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    for key in ["", "\"\"", "a b", &"x".repeat(256)] {
        let response = post(&api, key, files::broken_box(), "").await;
        assert_eq!(code_of(response).await, (400, "invalid_request".to_owned()), "{key}");
    }
    let twice = api.post("/v1/jobs").header("idempotency-key", "a").header("idempotency-key", "b");
    let response = twice.body(files::broken_box()).send().await.expect("a response");
    assert_eq!(code_of(response).await.0, 400);
    assert_eq!(json!(stored_uploads(data.path())), json!(0));
}
