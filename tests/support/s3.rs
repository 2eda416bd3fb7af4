//! An S3-compatible server for one test: s3s on a temporary folder, which can be killed and restarted.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use hyper::server::conn::http1;
use hyper_util::rt::TokioIo;
use meshmend::blobs::S3Config;
use s3s::auth::SimpleAuth;
use s3s::service::{S3Service, S3ServiceBuilder};
use s3s_fs::FileSystem;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;

use crate::server::{Start, files_below};

const BUCKET: &str = "meshmend-files";
const PREFIX: &str = "of/tests";
const KEY: (&str, &str) = ("test-key", "test-secret");

/// A running server, or one that was killed.
pub struct S3 {
    bucket: String,
    prefix: String,
    key: (String, String),
    folder: TempDir,
    address: SocketAddr,
    runtime: Option<Runtime>,
}

impl S3 {
    /// Starts a server with an empty bucket.
    pub fn start() -> Self {
        Self::start_with(&format!("s3://{BUCKET}/{PREFIX}"), KEY.0, KEY.1)
    }

    /// Starts a server with the bucket of this URL, `s3://BUCKET/PREFIX`, and with one key.
    pub fn start_with(url: &str, key: &str, secret: &str) -> Self {
        let (bucket, prefix) = url.strip_prefix("s3://").and_then(|rest| rest.split_once('/')).expect("a URL");
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::create_dir(folder.path().join(bucket)).expect("a bucket");
        let mut server = Self {
            bucket: bucket.to_owned(),
            prefix: prefix.to_owned(),
            key: (key.to_owned(), secret.to_owned()),
            folder,
            address: ([127, 0, 0, 1], 0).into(),
            runtime: None,
        };
        server.restart();
        server
    }

    /// Stops the server with all of its connections at once.
    pub fn kill(&mut self) {
        let runtime = self.runtime.take().expect("a running server");
        // A runtime must not end within another one.
        let ended = std::thread::spawn(move || runtime.shutdown_timeout(Duration::from_secs(20)));
        ended.join().expect("an end");
    }

    /// Starts the server again with the same files and address.
    pub fn restart(&mut self) {
        let mut service = S3ServiceBuilder::new(FileSystem::new(self.folder.path()).expect("a folder"));
        service.set_auth(SimpleAuth::from_single(self.key.0.clone(), self.key.1.clone()));
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.expect("a runtime");
        let asked = self.address;
        let deadline = Instant::now() + Duration::from_secs(20);
        let listener = loop {
            // In a separate thread, since tests run within a runtime.
            let handle = runtime.handle().clone();
            let bound = std::thread::spawn(move || handle.block_on(TcpListener::bind(asked)));
            match bound.join().expect("an answer") {
                Ok(listener) => break listener,
                Err(error) => assert!(Instant::now() < deadline, "{asked}: {error}"),
            }
            std::thread::sleep(Duration::from_millis(20));
        };
        self.address = listener.local_addr().expect("an address");
        runtime.spawn(serve(listener, service.build()));
        self.runtime = Some(runtime);
    }

    /// The configuration of a client.
    pub fn config(&self, spool: PathBuf) -> S3Config {
        S3Config {
            url: self.url(),
            endpoint: Some(self.endpoint()),
            credentials: Some(self.key.clone()),
            allow_http: true,
            spool,
            ..S3Config::default()
        }
    }

    /// Tells a program to keep its files here.
    pub fn store_files_of<'a>(&self, program: Start<'a>) -> Start<'a> {
        program
            .env("MESHMEND_BLOB_URL", &self.url())
            .env("MESHMEND_S3_ENDPOINT", &self.endpoint())
            .env("MESHMEND_S3_ACCESS_KEY_ID", &self.key.0)
            .env("MESHMEND_S3_SECRET_ACCESS_KEY", &self.key.1)
            .env("MESHMEND_S3_ALLOW_HTTP", "true")
    }

    fn url(&self) -> String {
        format!("s3://{}/{}", self.bucket, self.prefix)
    }

    /// The server's address.
    pub fn endpoint(&self) -> String {
        format!("http://{}", self.address)
    }

    /// The folder of the objects, one file each.
    pub fn objects(&self) -> PathBuf {
        self.folder.path().join(&self.bucket).join(&self.prefix)
    }

    /// The keys of all objects.
    pub fn files(&self) -> Vec<String> {
        let root = self.objects();
        let key = |path: PathBuf| path.strip_prefix(&root).expect("inside").to_string_lossy().into_owned();
        files_below(&root).into_iter().map(key).collect()
    }

    /// Parts of uploads that were neither completed nor aborted.
    pub fn loose_parts(&self) -> usize {
        let entries = std::fs::read_dir(self.folder.path()).expect("a folder").flatten();
        entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(".upload")).count()
    }
}

impl Drop for S3 {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

async fn serve(listener: TcpListener, service: S3Service) {
    while let Ok((stream, _)) = listener.accept().await {
        // Otherwise each response's body waits until the client acknowledges its head.
        let _ = stream.set_nodelay(true);
        let connection = http1::Builder::new().serve_connection(TokioIo::new(stream), service.clone());
        tokio::spawn(async move {
            let _ = connection.await;
        });
    }
}
