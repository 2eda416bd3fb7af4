//! A bucket of an S3-compatible store: its address and credentials, and uploads in parts of a size that S3 accepts.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use bytes::{Bytes, BytesMut};
use object_store::aws::{AmazonS3, AmazonS3Builder, AmazonS3ConfigKey, AwsCredential};
use object_store::path::Path as Key;
use object_store::prefix::PrefixStore;
use object_store::signer::Signer;
use object_store::{
    BackoffConfig, ClientOptions, MultipartUpload, ObjectStoreExt, RetryConfig, StaticCredentialProvider,
};
use tokio::fs::File;
use tokio::io::{AsyncReadExt, AsyncSeekExt};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::stored::{BlobError, CHUNK, Stored, Summary};
use crate::tls::use_ring;

/// The size of each part of a file except the last, in bytes. S3 requires at least 5 MiB, and at most 10,000 parts.
const PART: u64 = 8 << 20;
/// The memory that all parts under way may use together, in KiB.
const MEMORY_KIB: u32 = 64 << 10;
/// The time limit for connecting.
const CONNECT: Duration = Duration::from_secs(5);
/// The longest time without data in a response. It also limits the sending of a part, since the response starts only after it.
const READ_TIMEOUT: Duration = Duration::from_secs(30);
/// How often a request with a transient error is retried.
const RETRIES: usize = 3;
/// For how long a request with a transient error is retried.
const RETRY_TIME: Duration = Duration::from_secs(10);

/// The address of a bucket and the credentials for it.
#[derive(Clone, Default)]
pub struct S3Config {
    /// The bucket and the folder in it, as `s3://bucket/prefix`.
    pub url: String,
    /// The store's address. Without it, that of the environment (`AWS_ENDPOINT_URL`), or else AWS.
    pub endpoint: Option<String>,
    /// The address at which clients reach the store, if it differs from `endpoint`.
    pub public_endpoint: Option<String>,
    /// The region. Without it, that of the environment (`AWS_REGION`), or else us-east-1.
    pub region: Option<String>,
    /// The access key's id and secret. Without them, the credentials that the environment provides to AWS programs.
    pub credentials: Option<(String, String)>,
    /// Whether the endpoint may be reached without TLS.
    pub allow_http: bool,
    /// The local folder for files on their way into the store; created if missing.
    pub spool: PathBuf,
}

/// A folder of a bucket.
#[derive(Debug, Clone)]
pub(super) struct Bucket {
    store: Arc<PrefixStore<AmazonS3>>,
    /// The same folder at the address for clients.
    public: Arc<PrefixStore<AmazonS3>>,
    /// The local folder for files on their way into the store.
    pub spool: PathBuf,
    memory: Arc<Semaphore>,
}

impl Bucket {
    /// Opens the bucket without sending a request, and creates the spool folder.
    ///
    /// # Errors
    /// When the address or the endpoint can't be used, or the spool folder can't be created.
    pub fn open(config: &S3Config) -> Result<Self, BlobError> {
        use_ring();
        std::fs::create_dir_all(&config.spool)?;
        let address = || {
            BlobError::Address(format!("the address must be s3://bucket or s3://bucket/prefix; got '{}'", config.url))
        };
        let path = config.url.strip_prefix("s3://").ok_or_else(address)?;
        let (bucket, prefix) = path.split_once('/').unwrap_or((path, ""));
        let is_allowed = |c: char| c.is_ascii_alphanumeric() || "-._".contains(c);
        if bucket.is_empty() || !bucket.chars().all(is_allowed) {
            return Err(address());
        }
        let prefix = Key::parse(prefix).map_err(|_| address())?;
        let open = |endpoint: Option<&String>| -> Result<_, BlobError> {
            Ok(Arc::new(PrefixStore::new(client(config, bucket, endpoint)?, prefix.clone())))
        };
        let store = open(config.endpoint.as_ref())?;
        let public = match &config.public_endpoint {
            Some(endpoint) => open(Some(endpoint))?,
            None => Arc::clone(&store),
        };
        let memory = Arc::new(Semaphore::new(MEMORY_KIB as usize));
        Ok(Self { store, public, spool: config.spool.clone(), memory })
    }

    /// The folder as an object store.
    pub fn store(&self) -> Arc<PrefixStore<AmazonS3>> {
        Arc::clone(&self.store)
    }

    /// The folder at the address for clients, for signing addresses.
    pub fn public(&self) -> &impl Signer {
        self.public.as_ref()
    }

