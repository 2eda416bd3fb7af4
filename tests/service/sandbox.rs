//! The sandbox of jobs, tested by a hostile script in place of Blender.

use std::collections::BTreeMap;
use std::io::{ErrorKind, Write};
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Program, Start, signal, until};

/// Writes a script that stands in for Blender.
fn hostile_blender(folder: &Path, script: &str) -> PathBuf {
    let path = folder.join("blender");
    let script = format!("#!/bin/bash\ncase \"$*\" in *--version*) echo 'Blender 4.2.0'; exit 0;; esac\n{script}\n");
    std::fs::write(&path, script).expect("a file");
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).expect("permissions");
    path
}

async fn sandbox(api: &Api) -> Value {
    let can: Value = api.get("/v1/capabilities").send().await.expect("a response").json().await.expect("JSON");
    can["sandbox"].clone()
}

/// Whether a restriction of the sandbox is active. If not, prints that this machine does not test it.
fn is_active(sandbox: &Value, wall: &str) -> bool {
    let is_active = sandbox[wall]["enforced"].as_bool().expect("a boolean");
    if !is_active {
        let _ =
            writeln!(std::io::stderr(), "NOT TESTED: this machine has no wall '{wall}': {}", sandbox[wall]["detail"]);
    }
    is_active
}

async fn hostile_job(api: &Api) -> String {
    api.submit(files::boxes_on_an_edge(), json!({"preset": "blender-remesh", "voxel_size": 0.1, "deadline_s": 30}))
        .await
}

/// What a Blender under `mode` could do, by name, and the service's report on its sandbox.
async fn tried_under(mode: &str) -> (BTreeMap<String, bool>, Value) {
    let (data, tools) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.set_nonblocking(true).expect("it can be");
    let port = listener.local_addr().expect("an address").port();
    let data_dir = data.path().canonicalize().expect("it is there");
    let script = format!(
        "try() {{ name=$1; shift; if \"$@\" > /dev/null 2>&1; then echo \"could $name\"; else echo \"not $name\"; fi; }}
         data={data}
         try write-inside bash -c 'echo x > $HOME/file && cat $HOME/file'
         try run-programs sh -c true
         try read-proc cat /proc/self/stat
         try connect bash -c 'exec 3<>/dev/tcp/127.0.0.1/{port}'
         try read-database cat $data/meshmend.db
         try list-data ls $data
         try list-scratch ls $HOME/../..
         try read-passwords cat /etc/shadow
         try write-data bash -c \"echo x > $data/written\"
         try write-tmp bash -c 'echo x > /tmp/meshmend-hostile-$$ && rm /tmp/meshmend-hostile-$$'
         try cut-database bash -c \": >> $data/meshmend.db\"
         try close-data chmod 700 $data
         try link-out ln -s $data/meshmend.db $HOME/link
         try pipe mkfifo $HOME/pipe
         try signal bash -c \"kill -0 $(ps -o ppid= -p $PPID)\"
         try own-session setsid true
         try new-namespace unshare -Ur true
         try capabilities grep -E '^Cap(Eff|Prm|Inh|Amb):.*[1-9a-f]' /proc/self/status
         try more-files bash -c 'ulimit -n 100000'
         exit 1",
        data = data_dir.display(),
    );
    let blender = hostile_blender(tools.path(), &script);
    let program = Start::serve(data.path()).blender(&blender).arg("--sandbox", mode).start();
    let api = Api::new(&program);
    let sandbox = sandbox(&api).await;
    let id = hostile_job(&api).await;
    let job = api.finished(&id).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    let log = String::from_utf8(api.artifact(&id, "log.txt").await).expect("text");
    let said = log.lines().filter_map(|line| line.split_once("blender: ")?.1.split_once(' '));
    let mut tried: BTreeMap<String, bool> = said
        .filter(|(word, _)| ["could", "not"].contains(word))
        .map(|(word, name)| (name.to_owned(), word == "could"))
        .collect();
    assert!(tried.len() > 15, "{log}");
    let connected = listener.accept().map_or_else(|error| error.kind() != ErrorKind::WouldBlock, |_| true);
    assert_eq!(tried["connect"], connected, "{log}");
    tried.insert("written".to_owned(), data_dir.join("written").exists());
    (tried, sandbox)
}

