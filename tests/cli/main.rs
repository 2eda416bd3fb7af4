//! The command line as an engineer uses it: the built program, files, exit codes.

#[path = "../support/files.rs"]
#[allow(dead_code, reason = "shared with the tests of the service")]
mod files;

#[path = "../support/meshes.rs"]
#[allow(dead_code, reason = "shared with the tests of the engine")]
mod meshes;

mod example;
mod inspect;
mod inspect_options;
mod repair_options;
mod shapes;
mod verdict;

use std::path::Path;
use std::process::{Command, Output};

use glam::DVec3;
use meshmend::format::{Format, Limits, read, write};
use serde_json::Value;
use tempfile::TempDir;

struct Desk(TempDir);

impl Desk {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("a folder"))
    }

    fn put(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.0.path().join(name), bytes).expect("a file");
    }

    fn get(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.0.path().join(name)).expect("a file")
    }

    fn run(&self, args: &[&str]) -> Output {
        self.run_with(args, &[])
    }

    fn run_with(&self, args: &[&str], env: &[(&str, &str)]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
        command.args(args).envs(env.iter().copied()).current_dir(self.0.path());
        // No test here needs Blender, and looking for it takes time.
        command.env("MESHMEND_BLENDER", "/nonexistent/blender").output().expect("the program runs")
    }
}

fn code(output: &Output) -> i32 {
    output.status.code().expect("it ended by itself")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn repair_writes_the_model_and_the_report_and_says_printable_by_code_zero() {
    let desk = Desk::new();
    desk.put("in.stl", &files::broken_box());
    let output = desk.run(&["repair", "in.stl", "-o", "out.stl", "--report", "r.json", "--max-tier", "1"]);
    assert_eq!(code(&output), 0, "{}", said(&output));
    assert_eq!(read(&desk.get("out.stl"), &Limits::default()).expect("a model").soup.faces.len(), 12);
    let report: Value = serde_json::from_slice(&desk.get("r.json")).expect("JSON");
    assert_eq!(report["outcome"], "repaired");
    assert_eq!(report["options"]["max_tier"], 1);
    assert!(output.stdout.is_empty(), "standard output stays free");
}

#[test]
fn a_printable_model_of_too_many_faces_comes_back_with_as_many_as_were_asked_for() {
    let desk = Desk::new();
    desk.put("in.stl", &write(&meshes::cube(DVec3::ZERO, 10.0, 8), Format::Stl).expect("a model"));
    let faces = |name: &str| read(&desk.get(name), &Limits::default()).expect("a model").soup.faces.len();
    let args = ["repair", "in.stl", "-o", "out.stl", "--max-tier", "2", "--report", "r.json"];
    for (asked, expected) in [
        (["--max-faces", "300"].as_slice(), 300),
        (&["--max-error", "0.001"], 12),
        (&["--max-faces", "5000"], 768),
        (&["--max-faces", "4"], 12),
    ] {
        let output = desk.run(&[&args[..], asked].concat());
        assert_eq!((code(&output), faces("out.stl")), (0, expected), "{asked:?} {}", said(&output));
    }
    let report: Value = serde_json::from_slice(&desk.get("r.json")).expect("JSON");
    assert_eq!(report["options"]["max_faces"], 4);
    let last =
        report["steps"].as_array().expect("steps").iter().rfind(|it| it["operator"] == "simplify").expect("a step");
    assert!(last["note"].as_str().expect("a note").starts_with("12 faces are left of 4"), "{last}");
    let output = desk.run_with(&args, &[("MESHMEND_MAX_FACES", "3")]);
    assert!(code(&output) == 2 && said(&output).contains("max_faces"), "{}", said(&output));
}

#[test]
fn repair_draws_into_the_folder_that_is_named_and_only_then() {
    let desk = Desk::new();
    desk.put("in.stl", &files::broken_box());
    let args = ["repair", "in.stl", "-o", "out.stl", "--max-tier", "1"];
    assert_eq!(code(&desk.run(&args)), 0);
    assert_eq!(std::fs::read_dir(desk.0.path()).expect("a folder").count(), 2);
    let output = desk.run(&[&args[..], &["--pictures", "made/here"]].concat());
    assert_eq!(code(&output), 0, "{}", said(&output));
    let mut names: Vec<_> = std::fs::read_dir(desk.0.path().join("made/here"))
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name().into_string().expect("text"))
        .collect();
    names.sort();
    assert_eq!(
        names,
        ["after.png", "before.png", "change.glb", "change.ply", "change.png", "defects.glb", "defects.ply"]
    );
}

#[test]
fn a_model_repaired_only_in_part_is_written_and_code_one() {
    let desk = Desk::new();
    desk.put("in.stl", &files::boxes_on_an_edge());
    let output = desk.run(&["repair", "in.stl", "-o", "out.stl", "--preset", "fill-holes"]);
    assert_eq!(code(&output), 1, "{}", said(&output));
    assert!(!desk.get("out.stl").is_empty());
    assert!(said(&output).contains("Blender") || said(&output).contains("printable"), "{}", said(&output));
}

