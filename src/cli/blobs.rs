use std::path::{Path, PathBuf};

use clap::{ArgAction, Args};
use meshmend::blobs::{BlobError, Blobs, S3Config};

/// Where the service keeps files.
#[derive(Debug, Args)]
pub struct BlobArgs {
    /// Bucket of an S3-compatible store that keeps the files, as s3://bucket or s3://bucket/prefix; without it, the data folder. Any
    /// number of processes may share one.
    #[arg(long, env = "MESHMEND_BLOB_URL")]
    blob_url: Option<String>,
    /// Address of a store that is not AWS, such as https://s3.example.com.
    #[arg(long, env = "MESHMEND_S3_ENDPOINT", requires = "blob_url")]
    s3_endpoint: Option<String>,
    /// Address at which clients reach the store, where it is not the one at which this service does.
    #[arg(long, env = "MESHMEND_S3_PUBLIC_ENDPOINT", requires = "blob_url")]
    s3_public_endpoint: Option<String>,
    /// Region of the bucket; without it AWS_REGION, or us-east-1.
    #[arg(long, env = "MESHMEND_S3_REGION", requires = "blob_url")]
    s3_region: Option<String>,
    /// Access key id; without it, whatever credentials the environment offers in AWS' ways.
    #[arg(long, env = "MESHMEND_S3_ACCESS_KEY_ID", hide_env_values = true, requires = "s3_secret_access_key")]
    s3_access_key_id: Option<String>,
    /// Secret of the access key.
    #[arg(long, env = "MESHMEND_S3_SECRET_ACCESS_KEY", hide_env_values = true, requires = "s3_access_key_id")]
    s3_secret_access_key: Option<String>,
    /// Talk to the store without TLS, where its address says http and the network can be trusted.
    #[arg(long, env = "MESHMEND_S3_ALLOW_HTTP", default_value_t = false, action = ArgAction::Set)]
    s3_allow_http: bool,
}

/// The folder of the files where no bucket keeps them.
pub fn folder(data_dir: &Path) -> PathBuf {
    data_dir.join("files")
}

impl BlobArgs {
    pub fn open(&self, data_dir: &Path) -> Result<Blobs, BlobError> {
        let Some(url) = &self.blob_url else { return Blobs::local(&folder(data_dir)) };
        Blobs::s3(&S3Config {
            url: url.clone(),
            endpoint: self.s3_endpoint.clone(),
            public_endpoint: self.s3_public_endpoint.clone(),
            region: self.s3_region.clone(),
            credentials: self.s3_access_key_id.clone().zip(self.s3_secret_access_key.clone()),
            allow_http: self.s3_allow_http,
            spool: data_dir.join("spool"),
        })
    }
}