#[tokio::test]
async fn attempts_of_a_hostile_blender_fail_in_the_sandbox_and_succeed_outside() {
    let (inside, sandbox) = tried_under("auto").await;
    let (outside, off) = tried_under("off").await;
    let failed_by = |wall: &str, names: &[&str]| {
        for name in names {
            assert!(outside[*name], "{name} fails without a sandbox too, so it proves nothing: {outside:?}");
            assert!(!off[wall]["enforced"].as_bool().expect("a boolean"), "{off}");
            assert!(!is_active(&sandbox, wall) || !inside[*name], "{name} worked: {inside:?}");
        }
    };
    failed_by("network", &["connect"]);
    failed_by(
        "files",
        &["read-database", "list-data", "list-scratch", "write-data", "written", "write-tmp", "cut-database"],
    );
    failed_by("files", &["link-out", "pipe"]);
    failed_by("system_calls", &["own-session", "close-data"]);
    failed_by("signals", &["signal"]);
    assert!(!is_active(&sandbox, "files") || !inside["read-passwords"], "{inside:?}");
    assert!(!is_active(&sandbox, "system_calls") || !inside["new-namespace"], "{inside:?}");
    assert!(!inside["capabilities"] && !inside["more-files"], "{inside:?}");
    assert!(inside["write-inside"] && inside["run-programs"] && inside["read-proc"], "{inside:?}");
}

#[tokio::test]
async fn capabilities_list_the_sandbox_and_the_limits_of_jobs() {
    let data = tempfile::tempdir().expect("a folder");
    let start = Start::serve(data.path()).arg("--job-memory-mib", "3000").arg("--job-scratch-mib", "70");
    let program = start.arg("--job-processes", "99").start();
    let walls = sandbox(&Api::new(&program)).await;
    assert_eq!(walls["mode"], "auto");
    assert_eq!((&walls["memory_bytes"], &walls["scratch_bytes"]), (&json!(3000_u64 << 20), &json!(70_u64 << 20)));
    assert_eq!(walls["max_processes"], 99);
    for wall in ["network", "files", "system_calls", "signals", "processes"] {
        let (enforced, mechanisms) =
            (walls[wall]["enforced"] == true, walls[wall]["mechanisms"].as_array().expect("a list"));
        assert_eq!(enforced, !mechanisms.is_empty(), "{walls}");
        assert!(enforced || walls[wall]["detail"].is_string(), "{walls}");
    }
    assert!(program.log().contains("sandbox protection enforced"), "{}", program.log());
    let data = tempfile::tempdir().expect("a folder");
    let elsewhere = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    assert!(sandbox(&Api::new(&elsewhere)).await.is_null(), "a process without workers does not know");
}

#[tokio::test]
async fn a_required_sandbox_that_cannot_restrict_files_prevents_the_start() {
    let data = tempfile::tempdir().expect("a folder");
    let serve = |more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
        command.args(["serve", "--listen", "127.0.0.1:0", "--blender", "/nonexistent/blender", "--sandbox", "require"]);
        command.arg("--data-dir").arg(data.path()).args(more).output().expect("it runs")
    };
    let open = data.path().display().to_string();
    let refused = serve(&["--sandbox-read", &open]);
    let said = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(3), "{said}");
    assert!(said.contains("the sandbox for jobs: "), "{said}");
    let probed = Start::serve(data.path()).start();
    let can = sandbox(&Api::new(&probed)).await;
    drop(probed);
    if is_active(&can, "network") && is_active(&can, "files") {
        assert!(said.contains("can be read"), "{said}");
        let program = Start::serve(data.path()).arg("--sandbox", "require").start();
        let api = Api::new(&program);
        assert_eq!(sandbox(&api).await["mode"], "require");
        let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
        assert_eq!(api.finished(&id).await["outcome"], "repaired");
    }
}

#[tokio::test]
async fn a_job_that_fills_its_folder_is_stopped_and_says_so() {
    let (data, tools) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    let fill = "mkdir $HOME/deep; for i in $(seq 12); do head -c 8388608 /dev/zero > $HOME/deep/$i; done; sleep 600";
    let blender = hostile_blender(tools.path(), fill);
    let program = Start::serve(data.path()).blender(&blender).arg("--job-scratch-mib", "64").start();
    let api = Api::new(&program);
    let id = hostile_job(&api).await;
    let job = api.finished(&id).await;
    assert_eq!(job["problem"]["code"], "file_limit", "{job}");
    assert_eq!(job["attempt"], 1, "the same limit would be met again");
    assert!(job["problem"]["detail"].as_str().is_some_and(|detail| detail.contains("64 MiB")), "{job}");
    until("no process is left", async || program.job_children().is_empty().then_some(())).await;
}

