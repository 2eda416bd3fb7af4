//! Tenants: names, classes and limits.
use std::fmt;
use std::str::FromStr;

/// The tenant of all requests to a service that requires no keys.
pub const DEFAULT_TENANT: &str = "default";

/// A tenant's name: 1 to 63 lower-case letters, digits and hyphens.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TenantName(String);

/// The error of a text that is not a tenant's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a tenant's name must be 1 to 63 lower-case letters, digits and hyphens, and must not start with a hyphen")]
pub struct TenantNameError;

impl TenantName {
    /// Returns the name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl Default for TenantName {
    fn default() -> Self {
        Self(DEFAULT_TENANT.to_owned())
    }
}

impl fmt::Display for TenantName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for TenantName {
    type Err = TenantNameError;

    fn from_str(text: &str) -> Result<Self, TenantNameError> {
        if is_plain(text) { Ok(Self(text.to_owned())) } else { Err(TenantNameError) }
    }
}

/// Whether a text is 1 to 63 lower-case letters, digits and hyphens, without a leading hyphen.
fn is_plain(text: &str) -> bool {
    (1..=63).contains(&text.len())
        && !text.starts_with('-')
        && text.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-')
}

/// The class of tenants without a class of their own.
pub const STANDARD_CLASS: &str = "standard";

/// The class of a tenant: a name that the operator chooses, such as a price plan, to group jobs in the metrics.
///
/// A class changes no limit and no order. Its name is 1 to 63 lower-case letters, digits and hyphens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TenantClass(String);

/// The error of a text that is not a tenant class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a class must be 1 to 63 lower-case letters, digits and hyphens, and must not start with a hyphen")]
pub struct TenantClassError;

impl TenantClass {
    /// Returns the class as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for TenantClass {
    type Err = TenantClassError;

    fn from_str(text: &str) -> Result<Self, TenantClassError> {
        if is_plain(text) { Ok(Self(text.to_owned())) } else { Err(TenantClassError) }
    }
}

/// A tenant with its settings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tenant {
    /// The tenant's name.
    pub name: String,
    /// The tenant's class; none for [`STANDARD_CLASS`].
    pub class: Option<String>,
    /// The tenant's limits.
    pub limits: TenantLimits,
}

/// The limits of one tenant. The service's own limit applies where a limit is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TenantLimits {
    /// Maximum number of queued jobs.
    pub max_queued: Option<u32>,
    /// Maximum number of running jobs.
    pub max_running: Option<u32>,
    /// Maximum number of requests per minute to each server process.
    pub requests_per_minute: Option<u32>,
}

/// Changes to a tenant's settings. In each field, `None` keeps the setting and `Some(None)` clears it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TenantChange {
    /// The class.
    pub class: Option<Option<TenantClass>>,
    /// Maximum number of queued jobs.
    pub max_queued: Option<Option<u32>>,
    /// Maximum number of running jobs.
    pub max_running: Option<Option<u32>>,
    /// Maximum number of requests per minute to each server process.
    pub requests_per_minute: Option<Option<u32>>,
}

impl TenantChange {
    /// Creates a change that sets the given limits, clears the other limits and keeps the class.
    #[must_use]
    pub fn to_limits(limits: TenantLimits) -> Self {
        Self {
            class: None,
            max_queued: Some(limits.max_queued),
            max_running: Some(limits.max_running),
            requests_per_minute: Some(limits.requests_per_minute),
        }
    }
}

impl TenantLimits {
    /// Returns these limits, with `others` where a limit is `None`.
    #[must_use]
    pub fn or(self, others: Self) -> Self {
        Self {
            max_queued: self.max_queued.or(others.max_queued),
            max_running: self.max_running.or(others.max_running),
            requests_per_minute: self.requests_per_minute.or(others.requests_per_minute),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenants_name_is_short_and_has_only_plain_characters() {
        for name in ["shop", "shop-2", "2shops", &"x".repeat(63)] {
            assert_eq!(name.parse::<TenantName>().map(|name| name.to_string()), Ok(name.to_owned()));
        }
        for name in ["", "-shop", "Shop", "a b", "a/b", "ä", &"x".repeat(64)] {
            assert_eq!(name.parse::<TenantName>(), Err(TenantNameError), "{name}");
        }
    }
}
