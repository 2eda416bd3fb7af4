//! Whole jobs on PostgreSQL and a bucket: the requests to the bucket, and what stays in the database.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

use crate::drive::drive;
use crate::models::Model;
use crate::postgres::Postgres;
use crate::requests::service;
use crate::s3::S3;
use crate::server::Start;
use crate::{LOG, database, end};

const JOBS: usize = 100;
const METHODS: [&str; 5] = ["GET", "HEAD", "PUT", "POST", "DELETE"];

type Counts = Arc<Mutex<BTreeMap<&'static str, usize>>>;

/// Runs jobs through one process, and prints what each costs the bucket and the database.
pub async fn print(data: &Path) {
    let (cluster, bucket) = (Postgres::start_with(true), S3::start());
    let counts = Counts::default();
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = format!("http://{}", listener.local_addr().expect("an address"));
    let server = bucket.endpoint().replace("http://", "");
    let counting = Arc::clone(&counts);
    let proxy = tokio::spawn(async move {
        while let Ok((client, _)) = listener.accept().await {
            tokio::spawn(pass_on(client, server.clone(), Arc::clone(&counting)));
        }
    });
    let folder = data.join("bucket");
    let start = Start::serve(&folder).arg("--log", LOG).arg("--database-url", cluster.url());
    let program = bucket.store_files_of(start).env("MESHMEND_S3_ENDPOINT", &address).start();
    drive(&service(&program), Model::Box, 0..1, 1).await;
    counts.lock().expect("not poisoned").clear();
    let (before, size_before) = (database::Usage::of(Some(&cluster)).await, database::size(&cluster).await);
    drive(&service(&program), Model::Box, 1..JOBS + 1, 4).await;
    let requests = counts.lock().expect("not poisoned").clone();
    let size = database::size(&cluster).await;
    end(program);
    println!("\na job of a box, with its download, on PostgreSQL and a bucket");
    let shares = requests.iter().map(|(method, count)| format!("{:.1} {method}", *count as f64 / JOBS as f64));
    println!("{:44} {}", "  requests to the bucket", shares.collect::<Vec<_>>().join(", "));
    if let (Some(before), Some(after)) = (before, database::Usage::of(Some(&cluster)).await) {
        println!("{:44} {}", "  the database", after.since(&before).per_job(JOBS));
    }
    println!(
        "{:44} {:.1} rows, {:.1} KiB with indexes",
        "  what stays in the database",
        (size.0 - size_before.0) as f64 / JOBS as f64,
        (size.1 - size_before.1) as f64 / JOBS as f64 / 1024.0
    );
    proxy.abort();
}

/// Forwards a connection, and counts the requests on it by the starts of their lines.
async fn pass_on(client: TcpStream, server: String, counts: Counts) -> std::io::Result<()> {
    let (mut from_client, mut to_client) = client.into_split();
    let (mut from_server, mut to_server) = TcpStream::connect(server).await?.into_split();
    let back = tokio::spawn(async move { tokio::io::copy(&mut from_server, &mut to_client).await });
    let mut bytes = vec![0; 64 << 10];
    loop {
        let length = from_client.read(&mut bytes).await?;
        if length == 0 {
            break;
        }
        // A client sends its next request after the answer, so a request begins a piece.
        if let Some(method) = METHODS.into_iter().find(|method| bytes[..length].starts_with(method.as_bytes())) {
            *counts.lock().expect("not poisoned").entry(method).or_default() += 1;
        }
        to_server.write_all(&bytes[..length]).await?;
    }
    to_server.shutdown().await?;
    drop(back);
    Ok(())
}