/// Processes with this word on their command line.
fn with_argument(word: &str) -> Vec<u32> {
    let ids = std::fs::read_dir("/proc")
        .expect("a folder")
        .flatten()
        .filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let has_it = |id: &u32| {
        let line = std::fs::read(format!("/proc/{id}/cmdline")).unwrap_or_default();
        line.split(|&byte| byte == 0).any(|argument| argument == word.as_bytes())
    };
    ids.filter(has_it).collect()
}

#[tokio::test]
async fn a_job_cannot_start_more_processes_than_its_limit() {
    let (data, tools) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    let word = format!("many-{}", std::process::id());
    // Bounded, in case nothing stops it.
    let many = format!("for i in $(seq 300); do sh -c 'sleep 600; true' {word} & done; echo all of them; wait");
    let blender = hostile_blender(tools.path(), &many);
    let program = Start::serve(data.path()).blender(&blender).arg("--job-processes", "60").start();
    let api = Api::new(&program);
    assert_eq!(sandbox(&api).await["processes"]["enforced"], true);
    let options = json!({"preset": "blender-remesh", "voxel_size": 0.1, "deadline_s": 8});
    let id = api.submit(files::boxes_on_an_edge(), options).await;
    let mut most = 0;
    let job = until("the job has ended", async || {
        most = most.max(with_argument(&word).len());
        let job = api.job(&id).await;
        (!job["finished_at"].is_null()).then_some(job)
    })
    .await;
    if sandbox(&api).await["processes"]["mechanisms"] == json!(["worker"]) {
        assert_eq!(job["problem"]["code"], "crashed", "{job}");
        assert!(
            job["problem"]["detail"]
                .as_str()
                .is_some_and(|detail| detail.contains("more processes than a job may have (60)")),
            "{job}"
        );
    } else {
        let log = String::from_utf8(api.artifact(&id, "log.txt").await).expect("text");
        assert!(log.contains("Resource temporarily unavailable"), "{log}");
        assert!((1..=60).contains(&most), "{most} at once");
    }
    until("no process is left", async || with_argument(&word).is_empty().then_some(())).await;
}

/// A job whose Blender hangs after it has started a process in a separate session, with `word` on its command line.
async fn stray(data: &Path, tools: &Path, word: &str) -> (Program, String) {
    let blender = hostile_blender(tools, &format!("setsid sh -c 'sleep 600; true' {word} & sleep 600"));
    let program = Start::serve(data).blender(&blender).arg("--sandbox", "off").start();
    let id = hostile_job(&Api::new(&program)).await;
    until("the stray process runs", async || (!with_argument(word).is_empty()).then_some(())).await;
    (program, id)
}

#[tokio::test]
async fn a_process_that_left_its_group_still_ends_with_its_job() {
    let (data, tools) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    let word = format!("stray-{}", std::process::id());
    let (program, id) = stray(data.path(), tools.path(), &word).await;
    Api::new(&program).post(&format!("/v1/jobs/{id}/cancel")).send().await.expect("a response");
    until("no stray process is left", async || with_argument(&word).is_empty().then_some(())).await;
    until("no zombie is left", async || program.job_children().is_empty().then_some(())).await;
}

#[tokio::test]
async fn a_process_that_left_its_group_ends_when_the_jobs_process_is_killed() {
    let (data, tools) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    let word = format!("stray-of-a-killed-{}", std::process::id());
    let (program, id) = stray(data.path(), tools.path(), &word).await;
    let api = Api::new(&program);
    let before = with_argument(&word);
    signal(program.job_children()[0], "KILL");
    until("no stray process is left", async || {
        before.iter().all(|id| !with_argument(&word).contains(id)).then_some(())
    })
    .await;
    api.delete(&format!("/v1/jobs/{id}")).send().await.expect("a response");
    until("none of the next attempt", async || with_argument(&word).is_empty().then_some(())).await;
}
