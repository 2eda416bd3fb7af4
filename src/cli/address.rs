use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::str::FromStr;

use tokio::net::TcpListener;

use super::service::ServiceError;

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
}
