//! Jobs with the mode `analyze`: reports on one file or several.

use reqwest::multipart::{Form, Part};
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start, signal, stored_files, stored_uploads, until};

/// A form with these files, and these options at its end.
fn form(files: Vec<(&str, Vec<u8>)>, options: Value) -> Form {
    let part = |(name, bytes): (&str, Vec<u8>)| Part::bytes(bytes).file_name(name.to_owned());
    let form = files.into_iter().fold(Form::new(), |form, file| form.part("file", part(file)));
    form.text("options", options.to_string())
}

async fn submit(api: &Api, files: Vec<(&str, Vec<u8>)>, options: Value) -> (u16, Value) {
    let response = api.post("/v1/jobs").multipart(form(files, options)).send().await.expect("a response");
    (response.status().as_u16(), response.json().await.expect("JSON"))
}

/// Submits files, asserts that they are accepted, and returns the job's id.
async fn accepted(api: &Api, files: Vec<(&str, Vec<u8>)>, options: Value) -> String {
    let (status, job) = submit(api, files, options).await;
    assert_eq!(status, 202, "{job}");
    job["id"].as_str().expect("an id").to_owned()
}

fn analyze() -> Value {
    json!({"mode": "analyze"})
}

async fn nothing_is_left(api: &Api, data: &std::path::Path) {
    let list: Value = api.get("/v1/jobs").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!(list["jobs"].as_array().map(Vec::len), Some(0), "no refused request became a job");
    assert_eq!(stored_uploads(data), 0, "no file of a refused request is stored");
}

async fn full_report(api: &Api, id: &str) -> Value {
    api.finished(id).await;
    serde_json::from_slice(&api.artifact(id, "report-full.json").await).expect("JSON")
}

#[tokio::test]
async fn the_analysis_of_a_file_equals_what_a_repair_reports_of_its_input() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = accepted(&api, vec![("a.stl", files::open_box())], json!({"mode": "analyze", "places": 3})).await;
    let job = api.finished(&id).await;
    assert_eq!((job["status"].as_str(), job["outcome"].as_str()), (Some("succeeded"), Some("not_printable")), "{job}");
    assert_eq!((job["options"]["mode"].as_str(), job["options"]["places"].as_u64()), (Some("analyze"), Some(3)));
    assert_eq!(job["input"]["name"], "a.stl");
    assert!(job.get("inputs").is_none(), "one file is a list of one");
    let report = &job["report"];
    assert_eq!((report["mode"].as_str(), report["printable"].as_bool()), (Some("analyze"), Some(false)));
    assert!(report["version"].is_u64() && report["milliseconds"].is_f64() && report["engine"].is_string());
    let file = &report["files"][0];
    assert_eq!((file["name"].as_str(), file["dialect"].as_str()), (Some("a.stl"), Some("binary STL")));
    assert_eq!(file["sha256"], job["input"]["sha256"]);
    assert_eq!(file["inspection"]["boundary_edges"], 4);
    assert_eq!(
        job["artifacts"].as_object().expect("files").keys().collect::<Vec<_>>(),
        ["defects.glb", "defects.ply", "defects.png", "log.txt", "report-full.json", "report.json"]
    );
    assert_eq!(job["artifacts"]["report.json"]["filename"], "a-report.json");
    let stored: Value = serde_json::from_slice(&api.artifact(&id, "report.json").await).expect("JSON");
    assert_eq!(&stored, report);

    let repaired = accepted(&api, vec![("a.stl", files::open_box())], json!({"max_tier": 1})).await;
    let repaired = full_report(&api, &repaired).await;
    assert_eq!(repaired["mode"], "repair");
    let plain = accepted(&api, vec![("a.stl", files::open_box())], analyze()).await;
    let mut plain = full_report(&api, &plain).await;
    // A repair measures the walls only of its result, if the input is not printable.
    let print = plain["files"][0]["inspection"]["print"].as_object_mut().expect("measures");
    assert!(print["thinnest_wall"].is_object());
    print.insert("thinnest_wall".to_owned(), Value::Null);
    print.insert("no_wall_reason".to_owned(), json!("not_printable"));
    assert_eq!(repaired["before"], plain["files"][0]["inspection"]);

    let whole = api.post("/v1/jobs?mode=analyze&level=basic&name=b.stl").body(files::whole_box());
    let whole: Value = whole.send().await.expect("a response").json().await.expect("a job");
    let whole = api.finished(whole["id"].as_str().expect("an id")).await;
    assert_eq!((whole["outcome"].as_str(), &whole["report"]["printable"]), (Some("undecided"), &Value::Null));
    assert_eq!(whole["report"]["files"][0]["inspection"]["level"], "basic");
    let whole = accepted(&api, vec![("b.stl", files::whole_box())], analyze()).await;
    assert_eq!(api.finished(&whole).await["outcome"], "printable");
}

