//! Refused requests: the complete problem document of each error.

use reqwest::multipart::{Form, Part};
use reqwest::{Method, RequestBuilder};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::files;
use crate::server::{Api, Start, stored_uploads};

/// Sends a request and asserts that the response is this problem, with all of its members.
async fn problem(request: RequestBuilder, status: u16, code: &str) -> Value {
    let response = request.send().await.expect("a response");
    assert_eq!(response.headers()["content-type"], "application/problem+json", "{code}");
    let id = response.headers()["x-request-id"].to_str().expect("text").to_owned();
    assert_eq!(response.status(), status, "{code}");
    let problem: Value = response.json().await.expect("JSON");
    assert_eq!(problem["code"], code);
    assert_eq!(problem["status"], status);
    assert_eq!(problem["type"], format!("/problems/{code}"));
    assert_eq!(problem["request_id"], id);
    for field in ["title", "detail", "instance"] {
        assert!(problem[field].as_str().is_some_and(|text| !text.is_empty()), "{field}: {problem}");
    }
    problem
}

#[tokio::test]
async fn every_kind_of_wrong_request_gets_a_problem_that_says_what_to_do() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--max-file-mib", "1").start();
    let api = Api::new(&program);
    let form = reqwest::multipart::Form::new;
    let file = || Part::bytes(files::whole_box()).file_name("a.stl");
    let submit = || api.post("/v1/jobs");
    let missing = "job_0190163d8f7d7000800000000000000f";

    problem(api.get("/nowhere"), 404, "route_not_found").await;
    problem(api.get("/v1/jobs/x/y/z"), 404, "route_not_found").await;
    problem(api.http.request(Method::PUT, format!("{}/v1/jobs", api.url)), 405, "method_not_allowed").await;
    problem(api.delete("/livez"), 405, "method_not_allowed").await;
    problem(api.get("/v1/jobs/17"), 404, "job_not_found").await;
    problem(api.get(&format!("/v1/jobs/{missing}")), 404, "job_not_found").await;
    problem(api.get(&format!("/v1/jobs/{missing}/events")), 404, "job_not_found").await;
    problem(api.delete(&format!("/v1/jobs/{missing}")), 404, "job_not_found").await;
    problem(api.post(&format!("/v1/jobs/{missing}/cancel")), 404, "job_not_found").await;
    problem(api.get(&format!("/v1/jobs/{missing}/artifacts/model")), 404, "job_not_found").await;
    problem(api.get("/v1/jobs?limit=0"), 400, "invalid_request").await;
    problem(api.get("/v1/jobs?limit=many"), 400, "invalid_request").await;
    problem(api.get("/v1/jobs?cursor=zzz"), 400, "invalid_request").await;
    problem(api.get("/v1/jobs?colour=red"), 400, "invalid_request").await;
    problem(api.get("/v1/jobs?status=done"), 400, "invalid_request").await;
    problem(api.get("/v1/jobs/%ff"), 400, "invalid_request").await;
    problem(api.get("/problems/none"), 404, "route_not_found").await;

    problem(submit(), 400, "missing_file").await;
    problem(submit().multipart(form().text("options", "{}")), 400, "missing_file").await;
    problem(submit().multipart(form().part("file", Part::bytes(vec![]))), 400, "missing_file").await;
    let twice =
        problem(submit().multipart(form().part("file", file()).part("file", file())), 400, "invalid_request").await;
    assert!(twice["detail"].as_str().expect("text").contains("two parts `file`"));
    problem(submit().multipart(form().part("file", file()).text("colour", "red")), 400, "invalid_request").await;
    problem(submit().header("content-type", "multipart/form-data").body("x"), 400, "invalid_request").await;
    let broken = "--b\r\nContent-Disposition: form-data; name=\"file\"\r\n\r\nsolid";
    problem(submit().header("content-type", "multipart/form-data; boundary=b").body(broken), 400, "invalid_request")
        .await;
    problem(submit().json(&json!({"a": 1})), 400, "invalid_request").await;
    problem(api.post("/v1/uploads").header("content-type", "text/plain").body("a.stl"), 415, "unsupported_media_type")
        .await;
    problem(submit().body("hello, I am no model"), 415, "unsupported_model").await;
    problem(submit().body(b"Rar!\x1A\x07\0 something packed".to_vec()), 415, "unsupported_model").await;
    for options in ["{\"max_tier\": 9}", "{\"max_teir\": 1}", "{\"preset\": \"magic\"}", "[", "{\"deadline_s\": null}"]
    {
        problem(submit().multipart(form().part("file", file()).text("options", options)), 422, "invalid_options").await;
    }
    problem(api.post("/v1/jobs?max_tier=9").body(files::whole_box()), 422, "invalid_options").await;
    problem(api.post("/v1/jobs?max_teir=1").body(files::whole_box()), 422, "invalid_options").await;
    let large = problem(
        submit().multipart(form().part("file", file()).text("options", " ".repeat(100_000))),
        422,
        "invalid_options",
    )
    .await;
    assert!(large["detail"].as_str().expect("text").contains("64 KiB"));
    let list: Value = api.get("/v1/jobs").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!(list["jobs"].as_array().map(Vec::len), Some(0), "no refused request became a job");
    assert_eq!(stored_uploads(data.path()), 0, "no file of a refused request is stored");
}

