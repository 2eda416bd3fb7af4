//! The contract of file stores, tested on each: a folder, and a bucket of an S3-compatible server.

use std::convert::Infallible;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use futures::{Stream, StreamExt, TryStreamExt};
use meshmend::access::SystemIds;
use meshmend::blobs::{BlobError, Blobs, Owner, S3Config, Stored, UploadError};
use meshmend::jobs::{JobId, SystemClock, UploadId};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use crate::s3::S3;

/// An hour before now.
fn an_hour_ago() -> SystemTime {
    SystemTime::from(SystemClock.now()) - Duration::from_secs(3600)
}

/// More bytes than two parts of a multipart upload.
const LARGE: usize = 20 << 20;

struct Bench {
    blobs: Blobs,
    folder: TempDir,
    server: Option<S3>,
}

impl Bench {
    fn folder() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        Self { blobs: Blobs::local(folder.path()).expect("a store"), folder, server: None }
    }

    fn bucket() -> Self {
        let (folder, server) = (tempfile::tempdir().expect("a folder"), S3::start());
        let blobs = Blobs::s3(&server.config(folder.path().join("spool"))).expect("a store");
        Self { blobs, folder, server: Some(server) }
    }

    /// The path of a key's file.
    fn place(&self, key: &str) -> PathBuf {
        self.server.as_ref().map_or_else(|| self.folder.path().to_owned(), S3::objects).join(key)
    }

    /// Makes a file and its folders look old.
    fn age(&self, key: &str) {
        let (place, root) = (self.place(key), self.place(""));
        for path in place.ancestors().take_while(|path| *path != root) {
            let file = std::fs::File::open(path).expect("a file");
            file.set_modified(SystemTime::UNIX_EPOCH).expect("a time");
        }
    }

    async fn put(&self, key: &str, bytes: &[u8]) -> Stored {
        self.blobs.put_stream(key, in_chunks(bytes), u64::MAX).await.expect("stored")
    }

    async fn get(&self, key: &str) -> Result<Vec<u8>, BlobError> {
        Ok(self.blobs.get(key, None).await?.try_collect::<Vec<_>>().await?.concat())
    }

    async fn has(&self, key: &str) -> bool {
        match self.get(key).await {
            Ok(_) => true,
            Err(BlobError::NotFound) => false,
            Err(error) => panic!("{key}: {error}"),
        }
    }

    async fn owners(&self) -> Vec<Owner> {
        let mut owners: Vec<_> =
            self.blobs.owners(an_hour_ago()).await.expect("a list").try_collect().await.expect("ids");
        owners.sort();
        owners.dedup();
        owners
    }

    fn leaves_nothing_half(&self) {
        assert_eq!(self.server.as_ref().map_or(0, S3::loose_parts), 0);
        let folders = ["uploads", "spool"].map(|name| std::fs::read_dir(self.folder.path().join(name)));
        assert_eq!(folders.into_iter().flatten().flatten().count(), 0);
    }
}

fn in_chunks(bytes: &[u8]) -> impl Stream<Item = Result<Bytes, Infallible>> + use<> {
    let chunks: Vec<_> = bytes.chunks(100_000).map(|chunk| Ok(Bytes::copy_from_slice(chunk))).collect();
    futures::stream::iter(chunks)
}

/// Bytes without a pattern.
fn some_bytes(count: usize) -> Vec<u8> {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        state.to_be_bytes()[0]
    };
    (0..count).map(|_| next()).collect()
}

