//! `meshmend inspect`: its text, its JSON and its exit codes.

use serde_json::Value;

use crate::files;
use crate::support::{Workspace, exit_code, shapes, stderr};

fn text(output: std::process::Output) -> String {
    String::from_utf8(output.stdout).expect("text")
}

#[test]
fn inspect_reports_defects_as_text_and_as_json() {
    let workspace = Workspace::new();
    workspace.put("bad.stl", &files::open_box());
    workspace.put("good.stl", &files::whole_box());
    let text = workspace.run(&["inspect", "bad.stl"]);
    assert_eq!(exit_code(&text), 1);
    let lines = String::from_utf8(text.stdout).expect("text");
    for line in [
        "not printable: 1 hole (4 open edges), 2 edges between faces of opposite winding",
        "  boundaries                  1 of 4 edges",
        "  outward                     not measurable: not closed",
        "  1  hole               at (1, 0, 1), faces 3 5 7 9, length 4",
        "  check, level full           passes: the rules of this level allow boundaries and inconsistent orientation",
        "  unit                        mm, assumed; set --unit to change",
        "  volume                      0.666667 mm^3, unreliable: not a closed solid",
    ] {
        assert!(lines.lines().any(|l| l == line), "{lines}");
    }
    let json = workspace.run(&["inspect", "good.stl", "--json"]);
    assert_eq!(exit_code(&json), 0);
    let value: Value = serde_json::from_slice(&json.stdout).expect("JSON");
    assert_eq!((&value["version"], &value["set"]), (&Value::from(1), &Value::Null));
    let file = &value["files"][0];
    assert_eq!((&file["path"], &file["printable"]), (&Value::from("good.stl"), &Value::from(true)));
    assert_eq!(file["inspection"]["volume"]["value"], 1.0);
    assert_eq!(file["inspection"]["attributes"]["outward"], "yes");
    assert_eq!(file["inspection"]["statistics"]["edge_length"]["max"], 2f64.sqrt());
}

#[test]
fn inspect_takes_files_and_folders_in_order_and_exits_with_the_worst_code() {
    let workspace = Workspace::new();
    std::fs::create_dir(workspace.path().join("set")).expect("a folder");
    workspace.put("good.stl", &files::whole_box());
    workspace.put("set/b.stl", &files::open_box());
    workspace.put("set/a", &files::whole_box());
    workspace.put("set/notes.txt", b"these are no models");
    let paths = |args: &[&str]| {
        let output = workspace.run(args);
        let value: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let paths = value["files"].as_array().expect("a list").iter().map(|f| f["path"].as_str().expect("a path"));
        (exit_code(&output), paths.map(str::to_owned).collect::<Vec<_>>())
    };
    assert_eq!(
        paths(&["inspect", "good.stl", "set", "--json"]),
        (1, ["good.stl", "set/a", "set/b.stl"].map(str::to_owned).to_vec())
    );
    assert_eq!(paths(&["inspect", "good.stl", "good.stl", "--json"]).0, 0);
    workspace.put("set/c.ply", b"cut off");
    let (worst, named) = paths(&["inspect", "set", "--json"]);
    assert_eq!((worst, named.len(), named[2].as_str()), (2, 3, "set/c.ply"));
    std::fs::create_dir(workspace.path().join("empty")).expect("a folder");
    let output = workspace.run(&["inspect", "empty"]);
    assert_eq!(exit_code(&output), 2);
    assert!(stderr(&output).contains("this folder contains no models"), "{}", stderr(&output));
}

