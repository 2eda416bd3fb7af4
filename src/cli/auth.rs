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

#[cfg(test)]
mod tests {
    use super::*;

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
