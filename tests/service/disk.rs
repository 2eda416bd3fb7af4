//! A disk that is full, or may not be written to: what was accepted is kept, the rest is refused, and all goes on when there is room.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Program, Start, until};

/// The data folder as the program sees it, which has mounted a small disk there.
fn disk(program: &Program, data: &Path) -> PathBuf {
    Path::new("/proc").join(program.pid().to_string()).join("root").join(data.strip_prefix("/").expect("absolute"))
}

/// Writes until nothing more fits but for `left` bytes.
fn fill(disk: &Path, left: u64) -> PathBuf {
    let filler = disk.join("filler");
    let free = || {
        let disk = rustix::fs::statvfs(disk).expect("a disk");
        disk.f_bavail * disk.f_frsize
    };
    fs::write(&filler, vec![0; usize::try_from(free().saturating_sub(left)).expect("small")]).expect("room");
    assert!(free() <= left, "{} bytes are free", free());
    filler
}

async fn submit(api: &Api) -> (u16, Value) {
    let answer = api.try_submit("a.stl", files::broken_box(), json!({"max_tier": 1, "pictures": false})).await;
    (answer.status().as_u16(), answer.json().await.expect("JSON"))
}

fn id(job: &Value) -> &str {
    job["id"].as_str().expect("an id")
}

#[tokio::test]
async fn a_full_disk_refuses_uploads_keeps_what_was_accepted_and_all_goes_on_when_there_is_room() {
    let data = tempfile::tempdir().expect("a folder");
    let start = Start::serve(data.path()).arg("--min-free-mib", "0").env("FAILPOINTS", "worker-claimed=1*sleep(1000)");
    let Some(program) = start.on_small_disk(24) else { return };
    let api = Api::new(&program);
    let (status, accepted) = submit(&api).await;
    assert_eq!(status, 202, "{accepted}");
    // The worker is about to fetch the file when the disk becomes full.
    until("a worker has it", async || (api.job(id(&accepted)).await["status"] == "running").then_some(())).await;
    let disk = disk(&program, data.path());
    let filler = fill(&disk, 0);
    let (status, problem) = submit(&api).await;
    assert_eq!((status, &problem["code"]), (503, &json!("storage_full")), "{problem}");
    let answer = api.try_submit("a.stl", files::broken_box(), json!({})).await;
    assert!(answer.headers().contains_key("retry-after"));
    let ready = api.get("/readyz").send().await.expect("an answer");
    assert_eq!(ready.status(), 503);
    let log = until("the attempt has met the full disk", async || {
        let log = program.log();
        log.contains("No space left on device").then_some(log)
    })
    .await;
    assert!(!log.contains("panicked"), "{log}");
    let job = api.job(id(&accepted)).await;
    assert!(["running", "queued"].contains(&job["status"].as_str().expect("text")), "it is not lost: {job}");
    fs::remove_file(filler).expect("removed");
    let job = api.finished(id(&accepted)).await;
    assert_eq!(job["outcome"], "repaired", "{job}");
    let (_, other) = submit(&api).await;
    assert_eq!(api.finished(id(&other)).await["outcome"], "repaired");
    let left = fs::read_dir(disk.join("files/uploads")).expect("a folder").count();
    assert_eq!(left, 2, "nothing is left of what was refused");
}

#[tokio::test]
async fn no_job_is_begun_where_the_disk_has_too_little_room() {
    let data = tempfile::tempdir().expect("a folder");
    let start = Start::serve(data.path()).arg("--min-free-mib", "8").arg("--workers", "1");
    let Some(program) = start.env("FAILPOINTS", "child-read=sleep(1500)").on_small_disk(24) else { return };
    let api = Api::new(&program);
    let ((_, running), (_, waiting)) = (submit(&api).await, submit(&api).await);
    let filler = fill(&disk(&program, data.path()), 4 << 20);
    assert_eq!(submit(&api).await.0, 503);
    assert_eq!(api.finished(id(&running)).await["outcome"], "repaired", "what has begun is finished");
    until("the worker says why it waits", async || program.log().contains("too little room on the disk").then_some(()))
        .await;
    assert_eq!(api.job(id(&waiting)).await["attempt"], 0);
    fs::remove_file(filler).expect("removed");
    assert_eq!(api.finished(id(&waiting)).await["outcome"], "repaired");
}

#[tokio::test]
async fn a_folder_that_may_not_be_written_to_is_told_and_got_over() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let api = Api::new(&program);
    assert_eq!(submit(&api).await.0, 202);
    let uploads = data.path().join("files/uploads");
    // Modes do not keep root from writing, the file system's own flag does.
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
