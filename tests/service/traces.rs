//! Traces that lead from a request to the worker in another process, as a collector receives them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};

use axum::body::Bytes;
use axum::http::StatusCode;
use axum::routing::post;
use opentelemetry_proto::tonic::collector::trace::v1::ExportTraceServiceRequest;
use opentelemetry_proto::tonic::trace::v1::Span;
use prost::Message;
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start, until};

/// A collector that keeps the spans it receives.
#[derive(Clone, Default)]
struct Collector(Arc<Mutex<Vec<Span>>>);

impl Collector {
    /// Starts the collector and returns its address.
    async fn start(&self) -> String {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let spans = self.clone();
        let take = async move |body: Bytes| {
            let sent = ExportTraceServiceRequest::decode(body).expect("protobuf");
            let spans_of =
                sent.resource_spans.into_iter().flat_map(|spans| spans.scope_spans).flat_map(|spans| spans.spans);
            spans.0.lock().expect("not poisoned").extend(spans_of);
            StatusCode::OK
        };
        let router = axum::Router::new().route("/v1/traces", post(take));
        tokio::spawn(async move { axum::serve(listener, router).await });
        format!("http://{address}")
    }

    /// The spans of one trace by name.
    fn trace(&self, id: &str) -> BTreeMap<String, Span> {
        let spans = self.0.lock().expect("not poisoned");
        let spans = spans.iter().filter(|span| hex::encode(&span.trace_id) == id);
        spans.map(|span| (span.name.clone(), span.clone())).collect()
    }
}

fn traced<'a>(start: Start<'a>, collector: &str) -> Start<'a> {
    start.env("MESHMEND_OTLP_ENDPOINT", collector).env("MESHMEND_LOG_FORMAT", "json")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_trace_continues_from_the_request_to_the_worker_in_another_process() {
    const TRACE: &str = "0af7651916cd43dd8448eb211c80319c";
    let data = tempfile::tempdir().expect("a folder");
    let collector = Collector::default();
    let address = collector.start().await;
    let mut server = traced(Start::serve(data.path()), &address).env("MESHMEND_NO_WORKERS", "true").start();
    let mut worker = traced(Start::work(data.path()), &address).start();
    let api = Api::new(&server);
    let request = api.post("/v1/jobs?max_tier=1").header("x-request-id", "the-request");
    let request = request.header("traceparent", format!("00-{TRACE}-b7ad6b7169203331-01")).body(files::broken_box());
    let job: Value = request.send().await.expect("a response").json().await.expect("a job");
    let id = job["id"].as_str().expect("an id").to_owned();
    assert_eq!(api.finished(&id).await["outcome"], "repaired");
    // The processes send their last spans when they end.
    server.terminate();
    worker.terminate();
    assert_eq!((server.wait(), worker.wait()), (Some(0), Some(0)));

    let spans = collector.trace(TRACE);
    let names: BTreeSet<&str> = spans.keys().map(String::as_str).collect();
    let expected = [
        "POST /v1/jobs",
        "job",
        "fetch",
        "run",
        "read",
        "inspect",
        "repair tier 1",
        "verify tier 1",
        "publish",
        "complete",
    ];
    for name in expected {
        assert!(names.contains(name), "no {name} in {names:?}");
    }
    let parent = |name: &str| hex::encode(&spans[name].parent_span_id);
    let id_of = |name: &str| hex::encode(&spans[name].span_id);
    assert_eq!(parent("POST /v1/jobs"), "b7ad6b7169203331");
    assert_eq!(parent("job"), id_of("POST /v1/jobs"));
    for name in ["fetch", "run", "publish", "complete"] {
        assert_eq!(parent(name), id_of("job"), "{name}");
    }
    for name in ["read", "inspect", "repair tier 1", "verify tier 1"] {
        assert_eq!(parent(name), id_of("run"), "{name}");
        let (inner, outer) = (&spans[name], &spans["run"]);
        assert!(inner.start_time_unix_nano >= outer.start_time_unix_nano, "{name}");
        assert!(inner.end_time_unix_nano <= outer.end_time_unix_nano, "{name}");
    }

    for (program, message, span) in [(&server, "accepted", "request"), (&worker, "attempt ended", "job")] {
        let line = program.log().lines().find(|line| line.contains(message)).expect("a line").to_owned();
        let line: Value = serde_json::from_str(&line).expect("JSON");
        let spans = line["spans"].as_array().expect("spans");
        let found = spans.iter().find(|recorded| recorded["name"] == span).expect("the span");
        assert_eq!(found["trace_id"], TRACE, "{line}");
        match span {
            "request" => {
                assert_eq!((&found["request_id"], &line["fields"]["job_id"]), (&json!("the-request"), &json!(id)))
            }
            _ => assert_eq!((&found["job_id"], &found["attempt"]), (&json!(id), &json!(1))),
        }
    }
}

#[tokio::test]
async fn without_a_collector_the_log_lines_of_a_request_and_its_job_still_share_a_trace() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_LOG_FORMAT", "json").start();
    let api = Api::new(&program);
    let request = api.post("/v1/jobs?max_tier=1").header("traceparent", "00-not-a-trace").body(files::broken_box());
    let job: Value = request.send().await.expect("a response").json().await.expect("a job");
    api.finished(job["id"].as_str().expect("an id")).await;
    let trace_of = |message: &str| {
        let log = program.log();
        let line: Value = serde_json::from_str(log.lines().find(|line| line.contains(message))?).expect("JSON");
        Some(line["spans"][0]["trace_id"].as_str().expect("a trace").to_owned())
    };
    let ended = until("the end is in the log", async || trace_of("attempt ended")).await;
    assert_eq!(ended.len(), 32);
    assert_eq!(trace_of("accepted"), Some(ended));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_collector_that_never_answers_holds_up_no_job_and_no_end() {
    let data = tempfile::tempdir().expect("a folder");
    let silent = tokio::net::TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = format!("http://{}", silent.local_addr().expect("an address"));
    let mut program = traced(Start::serve(data.path()), &address).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    assert_eq!(api.finished(&id).await["outcome"], "repaired");
    program.terminate();
    assert_eq!(program.wait(), Some(0));
    assert!(silent.accept().await.is_ok(), "the program contacted the collector");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_is_not_to_be_sampled_sends_nothing() {
    let data = tempfile::tempdir().expect("a folder");
    let collector = Collector::default();
    let address = collector.start().await;
    let start = traced(Start::serve(data.path()), &address).env("MESHMEND_TRACE_RATIO", "0");
    let mut program = start.start();
    let api = Api::new(&program);
    let asked = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01";
    for (path, traceparent) in [
        ("/livez", None),
        ("/problems", Some(asked)),
        ("/livez", Some("00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-00")),
    ] {
        let request =
            traceparent.into_iter().fold(api.get(path), |request, parent| request.header("traceparent", parent));
        assert_eq!(request.send().await.expect("a response").status(), 200);
    }
    program.terminate();
    assert_eq!(program.wait(), Some(0));
    let spans = collector.0.lock().expect("not poisoned");
    let names: Vec<_> = spans.iter().map(|span| span.name.as_str()).collect();
    assert_eq!(names, ["GET /problems"]);
}