#[tokio::test]
async fn several_files_are_analysed_in_their_order_and_deleted_together() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let sent = vec![("a.stl", files::whole_box()), ("b.stl", files::open_box()), ("a.stl", files::boxes_on_an_edge())];
    let id = accepted(&api, sent, analyze()).await;
    let job = api.finished(&id).await;
    assert_eq!(job["outcome"], "not_printable", "{job}");
    let inputs = job["inputs"].as_array().expect("several");
    assert_eq!((inputs.len(), &inputs[0]), (3, &job["input"]));
    let files = job["report"]["files"].as_array().expect("files");
    let summaries: Vec<(&str, bool)> = files
        .iter()
        .map(|file| (file["name"].as_str().expect("a name"), file["printable"].as_bool().expect("a verdict")))
        .collect();
    assert_eq!(summaries, [("a.stl", true), ("b.stl", false), ("a.stl", false)]);
    for (file, input) in files.iter().zip(inputs) {
        assert_eq!((&file["sha256"], &file["bytes"]), (&input["sha256"], &input["bytes"]));
    }
    assert_eq!(stored_files(data.path(), &id).len(), 6, "three uploads, both reports and the log");
    assert_eq!(job["artifacts"]["3-defects.png"]["filename"], "a-defects.png");
    assert!(api.artifact(&id, "3-defects.png").await.starts_with(b"\x89PNG"));
    assert_eq!(stored_files(data.path(), &id).len(), 15, "and three drawings of each");
    assert_eq!(api.delete(&format!("/v1/jobs/{id}")).send().await.expect("a response").status(), 204);
    assert!(stored_files(data.path(), &id).is_empty());
    assert_eq!(stored_uploads(data.path()), 0);
}

#[tokio::test]
async fn a_file_that_is_no_model_is_named_and_the_others_go_with_it() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let sent = vec![("a.stl", files::whole_box()), ("notes.txt", b"hello".to_vec()), ("empty.stl", Vec::new())];
    let (status, problem) = submit(&api, sent, analyze()).await;
    assert_eq!((status, problem["code"].as_str()), (415, Some("unsupported_model")), "{problem}");
    let errors = problem["errors"].as_array().expect("a list");
    assert_eq!((&errors[0]["field"], &errors[1]["field"]), (&json!("file[1]"), &json!("file[2]")));
    let errors: Vec<&str> = errors.iter().filter_map(|error| error["message"].as_str()).collect();
    assert!(errors[0].starts_with("File 2 of 3, 'notes.txt': "), "{errors:?}");
    assert!(errors[1].starts_with("File 3 of 3, 'empty.stl': ") && errors.len() == 2, "{errors:?}");
    nothing_is_left(&api, data.path()).await;

    // Only reading the whole file shows that it is broken.
    let broken = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n";
    let id = accepted(&api, vec![("a.stl", files::whole_box()), ("b.off", broken.into())], analyze()).await;
    let job = api.finished(&id).await;
    assert_eq!((job["status"].as_str(), job["problem"]["code"].as_str()), (Some("failed"), Some("bad_input")), "{job}");
    assert!(job["problem"]["detail"].as_str().expect("text").starts_with("file 2 of 2, 'b.off': "), "{job}");
    assert_eq!((&job["problem"]["file"], &job["problem"]["place"]["line"]), (&json!(1), &json!(6)));
    assert_eq!(job["attempt"], 1);
}