#[test]
fn inspect_has_an_equivalent_for_each_option_of_meshalyzer() {
    let workspace = Workspace::new();
    workspace.put("good.stl", &files::whole_box());
    workspace.put("bad.stl", &files::open_box());
    let text = |args: &[&str]| {
        let output = workspace.run(args);
        (exit_code(&output), String::from_utf8(output.stdout).expect("text"))
    };
    let (_, attributes) = text(&["inspect", "bad.stl", "-a"]);
    assert_eq!(workspace.run(&["inspect", "good.stl", "-a"]).status.code(), Some(0));
    assert_eq!(attributes.lines().count(), 5, "{attributes}");
    assert!(attributes.contains("consistent                  no: 2 edges"), "{attributes}");
    let (_, offenders) = text(&["inspect", "bad.stl", "-a", "-p"]);
    assert!(offenders.starts_with(&attributes) && offenders.contains("misoriented edges"), "{offenders}");
    let (bad, line) = text(&["inspect", "bad.stl", "-g", "2.1,0.1,0.5"]);
    assert!(bad == 1 && line.starts_with("0 bad.stl: not closed (boundary edges: 4), "), "{line}");
    let (_, words) = text(&["inspect", "bad.stl", "-g", "2,0.1,0.5", "-p"]);
    assert!(words.starts_with("bad.stl: mesh is NOT good\n  not closed"), "{words}");
    assert!(words.contains("largest aspect ratio 2 is not below 2"), "{words}");
    let (bad, together) = text(&["inspect", "good.stl", "bad.stl", "-g", "2.1,0.1,0.5"]);
    assert!(bad == 1 && together.lines().count() == 2, "{together}");
    for wrong in [["inspect", "good.stl", "-g", "1,2"], ["inspect", "good.stl", "-g", "1,2,x"]] {
        let output = workspace.run(&wrong);
        assert_eq!(exit_code(&output), 2);
        assert!(stderr(&output).contains("three numbers"), "{}", stderr(&output));
    }
    assert_eq!(workspace.run(&["inspect", "good.stl", "-a", "-g", "1,2,3"]).status.code(), Some(2));
}

#[test]
fn inspect_counts_as_closely_as_it_is_asked_to() {
    let workspace = Workspace::new();
    workspace.put("good.stl", &files::whole_box());
    for (args, level) in [
        (["--json"].as_slice(), "full"),
        (&["--json", "--level", "basic"], "basic"),
        (&["--json", "-a"], "none"),
        (&["--json", "-a", "-p"], "basic"),
    ] {
        let output = workspace.run(&[&["inspect", "good.stl"], args].concat());
        let value: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let inspection = &value["files"][0]["inspection"];
        assert_eq!((&inspection["level"], inspection["statistics"].is_null()), (&Value::from(level), level == "none"));
    }
}

#[test]
fn the_report_fits_on_a_screen_and_a_half_and_offenders_lists_every_place() {
    let workspace = Workspace::new();
    workspace.put("open.stl", &shapes::sphere_with_holes(30));
    let short = text(workspace.run(&["inspect", "open.stl", "--unit", "mm"]));
    assert!(short.lines().count() <= 75, "{} lines: {short}", short.lines().count());
    let holes = |text: &str| text.lines().filter(|line| line.contains(", length 0.")).count();
    assert!(short.lines().any(|line| line.starts_with("  30  holes  at (")), "{short}");
    assert_eq!((holes(&short), holes(&text(workspace.run(&["inspect", "open.stl", "-p"])))), (3, 30));
    let lengths: Vec<f64> = short
        .lines()
        .filter_map(|line| line.split_once(", length "))
        .map(|(_, length)| length.parse().expect("a length"))
        .collect();
    assert!(lengths.is_sorted_by(|a, b| a >= b), "{lengths:?}");
}

#[test]
fn skipped_searches_of_a_level_are_reported_and_never_fail_a_model() {
    let workspace = Workspace::new();
    workspace.put("good.stl", &files::whole_box());
    let basic = text(workspace.run(&["inspect", "good.stl", "--level", "basic"]));
    assert!(basic.contains("printability unknown: self-intersections not checked"), "{basic}");
    assert!(basic.contains("  not checked at this level: self-intersections, slits, cracks, T-junctions,"), "{basic}");
    let json = workspace.run(&["inspect", "good.stl", "--level", "basic", "--json"]);
    assert_eq!(exit_code(&json), 0, "a defect that was not searched for does not fail the file");
    let value: Value = serde_json::from_slice(&json.stdout).expect("JSON");
    assert_eq!(value["files"][0]["printable"], Value::Null);
    let none = text(workspace.run(&["inspect", "good.stl", "--level", "none"]));
    assert!(!none.contains("Defects") && !none.contains("check, level"), "{none}");
    assert!(
        none.contains("faces without area, duplicate faces, faces with non-finite coordinates, inverted parts"),
        "{none}"
    );
    let full = text(workspace.run(&["inspect", "good.stl", "--unit", "in"]));
    assert!(full.starts_with("good.stl: binary STL\nprintable\n\nDefects: none (all 20 kinds checked)\n"), "{full}");
    assert!(full.contains("  check, level full           passes\n"), "{full}");
}

