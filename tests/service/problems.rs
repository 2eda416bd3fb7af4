use reqwest::{Method, RequestBuilder};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::files;
use crate::server::{Api, Start, stored_uploads};

/// Sends it and expects this problem, complete.
async fn problem(request: RequestBuilder, status: u16, code: &str) -> Value {
    let answer = request.send().await.expect("an answer");
    assert_eq!(answer.headers()["content-type"], "application/problem+json", "{code}");
    let id = answer.headers()["x-request-id"].to_str().expect("text").to_owned();
    assert_eq!(answer.status(), status, "{code}");
    let problem: Value = answer.json().await.expect("JSON");
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
    let file = || reqwest::multipart::Part::bytes(files::whole_box()).file_name("a.stl");
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
    problem(submit().multipart(form().part("file", reqwest::multipart::Part::bytes(vec![]))), 400, "missing_file")
        .await;
    let twice =
        problem(submit().multipart(form().part("file", file()).part("file", file())), 400, "invalid_request").await;
    assert!(twice["detail"].as_str().expect("text").contains("two parts 'file'"));
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
    let list: Value = api.get("/v1/jobs").send().await.expect("an answer").json().await.expect("JSON");
    assert_eq!(list["jobs"].as_array().map(Vec::len), Some(0), "nothing refused became a job");
    assert_eq!(stored_uploads(data.path()), 0, "nothing refused is stored");
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
        let (mut answer, mut sending) = TcpStream::connect(address).await.expect("a connection").into_split();
        let head = format!("POST /v1/jobs HTTP/1.1\r\nhost: {address}\r\ncontent-length: {}\r\n\r\n", 3 << 20);
        let sent = tokio::spawn(async move {
            sending.write_all(head.as_bytes()).await?;
            for _ in 0..48 {
                sending.write_all(&[0; 64 << 10]).await?;
            }
            Ok::<_, std::io::Error>(sending)
        });
        let mut text = String::new();
        answer.read_to_string(&mut text).await.expect("an answer, and an end that is no break");
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
