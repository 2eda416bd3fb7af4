//! Sends webhook messages over HTTPS, with protection against requests to private networks (SSRF).
use std::error::Error;
use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use reqwest::dns::{Addrs, Name, Resolve, Resolving};
use reqwest::redirect::Policy;
use reqwest::{Client, header};

use super::target::{TargetError, TargetPolicy};
use crate::tls::use_ring;

/// Timeout for a connection; the overall timeout applies too.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Longest error description, in characters.
const ERROR_CHARS: usize = 200;

/// The error of a client that can't be created.
#[derive(Debug, thiserror::Error)]
#[error("failed to create the HTTP client for webhooks: {0}")]
pub struct PosterError(#[from] reqwest::Error);

/// The result of one attempt to send a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PostResult {
    /// The HTTP status of the response; none without a response.
    pub status: Option<u16>,
    /// Why the attempt failed; none if it succeeded.
    pub error: Option<String>,
    /// Time from the start of the attempt to its result.
    pub elapsed: Duration,
}

/// A signed message to send.
#[derive(Debug, Clone, Copy)]
pub(super) struct Envelope<'a> {
    /// The receiver's URL.
    pub url: &'a str,
    /// The message's id, for the header `webhook-id`.
    pub message: &'a str,
    /// The time of the attempt in seconds since the Unix epoch.
    pub timestamp: i64,
    /// The header `webhook-signature`.
    pub signatures: &'a str,
    /// The JSON body.
    pub payload: &'a str,
}

/// Sends messages, each over a new connection to an address that was resolved and checked for this message. Uses no proxy, follows no
/// redirects, and reads only the status of the response.
#[derive(Clone)]
pub struct Poster {
    client: Client,
    targets: TargetPolicy,
    timeout: Duration,
}

impl Poster {
    /// Creates a client. `timeout` covers the whole attempt, from the DNS lookup to the response.
    ///
    /// # Errors
    /// If the HTTP client can't be created.
    pub fn new(targets: TargetPolicy, timeout: Duration) -> Result<Self, PosterError> {
        let lookup = |name| async move { Ok(tokio::net::lookup_host((name, 0)).await?.collect()) };
        Self::with_lookup(targets, timeout, lookup)
    }

    fn with_lookup<F>(
        targets: TargetPolicy,
        timeout: Duration,
        lookup: impl Fn(String) -> F + Send + Sync + 'static,
    ) -> Result<Self, PosterError>
    where
        F: Future<Output = io::Result<Vec<SocketAddr>>> + Send + 'static,
    {
        use_ring();
        let lookup = move |name| -> Lookup { Box::pin(lookup(name)) };
        let client = Client::builder()
            .user_agent(concat!("meshmend/", env!("CARGO_PKG_VERSION"), " webhooks"))
            .redirect(Policy::none())
            .no_proxy()
            .referer(false)
            .pool_max_idle_per_host(0)
            .connect_timeout(CONNECT_TIMEOUT.min(timeout))
            .timeout(timeout)
            .dns_resolver(Arc::new(CheckedResolver { targets, lookup: Box::new(lookup) }))
            .build()?;
        Ok(Self { client, targets, timeout })
    }

    /// Sends a message and waits for the response.
    pub(super) async fn post(&self, envelope: Envelope<'_>) -> PostResult {
        let started = Instant::now();
        let (status, error) = match self.try_post(envelope).await {
            Ok(status) if (200..300).contains(&status) => (Some(status), None),
            Ok(status) if (300..400).contains(&status) => {
                (Some(status), Some(format!("The receiver responded with {status}; redirects are not followed.")))
            }
            Ok(status) => (Some(status), Some(format!("The receiver responded with {status}."))),
            Err(error) => (None, Some(error)),
        };
        PostResult { status, error, elapsed: started.elapsed() }
    }

    async fn try_post(&self, envelope: Envelope<'_>) -> Result<u16, String> {
        let rejected = |error: TargetError| format!("The URL {error}.");
        let url = self.targets.read(envelope.url).map_err(rejected)?;
        let request = self
            .client
            .post(url)
            .header(header::CONTENT_TYPE, "application/json")
            .header("webhook-id", envelope.message)
            .header("webhook-timestamp", envelope.timestamp)
            .header("webhook-signature", envelope.signatures)
            .body(envelope.payload.to_owned());
        match request.send().await {
            Ok(response) => Ok(response.status().as_u16()),
            Err(error) => Err(match target_error(&error) {
                Some(error) => rejected(error),
                None if error.is_timeout() => format!("No response within {} s.", self.timeout.as_secs_f64()),
                None => describe(&error),
            }),
        }
    }
}

/// Returns the error of [`CheckedResolver`], if it caused this error.
fn target_error(error: &reqwest::Error) -> Option<TargetError> {
    causes(error).find_map(|cause| cause.downcast_ref::<TargetError>().copied())
}

/// Describes an error by the failed step and its root cause.
fn describe(error: &reqwest::Error) -> String {
    let step = if error.is_connect() { "Connection failed" } else { "Connection interrupted" };
    let cause = causes(error).last().map_or_else(|| error.to_string(), ToString::to_string);
    format!("{step}: {cause}.").chars().filter(|c| !c.is_control()).take(ERROR_CHARS).collect()
}

/// Iterates over the causes of an error, outermost first.
fn causes(error: &reqwest::Error) -> impl Iterator<Item = &(dyn Error + 'static)> {
    std::iter::successors(error.source(), |cause| (**cause).source())
}

/// A pending DNS lookup.
type Lookup = Pin<Box<dyn Future<Output = io::Result<Vec<SocketAddr>>> + Send>>;

