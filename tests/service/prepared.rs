//! Child processes that wait for a job: started ahead, used once, replaced when they end, and gone with their worker.

use std::path::Path;

use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Program, Start, is_alive, signal, until};

/// Waits until as many children wait as the worker has slots, and returns them.
async fn waiting(program: &Program, slots: usize) -> Vec<u32> {
    until("a child waits for each slot", async || {
        let children = program.waiting_children();
        (children.len() == slots).then_some(children)
    })
    .await
}

fn scratch_folders(data: &Path) -> usize {
    let worker = std::fs::read_dir(data.join("scratch")).expect("a folder").flatten().next().expect("one worker");
    let entries = std::fs::read_dir(worker.path()).expect("a folder").flatten();
    entries.filter(|entry| entry.path().is_dir()).count()
}

#[tokio::test]
async fn a_job_runs_in_a_child_that_waited_and_each_child_runs_one_job() {
    let data = tempfile::tempdir().expect("a folder");
    let start = Start::serve(data.path()).arg("--workers", "1").env("FAILPOINTS", "child-inspect=sleep(1000)");
    let program = start.start();
    let api = Api::new(&program);
    let mut used = Vec::new();
    // Different options, since a repeated request gets the result of the first.
    for max_holes in 100..103 {
        let waited = waiting(&program, 1).await;
        let id = api.submit(files::broken_box(), json!({"max_tier": 1, "max_holes": max_holes})).await;
        let child = until("the job runs", async || program.job_children().first().copied()).await;
        assert_eq!(vec![child], waited);
        assert!(!used.contains(&child), "child {child} ran two jobs");
        used.push(child);
        assert_eq!(api.finished(&id).await["outcome"], "repaired");
        until("the child has ended", async || (!is_alive(child)).then_some(())).await;
    }
}

#[tokio::test]
async fn no_more_children_wait_than_the_worker_has_slots() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--workers", "2").start();
    let api = Api::new(&program);
    waiting(&program, 2).await;
    let mut jobs = Vec::new();
    for _ in 0..12 {
        jobs.push(api.submit(files::broken_box(), json!({"max_tier": 1})).await);
    }
    for id in jobs {
        assert_eq!(api.finished(&id).await["outcome"], "repaired");
        assert!(program.waiting_children().len() <= 2);
    }
    waiting(&program, 2).await;
    until("only folders of waiting children are left", async || (scratch_folders(data.path()) == 2).then_some(()))
        .await;
}

#[tokio::test]
async fn a_child_that_was_killed_while_it_waited_costs_no_job() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--workers", "1").start();
    let api = Api::new(&program);
    let child = waiting(&program, 1).await[0];
    signal(child, "KILL");
    until("the child has ended", async || (!is_alive(child)).then_some(())).await;
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    let job = api.finished(&id).await;
    assert_eq!((&job["outcome"], &job["attempt"]), (&json!("repaired"), &json!(1)), "{job}");
}

#[tokio::test]
async fn waiting_children_end_with_their_worker_however_it_ends() {
    let data = tempfile::tempdir().expect("a folder");
    let mut program = Start::serve(data.path()).arg("--workers", "2").start();
    let children = waiting(&program, 2).await;
    program.terminate();
    assert_eq!(program.wait(), Some(0));
    assert!(children.iter().all(|&child| !is_alive(child)), "a worker waits for its children");
    let program = Start::serve(data.path()).arg("--workers", "2").start();
    let children = waiting(&program, 2).await;
    program.kill();
    until("the children end", async || children.iter().all(|&child| !is_alive(child)).then_some(())).await;
}

#[tokio::test]
async fn a_waiting_child_is_in_its_sandbox_before_it_has_a_task() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--workers", "1").arg("--job-memory-mib", "3000").start();
    let child = waiting(&program, 1).await[0];
    let can: Value =
        Api::new(&program).get("/v1/capabilities").send().await.expect("a response").json().await.expect("JSON");
    let is_active = |wall: &str| can["sandbox"][wall]["enforced"] == true;
    let read = |name: &str| std::fs::read_to_string(format!("/proc/{child}/{name}")).unwrap_or_default();
    // The child enters the sandbox within milliseconds of its start.
    until("the memory is limited", async || {
        let limits = read("limits");
        let memory = limits.lines().find(|line| line.starts_with("Max address space"))?;
        memory.contains(&(3000_u64 << 20).to_string()).then_some(())
    })
    .await;
    if is_active("system_calls") {
        until("system calls are filtered", async || read("status").contains("Seccomp:\t2").then_some(())).await;
    }
    if is_active("network") && can["sandbox"]["network"]["mechanisms"].to_string().contains("namespace") {
        // Only root can read the link of a process in another user namespace.
        let namespace = |id: u32| std::fs::read_link(format!("/proc/{id}/ns/net")).ok();
        assert_ne!(namespace(child), namespace(std::process::id()));
    }
}

#[tokio::test]
async fn without_prepared_children_each_job_starts_its_own_child() {
    let data = tempfile::tempdir().expect("a folder");
    let start = Start::serve(data.path()).arg("--prepared-children", "false");
    let program = start.env("FAILPOINTS", "child-inspect=sleep(300)").start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    until("the job runs", async || program.job_children().first().copied()).await;
    assert_eq!(api.finished(&id).await["outcome"], "repaired");
    assert_eq!(program.waiting_children(), Vec::<u32>::new());
}
