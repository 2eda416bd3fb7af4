//! Uploads before a job, and direct downloads, with files in a folder and in a bucket.

use reqwest::{Client, Response, redirect};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::files;
use crate::s3::S3;
use crate::server::{Api, Program, Start, until};

/// A service with its files in a folder or a bucket.
struct Service {
    api: Api,
    _program: Program,
    bucket: Option<S3>,
    data: TempDir,
}

impl Service {
    fn in_folder(args: &[(&str, &str)]) -> Self {
        Self::start(None, args)
    }

    fn in_bucket(args: &[(&str, &str)]) -> Self {
        Self::start(Some(S3::start()), args)
    }

    fn start(bucket: Option<S3>, args: &[(&str, &str)]) -> Self {
        let data = tempfile::tempdir().expect("a folder");
        let start = args.iter().fold(Start::serve(data.path()), |start, (name, value)| start.env(name, value));
        let program = match &bucket {
            Some(bucket) => bucket.store_files_of(start).start(),
            None => start.start(),
        };
        Self { api: Api::new(&program), _program: program, bucket, data }
    }

    async fn announce(&self, what: Value) -> Value {
        let response = self.api.post("/v1/uploads").json(&what).send().await.expect("a response");
        assert_eq!(response.status(), 201);
        assert_eq!(response.headers()["cache-control"], "no-store");
        response.json().await.expect("an upload")
    }

    async fn send(&self, upload: &Value, bytes: Vec<u8>) -> Response {
        assert_eq!((&upload["put"]["method"], &upload["put"]["headers"]), (&json!("PUT"), &json!({})));
        let url = upload["put"]["url"].as_str().expect("an address");
        let is_ours = url.starts_with('/');
        assert_eq!(is_ours, self.bucket.is_none(), "{url}");
        let url = if is_ours { format!("{}{url}", self.api.url) } else { url.to_owned() };
        self.api.http.put(url).body(bytes).send().await.expect("a response")
    }

    /// Creates an upload and sends its file.
    async fn upload(&self, name: &str, bytes: Vec<u8>) -> String {
        let upload = self.announce(json!({"name": name, "bytes": bytes.len()})).await;
        let sent = self.send(&upload, bytes).await;
        assert!(sent.status().is_success(), "{}", sent.status());
        upload["id"].as_str().expect("an id").to_owned()
    }

    async fn submit(&self, job: Value, key: &str) -> Response {
        self.api.post("/v1/jobs").header("idempotency-key", key).json(&job).send().await.expect("a response")
    }

    /// The number of uploads that wait for a job.
    fn waiting(&self) -> usize {
        let files = self.bucket.as_ref().map_or_else(|| self.data.path().join("files"), S3::objects);
        std::fs::read_dir(files.join("incoming")).into_iter().flatten().count()
    }
}

async fn refusal(response: Response) -> (u16, String) {
    let status = response.status().as_u16();
    let problem: Value = response.json().await.expect("a problem");
    (status, problem["code"].as_str().expect("a code").to_owned())
}

fn of(upload: &str) -> Value {
    json!({"source": {"upload_id": upload}, "options": {"max_tier": 1}})
}

/// Runs each test with each store.
macro_rules! with_each_store {
    ($($name:ident: $args:expr;)*) => {
        mod folder {
            $(#[tokio::test]
            async fn $name() {
                super::$name(super::Service::in_folder($args)).await;
            })*
        }
        mod bucket {
            $(#[tokio::test]
            async fn $name() {
                super::$name(super::Service::in_bucket($args)).await;
            })*
        }
    };
}

with_each_store! {
    a_job_is_made_of_a_file_that_was_sent_before: &[];
    a_job_of_an_upload_that_is_asked_for_again_with_its_key_is_the_same_job: &[];
    an_upload_is_refused_for_what_it_is_and_only_then: &[("MESHMEND_MAX_FILE_MIB", "1"), ("MESHMEND_NO_WORKERS", "true")];
    a_job_is_made_of_the_files_of_an_earlier_one: &[];
    no_more_uploads_wait_than_jobs_may: &[("MESHMEND_MAX_QUEUED", "2"), ("MESHMEND_NO_WORKERS", "true")];
}

