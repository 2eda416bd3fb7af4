//! `meshmend inspect`: the flags that choose what is searched for and where drawings go.

use serde_json::{Value, json};

use crate::files;
use crate::support::{Workspace, exit_code, shapes, stderr};

fn inspection(workspace: &Workspace, args: &[&str], env: &[(&str, &str)]) -> Value {
    let output = workspace.run_with(&[&["inspect", "--json"], args].concat(), env);
    let value: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    value["files"][0]["inspection"].clone()
}

fn text(workspace: &Workspace, args: &[&str]) -> String {
    String::from_utf8(workspace.run(&[&["inspect"], args].concat()).stdout).expect("text")
}

#[test]
fn measures_for_printing_follow_the_unit_the_direction_and_the_printer() {
    let workspace = Workspace::new();
    workspace.put("box.stl", &shapes::stretched_box([2.0, 1.0, 1.0]));
    let found = text(
        &workspace,
        &["box.stl", "--unit", "in", "--up=-1,-1,0", "--overhang", "20", "--build-volume", "30,60,30"],
    );
    for line in [
        "  unit                        in, as set by --unit",
        "  size                        2 x 1 x 1 in = 50.8 x 25.4 x 25.4 mm",
        "  volume                      2 in^3",
        "  centre of mass              (1, 0.5, 0.5)",
        "  solids                      1",
        "  build volume                the model fits into 30 x 60 x 30 mm only when rotated",
    ] {
        assert!(found.lines().any(|l| l == line), "{line}: {found}");
    }
    assert!(found.contains("thinnest wall               1 in = 25.4 mm at ("), "{found}");
    let overhang = "  overhang                    beyond 20, 30, 45, 60 degrees: 3, 3, 0, 0 in^2 (30.0, 30.0, 0.0, 0.0 %); up is (";
    assert!(found.contains(overhang), "{found}");
    let upright = text(&workspace, &["box.stl"]);
    assert!(upright.contains("none beyond 30, 45, 60 degrees; up is (0, 0, 1)"), "{upright}");
    let small = text(&workspace, &["box.stl", "--unit", "foot", "--build-volume", "30,60,30"]);
    assert!(small.contains("the model does not fit into 30 x 60 x 30 mm"), "{small}");
    let env = [("MESHMEND_UNIT", "cm"), ("MESHMEND_UP", "0,3,0"), ("MESHMEND_BUILD_VOLUME", "20,10,10")];
    let print = &inspection(&workspace, &["box.stl"], &env)["print"];
    assert_eq!((&print["unit"], &print["unit_source"]), (&json!("cm"), &json!("declared")));
    assert_eq!((&print["overhang"]["up"], &print["fit"]["as_is"]), (&json!([0.0, 1.0, 0.0]), &json!(true)));
}

#[test]
fn tolerances_decide_what_counts_as_nothing() {
    let workspace = Workspace::new();
    workspace.put("thin.stl", &shapes::stretched_box([1.0, 1.0, 0.01]));
    let kinds = |args: &[&str], env: &[(&str, &str)]| {
        let found = inspection(&workspace, &[&["thin.stl"], args].concat(), env);
        let kinds =
            found["defects"].as_array().expect("a list").iter().map(|g| g["kind"].as_str().expect("a kind").to_owned());
        kinds.collect::<Vec<_>>()
    };
    assert_eq!(kinds(&[], &[]), [""; 0]);
    for given in ["0.02", "2%", "degenerate=0.02", "linear=1e-9,degenerate=2%"] {
        let found = kinds(&["--tolerance", given], &[]);
        assert!(found.contains(&"degenerate_face".to_owned()), "{given}: {found:?}");
    }
    for given in ["0.009", "0.5%", "sheet=0.02", "linear=1,degenerate=0,sheet=0,foldover_height=0"] {
        let found = kinds(&["--tolerance", given], &[]);
        assert!(!found.contains(&"degenerate_face".to_owned()), "{given}: {found:?}");
    }
    assert!(kinds(&["--tolerance", "sheet=0.02"], &[]).contains(&"sheet".to_owned()));
    let twice = kinds(&["--tolerance", "1", "--tolerance", "linear=0.001"], &[]);
    assert_eq!(twice, kinds(&[], &[("MESHMEND_TOLERANCE", "1,linear=0.001")]));
    assert_eq!(twice, [""; 0]);
}

