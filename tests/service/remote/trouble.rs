//! Network errors and refusals between the client and the service.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use super::{Client, jobs};
use crate::files;
use crate::server::{Api, Program, Start};
use crate::support::interceptor::{Action, Interceptor};
use crate::support::receiver::{Receiver, Reply};

/// Whether this is the first call.
fn first(seen: &AtomicU32) -> bool {
    seen.fetch_add(1, Ordering::Relaxed) == 0
}

fn serve(data: &tempfile::TempDir) -> Program {
    Start::serve(data.path()).start()
}

#[tokio::test]
async fn an_unreachable_service_is_reported_soon() {
    let closed = std::net::TcpListener::bind("127.0.0.1:0").expect("a port").local_addr().expect("an address");
    let client = Client::of(&format!("http://{closed}"));
    client.put("in.stl", &files::broken_box());
    let started = Instant::now();
    for args in [&["submit", "in.stl"][..], &["watch"], &["watch", "job_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a"]] {
        let finished = client.run(&[args, &["--timeout-s", "1"]].concat()).await;
        finished.ended_with(4).prints("cannot be reached: Connection refused").prints("that the service is running");
    }
    assert!(started.elapsed() < Duration::from_secs(20));
}

#[tokio::test]
async fn an_untrusted_certificate_is_refused_and_the_message_names_the_remedy() {
    let folder = tempfile::tempdir().expect("a folder");
    let authority = folder.path().join("authority.pem");
    let receiver = Receiver::start_tls(&[Reply::Status(404)], &authority).await;
    let client = Client::of(&receiver.url);
    client.put("in.stl", &files::broken_box());
    let finished = client.run(&["submit", "in.stl"]).await;
    finished.ended_with(4).prints("is not trusted").prints("SSL_CERT_FILE");
    let authority = authority.to_str().expect("a path");
    let finished = client.run_with(&["submit", "in.stl"], &[("SSL_CERT_FILE", authority)]).await;
    finished.ended_with(4).prints("404").prints("not as a meshmend service");
}

#[tokio::test]
async fn a_submission_whose_response_is_lost_is_repeated_and_creates_one_job() {
    let data = tempfile::tempdir().expect("a folder");
    let (program, posts) = (serve(&data), AtomicU32::new(0));
    let interceptor = Interceptor::start(&program, move |method, _| match method {
        "POST" if first(&posts) => Action::LoseResponse,
        _ => Action::Pass,
    })
    .await;
    let client = Client::of(&interceptor.url);
    client.put("in.stl", &files::broken_box());
    let finished = client.run(&["submit", "in.stl", "-o", "out.stl", "--max-tier", "1"]).await;
    finished.ended_with(0).prints("; retry in");
    assert_eq!(client.faces("out.stl"), 12);
    assert_eq!(jobs(&Api::new(&program)).await.len(), 1);
}

#[tokio::test]
async fn a_busy_service_is_retried_after_the_time_that_it_gives() {
    let data = tempfile::tempdir().expect("a folder");
    let (program, posts) = (serve(&data), AtomicU32::new(0));
    let interceptor = Interceptor::start(&program, move |method, _| match method {
        "POST" if first(&posts) => Action::Respond(503, "no room"),
        _ => Action::Pass,
    })
    .await;
    let client = Client::of(&interceptor.url);
    client.put("in.stl", &files::broken_box());
    let started = Instant::now();
    let finished = client.run(&["submit", "in.stl", "-o", "out.stl", "--max-tier", "1"]).await;
    finished.ended_with(0).prints("answered 503 Service Unavailable; retry in");
    assert!(started.elapsed() >= Duration::from_secs(1), "the client did not wait");
    // The client gives up on a service that stays busy.
    let full = Interceptor::start(&program, |method, _| match method {
        "POST" => Action::Respond(429, "go away"),
        _ => Action::Pass,
    })
    .await;
    let client = Client { server: full.url.clone(), ..client };
    client.run(&["submit", "in.stl", "--no-wait", "--timeout-s", "2"]).await.ended_with(4).prints("answered 429");
}

#[tokio::test]
async fn a_damaged_download_is_noticed_and_leaves_no_file() {
    let data = tempfile::tempdir().expect("a folder");
    let program = serve(&data);
    let interceptor = Interceptor::start(&program, |_, path| match path.ends_with("/artifacts/model") {
        true => Action::Damage,
        false => Action::Pass,
    })
    .await;
    let client = Client::of(&interceptor.url);
    client.put("in.stl", &files::broken_box());
    let finished = client.run(&["submit", "in.stl", "-o", "out.stl", "--max-tier", "1"]).await;
    finished.ended_with(4).prints("the checksum of the download is wrong").prints("To continue: meshmend watch job_");
    assert_eq!((finished.out.as_str(), client.names()), ("", vec!["in.stl".to_owned()]));
}

#[tokio::test]
async fn without_an_event_stream_the_client_polls_the_job() {
    let data = tempfile::tempdir().expect("a folder");
    let program = serve(&data);
    let interceptor = Interceptor::start(&program, |_, path| match path.ends_with("/events") {
        true => Action::Respond(403, "<html>no streams</html>"),
        false => Action::Pass,
    })
    .await;
    let client = Client::of(&interceptor.url);
    client.put("in.stl", &files::broken_box());
    client.run(&["submit", "in.stl", "-o", "out.stl", "--max-tier", "1"]).await.ended_with(0);
    assert_eq!(client.faces("out.stl"), 12);
}

#[tokio::test]
async fn an_interrupt_leaves_the_job_and_says_how_to_continue() {
    let data = tempfile::tempdir().expect("a folder");
    let program = Start::serve(data.path()).env("MESHMEND_NO_WORKERS", "true").start();
    let (api, client) = (Api::new(&program), Client::of(&program.url));
    client.put("in.stl", &files::broken_box());
    let mut running = client.start(&["submit", "in.stl", "-o", "out.stl"]);
    running.says(": queued").await;
    running.interrupt();
    let id = jobs(&api).await.pop().expect("a job");
    running.ended().await.ended_with(130).prints(&format!("meshmend watch {id} --server {}", program.url));
    assert_eq!(api.job(&id).await["status"], "queued");
    assert_eq!(client.names(), ["in.stl"]);
}