fn sha256(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// Runs each test on each store.
macro_rules! on_each_store {
    ($($name:ident),* $(,)?) => {
        mod folder {
            $(#[tokio::test(flavor = "multi_thread")]
            async fn $name() {
                super::$name(super::Bench::folder()).await;
            })*
        }
        mod bucket {
            $(#[tokio::test(flavor = "multi_thread")]
            async fn $name() {
                super::$name(super::Bench::bucket()).await;
            })*
        }
    };
}

on_each_store! {
    a_stored_file_can_be_read_whole_and_in_ranges,
    a_local_file_is_stored_as_it_is,
    an_upload_that_is_too_large_or_breaks_off_leaves_nothing,
    an_upload_whose_client_went_leaves_nothing,
    many_uploads_at_once_all_arrive,
    a_damaged_file_is_never_served_completely,
    deleting_a_job_deletes_its_files_and_no_others,
    only_the_attempt_that_won_keeps_its_files,
    old_files_are_found_and_deleted_unless_their_job_has_a_recent_one,
    the_files_of_one_attempt_are_deleted_without_the_rest_of_its_job,
    an_upload_that_waited_too_long_for_its_job_is_deleted,
    the_probe_of_a_working_store_succeeds,
}

async fn a_stored_file_can_be_read_whole_and_in_ranges(bench: Bench) {
    for count in [0, 1, 8 << 20, LARGE] {
        let bytes = some_bytes(count);
        let stored = bench.put("uploads/x", &bytes).await;
        assert_eq!((stored.bytes, stored.sha256), (count as u64, sha256(&bytes)));
        assert_eq!(stored.head, bytes[..count.min(4096)]);
        assert!(bench.get("uploads/x").await.expect("there") == bytes, "{count} bytes");
        let whole = bench.blobs.get_whole("uploads/x", &sha256(&bytes)).await.expect("there");
        assert!(whole.try_collect::<Vec<_>>().await.expect("sound").concat() == bytes, "{count} bytes");
    }
    let bytes = some_bytes(LARGE);
    for range in [0..1, 5..70_000, LARGE as u64 - 7..LARGE as u64] {
        let part = bench.blobs.get("uploads/x", Some(range.clone())).await.expect("there");
        let part = part.try_collect::<Vec<_>>().await.expect("bytes").concat();
        assert!(part == bytes[range.start as usize..range.end as usize], "{range:?}");
    }
    assert!(matches!(bench.get("uploads/y").await, Err(BlobError::NotFound)));
    bench.blobs.delete("uploads/x").await.expect("deleted");
    bench.blobs.delete("uploads/x").await.expect("deleted before");
    assert!(!bench.has("uploads/x").await);
}

async fn put_file(blobs: &Blobs, key: &str, path: &Path) -> Result<Stored, BlobError> {
    let stored = blobs.put_files(&[(key.to_owned(), path.to_owned())]).await?;
    Ok(stored.into_iter().next().flatten().expect("the file is there"))
}

async fn a_local_file_is_stored_as_it_is(bench: Bench) {
    let path = bench.folder.path().join("local");
    for count in [0, 3000, LARGE] {
        let bytes = some_bytes(count);
        std::fs::write(&path, &bytes).expect("a file");
        let stored = put_file(&bench.blobs, "jobs/x/y/model", &path).await.expect("stored");
        assert_eq!((stored.bytes, &stored.sha256), (count as u64, &sha256(&bytes)));
        assert!(bench.get("jobs/x/y/model").await.expect("there") == bytes, "{count} bytes");
        let copy = bench.folder.path().join("copy");
        bench.blobs.fetch("jobs/x/y/model", &stored.sha256, &copy).await.expect("fetched");
        assert!(std::fs::read(copy).expect("a file") == bytes, "{count} bytes");
    }
}

async fn an_upload_that_is_too_large_or_breaks_off_leaves_nothing(bench: Bench) {
    let bytes = some_bytes(LARGE);
    let refused = bench.blobs.put_stream("uploads/x", in_chunks(&bytes), LARGE as u64 - 1).await;
    assert!(matches!(refused, Err(UploadError::TooLarge(limit)) if limit == LARGE as u64 - 1), "{refused:?}");
    let broken = in_chunks(&bytes).map(|chunk| chunk.map_err(|_| "never")).chain(futures::stream::iter([Err("broke")]));
    let refused = bench.blobs.put_stream("uploads/x", broken, u64::MAX).await;
    assert!(matches!(refused, Err(UploadError::Source("broke"))), "{refused:?}");
    assert!(!bench.has("uploads/x").await);
    bench.leaves_nothing_half();
    bench.blobs.put_stream("uploads/x", in_chunks(&bytes), LARGE as u64).await.expect("just as many as may");
}

async fn an_upload_whose_client_went_leaves_nothing(bench: Bench) {
    let bytes = some_bytes(LARGE);
    let silent = in_chunks(&bytes).chain(futures::stream::pending());
    let upload = bench.blobs.put_stream("uploads/x", silent, u64::MAX);
    assert!(
        tokio::time::timeout(Duration::from_secs(1), upload).await.is_err(),
        "the upload is still waiting for more"
    );
    crate::server::until("nothing is left", async || {
        let left = std::fs::read_dir(bench.folder.path().join("uploads")).into_iter().flatten().count();
        (left == 0).then_some(())
    })
    .await;
    assert!(!bench.has("uploads/x").await);
    bench.leaves_nothing_half();
}

async fn many_uploads_at_once_all_arrive(bench: Bench) {
    // Together more than uploads to a bucket may keep in memory.
    let bytes = some_bytes(9 << 20);
    let uploads = (0..12).map(|number| {
        let (blobs, bytes) = (bench.blobs.clone(), bytes.clone());
        async move { blobs.put_stream(&format!("uploads/{number}"), in_chunks(&bytes), u64::MAX).await }
    });
    for stored in futures::future::join_all(uploads).await {
        assert_eq!(stored.expect("stored").sha256, sha256(&bytes));
    }
}

async fn a_damaged_file_is_never_served_completely(bench: Bench) {
    let mut bytes = some_bytes(1 << 20);
    let stored = bench.put("uploads/x", &bytes).await;
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    std::fs::write(bench.place("uploads/x"), &bytes).expect("damage");
    let mut whole = bench.blobs.get_whole("uploads/x", &stored.sha256).await.expect("there");
    let mut came = 0;
    let error = loop {
        match whole.try_next().await {
            Ok(Some(chunk)) => came += chunk.len(),
            Ok(None) => panic!("the file ended"),
            Err(error) => break error,
        }
    };
    assert!(came < bytes.len());
    let found = sha256(&bytes);
    assert!(matches!(&error, BlobError::Damaged { found: other, .. } if *other == found), "{error}");
    assert!(!error.is_transient());
    let copy = bench.folder.path().join("copy");
    let fetched = bench.blobs.fetch("uploads/x", &stored.sha256, &copy).await;
    assert!(matches!(fetched, Err(BlobError::Damaged { .. })), "{fetched:?}");
}

/// A job with two files, and one file of each of two attempts.
async fn a_job(bench: &Bench) -> (JobId, [String; 4]) {
    let id = JobId::new(&SystemIds);
    let keys = [
        Blobs::input_key(id, 0),
        Blobs::input_key(id, 1),
        Blobs::artifact_key(id, "one", "model"),
        Blobs::artifact_key(id, "two", "model"),
    ];
    for key in &keys {
        bench.put(key, b"x").await;
    }
    (id, keys)
}

async fn deleting_a_job_deletes_its_files_and_no_others(bench: Bench) {
    let ((id, keys), (_, others)) = (a_job(&bench).await, a_job(&bench).await);
    bench.blobs.delete_job(id).await.expect("deleted");
    bench.blobs.delete_job(id).await.expect("deleted before");
    for (key, other) in keys.iter().zip(&others) {
        assert!(!bench.has(key).await, "{key}");
        assert!(bench.has(other).await, "{other}");
    }
}

async fn only_the_attempt_that_won_keeps_its_files(bench: Bench) {
    let (id, keys) = a_job(&bench).await;
    bench.blobs.delete_attempts(id, Some("two")).await.expect("deleted");
    for (key, stays) in keys.iter().zip([true, true, false, true]) {
        assert_eq!(bench.has(key).await, stays, "{key}");
    }
}

async fn old_files_are_found_and_deleted_unless_their_job_has_a_recent_one(bench: Bench) {
    let mut jobs = [a_job(&bench).await, a_job(&bench).await, a_job(&bench).await];
    jobs.sort();
    let [(old, of_old), (growing, of_growing), (young, _)] = &jobs;
    for key in of_old.iter().chain(&of_growing[..3]) {
        bench.age(key);
    }
    bench.put("probe/left", b"x").await;
    bench.age("probe/left");
    let owners = bench.owners().await;
    for claim in [None, Some("one"), Some("two")] {
        let claim = claim.map(str::to_owned);
        assert!(owners.contains(&Owner { job: *old, claim }), "{owners:?}");
    }
    assert!(owners.iter().all(|owner| owner.job != *young), "{owners:?}");
    for (id, goes) in [(old, true), (growing, false), (young, false)] {
        assert_eq!(bench.blobs.delete_stale_job(*id, an_hour_ago()).await.expect("a result"), goes);
    }
    for (id, keys) in &jobs {
        assert_eq!(bench.has(&keys[3]).await, id != old);
        assert_eq!(bench.has(&keys[0]).await, id != old);
    }
    assert!(bench.owners().await.iter().all(|owner| owner.job == *growing));
}

async fn the_files_of_one_attempt_are_deleted_without_the_rest_of_its_job(bench: Bench) {
    let (id, keys) = a_job(&bench).await;
    bench.blobs.delete_claim(id, "one").await.expect("deleted");
    bench.blobs.delete_claim(id, "one").await.expect("deleted before");
    for (key, stays) in keys.iter().zip([true, true, false, true]) {
        assert_eq!(bench.has(key).await, stays, "{key}");
    }
}

async fn an_upload_that_waited_too_long_for_its_job_is_deleted(bench: Bench) {
    bench.blobs.delete_stale_incoming(an_hour_ago()).await.expect("nothing to delete");
    let [old, young] = [UploadId::new(&SystemIds), UploadId::new(&SystemIds)].map(Blobs::incoming_key);
    for key in [&old, &young] {
        bench.put(key, b"12345").await;
        assert_eq!(bench.blobs.bytes(key).await.expect("there"), 5);
    }
    // The state that a killed server leaves.
    let half = bench.folder.path().join(format!("{old}#1"));
    if bench.server.is_none() {
        std::fs::write(&half, b"1").expect("a file");
        bench.age(&format!("{old}#1"));
    }
    bench.age(&old);
    bench.blobs.delete_stale_incoming(an_hour_ago()).await.expect("deleted");
    assert!(matches!(bench.blobs.bytes(&old).await, Err(BlobError::NotFound)));
    assert!(bench.has(&young).await && !half.exists());
}

async fn the_probe_of_a_working_store_succeeds(bench: Bench) {
    bench.blobs.probe(&SystemIds).await.expect("it works");
    assert!(bench.blobs.free_bytes().expect("a result").is_some_and(|free| free > 0));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_unreachable_bucket_fails_soon_with_a_transient_error_and_works_again_later() {
    let mut bench = Bench::bucket();
    let kept = bench.put("uploads/x", b"x").await;
    bench.server.as_mut().expect("a server").kill();
    let path = bench.folder.path().join("large");
    std::fs::write(&path, some_bytes(LARGE)).expect("a file");
    let all = async {
        let away = [
            bench.get("uploads/x").await.map(drop),
            bench.blobs.fetch("uploads/x", &kept.sha256, &path.with_extension("copy")).await,
            put_file(&bench.blobs, "uploads/y", &path).await.map(drop),
            bench.blobs.delete("uploads/x").await,
            bench.blobs.delete_job(JobId::new(&SystemIds)).await,
            bench.blobs.probe(&SystemIds).await,
        ];
        for (number, result) in away.into_iter().enumerate() {
            assert!(result.as_ref().is_err_and(BlobError::is_transient), "{number}: {result:?}");
        }
    };
    tokio::time::timeout(Duration::from_secs(120), all).await.expect("soon");
    bench.server.as_mut().expect("a server").restart();
    assert_eq!(bench.get("uploads/x").await.expect("kept"), b"x");
    assert!(!bench.has("uploads/y").await);
    put_file(&bench.blobs, "uploads/y", &path).await.expect("stored");
    bench.leaves_nothing_half();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bucket_killed_during_an_upload_has_the_whole_file_or_nothing() {
    let mut bench = Bench::bucket();
    let (path, bytes) = (bench.folder.path().join("large"), some_bytes(4 * LARGE));
    std::fs::write(&path, &bytes).expect("a file");
    let blobs = bench.blobs.clone();
    let upload = tokio::spawn(async move { put_file(&blobs, "uploads/x", &path).await });
    let server = bench.server.as_mut().expect("a server");
    while server.loose_parts() < 3 {
        tokio::task::yield_now().await;
    }
    server.kill();
    server.restart();
    match upload.await.expect("no panic") {
        Ok(stored) => assert_eq!(stored.sha256, sha256(&bytes)),
        Err(error) => assert!(error.is_transient(), "{error}"),
    }
    match bench.get("uploads/x").await {
        Ok(found) => assert!(found == bytes),
        Err(error) => assert!(matches!(error, BlobError::NotFound), "{error}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_misconfigured_bucket_is_distinguished_from_an_unreachable_one() {
    let bench = Bench::bucket();
    let config = bench.server.as_ref().expect("a server").config(bench.folder.path().join("spool"));
    for url in ["", "meshmend", "s3://", "s3:///x", "s3://a b/c", "https://bucket.example.com/x", "s3://bucket/a//x"] {
        let opened = Blobs::s3(&S3Config { url: url.to_owned(), ..config.clone() });
        assert!(matches!(opened, Err(BlobError::Address(_))), "{url}");
    }
    let plain = Blobs::s3(&S3Config { allow_http: false, ..config.clone() });
    assert!(plain.is_err_and(|error| error.to_string().contains("--s3-allow-http")));
    let strangers = S3Config { credentials: Some(("test-key".into(), "guessed".into())), ..config };
    let probe = Blobs::s3(&strangers).expect("opened").probe(&SystemIds).await;
    assert!(probe.as_ref().is_err_and(|error| !error.is_transient()), "{probe:?}");
}
