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

/// Longest time for a connection to be made; never more than the time for everything.
const CONNECT: Duration = Duration::from_secs(5);
/// Longest account of what went wrong, in characters.
const ERROR_CHARS: usize = 200;

/// Why nothing can be sent at all.
#[derive(Debug, thiserror::Error)]
#[error("a client for webhooks can't be made: {0}")]
pub struct PosterError(#[from] reqwest::Error);

/// What became of a message that was sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Answer {
    /// The HTTP status; none if there was no answer.
    pub status: Option<u16>,
    /// Why it was no success.
    pub error: Option<String>,
    /// How long it took.
    pub took: Duration,
}

/// A message in its envelope.
#[derive(Debug, Clone, Copy)]
pub(super) struct Envelope<'a> {
    pub url: &'a str,
    pub message: &'a str,
    pub timestamp: i64,
    pub signatures: &'a str,
    pub payload: &'a str,
}

/// Sends messages: by one connection each, to an address that was looked up and checked for it. No proxy is used, no redirect
/// followed, and of the answer only the status is read.
#[derive(Clone)]
pub struct Poster {
    client: Client,
    reach: TargetPolicy,
    timeout: Duration,
}

impl Poster {
    /// `timeout` is for all of a message's sending, from the look-up of the name to the answer.
    ///
    /// # Errors
    /// When the system's reasons can't be read.
    pub fn new(reach: TargetPolicy, timeout: Duration) -> Result<Self, PosterError> {
        Self::with_lookup(reach, timeout, |name| async move { Ok(tokio::net::lookup_host((name, 0)).await?.collect()) })
    }

    fn with_lookup<F>(
        reach: TargetPolicy,
        timeout: Duration,
        lookup: impl Fn(String) -> F + Send + Sync + 'static,
    ) -> Result<Self, PosterError>
    where
        F: Future<Output = io::Result<Vec<SocketAddr>>> + Send + 'static,
    {
        use_ring();
        let lookup = move |name| -> Found { Box::pin(lookup(name)) };
        let client = Client::builder()
            .user_agent(concat!("meshmend/", env!("CARGO_PKG_VERSION"), " webhooks"))
            .redirect(Policy::none())
            .no_proxy()
            .referer(false)
            .pool_max_idle_per_host(0)
            .connect_timeout(CONNECT.min(timeout))
            .timeout(timeout)
            .dns_resolver(Arc::new(Guard { reach, lookup: Box::new(lookup) }))
            .build()?;
        Ok(Self { client, reach, timeout })
    }

    /// Sends a message and waits for the answer.
    pub(super) async fn post(&self, envelope: Envelope<'_>) -> Answer {
        let started = Instant::now();
        let (status, error) = match self.try_post(envelope).await {
            Ok(status) if (200..300).contains(&status) => (Some(status), None),
            Ok(status) if (300..400).contains(&status) => {
                (Some(status), Some(format!("It answered {status}, and redirects are not followed.")))
            }
            Ok(status) => (Some(status), Some(format!("It answered {status}."))),
            Err(error) => (None, Some(error)),
        };
        Answer { status, error, took: started.elapsed() }
    }

    async fn try_post(&self, envelope: Envelope<'_>) -> Result<u16, String> {
        let refused = |error: TargetError| format!("The address {error}.");
        let url = self.reach.read(envelope.url).map_err(refused)?;
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
                Some(error) => refused(error),
                None if error.is_timeout() => format!("No answer came within {} s.", self.timeout.as_secs_f64()),
                None => describe(&error),
            }),
        }
    }
}

/// What the guard said, if it was the guard.
fn target_error(error: &reqwest::Error) -> Option<TargetError> {
    causes(error).find_map(|cause| cause.downcast_ref::<TargetError>().copied())
}

/// An error in words: what was tried, and the cause at the bottom of it.
fn describe(error: &reqwest::Error) -> String {
    let what = if error.is_connect() { "No connection could be made" } else { "The exchange broke off" };
    let cause = causes(error).last().map_or_else(|| error.to_string(), ToString::to_string);
    format!("{what}: {cause}.").chars().filter(|c| !c.is_control()).take(ERROR_CHARS).collect()
}

fn causes(error: &reqwest::Error) -> impl Iterator<Item = &(dyn Error + 'static)> {
    std::iter::successors(error.source(), |cause| (**cause).source())
}

type Found = Pin<Box<dyn Future<Output = io::Result<Vec<SocketAddr>>> + Send>>;

/// Looks names up for the client, which connects to the addresses it gets from here and to no others.
struct Guard {
    reach: TargetPolicy,
    lookup: Box<dyn Fn(String) -> Found + Send + Sync>,
}

