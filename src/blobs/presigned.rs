//! Addresses of single files that need no credentials and are good for a while, so that bytes need not pass through the service.

use std::time::Duration;

use object_store::path::Path as Key;
use object_store::signer::{Method, SignedUrlOptions, Signer};

use super::{BlobError, Blobs, Place};

/// How long an address is good that nobody asks.
const SHORTEST: Duration = Duration::from_secs(1);

impl Blobs {
    /// An address that answers with a file and these two headers; none where the store is a folder.
    ///
    /// # Errors
    /// When there are no credentials to sign with.
    pub async fn presigned_get(
        &self,
        key: &str,
        life: Duration,
        content_disposition: &str,
        content_type: &str,
    ) -> Result<Option<String>, BlobError> {
        let answer = [("response-content-disposition", content_disposition), ("response-content-type", content_type)];
        self.presigned(Method::GET, key, life, &SignedUrlOptions::new().with_query(answer)).await
    }

    /// An address that takes a file's bytes as the body of a PUT, as often as it is sent; none where the store is a folder. How many
    /// bytes that may be can't be said in it.
    ///
    /// # Errors
    /// When there are no credentials to sign with.
    pub async fn presigned_put(&self, key: &str, life: Duration) -> Result<Option<String>, BlobError> {
        self.presigned(Method::PUT, key, life, &SignedUrlOptions::new()).await
    }

    /// The origin of those addresses, such as `https://bucket.s3.amazonaws.com`; none where the store is a folder, or nothing can be
    /// signed now.
    pub async fn public_origin(&self) -> Option<String> {
        let any = self.presigned(Method::GET, "origin", SHORTEST, &SignedUrlOptions::new()).await;
        let address = url::Url::parse(&any.ok().flatten()?).ok()?;
        Some(address.origin().ascii_serialization())
    }

    async fn presigned(
        &self,
        method: Method,
        key: &str,
        life: Duration,
        options: &SignedUrlOptions,
    ) -> Result<Option<String>, BlobError> {
        let Place::Bucket(bucket) = &self.place else { return Ok(None) };
        let address = bucket.public().signed_url_opts(method, &Key::from(key), life, options).await?;
        Ok(Some(address.into()))
    }
}