async fn a_job_is_made_of_a_file_that_was_sent_before(service: Service) {
    let upload = service.upload("../box.stl", files::broken_box()).await;
    assert_eq!(service.waiting(), 1);
    let response = service.submit(of(&upload), "a").await;
    assert_eq!(response.status(), 202);
    let job: Value = response.json().await.expect("a job");
    assert_eq!((&job["input"]["name"], &job["input"]["bytes"]), (&json!("box.stl"), &json!(files::broken_box().len())));
    until("the upload is the job's", async || (service.waiting() == 0).then_some(())).await;
    let job = service.api.finished(job["id"].as_str().expect("an id")).await;
    assert_eq!(job["outcome"], "repaired", "{job}");
    assert_eq!(service.api.artifact(job["id"].as_str().expect("an id"), "model").await.len(), 84 + 50 * 12);
    assert_eq!(refusal(service.submit(of(&upload), "b").await).await, (409, "upload_used".to_owned()));

    // The name may be given with the job, and an analysis accepts an upload too.
    let upload = service.upload("box.stl", files::whole_box()).await;
    let job = json!({"source": {"upload_id": upload}, "options": {"mode": "analyze"}, "name": "other.stl"});
    let job: Value = service.submit(job, "c").await.json().await.expect("a job");
    let job = service.api.finished(job["id"].as_str().expect("an id")).await;
    assert_eq!((&job["status"], &job["input"]["name"]), (&json!("succeeded"), &json!("other.stl")), "{job}");
}

async fn a_job_is_made_of_the_files_of_an_earlier_one(service: Service) {
    let first = service.api.submit(files::broken_box(), json!({"max_tier": 1})).await;
    service.api.finished(&first).await;
    let submit = async |source: Value, options: Value, key| {
        let response = service.submit(json!({"source": source, "options": options, "name": "other.stl"}), key).await;
        assert_eq!(response.status(), 202);
        let job: Value = response.json().await.expect("a job");
        service.api.finished(job["id"].as_str().expect("an id")).await
    };
    // The upload of an earlier job, with other options.
    let again = submit(json!({"job_id": first}), json!({"max_tier": 1, "output": "off"}), "a").await;
    assert_eq!((&again["outcome"], &again["input"]["bytes"]), (&json!("repaired"), &json!(files::broken_box().len())));
    let id = again["id"].as_str().expect("an id");
    assert_ne!(id, first);
    assert!(service.api.artifact(id, "model").await.starts_with(b"OFF"));
    // The result of an earlier job, in another format.
    let other =
        submit(json!({"job_id": first, "file": "model"}), json!({"output": "obj", "pictures": false}), "b").await;
    assert_eq!(
        (&other["outcome"], &other["input"]["name"]),
        (&json!("already_printable"), &json!("other.stl")),
        "{other}"
    );
    let model = &other["artifacts"]["model"];
    assert_eq!((&model["filename"], &model["media_type"]), (&json!("other-repaired.obj"), &json!("model/obj")));
    assert_eq!(other["report"]["after"]["faces"], 12);

    let refused = async |source: Value| refusal(service.submit(json!({"source": source}), "c").await).await;
    let none = "job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a";
    assert_eq!(refused(json!({"job_id": none})).await, (404, "job_not_found".to_owned()));
    for source in [json!({}), json!({"file": "model"}), json!({"job_id": first, "upload_id": "upl_1"})] {
        assert_eq!(refused(source.clone()).await, (422, "invalid_options".to_owned()), "{source}");
    }
    assert_eq!(refused(json!({"job_id": first, "file": "log.txt"})).await, (400, "invalid_request".to_owned()));
    service.api.delete(&format!("/v1/jobs/{first}")).send().await.expect("a response");
    assert_eq!(refused(json!({"job_id": first})).await, (410, "job_deleted".to_owned()));
}

