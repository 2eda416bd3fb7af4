//! The listening address, the choice whether requests need a key, and the server loop that accepts connections.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use clap::ValueEnum;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use meshmend::api::Auth;
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;

use super::service_error::ServiceError;

/// An address to listen on: a host name or IP address, and a port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListenAddress(String);

impl FromStr for ListenAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.rsplit_once(':').filter(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
        match parts {
            Some(_) => Ok(Self(text.to_owned())),
            None => Err("expected a host and a port, such as 127.0.0.1:8080, [::1]:8080 or localhost:8080".to_owned()),
        }
    }
}

impl fmt::Display for ListenAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl ListenAddress {
    /// Resolves the host. IPv4 addresses come first: a name such as `localhost` has both kinds, and most clients try
    /// IPv4 first.
    ///
    /// # Errors
    /// The host has no address; the message names `flag`.
    pub(super) async fn resolve(&self, flag: &str) -> Result<Vec<SocketAddr>, ServiceError> {
        let resolved = tokio::net::lookup_host(&self.0).await.map(Iterator::collect::<Vec<_>>);
        match resolved {
            Ok(mut addresses) if !addresses.is_empty() => {
                addresses.sort_by_key(SocketAddr::is_ipv6);
                Ok(addresses)
            }
            unresolved => {
                let reason =
                    unresolved.err().map_or_else(|| "the name has no address".to_owned(), |error| error.to_string());
                Err(ServiceError::Refused(format!(
                    "{flag} {self}: the host cannot be resolved: {reason}. Use an address of this machine, such as 127.0.0.1:8080."
                )))
            }
        }
    }

    /// Listens on the first of `addresses` that is available.
    ///
    /// # Errors
    /// None is available; the message names `flag` and what to do.
    pub(super) async fn bind(&self, flag: &str, addresses: &[SocketAddr]) -> Result<TcpListener, ServiceError> {
        TcpListener::bind(addresses).await.map_err(|error| {
            let hint = match error.kind() {
                io::ErrorKind::AddrInUse => {
                    "Another program uses this port; stop that program, or choose another port."
                }
                io::ErrorKind::AddrNotAvailable => "Use an address of this machine, or 0.0.0.0 for all its addresses.",
                io::ErrorKind::PermissionDenied => "Ports below 1024 need root privileges; choose a higher port.",
                _ => "Choose another address or port.",
            };
            ServiceError::Unavailable(format!("{flag}: cannot listen on {self}: {error}. {hint}"))
        })
    }
}

/// Whether requests need a key.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum AuthMode {
    /// Requests need a key unless the service listens on this machine only.
    #[default]
    Auto,
    /// No request needs a key.
    Open,
    /// Every request needs a key.
    Keys,
}

impl AuthMode {
    /// Decides whether a service that listens on these addresses requires keys.
    pub fn for_addresses(self, addresses: &[SocketAddr]) -> Auth {
        match self {
            Self::Open => Auth::Open,
            Self::Keys => Auth::Keys,
            Self::Auto if are_loopback(addresses) => Auth::Open,
            Self::Auto => Auth::Keys,
        }
    }
}

/// Whether all addresses are loopback addresses, which only this machine can reach.
pub fn are_loopback(addresses: &[SocketAddr]) -> bool {
    addresses.iter().all(|address| address.ip().to_canonical().is_loopback())
}

/// Time limit for the headers of a request, and for an idle connection.
const HEADER_TIMEOUT: Duration = Duration::from_secs(30);
/// Limit of open files that this process requests. Connections may use half of the granted limit.
const OPEN_FILES: u64 = 65_536;
/// Pause after a failed accept. The usual cause is a lack of file descriptors.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Serves connections until `stop`, then finishes the open ones.
///
/// Idle connections are closed. The number of connections is limited, so that workers keep enough file descriptors;
/// further connections wait in the backlog.
pub async fn serve_connections(listener: TcpListener, router: Router, stop: CancellationToken) {
    let files = rlimit::increase_nofile_limit(OPEN_FILES).unwrap_or(1024);
    let max_connections = usize::try_from(files / 2).unwrap_or(512);
    let slots = Arc::new(Semaphore::new(max_connections));
    let open = GracefulShutdown::new();
    loop {
        let accepted = async {
            let slot = Arc::clone(&slots).acquire_owned().await;
            (slot, listener.accept().await)
        };
        let (slot, accepted) = tokio::select! {
            accepted = accepted => accepted,
            () = stop.cancelled() => break,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "failed to accept a connection");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        let _ = stream.set_nodelay(true);
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEADER_TIMEOUT)
            .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router.clone()));
        let connection = open.watch(connection);
        tokio::spawn(async move {
            // A client that disconnects or sends invalid HTTP is normal.
            let ended = connection.await;
            tracing::debug!(ended = ?ended.err(), "connection closed");
            drop(slot);
        });
    }
    drop(listener);
    open.shutdown().await;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_a_host_and_a_port() {
        for valid in ["127.0.0.1:0", "localhost:8080", "[::1]:80"] {
            assert_eq!(valid.parse::<ListenAddress>().map(|address| address.to_string()), Ok(valid.to_owned()));
        }
        for invalid in ["", "localhost", ":8080", "localhost:http", "localhost:99999"] {
            assert!(invalid.parse::<ListenAddress>().is_err(), "{invalid}");
        }
    }

    #[test]
    fn auto_requires_keys_if_any_address_is_reachable_from_another_machine() {
        let auth = |addresses: &[&str]| {
            let addresses: Vec<SocketAddr> = addresses.iter().map(|text| text.parse().expect("an address")).collect();
            AuthMode::Auto.for_addresses(&addresses)
        };
        assert_eq!(auth(&["127.0.0.1:80", "[::1]:80"]), Auth::Open);
        assert_eq!(auth(&["127.0.0.1:80", "192.0.2.1:80"]), Auth::Keys);
        assert_eq!(auth(&["[::]:80"]), Auth::Keys);
    }
}
