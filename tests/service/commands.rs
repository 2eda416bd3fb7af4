//! Commands for operators: lists of settings and keys, backups, and messages about unusable settings.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

use meshmend::jobs::{RetryPolicy, SqliteStore, SystemClock};
use serde_json::{Value, json};

use crate::files;
use crate::postgres::Postgres;
use crate::server::{Api, Start};

/// Runs the program with only these variables in its environment.
fn run(args: &[&str], variables: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_meshmend"));
    command.args(args).env_clear().envs(variables.iter().copied()).output().expect("the program runs")
}

/// Runs the program on a data folder, asserts that it succeeds, and returns its output.
fn printed(data: &Path, args: &[&str]) -> String {
    let output = run(args, &[("MESHMEND_DATA_DIR", &data.to_string_lossy())]);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text")
}

/// Runs the program, asserts that it fails, and returns its exit code and message.
fn refused(args: &[&str], variables: &[(&str, &str)]) -> (i32, String) {
    let output = run(args, variables);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code().unwrap_or_else(|| panic!("killed: {message}")), message)
}

/// Asserts that a message contains all of these parts in this order.
fn assert_says(message: &str, parts: &[&str]) {
    let mut rest = message;
    for part in parts {
        let at = rest.find(part).unwrap_or_else(|| panic!("'{part}' is not where it should be in: {message}"));
        rest = &rest[at + part.len()..];
    }
}

fn mode(path: &Path) -> u32 {
    path.metadata().expect("it is there").permissions().mode() & 0o777
}

#[test]
fn an_unusable_setting_is_reported_with_its_name_and_a_remedy() {
    let (code, message) = refused(&["serve", "--workers", "0"], &[]);
    assert_eq!(code, 2);
    assert_says(&message, &["--workers", "at least 1", "--no-workers"]);
    let (code, message) = refused(&["serve", "--listen", "nohost.invalid:80"], &[("MESHMEND_DATA_DIR", &temporary())]);
    assert_eq!(code, 2, "{message}");
    assert_says(&message, &["--listen nohost.invalid:80", "cannot be resolved", "Use an address"]);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address").to_string();
    let (code, message) = refused(&["serve", "--listen", &address], &[("MESHMEND_DATA_DIR", &temporary())]);
    assert_eq!(code, 3, "{message}");
    assert_says(&message, &["--listen", "cannot listen on", &address, "Another program uses this port"]);
    let (code, message) = refused(&["keys", "list", "--data-dir", "/proc/nowhere"], &[]);
    assert_eq!(code, 2, "{message}");
    assert_says(&message, &["--data-dir (MESHMEND_DATA_DIR) /proc/nowhere", "Use a folder"]);
}

/// The path of a new temporary folder, which is not deleted.
fn temporary() -> String {
    tempfile::tempdir().expect("a folder").keep().to_string_lossy().into_owned()
}

#[test]
fn a_variable_that_nothing_reads_is_refused_by_every_command_that_runs_the_service() {
    let data = tempfile::tempdir().expect("a folder");
    let folder = data.path().to_string_lossy().into_owned();
    let variables = [("MESHMEND_DATA_DIR", folder.as_str()), ("MESHMEND_WORKRES", "2")];
    let commands: [&[&str]; 7] = [
        &["serve", "--listen", "127.0.0.1:0"],
        &["work"],
        &["migrate"],
        &["keys", "list"],
        &["tenants", "list"],
        &["backup", "copy.db"],
        &["config"],
    ];
    for command in commands {
        let (code, message) = refused(command, &variables);
        assert_eq!(code, 2, "{command:?}: {message}");
        assert_says(&message, &["MESHMEND_WORKRES is set", "Did you mean MESHMEND_WORKERS?"]);
    }
    assert_eq!(std::fs::read_dir(data.path()).expect("a folder").count(), 0, "nothing was created");
}

#[tokio::test]
async fn listening_on_a_host_name_works_and_a_reachable_service_without_auth_warns() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve_on("localhost:0", data.path()).start();
    assert_eq!(Api::new(&program).get("/v1/jobs").send().await.expect("a response").status(), 200);
    assert_says(&program.log(), &["listening on", "no key required"]);
    assert!(!program.log().contains("--auth is open"), "only this machine reaches it");
    drop(program);
    let program = Start::serve_on("0.0.0.0:0", data.path()).arg("--auth", "open").start();
    let warned =
        crate::server::until("the program warns", async || program.log().contains("--auth is open").then_some(()));
    warned.await;
    assert_says(&program.log(), &["WARN", "--auth is open", "Use --auth keys"]);
}

#[tokio::test]
async fn only_the_service_s_user_can_read_its_data() {
    let above = tempfile::tempdir().expect("a folder");
    let data = above.path().join("data");
    let program = Start::serve(&data).start();
    Api::new(&program).submit(files::broken_box(), json!({"max_tier": 1})).await;
    assert_eq!(mode(&data), 0o700);
    for name in ["meshmend.db", "meshmend.db-wal", "meshmend.db-shm", "meshmend.lock"] {
        assert_eq!(mode(&data.join(name)), 0o600, "{name}");
    }
}

