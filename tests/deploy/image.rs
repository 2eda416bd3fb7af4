//! docker/Dockerfile and .dockerignore: the files they name, the build, the user and the health check.

use std::process::Command;

use serde_json::Value;

use crate::server::{PATIENCE, Start};
use crate::support::image::Image;
use crate::support::program::settings;
use crate::support::source::{files, root, text};

/// The command that builds the program.
const BUILD: &str = "cargo build --release --locked --features service";

#[test]
fn all_files_that_the_build_copies_exist_and_no_others_are_sent() {
    let ignored = text(".dockerignore");
    let mut sent: Vec<_> = ignored.lines().filter_map(|line| line.strip_prefix('!')).collect();
    assert!(ignored.lines().any(|line| line == "*"));
    let image = Image::whole();
    let mut sources = image.sources();
    sources.sort_unstable();
    sent.sort_unstable();
    assert_eq!(sources, sent);
    for source in sources {
        assert!(root().join(source).exists(), "{source}");
    }
    // Files that the program includes at compile time are copied too.
    let mut seen = 0;
    for file in files("src").into_iter().filter(|file| file.extension().is_some_and(|ending| ending == "rs")) {
        let code = std::fs::read_to_string(&file).expect("text");
        let here = file.parent().expect("a folder");
        for (from, before) in [(here, "include_str!("), (here, "include_bytes!("), (root(), "migrate!(")] {
            for (at, _) in code.match_indices(before) {
                let path = code[at + before.len()..].split('"').nth(1).expect("a path");
                let path = from.join(path).canonicalize().expect("a file");
                assert!(
                    image.sources().iter().any(|source| path.starts_with(root().join(source))),
                    "{}",
                    path.display()
                );
                seen += 1;
            }
        }
    }
    assert!(seen >= 3, "{seen}");
}

#[test]
fn the_dependency_layer_is_a_package_that_cargo_accepts() {
    let folder = tempfile::tempdir().expect("a folder");
    let image = Image::stage("build");
    let first = image.all("COPY")[0].split_whitespace().filter(|word| word.starts_with("Cargo"));
    for file in first {
        std::fs::copy(root().join(file), folder.path().join(file)).expect("copied");
    }
    let layer = image.all("RUN").into_iter().find(|run| run.contains("benches")).expect("the layer");
    let layer = layer.replace(BUILD, "cargo metadata --format-version 1 --no-deps --locked --offline");
    assert!(layer.contains("cargo metadata"), "the layer runs another command than {BUILD}: {layer}");
    let ran = Command::new("bash").args(["-euo", "pipefail", "-c", &layer]).current_dir(folder.path()).output();
    let ran = ran.expect("bash");
    assert!(ran.status.success(), "{layer}: {}", String::from_utf8_lossy(&ran.stderr));
    let found: Value = serde_json::from_slice(&ran.stdout).expect("JSON");
    let targets = found["packages"][0]["targets"].as_array().expect("targets");
    let kinds = |kind: &str| targets.iter().filter(|target| target["kind"][0] == kind).count();
    assert_eq!((kinds("lib"), kinds("bin")), (1, 1));
    assert_eq!(kinds("bench"), text("Cargo.toml").matches("[[bench]]").count());
    assert_eq!(kinds("test"), text("Cargo.toml").matches("[[test]]").count());
}

#[test]
fn the_image_starts_the_program_that_it_has_as_a_user_that_is_not_root() {
    let image = Image::read();
    let installed = image.all("RUN").into_iter().find(|run| run.contains("apt-get install")).expect("packages");
    let (_, program) = image
        .all("COPY")
        .into_iter()
        .find(|arguments| arguments.starts_with("--from=build"))
        .expect("the program")
        .rsplit_once(' ')
        .expect("from and to");
    let mut line = image.list("ENTRYPOINT");
    assert!(installed.contains(&format!(" {} ", line[0])), "{} is installed", line[0]);
    assert_eq!(program, format!("/usr/local/bin/{}", line[2]));
    line.extend(image.list("CMD"));
    let settings = settings(&line[3..], &image.variables());
    assert_eq!(settings["MESHMEND_LISTEN"], "0.0.0.0:8080");
    let volumes = image.all("VOLUME");
    assert_eq!(volumes, [settings["MESHMEND_DATA_DIR"].as_str()]);
    let user = image.user();
    assert!(user.iter().all(|&id| id >= 1000), "{user:?}");
    assert!(installed.contains(&format!("install -d -o {} -g {}", user[0], user[1])), "it owns its folder");
    for port in image.all("EXPOSE")[0].split(' ') {
        assert!(settings.values().any(|value| value.ends_with(&format!(":{port}"))), "nothing listens on {port}");
    }
    let grace: f64 = settings["MESHMEND_SHUTDOWN_GRACE_S"].parse().expect("seconds");
    assert!(grace < 10.0, "docker stop kills after 10 s");
}

#[test]
fn the_image_without_blender_is_set_up_like_the_one_with_it() {
    let (slim, full) = (Image::stage("slim"), Image::read());
    let mut variables = slim.variables();
    // An image from scratch has no PATH.
    let path = variables.remove("PATH").expect("a PATH");
    assert_eq!(variables, full.variables());
    for instruction in ["USER", "LABEL", "VOLUME", "WORKDIR", "EXPOSE", "ENTRYPOINT", "CMD"] {
        assert_eq!(slim.all(instruction), full.all(instruction));
    }
    let files = Image::stage("slim-files");
    let files = files.all("RUN").join("\n");
    let check = slim.all("HEALTHCHECK")[0];
    let line: Vec<String> = serde_json::from_str(&check[check.find('[').expect("a list")..]).expect("a list");
    for program in [&slim.list("ENTRYPOINT")[0], &line[0]] {
        assert!(
            path.split(':').any(|folder| files.contains(&format!("/slim{folder}/{program}"))),
            "{program} is not there"
        );
    }
    let port = slim.variables()["MESHMEND_METRICS_LISTEN"].rsplit(':').next().expect("a port").to_owned();
    assert!(line.last().expect("an address").contains(&format!(":{port}/readyz")), "{line:?}");
}

#[test]
fn the_image_s_health_check_passes_only_where_the_service_is_ready() {
    let image = Image::read();
    let check = image.all("HEALTHCHECK")[0];
    let line: Vec<String> = serde_json::from_str(&check[check.find('[').expect("a list")..]).expect("a list");
    let listener = &image.variables()["MESHMEND_METRICS_LISTEN"];
    let port = listener.rsplit(':').next().expect("a port");
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::work(data.path()).arg("--metrics-listen", "127.0.0.1:0").start();
    let healthy = || {
        let here = line[1..].iter().map(|word| word.replace(&format!("http://127.0.0.1:{port}"), &program.probes));
        let mut check = Command::new(&line[0]);
        check.args(here).args(["--max-time", &PATIENCE.as_secs().to_string()]);
        check.output().expect("it runs").status.success()
    };
    assert!(line.last().expect("an address").contains(&format!(":{port}/")), "{line:?}");
    assert!(healthy());
    std::fs::remove_dir_all(data.path().join("scratch")).expect("removed");
    assert!(!healthy());
}
