//! Where the service listens, whether requests need a key there, and the connections that it takes.

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

/// An address to listen on: a host, which may be a name, and a port.
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
    /// The addresses that the host has, those of IPv4 first: a name such as `localhost` has both, and most clients try IPv4.
    pub(super) async fn resolve(&self, flag: &str) -> Result<Vec<SocketAddr>, ServiceError> {
        let found = tokio::net::lookup_host(&self.0).await.map(Iterator::collect::<Vec<_>>);
        match found {
            Ok(mut addresses) if !addresses.is_empty() => {
                addresses.sort_by_key(SocketAddr::is_ipv6);
                Ok(addresses)
            }
            found => {
                let why = found.err().map_or_else(|| "it has no address".to_owned(), |error| error.to_string());
                Err(ServiceError::Refused(format!(
                    "{flag} {self}: the host can't be resolved: {why}. Name an address of this machine, such as 127.0.0.1:8080."
                )))
            }
        }
    }

    /// Listens on the first of the addresses that is to be had.
    pub(super) async fn bind(&self, flag: &str, addresses: &[SocketAddr]) -> Result<TcpListener, ServiceError> {
        TcpListener::bind(addresses).await.map_err(|error| {
            let hint = match error.kind() {
                io::ErrorKind::AddrInUse => "Another program listens there; stop it, or choose another port.",
                io::ErrorKind::AddrNotAvailable => "Name an address of this machine, or 0.0.0.0 for all of them.",
                io::ErrorKind::PermissionDenied => "Ports below 1024 need a privilege; choose a higher port.",
                _ => "Choose another address or port.",
            };
            ServiceError::Unavailable(format!("{flag}: can't listen on {self}: {error}. {hint}"))
        })
    }
}

/// Whether requests need a key.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum AuthMode {
    /// Unless the service listens on this machine only.
    #[default]
    Auto,
    /// None does.
    Open,
    /// Each does.
    Keys,
}

impl AuthMode {
    /// Whether a service that listens on these addresses asks for keys.
    pub fn on(self, listen: &[SocketAddr]) -> Auth {
        match self {
            Self::Open => Auth::Open,
            Self::Keys => Auth::Keys,
            Self::Auto if is_of_this_machine(listen) => Auth::Open,
            Self::Auto => Auth::Keys,
        }
    }
}

/// Whether only this machine reaches all of the addresses.
pub fn is_of_this_machine(listen: &[SocketAddr]) -> bool {
    listen.iter().all(|address| address.ip().to_canonical().is_loopback())
}

/// Longest time for a request's headers to come, and for a connection to stay open without one.
const HEADER_TIME: Duration = Duration::from_secs(30);
/// Open files that this process asks the operating system for; connections may take half of what it gets.
const OPEN_FILES: u64 = 65_536;
/// Pause after a connection could not be taken, which is mostly for want of open files.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// Serves until `stop`, then finishes the connections that are open. Silent connections are closed, and there are never
/// so many that workers run out of open files: more wait to be taken.
pub async fn listen(listener: TcpListener, router: Router, stop: CancellationToken) {
    let files = rlimit::increase_nofile_limit(OPEN_FILES).unwrap_or(1024);
    let most = usize::try_from(files / 2).unwrap_or(512);
    let places = Arc::new(Semaphore::new(most));
    let open = GracefulShutdown::new();
    loop {
        let accepted = async {
            let place = Arc::clone(&places).acquire_owned().await;
            (place, listener.accept().await)
        };
        let (place, accepted) = tokio::select! {
            accepted = accepted => accepted,
            () = stop.cancelled() => break,
        };
        let stream = match accepted {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::warn!(%error, "a connection could not be taken");
                tokio::time::sleep(ACCEPT_PAUSE).await;
                continue;
            }
        };
        let _ = stream.set_nodelay(true);
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(HEADER_TIME)
            .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router.clone()));
        let connection = open.watch(connection);
        tokio::spawn(async move {
            // A client that hangs up or talks nonsense is no news.
            let ended = connection.await;
            tracing::debug!(ended = ?ended.err(), "connection closed");
            drop(place);
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
        for good in ["127.0.0.1:0", "localhost:8080", "[::1]:80"] {
            assert_eq!(good.parse::<ListenAddress>().map(|address| address.to_string()), Ok(good.to_owned()));
        }
        for bad in ["", "localhost", ":8080", "localhost:http", "localhost:99999"] {
            assert!(bad.parse::<ListenAddress>().is_err(), "{bad}");
        }
    }

    #[test]
    fn without_a_setting_keys_are_asked_for_where_another_machine_could_ask() {
        let on = |addresses: &[&str]| {
            let addresses: Vec<SocketAddr> = addresses.iter().map(|text| text.parse().expect("an address")).collect();
            AuthMode::Auto.on(&addresses)
        };
        assert_eq!(on(&["127.0.0.1:80", "[::1]:80"]), Auth::Open);
        assert_eq!(on(&["127.0.0.1:80", "192.0.2.1:80"]), Auth::Keys);
        assert_eq!(on(&["[::]:80"]), Auth::Keys);
    }
}
