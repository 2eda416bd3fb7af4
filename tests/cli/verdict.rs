//! The verdict of a repair on the command line: its text, files and exit codes.

use serde_json::Value;

use crate::files;
use crate::support::{Workspace, exit_code, stderr};

/// Files, each with its outcome when Blender is missing.
fn models() -> [(&'static str, Vec<u8>, &'static str); 4] {
    [
        ("sound.stl", files::whole_box(), "already_printable"),
        ("broken.stl", files::broken_box(), "repaired"),
        ("sheet.stl", files::open_sheet(), "unrepairable"),
        ("touching.stl", files::boxes_on_an_edge(), "unrepairable"),
    ]
}

#[test]
fn report_exit_code_and_inspection_of_the_result_agree() {
    for (name, model, outcome) in models() {
        for ending in ["stl", "3mf", "glb", "obj", "ply", "off", "mesh", "zip"] {
            let workspace = Workspace::new();
            workspace.put(name, &model);
            let out = format!("out.{ending}");
            let output = workspace.run(&["repair", name, "-o", &out, "--report", "r.json", "--max-tier", "1"]);
            let report: Value = serde_json::from_slice(&workspace.get("r.json")).expect("JSON");
            let verdict = &report["verdict"];
            assert_eq!(report["outcome"], outcome, "{name} as {ending}: {report:#}");
            assert_eq!(verdict["printable"], exit_code(&output) == 0, "{name} as {ending}: {verdict}");
            let inspected = workspace.run(&["inspect", &out]);
            assert_eq!(verdict["passes"], exit_code(&inspected) == 0, "{name} as {ending}: {verdict}");
            let file = if outcome == "unrepairable" { "original" } else { "model" };
            assert_eq!(verdict["file"], file, "{name} as {ending}");
            let proven = verdict["proven"].as_array().expect("a list");
            assert_eq!(proven.len() == 4, verdict["passes"] == true, "{name} as {ending}: {verdict}");
        }
    }
}

#[test]
fn an_unprintable_result_that_must_be_printable_leaves_only_a_report() {
    let workspace = Workspace::new();
    workspace.put("sheet.stl", &files::open_sheet());
    let args =
        ["repair", "sheet.stl", "-o", "out.stl", "--report", "r.json", "--max-tier", "2", "--require", "printable"];
    let output = workspace.run(&args);
    assert_eq!(exit_code(&output), 5, "{}", stderr(&output));
    let last = stderr(&output).lines().last().expect("a line").to_owned();
    assert_eq!(last, "meshmend: out.stl was not written: the result does not meet `--require printable`");
    assert!(!workspace.path().join("out.stl").exists());
    let report: Value = serde_json::from_slice(&workspace.get("r.json")).expect("JSON");
    assert_eq!(report["verdict"]["file"], "none");
    assert_eq!((&report["verdict"]["printable"], &report["options"]["require"]), (&false.into(), &"printable".into()));
}

#[test]
fn a_printable_result_that_is_required_is_written_as_usual() {
    let workspace = Workspace::new();
    workspace.put("broken.stl", &files::broken_box());
    let output = workspace.run(&["repair", "broken.stl", "-o", "out.stl", "--max-tier", "1", "--require", "printable"]);
    assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
    assert!(workspace.path().join("out.stl").exists());
}

#[test]
fn an_unknown_requirement_is_refused_with_the_list_of_known_ones() {
    let workspace = Workspace::new();
    workspace.put("broken.stl", &files::broken_box());
    let output = workspace.run(&["repair", "broken.stl", "-o", "out.stl", "--require", "gold"]);
    assert_eq!(exit_code(&output), 2);
    assert!(stderr(&output).contains("[possible values: any, printable, print_ready]"), "{}", stderr(&output));
    let output = workspace.run(&["repair", "broken.stl", "-o", "out.stl", "--require", "print_ready"]);
    assert_eq!(exit_code(&output), 2);
    assert!(stderr(&output).contains("without `process`"), "{}", stderr(&output));
    assert!(!workspace.path().join("out.stl").exists());
}

#[test]
fn a_plate_that_must_be_print_ready_for_a_process_leaves_only_a_report() {
    let workspace = Workspace::new();
    let plate = files::BOX.map(|triangle| triangle.map(|[x, y, z]| [x * 6., y * 6., z * 0.2]));
    workspace.put("plate.stl", &files::stl(&plate));
    let args = ["repair", "plate.stl", "-o", "out.stl", "--report", "r.json", "--process", "fdm", "--unit", "mm"];
    let output = workspace.run(&[&args[..], &["--require", "print_ready"]].concat());
    assert_eq!(exit_code(&output), 5, "{}", stderr(&output));
    assert!(stderr(&output).contains("volume of separate solids"), "{}", stderr(&output));
    assert!(!workspace.path().join("out.stl").exists());
    let report: Value = serde_json::from_slice(&workspace.get("r.json")).expect("JSON");
    assert_eq!((&report["verdict"]["printable"], &report["verdict"]["print_ready"]), (&true.into(), &false.into()));
    let output = workspace.run(&["inspect", "plate.stl", "--process", "fdm"]);
    assert_eq!(exit_code(&output), 1, "{}", stderr(&output));
}
