//! `meshmend submit`: files, exit codes and messages.

use serde_json::Value;

use super::{Client, jobs};
use crate::files;
use crate::server::{Api, Start};
use crate::support::access::{create_key, start_with_keys};

#[tokio::test]
async fn submit_writes_a_printable_model_the_report_and_pictures_and_prints_where() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let client = Client::of(&program.url);
    client.put("in.stl", &files::broken_box());
    let finished = client
        .run(&["submit", "in.stl", "-o", "out.obj", "--report", "r.json", "--max-tier", "1", "--without", "sew,stitch"])
        .await;
    finished.ended_with(0).prints("in.stl: submitted as job_").prints("printable");
    assert_eq!(finished.out, "out.obj\n");
    assert_eq!(client.faces("out.obj"), 12);
    assert_eq!(client.names(), ["in.stl", "out.obj", "r.json"], "no pictures, and no leftovers");
    let report = client.json("r.json");
    assert_eq!((&report["outcome"], &report["options"]["max_tier"]), (&"repaired".into(), &1.into()));
    assert_eq!(report["options"]["without"], serde_json::json!(["sew", "stitch"]));

    let finished =
        client.run(&["submit", "in.stl", "--output-dir", "made/here", "--pictures", "seen", "--quiet"]).await;
    finished.ended_with(0);
    assert_eq!((finished.out.as_str(), finished.err.as_str()), ("made/here/in-repaired.stl\n", ""));
    assert!(client.path("seen/in-before.png").exists() && client.path("seen/in-defects.glb").exists());
}

#[tokio::test]
async fn alternatives_are_listed_and_written_beside_the_result() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let client = Client::of(&program.url);
    client.put("in.stl", &files::hollow_box());
    let finished = client.run(&["submit", "in.stl", "-o", "out.stl", "--max-tier", "2", "--alternatives"]).await;
    finished.ended_with(0).prints("alternative: out.voids-fill.stl: Sealed cavities are solid. (");
    assert_eq!(finished.out, "out.stl\n");
    assert_eq!([client.faces("out.stl"), client.faces("out.voids-fill.stl")], [24, 12]);
    let finished = client.run(&["submit", "in.stl", "--output-dir", "made", "--max-tier", "2", "--alternatives"]).await;
    finished.ended_with(0).prints("alternative: made/in-voids-fill.stl: ");
    assert_eq!(client.faces("made/in-voids-fill.stl"), 12);
    let finished = client.run(&["submit", "in.stl", "-o", "alone.stl", "--max-tier", "2"]).await;
    finished.ended_with(0);
    assert!(!finished.err.contains("alternative"), "{}", finished.err);
}

#[tokio::test]
async fn without_a_model_nothing_is_written_and_the_exit_code_says_why() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let client = Client::of(&program.url);
    client.put("in.stl", &files::open_sheet());
    let args = ["submit", "in.stl", "-o", "out.stl", "--report", "r.json", "--max-tier", "2"];
    let finished = client.run(&args).await;
    finished.ended_with(1).prints("The input is returned unchanged").prints("the repair made no model");
    assert_eq!(finished.out, "");
    assert_eq!(client.names(), ["in.stl", "r.json"]);
    let finished = client.run(&[args.as_slice(), &["--force", "--require", "printable"]].concat()).await;
    finished.ended_with(5).prints("Not printable: ");
    assert_eq!(client.names(), ["in.stl", "r.json"]);
    assert_eq!(client.json("r.json")["verdict"]["file"], "none");
}

#[tokio::test]
async fn each_of_several_files_is_reported_and_the_exit_code_is_the_worst() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let client = Client::of(&program.url);
    let mut names: Vec<String> = (0..6).map(|number| format!("{number}.stl")).collect();
    for name in &names {
        client.put(name, &files::broken_box());
    }
    client.put("none.stl", b"no model at all");
    names.extend(["none.stl".to_owned(), "missing.stl".to_owned()]);
    let mut args = vec!["submit", "--output-dir", "out", "--json", "--max-tier", "1"];
    args.extend(names.iter().map(String::as_str));
    let finished = client.run(&args).await;
    finished.ended_with(2).prints("none.stl: Unsupported model format").prints("(unsupported_model, request ");
    finished.prints("missing.stl: No such file");
    let mut lines: Vec<Value> = finished.out.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    lines.sort_by_key(|line| line["name"].to_string());
    assert_eq!(lines.len(), 8, "{finished:?}");
    for (number, line) in lines[..6].iter().enumerate() {
        assert_eq!((&line["outcome"], &line["exit_code"]), (&"repaired".into(), &0.into()), "{line}");
        assert_eq!(line["files"]["model"], format!("out/{number}-repaired.stl"), "{line}");
        assert_eq!(client.faces(&format!("out/{number}-repaired.stl")), 12);
    }
    assert_eq!((&lines[6]["name"], &lines[6]["exit_code"]), (&"missing.stl".into(), &2.into()));
    assert_eq!(lines[7]["problem"]["code"], "unsupported_model");
}