async fn a_job_of_an_upload_that_is_asked_for_again_with_its_key_is_the_same_job(service: Service) {
    let upload = service.upload("box.stl", files::broken_box()).await;
    let first: Value = service.submit(of(&upload), "k").await.json().await.expect("a job");
    until("the upload is the job's", async || (service.waiting() == 0).then_some(())).await;
    let again = service.submit(of(&upload), "k").await;
    assert_eq!(
        (again.status().as_u16(), &again.headers()["idempotency-replayed"]),
        (202, &"true".parse().expect("text"))
    );
    assert_eq!(again.json::<Value>().await.expect("a job")["id"], first["id"]);
    let other = json!({"source": {"upload_id": upload}, "options": {"max_tier": 2}});
    assert_eq!(refusal(service.submit(other, "k").await).await, (422, "idempotency_key_reused".to_owned()));
    let id = first["id"].as_str().expect("an id");
    service.api.delete(&format!("/v1/jobs/{id}")).send().await.expect("a response");
    assert_eq!(refusal(service.submit(of(&upload), "k").await).await, (410, "job_deleted".to_owned()));
}

async fn an_upload_is_refused_for_what_it_is_and_only_then(service: Service) {
    let (large, too_large) = (vec![0; (1 << 20) + 1], (413, "payload_too_large".to_owned()));
    let announced =
        service.api.post("/v1/uploads").json(&json!({"bytes": large.len()})).send().await.expect("a response");
    assert_eq!(refusal(announced).await, too_large);
    let odd = service.api.post("/v1/uploads").json(&json!({"colour": "red"})).send().await.expect("a response");
    assert_eq!(refusal(odd).await, (400, "invalid_request".to_owned()));
    let long =
        service.api.post("/v1/uploads").json(&json!({"name": "x".repeat(100_000)})).send().await.expect("a response");
    assert_eq!(refusal(long).await, too_large);

    let upload = service.announce(json!({})).await;
    let id = upload["id"].as_str().expect("an id");
    assert_eq!(refusal(service.submit(of(id), "a").await).await, (409, "upload_missing".to_owned()));
    let sent = service.send(&upload, large).await;
    if service.bucket.is_some() {
        assert_eq!(sent.status(), 200, "a bucket does not know");
        assert_eq!(refusal(service.submit(of(id), "a").await).await, too_large);
    } else {
        assert_eq!(refusal(sent).await, too_large);
        assert_eq!(refusal(service.submit(of(id), "a").await).await, (409, "upload_missing".to_owned()));
    }

    let upload = service.upload("a.stl", b"no model at all".to_vec()).await;
    assert_eq!(refusal(service.submit(of(&upload), "b").await).await, (415, "unsupported_model".to_owned()));
    let upload = service.upload("a.stl", files::broken_box()).await;
    let submit = async |job: Value| refusal(service.submit(job, "c").await).await;
    let wrong = json!({"source": {"upload_id": upload}, "options": {"max_tier": 9}});
    assert_eq!(submit(wrong).await, (422, "invalid_options".to_owned()));
    let wrong = json!({"source": {"upload_id": upload}, "colour": "red"});
    assert_eq!(submit(wrong).await, (400, "invalid_request".to_owned()));
    assert_eq!(submit(json!([])).await, (400, "invalid_request".to_owned()));
    for unknown in ["upl_0190163d8f7d7000800000000000000f", "upl_1", "", "../../etc/passwd"] {
        assert_eq!(submit(of(unknown)).await, (404, "upload_not_found".to_owned()), "{unknown}");
    }
    assert_eq!(service.submit(of(&upload), "c").await.status(), 202, "refused requests did not change the upload");
}

async fn no_more_uploads_wait_than_jobs_may(service: Service) {
    let uploads =
        [service.upload("a.stl", files::broken_box()).await, service.upload("b.stl", files::broken_box()).await];
    let third = service.api.post("/v1/uploads").send().await.expect("a response");
    assert!(third.headers().contains_key("retry-after"));
    assert_eq!(refusal(third).await, (429, "queue_full".to_owned()));
    assert_eq!(service.submit(of(&uploads[0]), "a").await.status(), 202);
    service.announce(json!({})).await;
}

