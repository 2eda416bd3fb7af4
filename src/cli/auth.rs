use std::net::SocketAddr;

use clap::ValueEnum;
use meshmend::api::Auth;

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
    /// What that is for a service that listens there.
    pub fn on(self, listen: SocketAddr) -> Auth {
        match self {
            Self::Open => Auth::Open,
            Self::Keys => Auth::Keys,
            Self::Auto if listen.ip().is_loopback() => Auth::Open,
            Self::Auto => Auth::Keys,
        }
    }
}