#[test]
fn overlapping_files_are_counted_and_separate_ones_measured() {
    let workspace = Workspace::new();
    workspace.put("a.stl", &files::whole_box());
    workspace.put("b.stl", &shapes::moved_box([0.5, 0.25, 0.25]));
    workspace.put("c.stl", &shapes::moved_box([4.0, 0.0, 0.0]));
    let apart = text(workspace.run(&["inspect", "a.stl", "c.stl", "--intersections", "--spacing"]));
    let (_, set) = apart.split_once("\nSet of 2 files\n").expect("a section");
    assert!(set.starts_with("  pairs of intersecting faces between files: 0\n"), "{set}");
    assert!(set.contains("    min 3   max "), "{set}");
    assert!(set.contains("    nearest: 3 from (1, ") && set.contains(" on c.stl, face "), "{set}");
    let all = text(workspace.run(&["inspect", "a.stl", "b.stl", "c.stl", "-i", "-s"]));
    let (_, set) = all.split_once("\nSet of 3 files\n").expect("a section");
    let lines: Vec<&str> = set.lines().collect();
    let total = lines[0].strip_prefix("  pairs of intersecting faces between files: ").expect("a count");
    assert!(total.parse::<u64>().is_ok_and(|total| total > 0), "{set}");
    assert_eq!(lines[1], format!("    a.stl and b.stl: {total}"));
    assert!(set.contains("nearest: 2.5 from (4, "), "{set}");
    let json: Value =
        serde_json::from_str(&text(workspace.run(&["inspect", "a.stl", "b.stl", "-i", "--json"]))).expect("JSON");
    assert_eq!(json["set"]["intersections"]["total"].to_string(), total);
    assert_eq!(json["set"]["spacing"], Value::Null);
    assert!(!text(workspace.run(&["inspect", "a.stl", "b.stl"])).contains("Set of"));
    let one = workspace.run(&["inspect", "a.stl", "-s"]);
    assert!(exit_code(&one) == 0 && stderr(&one).contains("at least two"), "{}", stderr(&one));
}

#[test]
fn distances_are_measured_between_the_good_files_of_a_folder() {
    let workspace = Workspace::new();
    std::fs::create_dir(workspace.path().join("set")).expect("a folder");
    workspace.put("set/a.stl", &files::whole_box());
    workspace.put("set/b.stl", &shapes::moved_box([4.0, 0.0, 0.0]));
    let alone = text(workspace.run(&["inspect", "set"]));
    let (_, set) = alone.split_once("\nSet of 2 files\n").expect("a section");
    assert!(set.contains("pairs of intersecting faces between files: 0\n") && set.contains("min 3   max "), "{set}");
    assert!(!text(workspace.run(&["inspect", "set", "-a"])).contains("Set of"), "-a tells the attributes only");
    let only = text(workspace.run(&["inspect", "set", "-i"]));
    assert!(!only.contains("distance from each vertex"), "{only}");
    workspace.put("set/c.stl", &files::open_box());
    let output = workspace.run(&["inspect", "set"]);
    let note = "distances between files are not measured because set/c.stl is not good: not closed";
    assert!(stderr(&output).contains(note), "{}", stderr(&output));
    assert!(String::from_utf8_lossy(&output.stdout).contains("pairs of intersecting faces between files"));
    let json: Value = serde_json::from_slice(&workspace.run(&["inspect", "set", "-s", "--json"]).stdout).expect("JSON");
    assert_eq!(json["not_good"][0]["path"], "set/c.stl");
    assert_eq!(json["set"], Value::Null);
}

#[test]
fn offenders_are_listed_by_the_numbers_of_the_file() {
    let workspace = Workspace::new();
    let mesh = "Vertex 10 0 0 0\nVertex 20 1 0 0\nVertex 30 0 1 0\nVertex 40 0 0 1\nVertex 50 9 9 9\n\
                Face 7 10 30 20\nFace 8 10 20 40\nFace 9 20 30 40\nFace 11 10 20 77\n";
    workspace.put("open.mesh", mesh.as_bytes());
    let output = workspace.run(&["inspect", "open.mesh", "-p"]);
    let text = String::from_utf8_lossy(&output.stdout);
    for line in [
        "  boundary edges (3): 10 30 of face 7, 40 10 of face 8, 30 40 of face 9\n",
        "  orphan vertices (1): 50\n",
        "  missing vertices (1): 77\n",
        "  faces that refer to missing vertices (1): 11\n",
    ] {
        assert!(text.contains(line), "{line}\n{text}");
    }
    assert!(text.contains("Offending elements, numbered as in the file"), "{text}");
}