#[tokio::test]
async fn a_file_over_the_limit_is_refused_by_its_declared_length_and_by_its_bytes() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--max-file-mib", "1").start();
    let api = Api::new(&program);
    let declared = problem(api.post("/v1/jobs").body(vec![0; 2 << 20]), 413, "payload_too_large").await;
    assert!(declared["detail"].as_str().expect("text").contains("1 MiB"));
    let chunks = futures::stream::iter((0..40).map(|_| Ok::<_, std::io::Error>(vec![0_u8; 64 << 10])));
    problem(api.post("/v1/jobs").body(reqwest::Body::wrap_stream(chunks)), 413, "payload_too_large").await;
    assert_eq!(stored_uploads(data.path()), 0, "nothing is stored");
}

#[tokio::test]
async fn a_client_that_still_sends_sees_why_it_is_refused() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--max-file-mib", "1").start();
    let address = program.url.trim_start_matches("http://");
    for _ in 0..20 {
        let (mut response, mut sending) = TcpStream::connect(address).await.expect("a connection").into_split();
        let head = format!("POST /v1/jobs HTTP/1.1\r\nhost: {address}\r\ncontent-length: {}\r\n\r\n", 3 << 20);
        let sent = tokio::spawn(async move {
            sending.write_all(head.as_bytes()).await?;
            for _ in 0..48 {
                sending.write_all(&[0; 64 << 10]).await?;
            }
            Ok::<_, std::io::Error>(sending)
        });
        let mut text = String::new();
        response.read_to_string(&mut text).await.expect("an answer, and an end that is no break");
        assert!(text.starts_with("HTTP/1.1 413") && text.contains("payload_too_large"), "{text}");
        sent.await.expect("no panic").expect("all could be sent");
    }
}

#[tokio::test]
async fn an_upload_that_stops_coming_is_given_up() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--upload-idle-s", "1").start();
    let api = Api::new(&program);
    let body =
        futures::stream::once(async { Ok::<_, std::io::Error>(vec![0_u8; 100]) }).chain(futures::stream::pending());
    use futures::StreamExt;
    problem(api.post("/v1/jobs").body(reqwest::Body::wrap_stream(body)), 408, "upload_timeout").await;
}

#[tokio::test]
async fn a_file_that_only_a_full_read_finds_broken_fails_its_job_and_names_the_place() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let text = "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n";
    let id = api.submit(text.into(), json!({})).await;
    let job = api.finished(&id).await;
    assert_eq!(job["status"], "failed");
    assert_eq!(job["problem"]["code"], "bad_input");
    assert_eq!(job["problem"]["place"]["line"], 6, "{job}");
    assert_eq!(job["attempt"], 1);
    assert!(api.artifact(&id, "log.txt").await.len() > 10);
    problem(api.get(&format!("/v1/jobs/{id}/artifacts/model")), 404, "artifact_not_found").await;
}

/// The problem of a refused request: its code, its detail and the messages for single fields.
async fn refused(request: RequestBuilder) -> (String, String, Vec<[String; 2]>) {
    let problem: Value = request.send().await.expect("a response").json().await.expect("JSON");
    let text = |value: &Value| value.as_str().expect("text").to_owned();
    let errors = problem["errors"].as_array().into_iter().flatten();
    let errors = errors.map(|error| [text(&error["field"]), text(&error["message"])]).collect();
    (text(&problem["code"]), text(&problem["detail"]), errors)
}

