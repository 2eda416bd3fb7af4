//! `meshmend watch`: jobs that are followed to their end and downloaded.

use serde_json::{Value, json};

use super::Client;
use crate::files;
use crate::server::{Api, Start};

#[tokio::test]
async fn jobs_submitted_without_waiting_are_watched_to_their_end_and_downloaded() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let client = Client::of(&program.url);
    client.put("a.stl", &files::broken_box());
    client.put("b.stl", &files::boxes_on_an_edge());
    let finished = client.run(&["submit", "a.stl", "b.stl", "--no-wait", "--preset", "fill-holes"]).await;
    finished.ended_with(0);
    let ids: Vec<&str> = finished.out.lines().collect();
    assert!(ids.len() == 2 && ids.iter().all(|id| id.starts_with("job_")), "{finished:?}");
    let finished = client.run(&["watch", ids[0], ids[1], "--download", "out", "--json"]).await;
    finished.ended_with(1).prints("is printable").prints("No repair step improved the model");
    let lines: Vec<Value> = finished.out.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!(lines.len(), 2, "{finished:?}");
    let exist: Vec<bool> =
        ["a-repaired.stl", "b-repaired.stl", "b.stl"].map(|name| client.path("out").join(name).exists()).to_vec();
    assert_eq!(exist, [true, false, false], "an unrepaired model is not downloaded, since it is the input");
    // Without a folder the client only reports.
    let finished = client.run(&["watch", ids[0]]).await;
    finished.prints(": ");
    assert_eq!(finished.out, "");
    let finished = client.run(&["watch", "job_00000000000000000000000000000000"]).await;
    finished.ended_with(4).prints("Job not found").prints("(job_not_found, request ");
    client.run(&["watch", "part.stl"]).await.ended_with(2).prints("a job id must be `job_`");
}

#[tokio::test]
async fn a_failed_or_canceled_job_is_reported_in_text_and_exit_code() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let client = Client::of(&program.url);
    // The file begins like a model.
    client.put("cut.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0,5 0 0\n");
    let finished = client.run(&["submit", "cut.stl", "-o", "out.stl"]).await;
    finished.ended_with(2).prints("line 4");
    assert_eq!(client.names(), ["cut.stl"]);
    let idle = tempfile::tempdir().expect("a folder");
    let program = Start::serve(idle.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let (api, client) = (Api::new(&program), Client::of(&program.url));
    let id = api.submit(files::broken_box(), json!({})).await;
    let mut running = client.start(&["watch", &id]);
    running.says(": queued").await;
    api.post(&format!("/v1/jobs/{id}/cancel")).send().await.expect("a response");
    running.ended().await.ended_with(1).prints("canceled");
}

#[tokio::test]
async fn without_jobs_all_that_come_are_watched_until_it_is_interrupted() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let (api, client) = (Api::new(&program), Client::of(&program.url));
    let first = api.submit(files::broken_box(), json!({})).await;
    let mut running = client.start(&["watch"]);
    running.says(&format!("{first} model.stl: queued")).await;
    let second = api.submit(files::broken_box(), json!({})).await;
    running.says(&format!("{second} model.stl: queued")).await;
    api.post(&format!("/v1/jobs/{first}/cancel")).send().await.expect("a response");
    running.says(&format!("{first} model.stl: the job was canceled")).await;
    running.interrupt();
    running.ended().await.ended_with(130).prints(&second);
}
