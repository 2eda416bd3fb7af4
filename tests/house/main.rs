//! The structure of the source: directions of imports, file sizes, and one place for each decision.
#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

mod imports;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Each module, and the modules it may import from. `ARCHITECTURE.md` describes them.
const MODULES: [(&str, &[&str]); 27] = [
    ("math", &[]),
    ("allocator", &[]),
    ("context", &[]),
    ("telemetry", &[]),
    ("tls", &[]),
    ("mesh", &["math"]),
    ("scene", &["math", "mesh"]),
    ("format", &["math", "mesh", "scene"]),
    ("inspect", &["math", "mesh", "context", "scene"]),
    ("render", &["math", "mesh", "context", "inspect"]),
    ("printing", &["math", "mesh", "scene", "context", "inspect", "arrange", "remesh"]),
    ("analyze", &["mesh", "context", "format", "inspect", "printing", "render", "scene"]),
    ("arrange", &["math", "mesh", "context"]),
    ("simplify", &["math", "mesh", "context"]),
    ("remesh", &["math", "mesh", "context"]),
    (
        "repair",
        &[
            "math", "mesh", "scene", "context", "format", "inspect", "render", "analyze", "arrange", "simplify",
            "remesh", "printing",
        ],
    ),
    ("options", &["inspect", "analyze", "repair"]),
    ("sandbox", &[]),
    ("blender", &["math", "mesh", "context", "repair", "sandbox"]),
    ("access", &[]),
    (
        "jobs",
        &["access", "context", "scene", "format", "inspect", "printing", "analyze", "repair", "options", "telemetry"],
    ),
    ("blobs", &["access", "jobs", "telemetry", "tls"]),
    ("webhooks", &["access", "jobs", "telemetry", "tls"]),
    ("web", &[]),
    ("manual", &["web"]),
    (
        "worker",
        &[
            "allocator",
            "format",
            "context",
            "inspect",
            "render",
            "analyze",
            "repair",
            "sandbox",
            "blender",
            "access",
            "jobs",
            "blobs",
            "telemetry",
        ],
    ),
    (
        "api",
        &[
            "access",
            "scene",
            "format",
            "context",
            "inspect",
            "printing",
            "analyze",
            "repair",
            "options",
            "sandbox",
            "jobs",
            "blobs",
            "telemetry",
            "manual",
            "web",
            "webhooks",
        ],
    ),
];

/// Modules of the engine, which may not use the crates below.
const ENGINE: [&str; 16] = [
    "allocator",
    "math",
    "context",
    "mesh",
    "scene",
    "format",
    "inspect",
    "render",
    "analyze",
    "arrange",
    "simplify",
    "remesh",
    "printing",
    "repair",
    "options",
    "blender",
];
const NOT_IN_THE_ENGINE: [&str; 5] = ["tokio", "axum", "sqlx", "object_store", "tower_http"];

const MAX_LINES_PER_FILE: usize = 450;

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    if folder.is_file() {
        return vec![folder.to_owned()];
    }
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let files = entries.flat_map(|path| if path.is_dir() { rust_files(&path) } else { vec![path] });
    files.filter(|path| path.extension().is_some_and(|e| e == "rs")).collect()
}

fn files_of(module: &str) -> Vec<PathBuf> {
    let folder = source().join(module);
    rust_files(&if folder.is_dir() { folder } else { folder.with_extension("rs") })
}

/// The names that follow `before` in a text.
fn names_after(text: &str, before: &str) -> BTreeSet<String> {
    let name = |rest: &str| rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    text.match_indices(before).map(|(at, found)| name(&text[at + found.len()..])).collect()
}

/// The text without comments.
fn code(path: &Path) -> String {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

#[test]
fn imports_run_one_way() {
    let known: BTreeSet<&str> = MODULES.iter().map(|(module, _)| *module).collect();
    let mut seen = 0;
    for (module, allowed) in MODULES {
        for file in files_of(module) {
            for import in names_after(&code(&file), "crate::") {
                if known.contains(import.as_str()) && import != module {
                    seen += 1;
                    assert!(allowed.contains(&import.as_str()), "{} imports {import}", file.display());
                }
            }
        }
    }
    assert!(seen > 50, "only {seen} imports were found: the test no longer works");
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let circles = imports::cycles(&source(), &rust_files(&source()));
    assert!(circles.is_empty(), "{circles:#?}");
}

#[test]
fn no_neighbours_in_a_folder_import_each_other_in_a_circle() {
    let circles = imports::cycles_of_neighbours(&source(), &rust_files(&source()));
    assert!(circles.is_empty(), "{circles:#?}");
}

fn write_in(folder: &Path, name: &str, text: &str) {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
}

#[test]
fn a_circle_of_two_folders_is_found_though_no_files_form_one() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| write_in(folder.path(), name, text);
    write("lib.rs", "mod a; mod b;");
    write("a.rs", "mod one; mod two; pub use one::One; pub use two::Two;");
    write("a/one.rs", "pub struct One(crate::b::B);");
    write("a/two.rs", "pub struct Two;");
    write("b/mod.rs", "mod three; pub struct B;");
    let found = || imports::cycles_of_neighbours(folder.path(), &rust_files(folder.path()));
    assert!(found().is_empty());
    write("b/three.rs", "use crate::a::Two; pub struct Three(Two);");
    assert!(imports::cycles(folder.path(), &rust_files(folder.path())).is_empty());
    assert_eq!(found().len(), 1);
    assert_eq!(found()[0].len(), 2, "{:?}", found());
}