#[tokio::test]
async fn wrong_options_repairs_of_two_files_and_too_many_or_large_files_are_refused() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--max-files", "2").arg("--max-file-mib", "1").start();
    let api = Api::new(&program);
    let small = |name| (name, files::whole_box());
    for (options, named) in [
        (json!({"mode": "analyze", "output": "obj"}), "`output` is an option of mode `repair`"),
        (json!({"level": "full"}), "`level` is an option of mode `analyze`"),
        (json!({"mode": "analyze", "places": 5000}), "`places` must be a whole number from 0 to 1000; got 5000."),
        (json!({"mode": "analyse"}), "`mode` must be `repair` or `analyze`; got \"analyse\"."),
    ] {
        let (status, problem) = submit(&api, vec![small("a.stl")], options).await;
        assert_eq!((status, problem["code"].as_str()), (422, Some("invalid_options")), "{problem}");
        assert!(problem["detail"].as_str().expect("text").contains(named), "{problem}");
    }
    let query = api.post("/v1/jobs?mode=analyze&max_tier=2").body(files::whole_box()).send().await.expect("a response");
    assert_eq!(query.status(), 422);
    let (status, problem) = submit(&api, vec![small("a.stl"), small("b.stl")], json!({"mode": "repair"})).await;
    assert_eq!((status, problem["code"].as_str()), (400, Some("invalid_request")), "{problem}");
    assert!(problem["detail"].as_str().expect("text").contains("`analyze`"), "{problem}");
    let (status, problem) = submit(&api, vec![small("a.stl"), small("b.stl"), small("c.stl")], analyze()).await;
    assert_eq!((status, problem["code"].as_str()), (413, Some("too_many_files")), "{problem}");
    assert!(problem["detail"].as_str().expect("text").contains("the limit of 2 files"), "{problem}");
    // Each file is small enough, but not both together; the request does not declare its length.
    let half = || {
        Part::stream(reqwest::Body::wrap_stream(futures::stream::iter([Ok::<_, std::io::Error>(vec![
            0_u8;
            600 << 10
        ])])))
    };
    let both = Form::new().text("options", analyze().to_string()).part("file", half()).part("file", half());
    let response = api.post("/v1/jobs").multipart(both).send().await.expect("a response");
    assert_eq!(response.status(), 413);
    assert_eq!(response.json::<Value>().await.expect("a problem")["code"], "payload_too_large");
    nothing_is_left(&api, data.path()).await;
    let can: Value = api.get("/v1/capabilities").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!((&can["modes"], &can["limits"]["max_files"]), (&json!(["repair", "analyze"]), &json!(2)));
    assert_eq!(can["levels"], json!(["none", "basic", "full"]));
    assert_eq!(can["default_analyze_options"]["level"], "full");
}

#[tokio::test]
async fn a_client_that_hangs_up_between_two_files_leaves_nothing() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let (sender, receiver) = tokio::sync::mpsc::channel::<Result<Vec<u8>, std::io::Error>>(1);
    let body = futures::stream::unfold(receiver, |mut r| async move { r.recv().await.map(|chunk| (chunk, r)) });
    let form = form(vec![("a.stl", files::whole_box())], analyze())
        .part("file", Part::stream(reqwest::Body::wrap_stream(body)).file_name("b.stl"));
    let upload = tokio::spawn(api.post("/v1/jobs").multipart(form).send());
    sender.send(Ok(files::whole_box())).await.expect("the upload listens");
    let second = || {
        let folder = std::fs::read_dir(data.path().join("files/more")).ok()?.flatten().next()?;
        std::fs::read_dir(folder.path()).ok()?.next().map(drop)
    };
    until("the second file has begun", async || second()).await;
    assert_eq!(stored_uploads(data.path()), 1);
    upload.abort();
    until("both files are gone", async || (stored_uploads(data.path()) == 0).then_some(())).await;
    nothing_is_left(&api, data.path()).await;
}

#[tokio::test]
async fn canceling_an_analysis_ends_its_process_and_a_killed_process_is_run_again() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("FAILPOINTS", "child-inspect=sleep(600000)").start();
    let api = Api::new(&program);
    let two = || vec![("a.stl", files::whole_box()), ("b.stl", files::open_box())];
    let canceled = accepted(&api, two(), analyze()).await;
    api.wait_for_stage(&canceled, "inspect", None).await;
    let child = until("the child runs", async || program.job_children().first().copied()).await;
    let response = api.post(&format!("/v1/jobs/{canceled}/cancel")).send().await.expect("a response");
    assert_eq!(response.json::<Value>().await.expect("a job")["status"], "canceled");
    until("the child is gone", async || (!crate::server::is_alive(child)).then_some(())).await;

    let killed = accepted(&api, two(), analyze()).await;
    api.wait_for_stage(&killed, "inspect", None).await;
    signal(until("the child runs", async || program.job_children().first().copied()).await, "KILL");
    let job = api.finished(&killed).await;
    assert_eq!((job["status"].as_str(), job["attempt"].as_u64()), (Some("succeeded"), Some(2)), "{job}");
    assert_eq!(job["report"]["files"].as_array().map(Vec::len), Some(2));
    // Two uploads, both reports and the log. The first attempt's files are deleted a little later.
    until("the first attempt's files are gone", async || (stored_files(data.path(), &killed).len() == 5).then_some(()))
        .await;
}

#[tokio::test]
async fn an_analysis_that_takes_longer_than_its_deadline_says_so() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("FAILPOINTS", "child-read=sleep(1200)").start();
    let api = Api::new(&program);
    let slow = accepted(&api, vec![("a.stl", files::whole_box())], json!({"mode": "analyze", "deadline_s": 1})).await;
    let job = api.finished(&slow).await;
    assert_eq!((job["status"].as_str(), job["outcome"].as_str()), (Some("failed"), None), "{job}");
    assert_eq!(job["problem"]["code"], "deadline_exceeded");
    assert!(job["problem"]["detail"].as_str().expect("text").contains("deadline_s"), "{job}");
}