#[tokio::test]
async fn existing_files_are_not_overwritten_without_force() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let client = Client::of(&program.url);
    client.put("in.stl", &files::broken_box());
    client.put("out.stl", b"mine");
    client.put("in-repaired.stl", b"mine too");
    let before = client.run(&["submit", "in.stl", "-o", "out.stl"]).await;
    before.ended_with(2).prints("out.stl: the file exists already; --force replaces it");
    assert!(jobs(&Api::new(&program)).await.is_empty(), "no job was submitted");
    // The client does not know in advance which name the service chooses.
    let after = client.run(&["submit", "in.stl", "--max-tier", "1"]).await;
    after.ended_with(2).prints("in-repaired.stl: the file exists already").prints("To continue: meshmend watch job_");
    assert_eq!(std::fs::read(client.path("out.stl")).expect("a file"), b"mine");
    assert_eq!(std::fs::read(client.path("in-repaired.stl")).expect("a file"), b"mine too");
    assert_eq!(client.names(), ["in-repaired.stl", "in.stl", "out.stl"]);
    client.run(&["submit", "in.stl", "-o", "out.stl", "--force", "--max-tier", "1"]).await.ended_with(0);
    assert_eq!(client.faces("out.stl"), 12);
}

#[tokio::test]
async fn impossible_requests_are_reported_before_anything_is_sent() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--max-file-mib", "1").start();
    let client = Client::of(&program.url);
    client.put("in.stl", &files::broken_box());
    client.put("large.stl", &vec![0; (1 << 20) + 1]);
    for (args, words) in [
        (&["in.stl", "-o", "missing/out.stl"][..], "missing/out.stl: No such file or directory"),
        (&["in.stl", "--output-dir", "in.stl/out"], "in.stl/out: "),
        (&["in.stl", "-o", "out.xyz"], "the output file must end in"),
        (&["in.stl", "-o", "out.stl", "--max-tier", "9"], "max_tier"),
        (&["in.stl", "in.stl", "-o", "out.stl"], "--output works only with a single file"),
        (&["in.stl", "made/../in.obj"], "would have the same name"),
        (&["large.stl"], "larger than 1 MiB, the limit of the service"),
        (&["."], ".: not a regular file"),
        (&["in.stl", "--server", "ftp://host"], "expected an address such as https://"),
        (&["in.stl", "--server", "http://me:secret@host"], "must not contain a user or password"),
    ] {
        let mut client = Client { folder: tempfile::tempdir().expect("a folder"), ..Client::of(&program.url) };
        client.put("in.stl", &files::broken_box());
        client.put("large.stl", &vec![0; (1 << 20) + 1]);
        if args.contains(&"--server") {
            client.server = args[2].to_owned();
            client.run(&["submit", args[0]]).await.ended_with(2).prints(words);
        } else {
            client.run(&[&["submit"], args].concat()).await.ended_with(2).prints(words);
        }
    }
    assert!(jobs(&Api::new(&program)).await.is_empty());
}

#[tokio::test]
async fn an_analysis_is_requested_with_the_api_s_options_and_returns_its_report() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let client = Client::of(&program.url);
    client.put("in.stl", &files::broken_box());
    client.put("fine.stl", &files::whole_box());
    let analyze = ["submit", "--mode", "analyze", "--option", "level=basic;places=3"];
    let finished = client.run(&[&analyze[..], &["in.stl", "-o", "r.json"]].concat()).await;
    finished.ended_with(1).prints("not printable");
    assert_eq!(finished.out, "r.json\n");
    let report = client.json("r.json");
    assert_eq!((&report["mode"], &report["options"]["places"]), (&"analyze".into(), &3.into()));
    let finished = client.run(&[&analyze[..], &["fine.stl"]].concat()).await;
    finished.ended_with(0);
    assert_eq!(finished.out, "fine-report-full.json\n");
    let finished = client.run(&[&analyze[..], &["in.stl", "--preset", "fill-holes"]].concat()).await;
    finished
        .ended_with(2)
        .prints("`preset` is an option of mode `repair`; this job's mode is `analyze`.")
        .prints("(invalid_options, request ");
}

#[tokio::test]
async fn a_key_comes_from_a_variable_or_a_file_and_without_one_the_message_says_how() {
    let data = tempfile::tempdir().expect("a folder");
    let program = start_with_keys(Start::serve(data.path()));
    let secret = create_key(data.path(), "shop", "jobs:read,jobs:write");
    let reader = create_key(data.path(), "shop", "jobs:read");
    let client = Client::of(&program.url);
    client.put("in.stl", &files::broken_box());
    client.put("key.txt", format!("{secret}\n").as_bytes());
    let submit = ["submit", "in.stl", "--no-wait"];
    let without = client.run(&submit).await;
    without
        .ended_with(4)
        .prints("This service requires an API key")
        .prints("MESHMEND_API_KEY")
        .prints("(unauthorized, request ");
    let wrong = client.run_with(&submit, &[("MESHMEND_API_KEY", "mm_key_guess")]).await;
    wrong.ended_with(4).prints("unknown, revoked or expired");
    client.run_with(&submit, &[("MESHMEND_API_KEY", &reader)]).await.ended_with(4).prints("jobs:write");
    client.run_with(&submit, &[("MESHMEND_API_KEY", &secret)]).await.ended_with(0);
    client.run(&[&submit[..], &["--api-key-file", "key.txt"]].concat()).await.ended_with(0);
    client
        .run(&[&submit[..], &["--api-key-file", "no.txt"]].concat())
        .await
        .ended_with(2)
        .prints("no.txt: No such file");
    let shown = client.run_with(&["config", "submit", "in.stl"], &[("MESHMEND_API_KEY", &secret)]).await;
    assert!(shown.ended_with(0).out.contains("--api-key ") && !shown.out.contains(&secret), "{shown:?}");
}
