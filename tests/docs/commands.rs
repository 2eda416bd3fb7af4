//! Every command and example in the documentation runs.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use meshmend::format::{Limits, read};

use crate::server::Start;
use crate::support::pages::{Page, all_pages, root};

/// The address of the service in examples.
const SERVICE: &str = "http://127.0.0.1:8080";
/// Kinds of code blocks that are only shown, not run.
const SHOWN: [&str; 4] = ["text", "html", "css", "http"];
/// Languages of example files. Other tests run the files, and tests/house compares them with the pages.
const PROGRAMS: [&str; 3] = ["python", "rust", "js"];
/// The page whose JavaScript snippets are fragments; tests/browser parses them and runs examples/shop.
const SNIPPETS: (&str, &str) = ("docs/widget.md", "js");
/// Programs that the tests lack or must not run.
const OF_OPERATORS: [&str; 16] = [
    "make",
    "docker",
    "kubectl",
    "helm",
    "systemctl",
    "install",
    "apt",
    "tar",
    "sha256sum",
    "psql",
    "pg_dump",
    "pg_restore",
    "aws",
    "pip",
    "npm",
    "cargo",
];

/// The commands of a page to run, as one script.
fn script(page: &Page) -> String {
    let blocks = page.blocks();
    let run = blocks.iter().filter(|block| block.kind == "sh");
    let lines: String = run.map(|block| block.code.clone()).collect();
    // The program is already built and on PATH.
    lines.replace("cargo build --release --features service\n", "").replace("./target/release/meshmend", "meshmend")
}

/// Runs the commands of a page in one folder against a new service, and returns what they print.
fn run(page: &Page, folder: &Path) -> String {
    let script = script(page);
    if script.is_empty() {
        return String::new();
    }
    let program = Start::serve(&folder.join("meshmend-data")).start();
    let built = Path::new(env!("CARGO_BIN_EXE_meshmend")).parent().unwrap().display().to_string();
    let path = format!("{built}:{}", std::env::var("PATH").unwrap());
    let mut bash = Command::new("bash");
    bash.args(["-euxo", "pipefail", "-c", &script.replace(SERVICE, &program.url)]);
    bash.current_dir(folder).env("PATH", path).env("MESHMEND_BLENDER", "/nonexistent/blender");
    bash.env("MESHMEND_SERVER", &program.url);
    let output = bash.output().expect("bash runs");
    let (printed, log) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{}:\n{printed}{log}", page.path);
    printed.into_owned()
}

#[test]
fn the_commands_of_every_page_run_as_pasted() {
    let mut ran = 0;
    for page in all_pages() {
        let folder = tempfile::tempdir().unwrap();
        let printed = run(&page, folder.path());
        ran += usize::from(!script(&page).is_empty());
        if page.path == "README.md" {
            assert!(printed.contains("\"outcome\":\"repaired\""), "{printed}");
            assert!(
                ["\"printable\":false", "\"printable\":true"].iter().all(|verdict| printed.contains(verdict)),
                "{printed}"
            );
            let model = std::fs::read(folder.path().join("repaired.stl")).unwrap();
            assert_eq!(read(&model, &Limits::default()).unwrap().soup.faces.len(), 12);
        }
    }
    assert!(ran >= 4, "{ran}");
}

#[test]
fn every_code_block_is_of_a_known_kind() {
    for page in all_pages() {
        for block in page.blocks() {
            match block.kind.as_str() {
                "sh" | "sh operator" => {}
                kind if SHOWN.contains(&kind) || (page.path.as_str(), kind) == SNIPPETS => {}
                kind if PROGRAMS.contains(&kind) => {
                    let named = format!(" -->\n```{kind}\n{}", block.code);
                    assert!(page.text.contains(&named), "{}: which file is this? {}", page.path, block.code);
                }
                "json" => drop(
                    serde_json::from_str::<serde_json::Value>(&block.code)
                        .unwrap_or_else(|error| panic!("{}: {error}: {}", page.path, block.code)),
                ),
                other => panic!("{}: nothing looks at blocks of the kind '{other}'", page.path),
            }
        }
    }
}