/// Resolves host names for the client and checks the addresses. The client connects only to addresses returned here, so a second DNS
/// response can't redirect it (DNS rebinding).
struct CheckedResolver {
    targets: TargetPolicy,
    lookup: Box<dyn Fn(String) -> Lookup + Send + Sync>,
}

impl Resolve for CheckedResolver {
    fn resolve(&self, name: Name) -> Resolving {
        let (targets, lookup) = (self.targets, (self.lookup)(name.as_str().to_owned()));
        Box::pin(async move {
            let addresses = lookup.await.map_err(|_| TargetError::Unresolved)?;
            if addresses.is_empty() {
                return Err(TargetError::Unresolved.into());
            }
            // A name with both public and private addresses is rejected, since the client may choose either.
            if !addresses.iter().all(|address| targets.allows(address.ip())) {
                return Err(TargetError::Private.into());
            }
            Ok(Box::new(addresses.into_iter()) as Addrs)
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    use super::*;

    const SHORT: Duration = Duration::from_millis(500);

    fn envelope(url: &str) -> Envelope<'_> {
        Envelope { url, message: "msg_1", timestamp: 1, signatures: "v1,x", payload: "{}" }
    }

    /// Listens on a local port, sends `response` to every connection, and counts the connections.
    async fn receiver(response: &'static str) -> (u16, Arc<AtomicUsize>) {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let (port, count) = (listener.local_addr().expect("an address").port(), Arc::new(AtomicUsize::new(0)));
        let counter = Arc::clone(&count);
        tokio::spawn(async move {
            let mut open = Vec::new();
            while let Ok((mut stream, _)) = listener.accept().await {
                counter.fetch_add(1, Ordering::SeqCst);
                let mut request = [0; 4096];
                let _ = stream.read(&mut request).await;
                let _ = stream.write_all(response.as_bytes()).await;
                open.push(stream);
            }
        });
        (port, count)
    }

    #[tokio::test]
    async fn a_host_is_resolved_once_per_message_and_only_that_address_is_contacted() {
        let (port, connections) = receiver("HTTP/1.1 204 No Content\r\n\r\n").await;
        let lookups = Arc::new(AtomicUsize::new(0));
        let counter = Arc::clone(&lookups);
        // A name server whose second response differs from the first.
        let poster = Poster::with_lookup(TargetPolicy::Anything, SHORT, move |_| {
            let address = if counter.fetch_add(1, Ordering::SeqCst) == 0 { [127, 0, 0, 1] } else { [127, 0, 0, 99] };
            async move { Ok(vec![SocketAddr::from((address, 0))]) }
        });
        let poster = poster.expect("a client");
        let url = format!("http://hooks.example:{port}/");
        let result = poster.post(envelope(&url)).await;
        assert_eq!((result.status, result.error), (Some(204), None));
        assert_eq!((lookups.load(Ordering::SeqCst), connections.load(Ordering::SeqCst)), (1, 1));
        assert_eq!(poster.post(envelope(&url)).await.status, None, "each message has its own lookup");
        assert_eq!((lookups.load(Ordering::SeqCst), connections.load(Ordering::SeqCst)), (2, 1));
    }

    #[tokio::test]
    async fn a_host_with_any_private_address_is_not_contacted() {
        let (port, connections) = receiver("HTTP/1.1 204 No Content\r\n\r\n").await;
        let public = SocketAddr::from(([203, 0, 114, 1], 0));
        for addresses in [
            vec![SocketAddr::from(([127, 0, 0, 1], 0))],
            vec![public, SocketAddr::from(([127, 0, 0, 1], 0))],
            vec!["[::ffff:127.0.0.1]:0".parse().expect("an address")],
        ] {
            let poster = Poster::with_lookup(TargetPolicy::Public, SHORT, move |_| {
                let addresses = addresses.clone();
                async move { Ok(addresses) }
            });
            let url = format!("https://hooks.example:{port}/");
            let result = poster.expect("a client").post(envelope(&url)).await;
            let error = result.error.expect("an error");
            assert_eq!(error, "The URL must have a host on the public internet.");
        }
        let poster = Poster::with_lookup(TargetPolicy::Public, SHORT, |_| async { Ok(Vec::new()) }).expect("a client");
        let error = poster.post(envelope("https://hooks.example/")).await.error.expect("an error");
        assert_eq!(error, "The URL must have a host that resolves to an address.");
        assert_eq!(connections.load(Ordering::SeqCst), 0);
    }

    #[tokio::test]
    async fn an_endless_or_missing_response_takes_no_longer_than_the_timeout() {
        let (endless, _) = receiver("HTTP/1.1 200 OK\r\ncontent-length: 100000000000\r\n\r\n{\"and\": \"so on\"").await;
        let (silent, _) = receiver("").await;
        let poster = Poster::new(TargetPolicy::Anything, SHORT).expect("a client");
        let result = poster.post(envelope(&format!("http://127.0.0.1:{endless}/"))).await;
        assert_eq!(result.status, Some(200), "{result:?}");
        let result = poster.post(envelope(&format!("http://127.0.0.1:{silent}/"))).await;
        assert_eq!((result.status, result.error.as_deref()), (None, Some("No response within 0.5 s.")));
        assert!(result.elapsed < Duration::from_secs(5), "{result:?}");
        let closed = TcpListener::bind("127.0.0.1:0").await.expect("a port").local_addr().expect("an address");
        let result = poster.post(envelope(&format!("http://{closed}/"))).await;
        assert!(result.error.as_ref().is_some_and(|error| error.contains("refused")), "{result:?}");
    }
}
