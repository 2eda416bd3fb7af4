//! Runs the built program and reads what it printed.

pub mod shapes;

use std::path::Path;
use std::process::{Command, Output};

use tempfile::TempDir;

/// An empty folder in which the program runs.
pub struct Workspace(TempDir);

impl Workspace {
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a folder"))
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    pub fn put(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.0.path().join(name), bytes).expect("a file");
    }

    pub fn get(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.0.path().join(name)).expect("a file")
    }

    pub fn run(&self, args: &[&str]) -> Output {
        self.run_with(args, &[])
    }

    pub fn run_with(&self, args: &[&str], env: &[(&str, &str)]) -> Output {
        self.command(args).envs(env.iter().copied()).output().expect("the program runs")
    }

    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
        // No test here needs Blender, and searching for it takes time.
        command.args(args).current_dir(self.0.path()).env("MESHMEND_BLENDER", "/nonexistent/blender");
        command
    }
}

/// The exit code.
pub fn exit_code(output: &Output) -> i32 {
    output.status.code().expect("not ended by a signal")
}

/// The text on standard error.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}
