//! Full and read-only disks: accepted jobs are kept, new ones are refused, and work resumes when there is space.

use std::fs;
use std::io::Write;
use std::process::Command;

use serde_json::{Value, json};

use crate::files;
use crate::s3::S3;
use crate::server::{Api, Start, stored_uploads, until};
use crate::support::disk::{disk, fill, has_spool_open};

async fn submit(api: &Api) -> (u16, Value) {
    let response = api.try_submit("a.stl", files::broken_box(), json!({"max_tier": 1, "pictures": false})).await;
    (response.status().as_u16(), response.json().await.expect("JSON"))
}

fn id(job: &Value) -> &str {
    job["id"].as_str().expect("an id")
}

#[tokio::test]
async fn a_full_disk_refuses_uploads_and_loses_no_accepted_job() {
    let data = tempfile::tempdir().expect("a folder");
    let start = Start::serve(data.path()).arg("--min-free-mib", "0").env("FAILPOINTS", "worker-claimed=1*sleep(1000)");
    let Some(program) = start.on_small_disk(24) else { return };
    let api = Api::new(&program);
    let (status, accepted) = submit(&api).await;
    assert_eq!(status, 202, "{accepted}");
    // The disk fills up when the worker is about to fetch the file.
    until("a worker has it", async || (api.job(id(&accepted)).await["status"] == "running").then_some(())).await;
    let disk = disk(&program, data.path());
    let filler = fill(&disk, 0);
    let (status, problem) = submit(&api).await;
    assert_eq!((status, &problem["code"]), (503, &json!("storage_full")), "{problem}");
    let response = api.try_submit("a.stl", files::broken_box(), json!({})).await;
    assert!(response.headers().contains_key("retry-after"));
    let ready = api.get("/readyz").send().await.expect("a response");
    assert_eq!(ready.status(), 503);
    let log = until("the attempt fails on the full disk", async || {
        let log = program.log();
        log.contains("No space left on device").then_some(log)
    })
    .await;
    assert!(!log.contains("panicked"), "{log}");
    let job = api.job(id(&accepted)).await;
    assert!(["running", "queued"].contains(&job["status"].as_str().expect("text")), "the job is not lost: {job}");
    fs::remove_file(filler).expect("removed");
    let job = api.finished(id(&accepted)).await;
    assert_eq!(job["outcome"], "repaired", "{job}");
    let (_, other) = submit(&api).await;
    assert_eq!(api.finished(id(&other)).await["outcome"], "repaired");
    let left = fs::read_dir(disk.join("files/uploads")).expect("a folder").count();
    assert_eq!(left, 2, "no file of a refused request is left");
}

#[tokio::test]
async fn an_upload_is_refused_when_the_disk_fills_up_during_it_with_a_folder_or_a_bucket() {
    for bucket in [None, Some(S3::start())] {
        let data = tempfile::tempdir().expect("a folder");
        let start = Start::serve(data.path()).arg("--min-free-mib", "0").env("MESHMEND_NO_WORKERS", "true");
        let start = if let Some(bucket) = &bucket { bucket.store_files_of(start) } else { start };
        let Some(program) = start.on_small_disk(24) else { return };
        let api = Api::new(&program);
        let disk = disk(&program, data.path());
        let begun = || match &bucket {
            None => stored_uploads(&disk) == 1,
            Some(_) => has_spool_open(&program),
        };
        let (sender, receiver) = tokio::sync::mpsc::channel::<Result<Vec<u8>, std::io::Error>>(1);
        let body = futures::stream::unfold(receiver, |mut r| async move { r.recv().await.map(|chunk| (chunk, r)) });
        let upload = tokio::spawn(api.post("/v1/jobs").body(reqwest::Body::wrap_stream(body)).send());
        sender.send(Ok(files::whole_box())).await.expect("the upload listens");
        until("the upload has begun", async || begun().then_some(())).await;
        let filler = fill(&disk, 0);
        sender.send(Ok(vec![0; 1 << 20])).await.expect("the upload listens");
        drop(sender);
        let response = upload.await.expect("no panic").expect("a response");
        let retry = response.headers().get("retry-after").cloned();
        let (status, problem): (_, Value) = (response.status(), response.json().await.expect("a problem"));
        assert_eq!((status.as_u16(), &problem["code"]), (503, &json!("storage_full")), "{problem}");
        assert!(
            retry.is_some() && problem["detail"].as_str().is_some_and(|detail| detail.contains("disk is full")),
            "{problem}"
        );
        fs::remove_file(filler).expect("removed");
        until("no part of the upload is left", async || (!begun()).then_some(())).await;
        assert_eq!(submit(&api).await.0, 202);
        assert_eq!(bucket.map_or(1, |bucket| bucket.files().len()), 1);
        assert!(!program.log().contains("panicked"), "{}", program.log());
    }
}

#[tokio::test]
async fn no_job_starts_if_the_disk_has_too_little_space() {
    let data = tempfile::tempdir().expect("a folder");
    let start = Start::serve(data.path()).arg("--min-free-mib", "8").arg("--workers", "1");
    let Some(program) = start.env("FAILPOINTS", "child-read=sleep(1500)").on_small_disk(24) else { return };
    let api = Api::new(&program);
    let ((_, running), (_, waiting)) = (submit(&api).await, submit(&api).await);
    let filler = fill(&disk(&program, data.path()), 4 << 20);
    assert_eq!(submit(&api).await.0, 503);
    assert_eq!(api.finished(id(&running)).await["outcome"], "repaired", "the running job finishes");
    until("the worker says why it waits", async || program.log().contains("too little free disk space").then_some(()))
        .await;
    assert_eq!(api.job(id(&waiting)).await["attempt"], 0);
    fs::remove_file(filler).expect("removed");
    assert_eq!(api.finished(id(&waiting)).await["outcome"], "repaired");
}

#[tokio::test]
async fn a_read_only_folder_is_reported_and_work_resumes_once_it_is_writable() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    assert_eq!(submit(&api).await.0, 202);
    let uploads = data.path().join("files/uploads");
    // File modes do not stop root from writing; the immutable flag does.
    let (seal, unseal): (&[&str], &[&str]) = match rustix::process::geteuid().is_root() {
        true => (&["chattr", "+i"], &["chattr", "-i"]),
        false => (&["chmod", "500"], &["chmod", "700"]),
    };
    let run = |command: &[&str]| {
        Command::new(command[0]).args(&command[1..]).arg(&uploads).output().is_ok_and(|done| done.status.success())
    };
    if !run(seal) {
        let _ = writeln!(std::io::stderr(), "SKIPPED: this file system knows no immutable folders");
        return;
    }
    let (status, problem) = submit(&api).await;
    assert!(run(unseal));
    assert_eq!((status, &problem["code"]), (503, &json!("storage_full")), "{problem}");
    assert_eq!(submit(&api).await.0, 202);
}
