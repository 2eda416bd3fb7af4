//! Limits on time, memory, uploads, the queue and the disk.

use std::path::Path;
use std::time::{Duration, Instant};

use bytes::Bytes;
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Program, Start, is_alive, stored_uploads, until};
use crate::support::fake_blender::hanging_blender;

fn scratch_is_empty(data: &Path) -> bool {
    let worker = std::fs::read_dir(data.join("scratch")).expect("a folder").flatten().next().expect("one worker");
    let folders = std::fs::read_dir(worker.path()).expect("a folder").flatten();
    // A child that waits for a job has an empty folder.
    let files = |folder: &Path| std::fs::read_dir(folder).map_or(0, Iterator::count);
    folders.filter(|entry| entry.path().is_dir()).all(|entry| files(&entry.path()) == 0)
}

async fn still_serves(api: &Api, program: &Program, data: &Path) {
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    assert_eq!(api.finished(&id).await["outcome"], "repaired");
    until("no process is left", async || program.job_children().is_empty().then_some(())).await;
    until("no scratch files are left", async || scratch_is_empty(data).then_some(())).await;
}

#[tokio::test]
async fn a_model_that_needs_more_memory_than_a_job_may_have_fails_alone_and_says_so() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--job-memory-mib", "160").start();
    let api = Api::new(&program);
    let id = api.submit(files::large_open_sphere(1_500_000), json!({"max_tier": 1})).await;
    let job = api.finished(&id).await;
    assert_eq!(job["status"], "failed");
    assert_eq!(job["problem"]["code"], "out_of_memory", "{job}");
    assert_eq!(job["attempt"], 1, "a retry would reach the same limit");
    assert!(job["problem"]["detail"].as_str().expect("text").contains("160 MiB"));
    still_serves(&api, &program, data.path()).await;
}

#[tokio::test]
async fn a_repair_that_hangs_is_killed_at_its_deadline_with_all_its_processes() {
    let data = tempfile::tempdir().expect("a folder");
    // The pause is at a point where the engine does not check its deadline.
    let program = Start::serve(data.path())
        .arg("--deadline-grace-s", "0.5")
        .env("FAILPOINTS", "child-inspect=sleep(600000)")
        .start();
    let api = Api::new(&program);
    let started = Instant::now();
    let id = api.submit(files::broken_box(), json!({"deadline_s": 1})).await;
    let child = until("the child runs", async || program.job_children().first().copied()).await;
    let job = api.finished(&id).await;
    assert!(started.elapsed() < Duration::from_secs(20));
    assert_eq!(job["problem"]["code"], "deadline_exceeded", "{job}");
    assert!(!is_alive(child));
    let log = String::from_utf8(api.artifact(&id, "log.txt").await).expect("text");
    assert!(log.contains("killed at its deadline"), "{log}");
}

#[tokio::test]
async fn a_hanging_blender_uses_up_its_time_and_the_best_result_so_far_is_returned() {
    let data = tempfile::tempdir().expect("a folder");
    let blender = hanging_blender(data.path());
    let program = Start::serve(data.path()).blender(&blender).start();
    let api = Api::new(&program);
    let id = api.submit(files::boxes_on_an_edge(), json!({"preset": "fill-holes", "deadline_s": 2})).await;
    let job = api.finished(&id).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let outcome = job["outcome"].as_str().expect("an outcome");
    assert!(["partially_repaired", "unrepairable"].contains(&outcome), "{job}");
    let file = if outcome == "unrepairable" { "original" } else { "model" };
    assert!(!api.artifact(&id, file).await.is_empty());
    still_serves(&api, &program, data.path()).await;
}

#[tokio::test]
async fn a_child_that_is_killed_each_time_is_set_aside_with_its_reason() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("FAILPOINTS", "child-read=sleep(600000)").start();
    let api = Api::new(&program);
    // Later attempts run without the pause, so the model must be large enough to catch them running.
    let id = api.submit(files::large_open_sphere(400_000), json!({"max_tier": 1})).await;
    let mut killed = Vec::new();
    let job = until("the job is set aside", async || {
        for pid in program.job_children() {
            if is_alive(pid) && !killed.contains(&pid) {
                crate::server::signal(pid, "KILL");
                killed.push(pid);
            }
        }
        let job = api.job(&id).await;
        (!job["finished_at"].is_null()).then_some(job)
    })
    .await;
    assert_eq!(job["status"], "failed");
    assert_eq!(job["problem"]["code"], "crashed", "{job}");
    assert_eq!(killed.len(), 3, "there were three attempts");
    until("no process is left", async || program.job_children().is_empty().then_some(())).await;
}

#[tokio::test]
async fn many_large_uploads_at_once_leave_the_servers_memory_small() {
    const UPLOADS: usize = 32;
    const CHUNKS: usize = 50 << 4;
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    let header = Bytes::from([vec![0; 80], 1_000_000_u32.to_le_bytes().to_vec()].concat());
    let zeros = Bytes::from(vec![0; 64 << 10]);
    let uploads = (0..UPLOADS).map(|number| {
        let (api, header, zeros) = (api.clone(), header.clone(), zeros.clone());
        tokio::spawn(async move {
            let chunks = std::iter::once(header).chain(std::iter::repeat_n(zeros, CHUNKS)).map(Ok::<_, std::io::Error>);
            let body = reqwest::Body::wrap_stream(futures::stream::iter(chunks));
            let request = if number % 2 == 0 {
                api.post("/v1/jobs").body(body)
            } else {
                let form = reqwest::multipart::Form::new();
                api.post("/v1/jobs").multipart(form.part("file", reqwest::multipart::Part::stream(body)))
            };
            request.send().await.expect("a response").status()
        })
    });
    for upload in uploads.collect::<Vec<_>>() {
        assert_eq!(upload.await.expect("no panic"), 202);
    }
    let status = std::fs::read_to_string(format!("/proc/{}/status", program.pid())).expect("a process");
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("a line");
    let peak: u64 = peak.trim().trim_end_matches(" kB").parse().expect("a number");
    assert!(peak < 200 << 10, "{} MiB for {UPLOADS} uploads of 50 MB", peak >> 10);
}

#[tokio::test]
async fn a_full_queue_or_disk_refuses_jobs_before_reading_files_and_says_when_to_retry() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").arg("--max-queued", "1").start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({})).await;
    let full = api.try_submit("b.stl", files::broken_box(), json!({})).await;
    assert_eq!((full.status().as_u16(), &full.headers()["retry-after"]), (429, &"30".parse().expect("a value")));
    assert_eq!(full.json::<Value>().await.expect("a problem")["code"], "queue_full");
    assert_eq!(stored_uploads(data.path()), 1);
    api.post(&format!("/v1/jobs/{id}/cancel")).send().await.expect("a response");
    api.submit(files::broken_box(), json!({})).await;
    drop(program);

    let endless = (u64::MAX >> 21).to_string();
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").arg("--min-free-mib", endless).start();
    let api = Api::new(&program);
    let full = api.try_submit("b.stl", files::broken_box(), json!({})).await;
    assert_eq!((full.status().as_u16(), &full.headers()["retry-after"]), (503, &"30".parse().expect("a value")));
    assert_eq!(full.json::<Value>().await.expect("a problem")["code"], "storage_full");
    let ready = api.get("/readyz").send().await.expect("a response");
    assert_eq!(ready.status(), 503);
    let checks = ready.json::<Value>().await.expect("checks");
    assert!(checks["checks"]["disk"].as_str().expect("words").contains("disk full"), "{checks}");
    assert_eq!(api.job(&id).await["status"], "canceled", "existing jobs can be read");
}
