//! What a bucket of an S3-compatible store needs beside object_store: an address and credentials, and parts of a size that S3
//! takes.

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

use super::stored::{Account, BlobError, CHUNK, Stored};
use crate::tls::use_ring;

/// Bytes of each part of a file but the last. S3 wants at least 5 MiB, and at most 10,000 parts.
const PART: u64 = 8 << 20;
/// Memory that all parts under way may take together, in KiB.
const MEMORY_KIB: u32 = 64 << 10;
/// Longest time to connect.
const CONNECT: Duration = Duration::from_secs(5);
/// Longest silence: of an answer, from the end of which a part must have been sent too, and in the midst of a file.
const SILENCE: Duration = Duration::from_secs(30);
/// How often, and for how long, a request is tried again that failed for a reason that may pass.
const RETRIES: usize = 3;
const RETRY_TIME: Duration = Duration::from_secs(10);

/// Where a bucket is and how to be let in.
#[derive(Clone, Default)]
pub struct S3Config {
    /// The bucket and the folder in it, as `s3://bucket/prefix`.
    pub url: String,
    /// Address of the store; without it that of AWS, unless the environment names one (`AWS_ENDPOINT_URL`).
    pub endpoint: Option<String>,
    /// Address at which clients reach the store, where it is another one than `endpoint`.
    pub public_endpoint: Option<String>,
    /// The region; without it that of the environment (`AWS_REGION`), or us-east-1.
    pub region: Option<String>,
    /// Access key id and secret; without them whatever the environment offers, as AWS' own programs take it.
    pub credentials: Option<(String, String)>,
    /// Whether the endpoint may be reached without TLS.
    pub allow_http: bool,
    /// Local folder for what is on its way into the store; made if missing.
    pub spool: PathBuf,
}

/// A folder of a bucket.
#[derive(Debug, Clone)]
pub(super) struct Bucket {
    store: Arc<PrefixStore<AmazonS3>>,
    public: Arc<PrefixStore<AmazonS3>>,
    pub spool: PathBuf,
    memory: Arc<Semaphore>,
}

impl Bucket {
    pub fn open(config: &S3Config) -> Result<Self, BlobError> {
        use_ring();
        std::fs::create_dir_all(&config.spool)?;
        let address = || BlobError::Address(format!("'{}' is not like s3://bucket or s3://bucket/prefix", config.url));
        let path = config.url.strip_prefix("s3://").ok_or_else(address)?;
        let (bucket, prefix) = path.split_once('/').unwrap_or((path, ""));
        let is_fine = |c: char| c.is_ascii_alphanumeric() || "-._".contains(c);
        if bucket.is_empty() || !bucket.chars().all(is_fine) {
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

    pub fn store(&self) -> Arc<PrefixStore<AmazonS3>> {
        Arc::clone(&self.store)
    }

    /// The same as clients reach it.
    pub fn public(&self) -> &impl Signer {
        self.public.as_ref()
    }

    /// A file on the local disk that has no name, so that it goes however this process ends.
    pub async fn spool_file(&self) -> Result<File, BlobError> {
        let folder = self.spool.clone();
        let file = tokio::task::spawn_blocking(move || tempfile::tempfile_in(folder)).await;
        Ok(File::from_std(file.map_err(std::io::Error::from)??))
    }

    /// Stores a local file, as one request where it is small.
    pub async fn send(&self, key: Key, file: File) -> Result<Stored, BlobError> {
        let this = self.clone();
        // Whoever waits for this may give up, and parts of a file that nobody completes or aborts would stay for ever.
        let sent = tokio::spawn(async move { this.send_whole(&key, file).await });
        sent.await.map_err(std::io::Error::from)?
    }

    async fn send_whole(&self, key: &Key, mut file: File) -> Result<Stored, BlobError> {
        let bytes = file.metadata().await?.len();
        file.rewind().await?;
        // Its buffer is beside the part, and not counted.
        file.set_max_buf_size(CHUNK);
        let mut account = Account::default();
        if bytes <= PART {
            let (part, _memory) = self.read_part(&mut file, bytes, &mut account).await?;
            self.store.put(key, part.into()).await?;
            return Ok(account.stored());
        }
        let mut upload = self.store.put_multipart(key).await?;
        let sent = self.send_parts(upload.as_mut(), &mut file, bytes, &mut account).await;
        if let Err(failure) = sent {
            if let Err(error) = upload.abort().await {
                tracing::warn!(%error, %key, "parts of a broken upload were left in the bucket");
            }
            return Err(failure);
        }
        Ok(account.stored())
    }

    async fn send_parts(
        &self,
        upload: &mut dyn MultipartUpload,
        file: &mut File,
        bytes: u64,
        account: &mut Account,
    ) -> Result<(), BlobError> {
        let mut left = bytes;
        while left > 0 {
            let (part, _memory) = self.read_part(file, left.min(PART), account).await?;
            left -= part.len() as u64;
            upload.put_part(part.into()).await?;
        }
        upload.complete().await?;
        Ok(())
    }

    /// The next bytes of a file, and the hold on the memory that they take.
    async fn read_part(
        &self,
        file: &mut File,
        bytes: u64,
        account: &mut Account,
    ) -> Result<(Bytes, OwnedSemaphorePermit), BlobError> {
        let kib = u32::try_from(bytes.div_ceil(1024)).unwrap_or(MEMORY_KIB).min(MEMORY_KIB);
        let memory = Arc::clone(&self.memory).acquire_many_owned(kib).await.map_err(std::io::Error::other)?;
        let mut part = BytesMut::zeroed(usize::try_from(bytes).map_err(std::io::Error::other)?);
        file.read_exact(&mut part).await?;
        account.add(&part);
        Ok((part.freeze(), memory))
    }
}

fn client(config: &S3Config, bucket: &str, endpoint: Option<&String>) -> Result<AmazonS3, BlobError> {
    let backoff = BackoffConfig { max_backoff: Duration::from_secs(2), ..BackoffConfig::default() };
    let options = ClientOptions::new()
        .with_timeout_disabled()
        .with_connect_timeout(CONNECT)
        .with_read_timeout(SILENCE)
        .with_allow_http(config.allow_http);
    let mut builder = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_client_options(options)
        .with_retry(RetryConfig { backoff, max_retries: RETRIES, retry_timeout: RETRY_TIME });
    if let Some(endpoint) = endpoint {
        // The one that goes before all others that the environment may name.
        builder = builder.with_config(AmazonS3ConfigKey::S3Endpoint, endpoint);
    }
    if let Some(region) = &config.region {
        builder = builder.with_region(region);
    }
    if let Some((key_id, secret_key)) = config.credentials.clone() {
        let credential = AwsCredential { key_id, secret_key, token: None };
        builder = builder.with_credentials(Arc::new(StaticCredentialProvider::new(credential)));
    }
    let used = [AmazonS3ConfigKey::S3Endpoint, AmazonS3ConfigKey::Endpoint];
    let used = used.iter().find_map(|key| builder.get_config_value(key)).unwrap_or_default();
    if !config.allow_http && used.starts_with("http://") {
        let detail = format!("the endpoint '{used}' has no TLS; on a network that you trust, say --s3-allow-http true");
        return Err(BlobError::Address(detail));
    }
    Ok(builder.build()?)
}
