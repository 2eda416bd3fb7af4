//! Cancelling and deleting jobs: their processes end and their files go.

use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start, is_alive, stored_files, until};
use crate::support::fake_blender::hanging_blender;

#[tokio::test]
async fn cancelling_a_running_job_ends_its_whole_process_tree() {
    let data = tempfile::tempdir().expect("a folder");
    let blender = hanging_blender(data.path());
    let program = Start::serve(data.path()).blender(&blender).start();
    let api = Api::new(&program);
    let id = api.submit(files::boxes_on_an_edge(), json!({"preset": "blender-remesh"})).await;
    api.wait_for_stage(&id, "repair", Some(3)).await;
    let processes = until("Blender runs", async || {
        let tree = program.job_processes();
        (tree.len() >= 2).then_some(tree)
    })
    .await;
    let response = api.post(&format!("/v1/jobs/{id}/cancel")).send().await.expect("a response");
    assert_eq!(response.status(), 200);
    assert_eq!(response.json::<Value>().await.expect("a job")["status"], "canceled");
    until("the processes are gone", async || processes.iter().all(|pid| !is_alive(*pid)).then_some(())).await;
    let again = api.post(&format!("/v1/jobs/{id}/cancel")).send().await.expect("a response");
    assert_eq!(again.status(), 200, "a second cancel changes nothing");
    let id = api.submit(files::whole_box(), json!({})).await;
    assert_eq!(api.finished(&id).await["status"], "succeeded", "the worker continues");
}

#[tokio::test]
async fn a_waiting_job_is_cancelled_before_it_starts_and_a_finished_one_no_more() {
    let data = tempfile::tempdir().expect("a folder");
    let blender = hanging_blender(data.path());
    let program = Start::serve(data.path()).blender(&blender).arg("--workers", "1").start();
    let api = Api::new(&program);
    let done = api.submit(files::whole_box(), json!({})).await;
    api.finished(&done).await;
    let running = api.submit(files::boxes_on_an_edge(), json!({"preset": "blender-remesh"})).await;
    api.wait_for_stage(&running, "repair", Some(3)).await;
    let waiting = api.submit(files::broken_box(), json!({})).await;
    assert_eq!(api.job(&waiting).await["progress"]["queue_position"], 0);
    let response = api.post(&format!("/v1/jobs/{waiting}/cancel")).send().await.expect("a response");
    assert_eq!(response.json::<Value>().await.expect("a job")["started_at"], Value::Null);
    let response = api.post(&format!("/v1/jobs/{done}/cancel")).send().await.expect("a response");
    assert_eq!(response.status(), 409);
    assert_eq!(response.json::<Value>().await.expect("a problem")["code"], "job_finished");
}

#[tokio::test]
async fn deleting_a_job_deletes_its_files_and_leaves_nothing_to_read() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    api.finished(&id).await;
    api.artifact(&id, "before.png").await;
    assert_eq!(
        stored_files(data.path(), &id).len(),
        12,
        "the upload, the model, seven drawings, both reports and the log"
    );
    let response = api.delete(&format!("/v1/jobs/{id}")).send().await.expect("a response");
    assert_eq!(response.status(), 204);
    assert!(stored_files(data.path(), &id).is_empty());
    for path in [format!("/v1/jobs/{id}"), format!("/v1/jobs/{id}/artifacts/model"), format!("/v1/jobs/{id}/events")] {
        let response = api.get(&path).send().await.expect("a response");
        assert_eq!(response.status(), 410, "{path}");
    }
    let list: Value = api.get("/v1/jobs").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!(list["jobs"].as_array().map(Vec::len), Some(0));
}

#[tokio::test]
async fn deleting_a_running_job_stops_it() {
    let data = tempfile::tempdir().expect("a folder");
    let blender = hanging_blender(data.path());
    let program = Start::serve(data.path()).blender(&blender).start();
    let api = Api::new(&program);
    let id = api.submit(files::boxes_on_an_edge(), json!({"preset": "blender-remesh"})).await;
    api.wait_for_stage(&id, "repair", Some(3)).await;
    let processes = program.job_processes();
    assert_eq!(api.delete(&format!("/v1/jobs/{id}")).send().await.expect("a response").status(), 204);
    until("the processes are gone", async || processes.iter().all(|pid| !is_alive(*pid)).then_some(())).await;
    until("its files are gone", async || stored_files(data.path(), &id).is_empty().then_some(())).await;
}
