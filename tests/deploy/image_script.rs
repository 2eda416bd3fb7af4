//! scripts/image.sh with docker and with podman, which are fakes that record how they are called.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

use tempfile::TempDir;

use crate::support::source::{root, text};

/// A folder for PATH with fakes, and what they recorded.
struct Fakes(TempDir);

impl Fakes {
    /// Each fake appends its name and arguments to `calls`, keeps the Dockerfile of a build, and then runs its own script.
    fn new(fakes: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, script) in fakes {
            let path = folder.path().join(name);
            let kept = folder.path().display();
            let script = format!(
                "#!/bin/sh\necho \"{name} $*\" >> {kept}/calls\n\
                 for word in \"$@\"; do case $word in */Dockerfile) cp \"$word\" {kept}/built ;; esac; done\n{script}\n"
            );
            std::fs::write(&path, script).expect("written");
            std::fs::set_permissions(&path, PermissionsExt::from_mode(0o755)).expect("made executable");
        }
        Self(folder)
    }

    /// Runs the script for a target, and returns the calls with the temporary folder of the script written as WORK.
    fn run(&self, target: &str) -> Vec<String> {
        let path = format!("{}:{}", self.0.path().display(), std::env::var("PATH").expect("a PATH"));
        let mut script = Command::new("sh");
        script.arg(root().join("scripts/image.sh")).arg(target).env("PATH", path).env_remove("COMPILE");
        script.env("BINARY", "/bin/true").env("DIST", self.0.path()).env("TMPDIR", self.0.path());
        let output = script.output().expect("sh");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let calls = self.text("calls");
        let work = calls.split_whitespace().find_map(|word| word.strip_suffix("/Dockerfile")).expect("a Dockerfile");
        calls
            .replace(work, "WORK")
            .replace(&self.0.path().display().to_string(), "DIST")
            .lines()
            .map(str::to_owned)
            .collect()
    }

    fn text(&self, name: &str) -> String {
        std::fs::read_to_string(Path::new(self.0.path()).join(name)).expect("recorded")
    }
}

const BASE: &str = "docker.io/library/debian:bookworm-slim";

fn version() -> String {
    let manifest = text("Cargo.toml");
    manifest.split('"').nth(3).expect("a version").to_owned()
}

#[test]
fn docker_builds_the_image_from_the_finished_program() {
    let fakes = Fakes::new(&[("docker", ""), ("podman", "exit 1")]);
    let version = version();
    assert_eq!(
        fakes.run("full"),
        [
            "docker info".to_owned(),
            format!("docker image inspect {BASE}"),
            format!("docker build --quiet -f WORK/Dockerfile --target full -t meshmend:{version} WORK/context"),
            format!("docker save -o DIST/meshmend-{version}-image.tar meshmend:{version}"),
        ]
    );
    let built = fakes.text("built");
    let (first, rest) = built.split_once("FROM debian").expect("the other stages");
    assert_eq!(first, "FROM scratch AS build\nCOPY meshmend /src/target/release/meshmend\n");
    assert!(text("docker/Dockerfile").ends_with(rest), "{built}");
}

#[test]
fn podman_keeps_the_health_check_and_uses_a_base_made_here_without_a_registry() {
    let fakes = Fakes::new(&[
        ("docker", "exit 1"),
        ("podman", "[ \"$1 $2\" != \"image inspect\" ] && [ \"$1\" != pull ]"),
        ("mmdebstrap", ""),
    ]);
    let version = version();
    let calls = fakes.run("slim");
    let debstrap = calls.iter().position(|call| call.starts_with("mmdebstrap ")).expect("a base image");
    assert!(calls[debstrap].ends_with(" bookworm WORK/base.tar"), "{}", calls[debstrap]);
    let (before, after) = (&calls[..debstrap], &calls[debstrap + 1..]);
    assert_eq!(
        before,
        ["docker info".to_owned(), format!("podman image inspect {BASE}"), format!("podman pull --quiet {BASE}")]
    );
    let name = format!("meshmend:{version}-slim");
    assert_eq!(
        after,
        [
            format!("podman import WORK/base.tar {BASE}"),
            format!("podman build --quiet --format docker -f WORK/Dockerfile --target slim -t {name} WORK/context"),
            format!("podman save --format docker-archive -o DIST/meshmend-{version}-image-slim.tar {name}"),
        ]
    );
}