impl Resolve for Guard {
    fn resolve(&self, name: Name) -> Resolving {
        let (reach, found) = (self.reach, (self.lookup)(name.as_str().to_owned()));
        Box::pin(async move {
            let addresses = found.await.map_err(|_| TargetError::Nowhere)?;
            if addresses.is_empty() {
                return Err(TargetError::Nowhere.into());
            }
            // A name that leads inside as well as outside is not to be trusted with either.
            if !addresses.iter().all(|address| reach.allows(address.ip())) {
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

    /// Takes connections, answers each so, and counts them.
    async fn receiver(answer: &'static str) -> (u16, Arc<AtomicUsize>) {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let (port, count) = (listener.local_addr().expect("an address").port(), Arc::new(AtomicUsize::new(0)));
        let counter = Arc::clone(&count);
        tokio::spawn(async move {
            let mut open = Vec::new();
            while let Ok((mut stream, _)) = listener.accept().await {
                counter.fetch_add(1, Ordering::SeqCst);
                let mut request = [0; 4096];
                let _ = stream.read(&mut request).await;
                let _ = stream.write_all(answer.as_bytes()).await;
                open.push(stream);
            }
        });
        (port, count)
    }

    #[tokio::test]
    async fn a_name_is_looked_up_once_for_a_message_and_only_what_was_found_is_reached() {
        let (port, reached) = receiver("HTTP/1.1 204 No Content\r\n\r\n").await;
        let asked = Arc::new(AtomicUsize::new(0));
        let counter = Arc::clone(&asked);
        // A name server that answers otherwise the second time.
        let poster = Poster::with_lookup(TargetPolicy::Anything, SHORT, move |_| {
            let address = if counter.fetch_add(1, Ordering::SeqCst) == 0 { [127, 0, 0, 1] } else { [127, 0, 0, 99] };
            async move { Ok(vec![SocketAddr::from((address, 0))]) }
        });
        let poster = poster.expect("a client");
        let url = format!("http://hooks.example:{port}/");
        let answer = poster.post(envelope(&url)).await;
        assert_eq!((answer.status, answer.error), (Some(204), None));
        assert_eq!((asked.load(Ordering::SeqCst), reached.load(Ordering::SeqCst)), (1, 1));
        assert_eq!(poster.post(envelope(&url)).await.status, None, "each message asks anew");
        assert_eq!((asked.load(Ordering::SeqCst), reached.load(Ordering::SeqCst)), (2, 1));
    }

    #[tokio::test]
    async fn a_name_that_leads_to_any_private_address_is_not_reached() {
        let (port, reached) = receiver("HTTP/1.1 204 No Content\r\n\r\n").await;
        let public = SocketAddr::from(([203, 0, 114, 1], 0));
        for found in [
            vec![SocketAddr::from(([127, 0, 0, 1], 0))],
            vec![public, SocketAddr::from(([127, 0, 0, 1], 0))],
            vec!["[::ffff:127.0.0.1]:0".parse().expect("an address")],
        ] {
            let poster = Poster::with_lookup(TargetPolicy::Public, SHORT, move |_| {
                let found = found.clone();
                async move { Ok(found) }
            });
            let url = format!("https://hooks.example:{port}/");
            let answer = poster.expect("a client").post(envelope(&url)).await;
            let error = answer.error.expect("an error");
            assert_eq!(error, "The address must have a host on the public internet.");
        }
        let poster = Poster::with_lookup(TargetPolicy::Public, SHORT, |_| async { Ok(Vec::new()) }).expect("a client");
        let error = poster.post(envelope("https://hooks.example/")).await.error.expect("an error");
        assert_eq!(error, "The address names a host that has no address.");
        assert_eq!(reached.load(Ordering::SeqCst), 0);
    }

    #[tokio::test]
    async fn an_answer_that_does_not_end_or_does_not_come_costs_no_more_than_its_time() {
        let (endless, _) = receiver("HTTP/1.1 200 OK\r\ncontent-length: 100000000000\r\n\r\n{\"and\": \"so on\"").await;
        let (silent, _) = receiver("").await;
        let poster = Poster::new(TargetPolicy::Anything, SHORT).expect("a client");
        let answer = poster.post(envelope(&format!("http://127.0.0.1:{endless}/"))).await;
        assert_eq!(answer.status, Some(200), "{answer:?}");
        let answer = poster.post(envelope(&format!("http://127.0.0.1:{silent}/"))).await;
        assert_eq!((answer.status, answer.error.as_deref()), (None, Some("No answer came within 0.5 s.")));
        assert!(answer.took < Duration::from_secs(5), "{answer:?}");
        let closed = TcpListener::bind("127.0.0.1:0").await.expect("a port").local_addr().expect("an address");
        let answer = poster.post(envelope(&format!("http://{closed}/"))).await;
        assert!(answer.error.as_ref().is_some_and(|error| error.contains("refused")), "{answer:?}");
    }
}