#[test]
fn bad_input_is_code_two_with_the_place_and_nothing_is_written() {
    let desk = Desk::new();
    desk.put("in.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0,5 0 0\n");
    for (args, expected) in [
        (["repair", "in.stl", "-o", "out.stl"].as_slice(), "line 4"),
        (&["repair", "missing.stl", "-o", "out.stl"], "missing.stl"),
        (&["repair", "in.stl", "-o", "out.xyz"], ".mesh, .glb, .3mf or .zip"),
        (&["repair", "in.stl", "-o", "out.stl", "--max-tier", "7"], "max_tier"),
        (&["repair", "in.stl", "-o", "out.stl", "--preset", "magic"], "magic"),
        (&["inspect", "in.stl"], "line 4"),
    ] {
        let output = desk.run(args);
        assert_eq!(code(&output), 2, "{args:?}: {}", said(&output));
        assert!(said(&output).contains(expected), "{args:?}: {}", said(&output));
    }
    assert!(!desk.0.path().join("out.stl").exists());
}

#[test]
fn the_output_s_ending_is_its_format() {
    let desk = Desk::new();
    desk.put("in.stl", &files::broken_box());
    for name in ["out.stl", "out.obj", "out.ply", "out.OFF", "out.mesh"] {
        let output = desk.run(&["repair", "in.stl", "-o", name, "--max-tier", "1"]);
        assert_eq!(code(&output), 0, "{}", said(&output));
        let found = read(&desk.get(name), &Limits::default()).expect("a model");
        assert_eq!(format!("{:?}", found.format).to_lowercase(), name.to_lowercase()[4..]);
        assert_eq!(found.soup.faces.len(), 12);
    }
}

#[test]
fn compare_says_what_changed_and_whether_the_shape_was_kept_by_its_code() {
    let desk = Desk::new();
    desk.put("whole.stl", &files::whole_box());
    desk.put("broken.stl", &files::broken_box());
    let same = desk.run(&["compare", "whole.stl", "whole.stl"]);
    assert_eq!(code(&same), 0, "{}", said(&same));
    let lines = String::from_utf8(same.stdout).expect("text");
    assert!(lines.contains("faithful                yes") && lines.contains("farthest at"), "{lines}");
    let changed = desk.run(&["compare", "whole.stl", "broken.stl", "--json", "--samples", "500"]);
    assert_eq!(code(&changed), 1, "{}", said(&changed));
    let value: Value = serde_json::from_slice(&changed.stdout).expect("JSON");
    assert_eq!(value["comparison"]["faithful"], false);
    assert_eq!(value["comparison"]["inside"]["points"], 500);
    assert!(value["comparison"]["lost"]["distance"]["max"].as_f64() > Some(0.1));
    assert_eq!(code(&desk.run(&["compare", "whole.stl", "missing.stl"])), 2);
}

#[test]
fn flags_can_be_set_by_the_environment_and_the_command_line_wins() {
    let desk = Desk::new();
    desk.put("in.stl", &files::broken_box());
    let env = [("MESHMEND_MAX_TIER", "1"), ("MESHMEND_PRESET", "basic-cleanup"), ("MESHMEND_REPORT", "r.json")];
    desk.run_with(&["repair", "in.stl", "-o", "out.stl", "--preset", "fill-holes"], &env);
    let report: Value = serde_json::from_slice(&desk.get("r.json")).expect("JSON");
    assert_eq!(report["options"]["max_tier"], 1);
    assert_eq!(report["options"]["preset"], "fill-holes");
}

#[test]
fn the_kept_openapi_document_is_the_one_that_the_code_makes() {
    let kept = Path::new(env!("CARGO_MANIFEST_DIR")).join("openapi/openapi.json");
    let desk = Desk::new();
    let kept = kept.to_str().expect("a path");
    assert_eq!(code(&desk.run(&["openapi", "--check", kept])), 0, "run 'make openapi'");
    desk.put("stale.json", b"{}");
    assert_eq!(code(&desk.run(&["openapi", "--check", "stale.json"])), 1);
}

#[test]
fn migrate_makes_the_database_and_may_be_run_again() {
    let desk = Desk::new();
    for _ in 0..2 {
        let output = desk.run(&["migrate", "--data-dir", "data"]);
        assert_eq!(code(&output), 0, "{}", said(&output));
    }
    assert!(desk.0.path().join("data/meshmend.db").exists());
}

#[test]
fn a_port_in_use_is_said_plainly() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address").to_string();
    let desk = Desk::new();
    let output = desk.run(&["serve", "--data-dir", "data", "--listen", &address]);
    assert_eq!(code(&output), 3);
    assert!(said(&output).contains(&format!("listen on {address}")), "{}", said(&output));
}
