//! `meshmend submit` and `meshmend watch`: the built program as a client of the built program.

mod submit;
mod trouble;
mod watch;

use std::path::PathBuf;
use std::process::{Output, Stdio};

use meshmend::format::{Limits, read};
use serde_json::Value;
use tempfile::TempDir;
use tokio::io::{AsyncBufReadExt, BufReader, Lines};
use tokio::process::{Child, ChildStderr, Command};

use crate::server::{Api, PATIENCE, signal};

/// Runs the program as a client in one folder, against one service.
struct Client {
    folder: TempDir,
    server: String,
}

impl Client {
    fn of(server: &str) -> Self {
        Self { folder: tempfile::tempdir().expect("a folder"), server: server.to_owned() }
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).expect("a file");
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The names of the folder's entries.
    fn names(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder.path()).expect("a folder");
        let mut names: Vec<_> =
            entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("text")).collect();
        names.sort();
        names
    }

    fn command(&self, args: &[&str], env: &[(&str, &str)]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
        command.args(args).args(["--server", &self.server]).envs(env.iter().copied()).current_dir(self.folder.path());
        command.stdin(Stdio::null()).kill_on_drop(true);
        command
    }

    async fn run(&self, args: &[&str]) -> Finished {
        self.run_with(args, &[]).await
    }

    async fn run_with(&self, args: &[&str], env: &[(&str, &str)]) -> Finished {
        let output = tokio::time::timeout(PATIENCE, self.command(args, env).output()).await;
        Finished::of(&output.expect("it ends").expect("it runs"))
    }

    /// Starts the program without waiting for its end.
    fn start(&self, args: &[&str]) -> Running {
        let mut command = self.command(args, &[]);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
        let lines = BufReader::new(child.stderr.take().expect("a pipe")).lines();
        Running { child, lines, heard: String::new() }
    }

    fn faces(&self, name: &str) -> usize {
        let model = std::fs::read(self.path(name)).expect("a file");
        read(&model, &Limits::default()).expect("a model").soup.faces.len()
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&std::fs::read(self.path(name)).expect("a file")).expect("JSON")
    }
}

/// A running client.
struct Running {
    child: Child,
    lines: Lines<BufReader<ChildStderr>>,
    heard: String,
}

impl Running {
    /// Waits until the client prints these words.
    async fn says(&mut self, words: &str) {
        while !self.heard.contains(words) {
            let line = tokio::time::timeout(PATIENCE, self.lines.next_line()).await.expect("it speaks in time");
            let line = line.expect("text").unwrap_or_else(|| panic!("it never says '{words}': {}", self.heard));
            self.heard.push_str(&line);
            self.heard.push('\n');
        }
    }

    fn interrupt(&self) {
        signal(self.child.id().expect("it runs"), "INT");
    }

    async fn ended(mut self) -> Finished {
        while let Some(line) = self.lines.next_line().await.expect("text") {
            self.heard.push_str(&line);
        }
        let output = self.child.wait_with_output().await.expect("it ends");
        Finished { err: self.heard, ..Finished::of(&output) }
    }
}

/// The exit code and output of a run.
#[derive(Debug)]
struct Finished {
    code: Option<i32>,
    out: String,
    err: String,
}

impl Finished {
    fn of(output: &Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self { code: output.status.code(), out: text(&output.stdout), err: text(&output.stderr) }
    }

    #[track_caller]
    fn ended_with(&self, code: i32) -> &Self {
        assert_eq!(self.code, Some(code), "{self:?}");
        self
    }

    #[track_caller]
    fn prints(&self, words: &str) -> &Self {
        assert!(self.err.contains(words), "'{words}' is not in {self:?}");
        self
    }
}

/// The ids of all jobs.
async fn jobs(api: &Api) -> Vec<String> {
    let list: Value = api.get("/v1/jobs").send().await.expect("a response").json().await.expect("JSON");
    let jobs = list["jobs"].as_array().expect("jobs").iter();
    jobs.map(|job| job["id"].as_str().expect("an id").to_owned()).collect()
}
