//! Responses are short and compressed.

use std::io::Write;

use flate2::Compression;
use flate2::write::{DeflateEncoder, GzEncoder};
use serde_json::{Value, json};

use crate::files;
use crate::server::{Api, Start};

/// A surface with many holes, whose full report is far longer than the short one.
fn many_holes() -> Vec<u8> {
    let sphere = files::large_open_sphere(6000);
    let mut kept = sphere[..84].to_vec();
    let faces = sphere[84..].chunks(50).enumerate().filter(|(face, _)| face % 29 != 0);
    faces.for_each(|(_, face)| kept.extend_from_slice(face));
    let count = u32::try_from((kept.len() - 84) / 50).expect("few faces");
    kept[80..84].copy_from_slice(&count.to_le_bytes());
    kept
}

#[tokio::test]
async fn a_job_and_its_report_are_short_and_the_full_report_is_a_file() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    for (model, most) in [(files::whole_box(), 8 << 10), (files::broken_box(), 8 << 10), (many_holes(), 32 << 10)] {
        let id = api.submit(model, json!({})).await;
        let with_report = api.finished(&id).await;
        let text = api.get(&format!("/v1/jobs/{id}")).send().await.expect("a response").text().await.expect("text");
        assert!(text.len() < 4 << 10, "{} bytes: {text}", text.len());
        let job: Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(job.get("report"), None);
        assert_eq!(job["options"], json!({"mode": "repair"}));

        let stored = api.artifact(&id, "report.json").await;
        assert!(stored.len() < most, "{} bytes", stored.len());
        let short: Value = serde_json::from_slice(&stored).expect("JSON");
        assert_eq!(short, with_report["report"]);
        let full: Value = serde_json::from_slice(&api.artifact(&id, "report-full.json").await).expect("JSON");
        assert_eq!((&short["abridged"], full.get("abridged")), (&json!(true), None));
        assert!(full["before"]["statistics"]["edge_length"]["histogram"].is_object());
        for (short, full) in [(&short["before"], &full["before"]), (&short, &full)] {
            let same = ["boundary_edges", "faces", "verdict", "red_flags", "assumptions", "summary"];
            assert!(same.iter().all(|name| short.get(name) == full.get(name)));
        }
    }
}

#[tokio::test]
async fn a_quote_has_the_figures_of_the_result_in_millimetres() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({"unit": "in"})).await;
    let job = api.finished(&id).await;
    let quote = &job["quote"];
    assert_eq!(
        (&quote["printable"], &quote["unit"], &quote["unit_source"]),
        (&json!(true), &json!("in"), &json!("declared"))
    );
    assert_eq!((&quote["faces"], &quote["parts"], &quote["red_flags"]), (&json!(12), &json!(1), &json!([])));
    let near = |value: &Value, expected: f64| (value.as_f64().expect("a number") / expected - 1.0).abs() < 1e-6;
    assert!(quote["size_mm"].as_array().expect("sides").iter().all(|side| near(side, 25.4)), "{quote}");
    assert!(
        near(&quote["volume_mm3"], 25.4_f64.powi(3)) && near(&quote["area_mm2"], 6.0 * 25.4_f64.powi(2)),
        "{quote}"
    );
    assert!(near(&quote["thinnest_wall_mm"], 25.4), "{quote}");

    // An open sheet encloses nothing, so it has no volume.
    let id = api.submit(files::open_sheet(), json!({})).await;
    let quote = api.finished(&id).await["quote"].clone();
    assert_eq!((&quote["printable"], &quote["volume_mm3"], &quote["faces"]), (&json!(false), &Value::Null, &json!(2)));
    let id = api.submit(files::whole_box(), json!({"mode": "analyze"})).await;
    let quote = api.finished(&id).await["quote"].clone();
    assert_eq!((&quote["printable"], &quote["volume_mm3"]), (&json!(true), &json!(1.0)));
}

#[tokio::test]
async fn text_is_sent_in_an_encoding_that_the_client_accepts() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).start();
    let api = Api::new(&program);
    let id = api.submit(files::broken_box(), json!({})).await;
    api.finished(&id).await;
    let path = format!("/v1/jobs/{id}/artifacts/report.json");
    let plain = api.get(&path).send().await.expect("a response");
    let tag = plain.headers()["etag"].to_str().expect("text").to_owned();
    let plain = plain.bytes().await.expect("bytes");
    for coding in ["gzip", "br", "zstd"] {
        let response = api.get(&path).header("accept-encoding", coding).send().await.expect("a response");
        assert_eq!(response.headers()["content-encoding"], coding);
        assert_eq!(
            response.headers()["etag"],
            format!("W/{tag}").as_str(),
            "a compressed response has a different entity tag"
        );
        assert!(response.bytes().await.expect("bytes").len() * 2 < plain.len());
        let model = api.get(&format!("/v1/jobs/{id}/artifacts/model")).header("accept-encoding", coding);
        assert!(model.send().await.expect("a response").headers().get("content-encoding").is_none());
    }
    let known = api.get(&path).header("accept-encoding", "gzip").header("if-none-match", format!("W/{tag}"));
    assert_eq!(known.send().await.expect("a response").status(), 304);
}

#[tokio::test]
async fn a_model_may_be_sent_compressed_within_the_limits_of_its_size() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).arg("--max-file-mib", "1").start();
    let api = Api::new(&program);
    let send = |coding: &'static str, body: Vec<u8>| {
        let request = api.post("/v1/jobs?name=box.stl").header("content-type", "application/octet-stream");
        request.header("content-encoding", coding).body(body).send()
    };
    let gzip = |bytes: &[u8]| {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(bytes).expect("memory");
        encoder.finish().expect("memory")
    };
    let response = send("gzip", gzip(&files::whole_box())).await.expect("a response");
    assert_eq!(response.status(), 202);
    let job: Value = response.json().await.expect("JSON");
    assert_eq!((&job["input"]["format"], &job["input"]["bytes"]), (&json!("stl"), &json!(files::whole_box().len())));

    let mut many = files::whole_box();
    many.resize(3 << 20, 0);
    let response = send("gzip", gzip(&many)).await.expect("a response");
    assert_eq!(response.status(), 413, "the limit applies to the decoded bytes");

    let mut broken = gzip(&files::whole_box());
    broken[20] ^= 0xff;
    let response = send("gzip", broken).await.expect("a response");
    assert_eq!(response.status(), 400);
    let detail = response.json::<Value>().await.expect("JSON")["detail"].clone();
    assert!(detail.as_str().expect("text").contains("`Content-Encoding`"), "{detail}");

    let mut deflated = DeflateEncoder::new(Vec::new(), Compression::best());
    deflated.write_all(&files::whole_box()).expect("memory");
    let response = send("compress", deflated.finish().expect("memory")).await.expect("a response");
    assert_eq!(response.status(), 415);
    let problem: Value = response.json().await.expect("JSON");
    assert_eq!(problem["code"], "unsupported_media_type");
}
