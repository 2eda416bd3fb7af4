//! Which URLs webhooks may be sent to. A URL may come from a stranger, and the service may run in a network whose hosts trust it, so
//! private addresses are rejected (SSRF).

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

use url::{Host, Url};

/// Longest URL, in bytes.
const MAX_URL_BYTES: usize = 2048;

/// A policy for webhook URLs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TargetPolicy {
    /// Only https URLs of hosts on the public internet, on port 443 or 1024 and above.
    Public,
    /// Every http and https URL, including hosts on this machine.
    Anything,
}

/// Why a URL is rejected. The text completes a sentence that begins with the field's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TargetError {
    /// The text is not a URL of at most 2048 bytes.
    #[error("must be an https URL of at most 2048 bytes, such as https://shop.example/hooks")]
    InvalidUrl,
    /// The scheme is http or another one than https.
    #[error("must begin with https://")]
    NotHttps,
    /// The URL contains a user name or password, which would appear in logs.
    #[error("must not contain a user name or password; messages are signed instead")]
    Credentials,
    /// The port is reserved for another service.
    #[error("must use port 443, or a port from 1024 up")]
    Port,
    /// The host is on this machine or in a private network, by its address or its name.
    #[error("must have a host on the public internet")]
    Private,
    /// The host name has no address.
    #[error("must have a host that resolves to an address")]
    Unresolved,
}

impl TargetPolicy {
    /// Parses a URL and checks everything that needs no DNS lookup.
    ///
    /// # Errors
    /// The first rule that the URL violates.
    pub fn read(self, text: &str) -> Result<Url, TargetError> {
        let is_plain = text.len() <= MAX_URL_BYTES && !text.chars().any(|c| c.is_control() || c.is_whitespace());
        let url = Url::parse(text).ok().filter(|_| is_plain).ok_or(TargetError::InvalidUrl)?;
        match url.scheme() {
            "https" => {}
            "http" if self == Self::Anything => {}
            _ => return Err(TargetError::NotHttps),
        }
        if !url.username().is_empty() || url.password().is_some() {
            return Err(TargetError::Credentials);
        }
        if self == Self::Public && url.port_or_known_default().is_none_or(|port| port != 443 && port < 1024) {
            return Err(TargetError::Port);
        }
        // The parser has converted unusual IPv4 forms, such as 0x7f.1, to addresses.
        let is_allowed = match url.host().ok_or(TargetError::InvalidUrl)? {
            Host::Ipv4(address) => self.allows(address.into()),
            Host::Ipv6(address) => self.allows(address.into()),
            Host::Domain(name) => self == Self::Anything || !is_local(name),
        };
        if is_allowed { Ok(url) } else { Err(TargetError::Private) }
    }

    /// Whether messages may be sent to this IP address.
    #[must_use]
    pub fn allows(self, address: IpAddr) -> bool {
        match (self, address) {
            (Self::Anything, _) => true,
            (Self::Public, IpAddr::V4(address)) => is_public_v4(address),
            (Self::Public, IpAddr::V6(address)) => is_public_v6(address),
        }
    }
}

/// Whether a name never resolves on the public internet (RFC 6761, RFC 6762, RFC 8375, and ICANN's .internal).
fn is_local(name: &str) -> bool {
    let name = name.trim_end_matches('.');
    ["localhost", "local", "internal", "home.arpa", "onion"]
        .iter()
        .any(|last| name.strip_suffix(last).is_some_and(|rest| rest.is_empty() || rest.ends_with('.')))
}

/// IPv4 ranges outside the public internet (IANA, IPv4 Special-Purpose Address Registry), multicast, and 168.63.129.16, the address of
/// Azure's internal services.
const PRIVATE_V4: [(Ipv4Addr, u32); 16] = [
    (Ipv4Addr::new(0, 0, 0, 0), 8),
    (Ipv4Addr::new(10, 0, 0, 0), 8),
    (Ipv4Addr::new(100, 64, 0, 0), 10),
    (Ipv4Addr::new(127, 0, 0, 0), 8),
    (Ipv4Addr::new(169, 254, 0, 0), 16),
    (Ipv4Addr::new(172, 16, 0, 0), 12),
    (Ipv4Addr::new(192, 0, 0, 0), 24),
    (Ipv4Addr::new(192, 0, 2, 0), 24),
    (Ipv4Addr::new(192, 88, 99, 0), 24),
    (Ipv4Addr::new(192, 168, 0, 0), 16),
    (Ipv4Addr::new(198, 18, 0, 0), 15),
    (Ipv4Addr::new(198, 51, 100, 0), 24),
    (Ipv4Addr::new(203, 0, 113, 0), 24),
    (Ipv4Addr::new(224, 0, 0, 0), 4),
    (Ipv4Addr::new(240, 0, 0, 0), 4),
    (Ipv4Addr::new(168, 63, 129, 16), 32),
];

/// Whether an IPv4 address is on the public internet.
fn is_public_v4(address: Ipv4Addr) -> bool {
    !PRIVATE_V4.iter().any(|(start, bits)| (address.to_bits() ^ start.to_bits()).leading_zeros() >= *bits)
}