/// The lines of a script without comments, with continuations joined, and split at `|`, `&&` and `;`.
fn lines(code: &str) -> Vec<String> {
    let joined = code.replace("\\\n", " ");
    let lines = joined.lines().map(|line| line.split(" #").next().unwrap_or_default().trim());
    let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines
        .flat_map(|line| line.split(['|', ';']).flat_map(|part| part.split("&&")))
        .map(|part| part.trim().to_owned())
        .collect()
}

/// Checks that the program accepts a command line.
fn check_command(line: &str) -> Result<(), String> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
    let output = command.arg("config").args(line.split_whitespace()).env_clear().output().expect("it runs");
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
}

#[test]
fn commands_for_operators_name_existing_programs_targets_and_files() {
    let makefile = std::fs::read_to_string(root().join("Makefile")).unwrap();
    let mut seen = 0;
    for page in all_pages() {
        for block in page.blocks().into_iter().filter(|block| block.kind == "sh operator") {
            for line in lines(&block.code) {
                // Skips variables before the command and prefixes such as sudo.
                let words: Vec<_> =
                    line.split_whitespace().skip_while(|word| word.contains('=') || *word == "sudo").collect();
                let Some((program, arguments)) = words.split_first() else { continue };
                match *program {
                    "meshmend" => {
                        let line = arguments.join(" ");
                        check_command(&line).unwrap_or_else(|error| panic!("{}: {line}: {error}", page.path));
                    }
                    "make" => {
                        let target = format!("\n{}:", arguments[0]);
                        assert!(makefile.contains(&target), "{}: there is no target {}", page.path, arguments[0]);
                    }
                    known => assert!(OF_OPERATORS.contains(&known), "{}: what is '{known}'? {line}", page.path),
                }
                for path in words.iter().filter(|word| word.starts_with("deploy/") || word.starts_with("docker/")) {
                    assert!(root().join(path).exists(), "{}: there is no {path}", page.path);
                }
                seen += 1;
            }
        }
    }
    assert!(seen > 5, "{seen}");
}

#[test]
fn every_command_and_variable_within_the_text_is_one_of_the_programs() {
    let mut seen = 0;
    let known = settings();
    let style = std::fs::read_to_string(root().join("src/web/page/src/widget/widget.css")).unwrap();
    for page in all_pages() {
        for (at, before) in page.text.match_indices("`meshmend ") {
            let line = &page.text[at + before.len()..];
            let line = line[..line.find('`').expect("an end")].replace(" --help", "");
            check_command(&line).unwrap_or_else(|error| panic!("{}: {line}: {error}", page.path));
            seen += 1;
        }
        for (at, _) in page.text.match_indices("MESHMEND_") {
            let name: String = page.text[at..].chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '_').collect();
            assert!(name == "MESHMEND_" || known.contains(&name), "{}: nothing reads {name}", page.path);
            seen += 1;
        }
        for flag in flags(&page.text) {
            // CSS custom properties look like flags.
            let is_of_the_widget = flag.starts_with("--meshmend-") && style.contains(&flag);
            assert!(is_of_the_widget || known.contains(&flag), "{}: no command has {flag}", page.path);
            seen += 1;
        }
    }
    assert!(seen > 30, "{seen}");
}

/// The flags that a text names in backticks.
fn flags(text: &str) -> Vec<String> {
    let name = |rest: &str| rest.chars().take_while(|c| c.is_ascii_alphanumeric() || *c == '-').collect::<String>();
    text.match_indices("`--").map(|(at, _)| name(&text[at + 1..])).collect()
}

/// Every flag and variable that a command reads.
fn settings() -> BTreeSet<String> {
    let of = |verb: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
        command.args(["config", "--format", "json"]).args(verb.split(' ')).env_clear();
        let output = command.output().expect("it runs");
        let config: serde_json::Value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|_| panic!("{verb}: {}", String::from_utf8_lossy(&output.stderr)));
        let settings = config["settings"].as_array().expect("a list").clone();
        settings
            .iter()
            .flat_map(|setting| [&setting["variable"], &setting["flag"]])
            .filter_map(|name| Some(name.as_str()?.to_owned()))
            .collect::<Vec<_>>()
    };
    let verbs = [
        "serve",
        "work",
        "migrate",
        "config",
        "openapi",
        "repair x -o x.stl",
        "inspect x",
        "compare x y",
        "submit x",
        "watch",
        "keys create",
        "tenants set x",
        "profiles set x y",
    ];
    verbs.into_iter().flat_map(of).collect()
}