#[tokio::test]
async fn an_upload_url_accepts_one_file_without_a_key() {
    let service = Service::in_folder(&[("MESHMEND_NO_WORKERS", "true"), ("MESHMEND_UPLOAD_IDLE_S", "1")]);
    let upload = service.announce(json!({"name": "a.stl"})).await;
    let mut guessed = upload.clone();
    guessed["put"]["url"] =
        json!(format!("/v1/uploads/{}/content?token=guessed", upload["id"].as_str().expect("an id")));
    assert_eq!(refusal(service.send(&guessed, files::whole_box()).await).await, (404, "upload_not_found".to_owned()));
    let url = format!("{}{}", service.api.url, upload["put"]["url"].as_str().expect("an address"));
    let silent = reqwest::Body::wrap_stream(futures::stream::pending::<Result<Vec<u8>, std::io::Error>>());
    let stopped = service.api.http.put(url).body(silent).send().await.expect("a response");
    assert_eq!(refusal(stopped).await, (408, "upload_timeout".to_owned()));
    assert_eq!(service.waiting(), 0);
    assert_eq!(service.send(&upload, files::broken_box()).await.status(), 204, "an interrupted upload may be repeated");
    assert_eq!(refusal(service.send(&upload, files::whole_box()).await).await, (409, "upload_used".to_owned()));
    let id = upload["id"].as_str().expect("an id");
    let job: Value = service.submit(of(id), "a").await.json().await.expect("a job");
    assert_eq!(job["input"]["bytes"], files::broken_box().len(), "{job}");
    assert_eq!(refusal(service.send(&upload, files::whole_box()).await).await, (409, "upload_used".to_owned()));
}

#[tokio::test]
async fn uploads_pass_through_the_service_where_clients_do_not_reach_the_bucket() {
    let service = Service::in_bucket(&[("MESHMEND_PRESIGNED_UPLOADS", "false")]);
    let upload = service.announce(json!({"name": "a.stl"})).await;
    let url = upload["put"]["url"].as_str().expect("an address");
    assert!(url.starts_with("/v1/uploads/"), "{url}");
    let sent = service.api.http.put(format!("{}{url}", service.api.url)).body(files::broken_box()).send().await;
    assert_eq!(sent.expect("a response").status(), 204);
    let job: Value = service.submit(of(upload["id"].as_str().expect("an id")), "a").await.json().await.expect("a job");
    assert_eq!(service.api.finished(job["id"].as_str().expect("an id")).await["status"], "succeeded");
}

#[tokio::test]
async fn downloads_are_sent_on_to_the_bucket_where_that_is_wanted() {
    for wanted in ["true", "false"] {
        let service = Service::in_bucket(&[("MESHMEND_PRESIGNED_DOWNLOADS", wanted)]);
        let id = service.api.submit(files::broken_box(), json!({"max_tier": 1})).await;
        let job = service.api.finished(&id).await;
        let path = format!("{}/v1/jobs/{id}/artifacts/model", service.api.url);
        let http = Client::builder().redirect(redirect::Policy::none()).build().expect("a client");
        let first = http.get(&path).send().await.expect("a response");
        if wanted == "false" {
            assert_eq!(first.status(), 200);
            continue;
        }
        assert_eq!(first.status(), 307);
        assert_eq!(first.headers()["cache-control"], "no-store");
        let address = first.headers()["location"].to_str().expect("text").to_owned();
        assert!(!address.starts_with(&service.api.url), "{address}");
        let there = http.get(&address).send().await.expect("a response");
        assert_eq!(there.status(), 200);
        assert_eq!(there.headers()["content-type"], "model/stl");
        let disposition = there.headers()["content-disposition"].to_str().expect("text").to_owned();
        assert!(disposition.contains("filename=\"model-repaired.stl\""), "{disposition}");
        assert_eq!(there.bytes().await.expect("bytes").len() as u64, job["artifacts"]["model"]["bytes"]);
        // Requests that need no bytes are answered by the service.
        let head = http.head(&path).send().await.expect("a response");
        assert_eq!(head.status(), 200);
        let etag = head.headers()["etag"].clone();
        let known = http.get(&path).header("if-none-match", etag).send().await.expect("a response");
        assert_eq!(known.status(), 304);
        assert_eq!(service.api.artifact(&id, "model").await.len(), 84 + 50 * 12, "clients follow redirects");
    }
}