/// IPv6 ranges within global unicast, 2000::/3, that are not public or embed IPv4 addresses (IANA, IPv6 Special-Purpose Address Registry).
/// In order: protocol assignments with Teredo and ORCHID, documentation, 6to4, documentation.
const PRIVATE_V6: [(Ipv6Addr, u32); 4] = [
    (Ipv6Addr::new(0x2001, 0, 0, 0, 0, 0, 0, 0), 23),
    (Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 0), 32),
    (Ipv6Addr::new(0x2002, 0, 0, 0, 0, 0, 0, 0), 16),
    (Ipv6Addr::new(0x3fff, 0, 0, 0, 0, 0, 0, 0), 20),
];

/// Whether an IPv6 address is on the public internet. Loopback, private, link-local, multicast, mapped (::ffff:0:0/96) and translated
/// (64:ff9b::/96) addresses all lie outside 2000::/3.
fn is_public_v6(address: Ipv6Addr) -> bool {
    address.segments()[0] & 0xe000 == 0x2000
        && !PRIVATE_V6.iter().any(|(start, bits)| (address.to_bits() ^ start.to_bits()).leading_zeros() >= *bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_public_policy_accepts_only_https_urls_of_public_hosts() {
        for valid in [
            "https://shop.example/hooks?a=b",
            "https://shop.example:8443/",
            "https://8.8.8.8/",
            "https://[2606:4700::1111]/",
            "https://LOCALHOST.shop.example/",
        ] {
            assert!(TargetPolicy::Public.read(valid).is_ok(), "{valid}");
        }
        let long = format!("https://shop.example/{}", "x".repeat(2048));
        for (text, error) in [
            ("", TargetError::InvalidUrl),
            ("shop.example/hooks", TargetError::InvalidUrl),
            ("https://", TargetError::InvalidUrl),
            ("https://a b.example/", TargetError::InvalidUrl),
            ("https://shop.example/\u{0}", TargetError::InvalidUrl),
            ("https://shop.example/\r\nx: y", TargetError::InvalidUrl),
            (&long, TargetError::InvalidUrl),
            ("http://shop.example/", TargetError::NotHttps),
            ("file:///etc/passwd", TargetError::NotHttps),
            ("gopher://shop.example/", TargetError::NotHttps),
            ("https://me@shop.example/", TargetError::Credentials),
            ("https://me:secret@shop.example/", TargetError::Credentials),
            ("https://shop.example:22/", TargetError::Port),
            ("https://shop.example:80/", TargetError::Port),
            ("https://shop.example:0/", TargetError::Port),
            ("https://localhost/", TargetError::Private),
            ("https://LocalHost./", TargetError::Private),
            ("https://db.internal/", TargetError::Private),
            ("https://printer.local/", TargetError::Private),
        ] {
            assert_eq!(TargetPolicy::Public.read(text).map(|url| url.to_string()), Err(error), "{text}");
        }
    }

    #[test]
    fn an_address_of_this_machine_is_rejected_in_every_notation() {
        for host in [
            "127.0.0.1",
            "127.1",
            "2130706433",
            "0x7f000001",
            "0x7f.1",
            "0177.0.0.1",
            "017700000001",
            "127.0.0.1.",
            "１２７.０.０.１",
            "%31%32%37.0.0.1",
            "0",
            "[::1]",
            "[::]",
            "[::127.0.0.1]",
            "[::ffff:127.0.0.1]",
            "[::ffff:7f00:1]",
            "[0:0:0:0:0:ffff:a00:1]",
            "[64:ff9b::7f00:1]",
            "[64:ff9b:1::a00:1]",
            "[2002:7f00:1::]",
            "[2001:0:7f00:1::]",
            "[fe80::1]",
            "[fd00:ec2::254]",
            "169.254.169.254",
            "0xa9fea9fe",
        ] {
            assert_eq!(TargetPolicy::Public.read(&format!("https://{host}/")), Err(TargetError::Private), "{host}");
            assert!(TargetPolicy::Anything.read(&format!("http://{host}/")).is_ok(), "{host}");
        }
    }

    #[test]
    fn private_ranges_end_where_the_registries_say() {
        for (first, last) in [
            ("0.0.0.0", "0.255.255.255"),
            ("10.0.0.0", "10.255.255.255"),
            ("100.64.0.0", "100.127.255.255"),
            ("127.0.0.0", "127.255.255.255"),
            ("169.254.0.0", "169.254.255.255"),
            ("172.16.0.0", "172.31.255.255"),
            ("192.0.0.0", "192.0.0.255"),
            ("192.168.0.0", "192.168.255.255"),
            ("198.18.0.0", "198.19.255.255"),
            ("224.0.0.0", "255.255.255.255"),
            ("168.63.129.16", "168.63.129.16"),
        ] {
            let (first, last): (Ipv4Addr, Ipv4Addr) = (first.parse().expect("first"), last.parse().expect("last"));
            assert!(!is_public_v4(first) && !is_public_v4(last), "{first} to {last}");
            for neighbour in [first.to_bits().checked_sub(1), last.to_bits().checked_add(1)].into_iter().flatten() {
                assert!(is_public_v4(Ipv4Addr::from_bits(neighbour)), "next to {first} to {last}");
            }
        }
        for (address, public) in [
            ("2001:1ff:ffff::1", false),
            ("2001:200::1", true),
            ("2001:db8::1", false),
            ("2001:db9::1", true),
            ("2003::1", true),
            ("3fff:fff::1", false),
            ("3fff:1000::1", true),
            ("1fff::1", false),
            ("4000::1", false),
            ("ff02::1", false),
            ("fec0::1", false),
        ] {
            assert_eq!(is_public_v6(address.parse().expect("an address")), public, "{address}");
        }
    }
}
