//! Jobs are done exactly once after `kill -9` of the child, the worker or the server at any stage.

use std::path::Path;

use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Program, Start, is_alive, signal, stored_files, stored_uploads, until};
use crate::support::FILES_PER_JOB;
use crate::support::fake_blender::hanging_blender;

const CHILD_STAGES: [(&str, &str); 5] = [
    ("child-read", "read"),
    ("child-inspect", "inspect"),
    ("child-tier1", "repair"),
    ("child-verify", "verify"),
    ("child-finish", "finish"),
];

const WORKER_STAGES: [&str; 4] = ["worker-claimed", "worker-spawn", "worker-publish", "worker-complete"];

fn paused(stage: &str) -> String {
    format!("{stage}=sleep(600000)")
}

/// Asserts that the job is done once and that no file of a failed attempt is left.
async fn done_exactly_once(api: &Api, data: &Path, id: &str, attempt: u64) {
    let job = api.finished(id).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    assert_eq!(job["outcome"], "repaired");
    assert_eq!(job["attempt"], attempt);
    let files = until("only the last attempt's files are left", async || {
        let files = stored_files(data, id);
        (files.len() <= FILES_PER_JOB).then_some(files)
    })
    .await;
    assert_eq!(files.len(), FILES_PER_JOB, "{files:?}");
    assert_eq!(api.artifact(id, "model").await.len(), 84 + 50 * 12);
    let list: Value =
        api.get("/v1/jobs?status=succeeded").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!(list["jobs"].as_array().map(Vec::len), Some(1));
}

async fn one_child(program: &Program) -> u32 {
    until("the child runs", async || program.job_children().first().copied()).await
}

#[tokio::test]
async fn a_child_killed_at_any_stage_is_run_again() {
    for (pause, stage) in CHILD_STAGES {
        let data = tempfile::tempdir().expect("a folder");
        let program = Start::serve(data.path()).env("FAILPOINTS", &paused(pause)).start();
        let api = Api::new(&program);
        let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
        api.wait_for_stage(&id, stage, None).await;
        signal(one_child(&program).await, "KILL");
        done_exactly_once(&api, data.path(), &id, 2).await;
    }
}

#[tokio::test]
async fn a_killed_server_leaves_no_process_and_finishes_the_job_after_its_restart() {
    for (pause, stage) in CHILD_STAGES {
        let data = tempfile::tempdir().expect("a folder");
        let program = Start::serve(data.path()).env("FAILPOINTS", &paused(pause)).start();
        let api = Api::new(&program);
        let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
        api.wait_for_stage(&id, stage, None).await;
        let child = one_child(&program).await;
        program.kill();
        until("the child is gone too", async || (!is_alive(child)).then_some(())).await;
        let program = Start::serve(data.path()).start();
        done_exactly_once(&Api::new(&program), data.path(), &id, 2).await;
    }
}

#[tokio::test]
async fn a_worker_killed_at_any_of_its_steps_loses_the_job_to_another_worker() {
    for pause in WORKER_STAGES {
        let data = tempfile::tempdir().expect("a folder");
        // This process only serves; another one works.
        let server = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
        let api = Api::new(&server);
        let worker = Start::work(data.path()).env("FAILPOINTS", &paused(pause)).start();
        let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
        until("the worker has it", async || (api.job(&id).await["status"] == "running").then_some(())).await;
        if pause == "worker-complete" {
            until("the result is stored", async || {
                (stored_files(data.path(), &id).len() == FILES_PER_JOB).then_some(())
            })
            .await;
        }
        worker.kill();
        let _other = Start::work(data.path()).start();
        done_exactly_once(&api, data.path(), &id, 2).await;
    }
}

#[tokio::test]
async fn a_worker_that_was_stopped_and_comes_back_after_its_lease_changes_nothing() {
    let data = tempfile::tempdir().expect("a folder");
    let server = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&server);
    let stale = Start::work(data.path()).env("FAILPOINTS", "worker-complete=sleep(3000)").start();
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    until("the result is stored", async || (stored_files(data.path(), &id).len() == FILES_PER_JOB).then_some(())).await;
    signal(stale.pid(), "STOP");
    let other = Start::work(data.path()).start();
    let job = api.finished(&id).await;
    assert_eq!(job["attempt"], 2);
    signal(stale.pid(), "CONT");
    until("the stale worker sees it", async || stale.log().contains("lease lost; result dropped").then_some(())).await;
    assert_eq!(api.job(&id).await, job, "the stale worker's write was rejected");
    done_exactly_once(&api, data.path(), &id, 2).await;
    drop(other);
}

