//! Jobs from their upload to their result over the API.

use meshmend::format::{Limits, read};
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start};

#[tokio::test]
async fn a_broken_model_is_repaired_to_a_printable_one_with_a_report() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let answer = api.try_submit("my bracket.stl", files::broken_box(), json!({"max_tier": 1})).await;
    assert_eq!(answer.status(), 202);
    assert!(answer.headers().contains_key("retry-after"));
    let address = answer.headers()["location"].to_str().expect("text").to_owned();
    let accepted: Value = answer.json().await.expect("a job");
    assert_eq!(accepted["status"], "queued");
    assert_eq!(accepted["input"]["name"], "my bracket.stl");
    assert_eq!(accepted["input"]["format"], "stl");
    assert_eq!(accepted["input"]["bytes"], files::broken_box().len());
    assert_eq!(accepted["options"]["max_tier"], 1);
    let id = accepted["id"].as_str().expect("an id");
    assert_eq!(address, format!("/v1/jobs/{id}"));

    let job = api.finished(id).await;
    assert_eq!(job["status"], "succeeded", "{job}");
    assert_eq!(job["outcome"], "repaired");
    assert_eq!(job["attempt"], 1);
    let report = &job["report"];
    assert_eq!(report["verified_from_output_bytes"], true);
    assert_eq!(report["before"]["boundary_edges"], 3);
    assert_eq!(report["after"]["boundary_edges"], 0);
    assert_eq!(report["after"]["closed"], true);
    assert_eq!(report["after"]["self_intersections"]["complete"], true);
    assert_eq!(report["after"]["self_intersections"]["pairs"], 0);

    let model = api.artifact(id, "model").await;
    assert_eq!(job["artifacts"]["model"]["bytes"], model.len());
    let soup = read(&model, &Limits::default()).expect("a model").soup;
    assert_eq!(soup.faces.len(), 12);
    let stored: Value = serde_json::from_slice(&api.artifact(id, "report.json").await).expect("JSON");
    assert_eq!(&stored, report);
    let log = String::from_utf8(api.artifact(id, "log.txt").await).expect("text");
    assert!(!log.is_empty());
}

#[tokio::test]
async fn without_pictures_a_job_has_its_result_its_report_and_its_log_only() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1, "pictures": false})).await;
    let job = api.finished(&id).await;
    let names: Vec<&String> = job["artifacts"].as_object().expect("an object").keys().collect();
    assert_eq!(names, ["log.txt", "model", "report-full.json", "report.json"]);
}

#[tokio::test]
async fn a_printable_model_comes_back_bit_for_bit() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::whole_box(), json!({})).await;
    assert_eq!(api.finished(&id).await["outcome"], "already_printable");
    assert_eq!(api.artifact(&id, "model").await, files::whole_box());
}

#[tokio::test]
async fn a_raw_body_with_its_options_in_the_query_is_a_job_too() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let answer = api
        .post("/v1/jobs?name=raw.stl&output=obj&max_tier=1&deadline_s=20.5")
        .body(files::broken_box())
        .send()
        .await
        .expect("a response");
    assert_eq!(answer.status(), 202);
    let job: Value = answer.json().await.expect("a job");
    assert_eq!(job["input"]["name"], "raw.stl");
    assert_eq!(job["options"]["deadline_s"], 20.5);
    let id = job["id"].as_str().expect("an id");
    let job = api.finished(id).await;
    assert_eq!(job["artifacts"]["model"]["filename"], "raw-repaired.obj");
    let text = String::from_utf8(api.artifact(id, "model").await).expect("text");
    assert!(text.contains("\nf "), "{text}");
}

#[tokio::test]
async fn long_polling_waits_for_a_new_status_and_entity_tags_spare_the_body() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    let mut statuses = Vec::new();
    let mut etag = String::new();
    while statuses.last().is_none_or(|s| s != "succeeded") {
        let answer = api.get(&format!("/v1/jobs/{id}?wait=20")).send().await.expect("a response");
        etag = answer.headers()["etag"].to_str().expect("text").to_owned();
        let job: Value = answer.json().await.expect("a job");
        statuses.push(job["status"].as_str().expect("a status").to_owned());
        assert!(statuses.len() < 4, "each response has a new status: {statuses:?}");
    }
    let again = api.get(&format!("/v1/jobs/{id}")).header("if-none-match", &etag).send().await.expect("a response");
    assert_eq!(again.status(), 304);
    assert!(again.bytes().await.expect("bytes").is_empty());
    let other = api.get(&format!("/v1/jobs/{id}")).header("if-none-match", "W/\"0\"").send().await.expect("a response");
    assert_eq!(other.status(), 200);
}

