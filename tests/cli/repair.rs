//! `meshmend repair`: the files it writes, its exit codes and its settings.

use glam::DVec3;
use meshmend::format::{Format, Limits, read, write};
use serde_json::Value;

use crate::support::{Workspace, exit_code, stderr};
use crate::{files, meshes};

#[test]
fn repair_writes_the_model_and_the_report_and_exits_with_zero_if_printable() {
    let workspace = Workspace::new();
    workspace.put("in.stl", &files::broken_box());
    let output = workspace.run(&["repair", "in.stl", "-o", "out.stl", "--report", "r.json", "--max-tier", "1"]);
    assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
    assert_eq!(read(&workspace.get("out.stl"), &Limits::default()).expect("a model").soup.faces.len(), 12);
    let report: Value = serde_json::from_slice(&workspace.get("r.json")).expect("JSON");
    assert_eq!(report["outcome"], "repaired");
    assert_eq!(report["options"]["max_tier"], 1);
    assert!(output.stdout.is_empty(), "standard output stays empty");
}

#[test]
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn a_large_file_is_repaired_by_a_process_that_keeps_freed_memory() {
    let workspace = Workspace::new();
    let cube = write(&meshes::cube(DVec3::ZERO, 10.0, 1), Format::Obj).expect("a model");
    workspace.put("large.obj", &["# a comment\n".repeat(2 << 20).as_bytes(), &cube].concat());
    workspace.put("small.obj", &cube);
    let has_settings = |name: &str| {
        let args = ["repair", name, "-o", "out.stl", "--max-tier", "2"];
        let mut child = workspace.command(&args).env_remove("GLIBC_TUNABLES").spawn().expect("the program starts");
        let environment = format!("/proc/{}/environ", child.id());
        let mut has_settings = false;
        while child.try_wait().expect("a status").is_none() {
            let variables = std::fs::read(&environment).unwrap_or_default();
            has_settings |= variables.windows(14).any(|text| text == b"GLIBC_TUNABLES");
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert!(child.wait().expect("a status").success());
        has_settings
    };
    assert!(has_settings("large.obj"));
    assert!(!has_settings("small.obj"));
}

#[test]
fn a_printable_model_is_simplified_to_the_requested_face_count() {
    let workspace = Workspace::new();
    workspace.put("in.stl", &write(&meshes::cube(DVec3::ZERO, 10.0, 8), Format::Stl).expect("a model"));
    let faces = |name: &str| read(&workspace.get(name), &Limits::default()).expect("a model").soup.faces.len();
    let args = ["repair", "in.stl", "-o", "out.stl", "--max-tier", "2", "--report", "r.json"];
    for (asked, expected) in [
        (["--max-faces", "300"].as_slice(), 300),
        (&["--max-error", "0.001"], 12),
        (&["--max-faces", "5000"], 768),
        (&["--max-faces", "4"], 12),
    ] {
        let output = workspace.run(&[&args[..], asked].concat());
        assert_eq!((exit_code(&output), faces("out.stl")), (0, expected), "{asked:?} {}", stderr(&output));
    }
    let report: Value = serde_json::from_slice(&workspace.get("r.json")).expect("JSON");
    assert_eq!(report["options"]["max_faces"], 4);
    let last =
        report["steps"].as_array().expect("steps").iter().rfind(|step| step["operator"] == "simplify").expect("a step");
    assert!(last["note"].as_str().expect("a note").starts_with("12 faces remain; 4 were requested"), "{last}");
    let output = workspace.run_with(&args, &[("MESHMEND_MAX_FACES", "3")]);
    assert!(exit_code(&output) == 2 && stderr(&output).contains("max_faces"), "{}", stderr(&output));
}

#[test]
fn repair_draws_into_the_folder_that_is_named_and_only_then() {
    let workspace = Workspace::new();
    workspace.put("in.stl", &files::broken_box());
    let args = ["repair", "in.stl", "-o", "out.stl", "--max-tier", "1"];
    assert_eq!(exit_code(&workspace.run(&args)), 0);
    assert_eq!(std::fs::read_dir(workspace.path()).expect("a folder").count(), 2);
    let output = workspace.run(&[&args[..], &["--pictures", "made/here"]].concat());
    assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
    let mut names: Vec<_> = std::fs::read_dir(workspace.path().join("made/here"))
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
fn a_partially_repaired_model_is_written_and_exits_with_code_one() {
    let workspace = Workspace::new();
    workspace.put("in.stl", &files::boxes_on_an_edge());
    let output = workspace.run(&["repair", "in.stl", "-o", "out.stl", "--preset", "fill-holes"]);
    assert_eq!(exit_code(&output), 1, "{}", stderr(&output));
    assert!(!workspace.get("out.stl").is_empty());
    assert!(stderr(&output).contains("Blender") || stderr(&output).contains("printable"), "{}", stderr(&output));
}

#[test]
fn bad_input_exits_with_code_two_and_its_place_and_writes_nothing() {
    let workspace = Workspace::new();
    workspace.put("in.stl", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0,5 0 0\n");
    for (args, expected) in [
        (["repair", "in.stl", "-o", "out.stl"].as_slice(), "line 4"),
        (&["repair", "missing.stl", "-o", "out.stl"], "missing.stl"),
        (&["repair", "in.stl", "-o", "out.xyz"], ".mesh, .glb, .3mf or .zip"),
        (&["repair", "in.stl", "-o", "out.stl", "--max-tier", "7"], "max_tier"),
        (&["repair", "in.stl", "-o", "out.stl", "--preset", "magic"], "magic"),
        (&["inspect", "in.stl"], "line 4"),
    ] {
        let output = workspace.run(args);
        assert_eq!(exit_code(&output), 2, "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{args:?}: {}", stderr(&output));
    }
    assert!(!workspace.path().join("out.stl").exists());
}

#[test]
fn the_output_s_ending_is_its_format() {
    let workspace = Workspace::new();
    workspace.put("in.stl", &files::broken_box());
    for name in ["out.stl", "out.obj", "out.ply", "out.OFF", "out.mesh"] {
        let output = workspace.run(&["repair", "in.stl", "-o", name, "--max-tier", "1"]);
        assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
        let found = read(&workspace.get(name), &Limits::default()).expect("a model");
        assert_eq!(format!("{:?}", found.format).to_lowercase(), name.to_lowercase()[4..]);
        assert_eq!(found.soup.faces.len(), 12);
    }
}

#[test]
fn flags_can_be_set_by_the_environment_and_the_command_line_wins() {
    let workspace = Workspace::new();
    workspace.put("in.stl", &files::broken_box());
    let env = [("MESHMEND_MAX_TIER", "1"), ("MESHMEND_PRESET", "basic-cleanup"), ("MESHMEND_REPORT", "r.json")];
    workspace.run_with(&["repair", "in.stl", "-o", "out.stl", "--preset", "fill-holes"], &env);
    let report: Value = serde_json::from_slice(&workspace.get("r.json")).expect("JSON");
    assert_eq!(report["options"]["max_tier"], 1);
    assert_eq!(report["options"]["preset"], "fill-holes");
}

#[test]
fn repair_writes_alternatives_beside_the_result_and_names_them() {
    let workspace = Workspace::new();
    workspace.put("in.stl", &files::hollow_box());
    let args = ["repair", "in.stl", "-o", "out.stl", "--max-tier", "2", "--report", "r.json"];
    assert_eq!(exit_code(&workspace.run(&args)), 0);
    assert!(!workspace.path().join("out.voids-fill.stl").exists(), "only on request");
    let output = workspace.run(&[&args[..], &["--alternatives", "--pictures", "seen"]].concat());
    assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
    let faces = |name: &str| read(&workspace.get(name), &Limits::default()).expect("a model").soup.faces.len();
    assert_eq!((faces("out.stl"), faces("out.voids-fill.stl")), (24, 12));
    let line = "alternative: out.voids-fill.stl: Sealed cavities are solid. (8.000 cm³, 1 part)";
    assert!(stderr(&output).contains(line), "{}", stderr(&output));
    for name in ["after-voids-fill.png", "change-voids-fill.glb"] {
        assert!(workspace.path().join("seen").join(name).exists(), "{name}");
    }
    let report: Value = serde_json::from_slice(&workspace.get("r.json")).expect("JSON");
    assert_eq!(report["alternatives"]["offered"][1]["id"], "voids-fill");
}