#[tokio::test]
async fn every_wrong_option_is_named_with_what_it_must_be() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let options = |options: Value| {
        let part = Part::bytes(files::whole_box()).file_name("box.stl");
        api.post("/v1/jobs").multipart(Form::new().text("options", options.to_string()).part("file", part))
    };
    let (code, detail, errors) =
        refused(options(json!({"max_tier": "2", "preset": "fast", "max_teir": 1, "level": "full"}))).await;
    assert_eq!(code, "invalid_options");
    let messages: Vec<_> = errors.iter().map(|[_, message]| message.as_str()).collect();
    assert_eq!(
        messages,
        [
            "`level` is an option of mode `analyze`; this job's mode is `repair`.",
            "There is no option `max_teir`. Did you mean `max_tier`?",
            r#"`max_tier` must be a whole number from 1 to 3; got "2" (text)."#,
            r#"`preset` must be one of `auto`, `basic-cleanup`, `fill-holes`, `full-repair`, `conservative-repair`, `manifold-repair`, `blender-remesh`, `generated`; got "fast" (text)."#,
        ]
    );
    assert_eq!(
        errors.iter().map(|[field, _]| field.as_str()).collect::<Vec<_>>(),
        ["level", "max_teir", "max_tier", "preset"]
    );
    assert_eq!(detail, format!("{} 3 more fields are invalid; `errors` lists all of them.", messages[0]));

    let form = |options: &'static str| {
        let part = Part::bytes(files::whole_box()).file_name("box.stl");
        api.post("/v1/jobs").multipart(Form::new().text("options", options).part("file", part))
    };
    let raw = |query: &str| api.post(&format!("/v1/jobs?{query}")).body(files::whole_box());
    for (request, expected) in [
        (form(""), "`options` is empty; send JSON such as `{}`."),
        (form("[1]"), "`options` must be a JSON object, such as `{}`."),
        (form("{\"max_tier\": }"), "`options` is not valid JSON; check line 1, column 14."),
        (options(json!({"mode": "mend"})), "`mode` must be `repair` or `analyze`; got \"mend\"."),
        (options(json!({"deadline_s": 0})), "`deadline_s` must be a number from 1 to 3600; got 0."),
        (options(json!({"with": ["fly"]})), "`with[0]` must be one of"),
        (raw("max_tier=two"), r#"`max_tier` must be a whole number from 1 to 3; got "two" (text)."#),
        (raw("max_tier=1&max_tier=2"), "`max_tier` occurs twice; send it once."),
        (raw("metadata=5"), "`metadata` must be a JSON object of at most 50 text values and 8 KiB."),
        (raw("callback_url=ftp://shop.example"), "`callback_url` must begin with https://."),
        (api.get("/v1/jobs?limit=0"), "`limit` must be a whole number from 1 to 200; got 0."),
        (api.get("/v1/jobs?limit=many"), r#"`limit` must be a whole number from 1 to 200; got "many" (text)."#),
        (api.get("/v1/jobs?status=queued,done"), "`status[1]` must be one of `queued`, `running`,"),
        (api.get("/v1/jobs?stauts=queued"), "There is no query parameter `stauts`. Did you mean `status`?"),
        (
            api.get("/v1/jobs?created_from=today"),
            "`created_from` must be a time such as 2026-01-31T00:00:00Z; got \"today\".",
        ),
        (api.get("/v1/jobs?cursor=zzz"), "`cursor` must be the `next` value of the previous page."),
        (api.post("/v1/jobs").json(&json!({"a": 1})), "There is no field `a`."),
        (api.post("/v1/webhook-endpoints").json(&json!({"url": 5})), "`url` must be text"),
        (api.post("/v1/browser-tokens").json(&json!({})), "`origin` is missing."),
    ] {
        let (_, detail, errors) = refused(request).await;
        assert!(detail.starts_with(expected), "{detail}");
        assert!(errors.iter().any(|[_, message]| detail.starts_with(message.as_str())), "{detail}: {errors:?}");
    }
}

#[tokio::test]
async fn jobs_are_listed_by_statuses_outcomes_dates_and_metadata() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let mut ids = Vec::new();
    for (file, order) in [(files::whole_box(), "1"), (files::broken_box(), "2"), (files::open_sheet(), "3")] {
        let metadata = format!(r#"{{"order":"{order}","shop":"north"}}"#);
        let form = Form::new().text("metadata", metadata).part("file", Part::bytes(file).file_name("box.stl"));
        let response = api.post("/v1/jobs").multipart(form).send().await;
        let job: Value = response.expect("a response").json().await.expect("a job");
        ids.push(job["id"].as_str().expect("an id").to_owned());
        api.finished(&ids[ids.len() - 1]).await;
    }
    let second = api.job(&ids[1]).await;
    let second = second["created_at"].as_str().expect("a time");
    assert_eq!(second.len(), "2026-01-31T00:00:00.000Z".len());
    let from = format!("created_from={second}");
    let before = format!("created_before={second}");
    for (query, expected) in [
        ("status=succeeded", vec![2, 1, 0]),
        ("status=queued,running", vec![]),
        ("status=queued,succeeded", vec![2, 1, 0]),
        ("outcome=repaired", vec![1]),
        ("outcome=already_printable,repaired", vec![1, 0]),
        (r#"metadata={"order":"3"}"#, vec![2]),
        (r#"metadata={"shop":"north","order":"1"}"#, vec![0]),
        (r#"metadata={"shop":"south"}"#, vec![]),
        (from.as_str(), vec![2, 1]),
        (before.as_str(), vec![0]),
    ] {
        let page: Value =
            api.get(&format!("/v1/jobs?{query}")).send().await.expect("a response").json().await.expect("JSON");
        let found: Vec<_> =
            page["jobs"].as_array().expect("jobs").iter().map(|job| job["id"].as_str().expect("an id")).collect();
        assert_eq!(found, expected.iter().map(|&number: &usize| ids[number].as_str()).collect::<Vec<_>>(), "{query}");
    }
}