#[tokio::test]
async fn a_kill_during_an_upload_leaves_no_job_and_a_kill_after_the_response_loses_none() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    let accepted = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    let (sender, receiver) = tokio::sync::mpsc::channel::<Result<Vec<u8>, std::io::Error>>(1);
    let body = futures::stream::unfold(receiver, |mut r| async move { r.recv().await.map(|chunk| (chunk, r)) });
    let upload = api.post("/v1/jobs").body(reqwest::Body::wrap_stream(body)).send();
    let upload = tokio::spawn(upload);
    sender.send(Ok(files::whole_box())).await.expect("the upload listens");
    until("the upload has begun", async || (stored_uploads(data.path()) == 2).then_some(())).await;
    program.kill();
    assert!(upload.await.expect("no panic").is_err());
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    done_exactly_once(&api, data.path(), &accepted, 1).await;
    let list: Value = api.get("/v1/jobs").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!(list["jobs"].as_array().map(Vec::len), Some(1));
}

#[tokio::test]
async fn a_shutdown_releases_running_jobs_and_charges_no_attempt() {
    let data = tempfile::tempdir().expect("a folder");
    let mut program =
        Start::serve(data.path()).arg("--shutdown-grace-s", "0.3").env("FAILPOINTS", &paused("child-tier1")).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    api.wait_for_stage(&id, "repair", Some(1)).await;
    let child = one_child(&program).await;
    program.terminate();
    assert_eq!(program.wait(), Some(0));
    assert!(!is_alive(child));
    let program = Start::serve(data.path()).start();
    done_exactly_once(&Api::new(&program), data.path(), &id, 1).await;
}

#[tokio::test]
async fn a_shutdown_lets_running_jobs_finish_and_accepts_no_new_connections() {
    let data = tempfile::tempdir().expect("a folder");
    let mut program = Start::serve(data.path()).env("FAILPOINTS", "child-tier1=sleep(1500)").start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    api.wait_for_stage(&id, "repair", Some(1)).await;
    program.terminate();
    until("the server accepts no connections", async || {
        let fresh = Api::new(&program);
        fresh.get("/livez").send().await.is_err().then_some(())
    })
    .await;
    assert_eq!(program.wait(), Some(0));
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let job = Api::new(&program).job(&id).await;
    assert_eq!(job["status"], "succeeded", "the job finished before the server stopped");
}

/// Starts a job that hangs in Blender, and returns the server's descendant processes.
async fn hanging_in_tier_three(program: &Program, api: &Api) -> (String, Vec<u32>) {
    let id = api.submit(files::boxes_on_an_edge(), json!({"preset": "blender-remesh", "deadline_s": 30})).await;
    api.wait_for_stage(&id, "repair", Some(3)).await;
    let processes = until("Blender runs", async || {
        let tree = program.job_processes();
        (tree.len() >= 2).then_some(tree)
    })
    .await;
    (id, processes)
}

#[tokio::test]
async fn a_server_killed_while_blender_runs_takes_blender_with_it() {
    let data = tempfile::tempdir().expect("a folder");
    let blender = hanging_blender(data.path());
    let program = Start::serve(data.path()).blender(&blender).start();
    let (id, processes) = hanging_in_tier_three(&program, &Api::new(&program)).await;
    program.kill();
    until("no process is left", async || processes.iter().all(|pid| !is_alive(*pid)).then_some(())).await;
    let program = Start::serve(data.path()).start();
    let job = Api::new(&program).finished(&id).await;
    assert_eq!((job["status"].as_str(), job["attempt"].as_u64()), (Some("succeeded"), Some(2)), "{job}");
}

#[tokio::test]
async fn a_child_killed_while_blender_runs_leaves_no_blender_behind() {
    let data = tempfile::tempdir().expect("a folder");
    let blender = hanging_blender(data.path());
    let program = Start::serve(data.path()).blender(&blender).start();
    let api = Api::new(&program);
    let (id, processes) = hanging_in_tier_three(&program, &api).await;
    signal(processes[0], "KILL");
    until("no process is left", async || processes.iter().all(|pid| !is_alive(*pid)).then_some(())).await;
    until("the job is retried", async || (api.job(&id).await["attempt"] == 2).then_some(())).await;
    api.delete(&format!("/v1/jobs/{id}")).send().await.expect("a response");
}