#[test]
fn a_circle_through_a_re_export_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| write_in(folder.path(), name, text);
    write("lib.rs", "pub mod a; pub mod b;");
    write("a/mod.rs", "mod one; mod two; pub use one::One; pub use two::Two;");
    write("a/one.rs", "use super::Two; pub struct One(Option<Box<Two>>);");
    write("a/two.rs", "pub struct Two; #[cfg(test)] mod tests { use crate::a::One; }");
    write("b.rs", "use crate::a::{self, One}; pub fn f(_: One, _: a::Two) {}");
    assert!(imports::cycles(folder.path(), &rust_files(folder.path())).is_empty());
    write("a/two.rs", "pub struct Two(crate::a::One);");
    let circles = imports::cycles(folder.path(), &rust_files(folder.path()));
    assert_eq!(circles.len(), 1);
    assert_eq!(circles[0].len(), 2, "{circles:?}");
}

/// The folders of `tests/` that are each built into one test binary.
fn test_binaries() -> Vec<PathBuf> {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    let folders = std::fs::read_dir(tests).unwrap().map(|entry| entry.unwrap().path());
    folders.filter(|folder| folder.join("main.rs").exists()).collect()
}

fn has_tests(file: &Path) -> bool {
    code(file).lines().any(|line| {
        ["#[test]", "#[tokio::test", "on_each_store! {"].iter().any(|start| line.trim_start().starts_with(start))
    })
}

/// The imports of items that are defined in a file with tests.
fn imports_from_tests(binary: &Path) -> Vec<(PathBuf, PathBuf)> {
    imports::imports(binary, &rust_files(binary)).into_iter().filter(|(_, to)| has_tests(to)).collect()
}

#[test]
fn no_file_imports_from_a_file_with_tests() {
    let binaries = test_binaries();
    assert!(binaries.len() > 5, "only {} test binaries were found", binaries.len());
    for binary in binaries {
        let found = imports_from_tests(&binary);
        assert!(found.is_empty(), "move shared helpers to tests/support or {}/support: {found:#?}", binary.display());
    }
}

#[test]
fn every_test_name_has_fewer_than_80_characters() {
    for file in test_binaries().iter().flat_map(|folder| rust_files(folder)).chain(rust_files(&source())) {
        for name in names_after(&code(&file), "fn ") {
            assert!(name.len() < 80, "{}: {name} has {} characters", file.display(), name.len());
        }
    }
}

#[test]
fn an_import_from_a_file_with_tests_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("main.rs", "mod one; mod two; mod support;");
    write("support.rs", "pub fn helper() {}");
    write("one.rs", "pub fn helper() {}\n#[test]\nfn holds() { helper(); }");
    write("two.rs", "use crate::support::helper;\n#[test]\nfn holds() { helper(); }");
    assert_eq!(imports_from_tests(folder.path()), []);
    for text in
        ["use crate::one::helper;", "use super::one;\nfn f() { one::helper(); }", "fn f() { crate::one::helper() }"]
    {
        write("two.rs", text);
        let pair = ["two.rs", "one.rs"].map(|name| folder.path().join(name));
        assert_eq!(imports_from_tests(folder.path()), [pair.into()], "{text}");
    }
}

#[test]
fn every_module_is_on_the_list() {
    let lib = code(&source().join("lib.rs"));
    let modules: BTreeSet<String> = names_after(&lib, "pub mod ");
    let listed: BTreeSet<String> = MODULES.iter().map(|(module, _)| (*module).to_owned()).collect();
    assert_eq!(modules, listed);
}

#[test]
fn the_engine_does_not_use_crates_of_the_service() {
    for module in ENGINE {
        for file in files_of(module) {
            let code = code(&file);
            for name in NOT_IN_THE_ENGINE {
                assert!(!code.contains(&format!("{name}::")), "{} uses {name}", file.display());
            }
        }
    }
}