#[test]
fn an_unusable_database_is_reported_with_its_setting_and_the_database_s_message() {
    let data = tempfile::tempdir().expect("a folder");
    let folder = data.path().to_string_lossy().into_owned();
    let cluster = Postgres::start();
    let good = cluster.url();
    let cases = [
        (
            good.replace("meshmend@", "stranger:secret@"),
            2,
            ["rejects the user or the password", "\"stranger\"", "Correct"],
        ),
        (
            good.replace("/postgres?", "/nothing?"),
            2,
            ["no database of this name", "\"nothing\" does not exist", "createdb"],
        ),
        ("postgres://meshmend@127.0.0.1:1/jobs".into(), 3, ["no PostgreSQL server", "refused", "Check the host"]),
        ("host=db user=me".into(), 2, ["the address is invalid", ".", "postgres://user:password@host"]),
    ];
    for (url, expected, parts) in cases {
        let variables = [("MESHMEND_DATA_DIR", folder.as_str()), ("MESHMEND_DATABASE_URL", url.as_str())];
        for command in ["migrate", "serve"] {
            let (code, message) = refused(&[command], &variables);
            assert_eq!(code, expected, "{message}");
            assert_says(&message, &["--database-url (MESHMEND_DATABASE_URL)", parts[0], parts[1], parts[2]]);
            assert!(!message.contains("secret") && !message.contains("pool"), "{message}");
        }
    }
    std::fs::write(data.path().join("meshmend.db"), "this is no database".repeat(100)).expect("written");
    let (code, message) = refused(&["keys", "list", "--data-dir", &folder], &[]);
    assert_eq!(code, 2, "{message}");
    assert_says(
        &message,
        &["--data-dir (MESHMEND_DATA_DIR)", "meshmend.db", "not a SQLite database", "Replace it with a backup"],
    );
}

#[test]
fn keys_and_tenants_are_listed_as_a_table_or_as_json() {
    let data = tempfile::tempdir().expect("a folder");
    printed(
        data.path(),
        &["keys", "create", "--tenant", "shop", "--scopes", "jobs:write,jobs:read", "--label", "till"],
    );
    let listed = printed(data.path(), &["keys", "list", "--json"]);
    let key: Value = serde_json::from_str(&listed).expect("JSON");
    assert_eq!(key["scopes"], json!(["jobs:read", "jobs:write"]));
    let table = printed(data.path(), &["keys", "list"]);
    let [header, row] = table.lines().collect::<Vec<_>>().try_into().expect("two lines");
    for (name, value) in [("ID", key["id"].as_str().expect("an id")), ("TENANT", "shop"), ("LABEL", "till")] {
        assert_eq!(header.find(name), row.find(value), "{name} is above its values:\n{table}");
    }
    let set = |args: &[&str]| {
        let all = [&["tenants", "set", "shop", "--json"], args].concat();
        serde_json::from_str::<Value>(&printed(data.path(), &all)).expect("JSON")
    };
    set(&["--max-queued", "5", "--class", "gold"]);
    let changed = set(&["--max-running", "2"]);
    let all =
        json!({"tenant": "shop", "class": "gold", "max_queued": 5, "max_running": 2, "requests_per_minute": null});
    assert_eq!(changed, all, "settings that are not named stay");
    assert_eq!(set(&["--clear", "max-queued,class"])["max_queued"], Value::Null);
    let table = printed(data.path(), &["tenants", "list"]);
    let row = table.lines().nth(1).expect("a row").split_whitespace().collect::<Vec<_>>();
    assert_eq!(row, ["shop", "standard", "-", "2", "-"]);
    let variables = [("MESHMEND_DATA_DIR", data.path().to_str().expect("text"))];
    let (code, message) =
        refused(&["tenants", "set", "shop", "--clear", "max-queued", "--max-queued", "1"], &variables);
    assert_eq!(code, 2);
    assert_says(&message, &["--clear max-queued and --max-queued contradict each other", "Use only one of them"]);
}

#[tokio::test]
async fn a_database_is_copied_while_the_service_runs_and_no_file_is_overwritten() {
    let (data, backups) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let id = Api::new(&program).submit(files::broken_box(), json!({"max_tier": 1})).await;
    let folder = backups.path().to_string_lossy().into_owned();
    let copy = backups.path().join("meshmend.db");
    assert_eq!(printed(data.path(), &["backup", &folder]).trim(), copy.to_string_lossy());
    assert_eq!(mode(&copy), 0o600);
    let before = std::fs::read(&copy).expect("a copy");
    let variables = [("MESHMEND_DATA_DIR", data.path().to_str().expect("text"))];
    let (code, message) = refused(&["backup", &folder], &variables);
    assert_eq!(code, 2);
    assert_says(&message, &["meshmend.db", "exists and is not overwritten"]);
    assert_eq!(std::fs::read(&copy).expect("a copy"), before);
    let (_, message) = refused(&["backup", &folder], &[("MESHMEND_DATABASE_URL", "postgres://me:secret@db/jobs")]);
    assert_says(&message, &["PostgreSQL", "pg_dump"]);
    let (code, message) = refused(&["backup", "--data-dir", &folder[..1], "copy.db"], &[]);
    assert_eq!(code, 2);
    assert_says(&message, &["--data-dir", "there is no database"]);

    let clock = std::sync::Arc::new(SystemClock);
    let store = SqliteStore::open(&copy, clock, RetryPolicy::default()).await.expect("a database");
    let job = meshmend::jobs::JobStore::get(&store, id.parse().expect("an id")).await.expect("a response");
    assert_eq!(job.map(|job| job.id.to_string()), Some(id), "the copy has the latest writes");
}

#[test]
fn completions_know_the_commands_in_the_words_of_each_shell() {
    for (shell, word) in
        [("bash", "complete -F _meshmend"), ("zsh", "#compdef meshmend"), ("fish", "complete -c meshmend")]
    {
        let script = String::from_utf8(run(&["completions", shell], &[]).stdout).expect("text");
        assert!(script.contains(word) && script.contains("tenants"), "{shell}");
    }
}