#[test]
fn an_unusable_option_exits_with_code_two_and_a_remedy() {
    let workspace = Workspace::new();
    workspace.put("box.stl", &files::whole_box());
    for (given, expected) in [
        ("--unit=parsec", "mm, cm, in, ft, m"),
        ("--up=0,0,0", "three finite numbers that are not all 0"),
        ("--up=1,2", "expected three numbers"),
        ("--overhang=95", "must be from 0 to 90 degrees"),
        ("--overhang=-1", "must be from 0 to 90 degrees"),
        ("--overhang=nan", "must be from 0 to 90 degrees"),
        ("--build-volume=0,200,200", "three lengths above 0"),
        ("--build-volume=200", "expected three numbers"),
        ("--tolerance=thin", "a percentage of its diagonal"),
        ("--tolerance=slits=1", "`foldover_height`, `degenerate`, `slit`"),
        ("--tolerance=slit=-1", "a finite number, 0 or greater"),
        ("--tolerance=foldover_angle=1%", "an angle in radians"),
    ] {
        let output = workspace.run(&["inspect", "box.stl", given]);
        assert_eq!(exit_code(&output), 2, "{given}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected) && output.stdout.is_empty(), "{given}: {}", stderr(&output));
    }
}

#[test]
fn pictures_are_drawn_into_the_folder_and_of_several_files_each_has_its_own() {
    let workspace = Workspace::new();
    std::fs::create_dir(workspace.path().join("other")).expect("a folder");
    workspace.put("bad.stl", &files::open_box());
    workspace.put("other/bad.stl", &files::whole_box());
    let names = |folder: &str| {
        let entries = std::fs::read_dir(workspace.path().join(folder)).expect("a folder");
        let mut names: Vec<String> =
            entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("text")).collect();
        names.sort();
        names
    };
    assert_eq!(exit_code(&workspace.run(&["inspect", "bad.stl", "--pictures", "made/one"])), 1);
    assert_eq!(names("made/one"), ["defects.glb", "defects.ply", "defects.png"]);
    assert!(workspace.get("made/one/defects.png").starts_with(b"\x89PNG"));
    let env = [("MESHMEND_PICTURES", "two")];
    assert_eq!(exit_code(&workspace.run_with(&["inspect", "bad.stl", "other", "--json"], &env)), 1);
    let expected = ["bad-2-defects.glb", "bad-2-defects.ply", "bad-2-defects.png"];
    assert_eq!(names("two"), [&expected[..], &["bad-defects.glb", "bad-defects.ply", "bad-defects.png"]].concat());
    assert_eq!(workspace.get("two/bad-defects.png"), workspace.get("made/one/defects.png"));
    assert_ne!(workspace.get("two/bad-2-defects.png"), workspace.get("two/bad-defects.png"));
    assert_eq!(exit_code(&workspace.run(&["inspect", "bad.stl", "-a", "--pictures", "three"])), 1);
    assert!(!workspace.get("three/defects.ply").is_empty());
    assert_eq!(
        workspace.get("three/defects.ply"),
        workspace.get("made/one/defects.ply"),
        "`attributes` alone searches for no defects"
    );
    workspace.put("file", b"in the way");
    let output = workspace.run(&["inspect", "bad.stl", "--pictures", "file"]);
    assert!(exit_code(&output) == 3 && stderr(&output).contains("file"), "{}", stderr(&output));
}

/// A block of 20 mm with a square pit of 16 x 16 x 18 mm that opens upward.
const CUP: &str = "\
v 0 0 0\nv 20 0 0\nv 20 20 0\nv 0 20 0\nv 0 0 20\nv 20 0 20\nv 20 20 20\nv 0 20 20
v 2 2 2\nv 18 2 2\nv 18 18 2\nv 2 18 2\nv 2 2 20\nv 18 2 20\nv 18 18 20\nv 2 18 20
f 4 3 2 1\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8
f 5 6 14 13\nf 6 7 15 14\nf 7 8 16 15\nf 8 5 13 16
f 13 14 10 9\nf 14 15 11 10\nf 15 16 12 11\nf 16 13 9 12\nf 9 10 11 12
";

#[test]
fn a_hollow_that_holds_resin_is_named_for_resin_only() {
    let workspace = Workspace::new();
    workspace.put("cup.obj", CUP.as_bytes());
    let row = "  resin cup, as it stands     4608 mm^3; opening 256 mm^2; drains at (";
    let resin = text(&workspace, &["cup.obj", "--process", "sla-resin"]);
    assert!(resin.contains(row), "{resin}");
    assert!(!text(&workspace, &["cup.obj", "--process", "sls-pa12"]).contains("resin cup"));
    let repaired = workspace.run(&["repair", "cup.obj", "-o", "out.obj", "--process", "sla-resin"]);
    let sentence = "In this orientation, a hollow holds resin during the print: 4608 mm³.";
    assert!(stderr(&repaired).contains(sentence), "{}", stderr(&repaired));
}