/// The names of all packages that the library or the program needs with these features.
fn packages(features: &str) -> BTreeSet<String> {
    let mut cargo = std::process::Command::new(env!("CARGO"));
    cargo.args(["tree", "--offline", "--locked", "--edges", "normal", "--prefix", "none", "--features", features]);
    let output = cargo.current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().filter_map(|line| line.split(' ').next()).map(|name| name.replace('-', "_")).collect()
}

#[test]
fn only_the_feature_service_brings_the_crates_of_the_service() {
    for (features, has_service, has_clap) in [("", false, false), ("cli", false, true), ("service", true, true)] {
        let packages = packages(features);
        assert!(packages.contains("rayon"), "'{features}' has no engine: {packages:?}");
        assert_eq!(packages.contains("clap"), has_clap, "'{features}': {packages:?}");
        for name in NOT_IN_THE_ENGINE {
            assert_eq!(packages.contains(name), has_service, "'{features}', {name}");
        }
    }
}

#[test]
fn metric_names_are_defined_in_one_place() {
    let mut used = 0;
    for file in rust_files(&source()) {
        let code = code(&file);
        for kind in ["counter", "gauge", "histogram"] {
            assert!(!code.contains(&format!("{kind}!(\"")), "{} names a metric itself", file.display());
            used += code.matches(&format!("metrics::{kind}!(telemetry::")).count();
        }
    }
    assert!(used > 15, "only {used} metrics were found: the test no longer works");
}

/// `repair::Verdict` and `JobOutcome::is_printable` say what an outcome means. Another file that distinguishes outcomes
/// could contradict them.
#[test]
fn the_meaning_of_an_outcome_is_decided_in_one_place() {
    // These map the outcomes of repairs to those of jobs, and decide which results may be reused.
    let may = ["jobs/report.rs", "api/submit.rs"];
    for file in rust_files(&source()) {
        let name = file.strip_prefix(source()).unwrap().to_string_lossy().into_owned();
        if name.starts_with("repair/") || may.contains(&name.as_str()) {
            continue;
        }
        for variant in ["AlreadyPrintable", "Repaired", "PartiallyRepaired", "Unrepairable", "NotPrintable"] {
            let found = code(&file).contains(&format!("Outcome::{variant}"));
            let is_text = name == "cli/remote/job.rs" && variant == "NotPrintable";
            assert!(!found || is_text, "{name} decides for itself what {variant} means");
        }
    }
}

#[test]
fn no_file_has_more_than_450_lines() {
    for file in rust_files(&source()) {
        let lines = std::fs::read_to_string(&file).unwrap().lines().count();
        assert!(lines <= MAX_LINES_PER_FILE, "{} has {lines} lines", file.display());
    }
}

/// Name and version of each package in a lock file.
fn locked(path: &str) -> BTreeSet<(String, String)> {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap();
    let value = |line: Option<&str>| line.unwrap().split('"').nth(1).unwrap().to_owned();
    let packages = text.split("[[package]]\n").skip(1).map(str::lines);
    packages.map(|mut lines| (value(lines.next()), value(lines.next()))).collect()
}

#[test]
fn the_python_package_has_the_versions_of_the_command_line() {
    let (program, package) = (locked("Cargo.lock"), locked("clients/python/Cargo.lock"));
    let names: BTreeSet<&String> = program.iter().map(|(name, _)| name).collect();
    let others: Vec<_> = package.difference(&program).filter(|(name, _)| names.contains(name)).collect();
    assert!(others.is_empty(), "Cargo.lock has other versions than clients/python/Cargo.lock: {others:?}");
    let version = env!("CARGO_PKG_VERSION").to_owned();
    assert!(package.contains(&("meshmend-python".to_owned(), version.clone())), "the package is not version {version}");
}

#[test]
fn code_in_the_documents_is_that_of_the_tested_examples() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("docs/clients.md")).unwrap();
    // A comment above each block names its file.
    let shown: Vec<(&str, &str)> = text
        .split("<!-- ")
        .skip(1)
        .map(|rest| {
            let (path, rest) = rest.split_once(" -->\n```").unwrap();
            (path, rest.split_once('\n').unwrap().1.split("```").next().unwrap())
        })
        .collect();
    assert!(shown.len() > 8, "only {} examples were found: the test no longer works", shown.len());
    for (path, code) in shown {
        let example = std::fs::read_to_string(root.join(path)).unwrap_or_else(|error| panic!("{path}: {error}"));
        assert_eq!(code, example, "docs/clients.md and {path} differ");
    }
}