    /// An unnamed file on the local disk, which vanishes however this process ends.
    pub async fn spool_file(&self) -> Result<File, BlobError> {
        let folder = self.spool.clone();
        let file = tokio::task::spawn_blocking(move || tempfile::tempfile_in(folder)).await;
        Ok(File::from_std(file.map_err(std::io::Error::from)??))
    }

    /// Stores a local file: a small one by a single request, a larger one in parts.
    pub async fn send(&self, key: Key, file: File) -> Result<Stored, BlobError> {
        let this = self.clone();
        // A separate task, so that a caller that gives up does not leave parts in the bucket that are never completed or aborted.
        let sent = tokio::spawn(async move { this.send_whole(&key, file).await });
        sent.await.map_err(std::io::Error::from)?
    }

    async fn send_whole(&self, key: &Key, mut file: File) -> Result<Stored, BlobError> {
        let bytes = file.metadata().await?.len();
        file.rewind().await?;
        // The file's own buffer is not counted as memory of parts.
        file.set_max_buf_size(CHUNK);
        let mut summary = Summary::default();
        if bytes <= PART {
            let (part, _memory) = self.read_part(&mut file, bytes, &mut summary).await?;
            self.store.put(key, part.into()).await?;
            return Ok(summary.finish());
        }
        let mut upload = self.store.put_multipart(key).await?;
        let sent = self.send_parts(upload.as_mut(), &mut file, bytes, &mut summary).await;
        if let Err(failure) = sent {
            if let Err(error) = upload.abort().await {
                tracing::warn!(%error, %key, "could not abort a failed upload; its parts remain in the bucket");
            }
            return Err(failure);
        }
        Ok(summary.finish())
    }

    async fn send_parts(
        &self,
        upload: &mut dyn MultipartUpload,
        file: &mut File,
        bytes: u64,
        summary: &mut Summary,
    ) -> Result<(), BlobError> {
        let mut remaining = bytes;
        while remaining > 0 {
            let (part, _memory) = self.read_part(file, remaining.min(PART), summary).await?;
            remaining -= part.len() as u64;
            upload.put_part(part.into()).await?;
        }
        upload.complete().await?;
        Ok(())
    }

    /// Reads the next bytes of a file. The returned permit reserves the memory that they use.
    async fn read_part(
        &self,
        file: &mut File,
        bytes: u64,
        summary: &mut Summary,
    ) -> Result<(Bytes, OwnedSemaphorePermit), BlobError> {
        let kib = u32::try_from(bytes.div_ceil(1024)).unwrap_or(MEMORY_KIB).min(MEMORY_KIB);
        let memory = Arc::clone(&self.memory).acquire_many_owned(kib).await.map_err(std::io::Error::other)?;
        let mut part = BytesMut::zeroed(usize::try_from(bytes).map_err(std::io::Error::other)?);
        file.read_exact(&mut part).await?;
        summary.add(&part);
        Ok((part.freeze(), memory))
    }
}

fn client(config: &S3Config, bucket: &str, endpoint: Option<&String>) -> Result<AmazonS3, BlobError> {
    let backoff = BackoffConfig { max_backoff: Duration::from_secs(2), ..BackoffConfig::default() };
    let options = ClientOptions::new()
        .with_timeout_disabled()
        .with_connect_timeout(CONNECT)
        .with_read_timeout(READ_TIMEOUT)
        .with_allow_http(config.allow_http);
    let mut builder = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_client_options(options)
        .with_retry(RetryConfig { backoff, max_retries: RETRIES, retry_timeout: RETRY_TIME });
    if let Some(endpoint) = endpoint {
        // This key takes precedence over the others that the environment may set.
        builder = builder.with_config(AmazonS3ConfigKey::S3Endpoint, endpoint);
    }
    if let Some(region) = &config.region {
        builder = builder.with_region(region);
    }
    if let Some((key_id, secret_key)) = config.credentials.clone() {
        let credential = AwsCredential { key_id, secret_key, token: None };
        builder = builder.with_credentials(Arc::new(StaticCredentialProvider::new(credential)));
    }
    let endpoint = [AmazonS3ConfigKey::S3Endpoint, AmazonS3ConfigKey::Endpoint];
    let endpoint = endpoint.iter().find_map(|key| builder.get_config_value(key)).unwrap_or_default();
    if !config.allow_http && endpoint.starts_with("http://") {
        let detail = format!(
            "the endpoint '{endpoint}' has no TLS; use an https:// address, or set --s3-allow-http true on a trusted network"
        );
        return Err(BlobError::Address(detail));
    }
    Ok(builder.build()?)
}