#[tokio::test]
async fn a_download_can_be_resumed_and_is_named_and_tagged() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let answer = api.try_submit("größe.stl", files::broken_box(), json!({"max_tier": 1})).await;
    let id = answer.json::<Value>().await.expect("a job")["id"].as_str().expect("an id").to_owned();
    let job = api.finished(&id).await;
    let path = format!("/v1/jobs/{id}/artifacts/model");
    let whole = api.get(&path).send().await.expect("a response");
    assert_eq!(whole.headers()["accept-ranges"], "bytes");
    let etag = whole.headers()["etag"].to_str().expect("text").to_owned();
    assert_eq!(etag.trim_matches('"'), job["artifacts"]["model"]["sha256"].as_str().expect("a hash"));
    let named = whole.headers()["content-disposition"].to_str().expect("text").to_owned();
    assert!(named.contains("filename*=UTF-8''gr%C3%B6%C3%9Fe-repaired.stl"), "{named}");
    let bytes = whole.bytes().await.expect("bytes");

    let part = api.get(&path).header("range", "bytes=80-").header("if-range", &etag).send().await.expect("a response");
    assert_eq!(part.status(), 206);
    assert_eq!(
        part.headers()["content-range"].to_str().expect("text"),
        format!("bytes 80-{}/{}", bytes.len() - 1, bytes.len())
    );
    assert_eq!(part.bytes().await.expect("bytes"), bytes[80..]);
    let outside = api.get(&path).header("range", "bytes=999999-").send().await.expect("a response");
    assert_eq!(outside.status(), 416);
    let known = api.get(&path).header("if-none-match", &etag).send().await.expect("a response");
    assert_eq!(known.status(), 304);
    let head = api.http.head(format!("{}{path}", api.url)).send().await.expect("a response");
    assert_eq!(head.headers()["content-length"].to_str().expect("text"), bytes.len().to_string());
}

#[tokio::test]
async fn events_report_each_stage_and_end_with_the_job() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--workers", "1").start();
    let api = Api::new(&program);
    // The second job waits behind the first, so the listener is connected before it starts.
    api.submit(files::large_open_sphere(60_000), json!({"max_tier": 1})).await;
    let id = api.submit(files::large_open_sphere(60_000), json!({"max_tier": 1})).await;
    let events = api.get(&format!("/v1/jobs/{id}/events")).send().await.expect("a response");
    assert_eq!(events.headers()["content-type"], "text/event-stream");
    let text = events.text().await.expect("the stream ends by itself");
    let of = |name: &str| -> Vec<Value> {
        let blocks = text.split("\n\n").filter(|block| block.contains(&format!("event: {name}")));
        let data = |block: &str| block.lines().find_map(|l| l.strip_prefix("data: ")).map(str::to_owned);
        blocks.filter_map(data).map(|d| serde_json::from_str(&d).expect("JSON")).collect()
    };
    let progress = of("progress");
    assert_eq!(progress[0]["status"], "queued");
    let percents: Vec<u64> = progress.iter().map(|p| p["percent"].as_u64().expect("a number")).collect();
    assert!(percents.is_sorted(), "{percents:?}");
    assert!(progress.iter().any(|p| p["status"] == "running"), "{text}");
    let done = of("done");
    assert_eq!(done.len(), 1, "{text}");
    assert_eq!(done[0]["id"], id);
    assert_eq!(done[0]["status"], "succeeded");
}

#[tokio::test]
async fn the_list_pages_through_all_jobs_newest_first() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let mut ids = Vec::new();
    for _ in 0..5 {
        ids.push(api.submit(files::whole_box(), json!({})).await);
    }
    ids.reverse();
    let mut seen = Vec::new();
    let mut path = "/v1/jobs?limit=2".to_owned();
    loop {
        let page: Value = api.get(&path).send().await.expect("a response").json().await.expect("JSON");
        seen.extend(page["jobs"].as_array().expect("jobs").iter().map(|j| j["id"].as_str().expect("an id").to_owned()));
        let Some(next) = page["next"].as_str() else { break };
        path = format!("/v1/jobs?limit=2&cursor={next}");
    }
    assert_eq!(seen, ids);
    for id in &ids {
        api.finished(id).await;
    }
    let none: Value = api.get("/v1/jobs?status=failed").send().await.expect("a response").json().await.expect("JSON");
    assert_eq!(none["jobs"].as_array().map(Vec::len), Some(0));
}

#[tokio::test]
async fn the_same_upload_gives_the_same_bytes_every_time() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--workers", "2").start();
    let api = Api::new(&program);
    let file = files::large_open_sphere(20_000);
    let mut results = Vec::new();
    for _ in 0..3 {
        let id = api.submit(file.clone(), json!({"max_tier": 1})).await;
        api.finished(&id).await;
        results.push(api.artifact(&id, "model").await);
    }
    assert!(results.windows(2).all(|pair| pair[0] == pair[1]));
}
