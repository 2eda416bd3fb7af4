use std::fmt;
use std::str::FromStr;

/// The tenant of a service that asks for no keys.
pub const DEFAULT_TENANT: &str = "default";

/// A tenant's name: 1 to 63 lower-case letters, digits and hyphens.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TenantName(String);

/// A text that is no tenant's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a tenant's name is 1 to 63 lower-case letters, digits and hyphens, and does not begin with a hyphen")]
pub struct TenantNameError;

impl TenantName {
    /// The name.
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

fn is_plain(text: &str) -> bool {
    (1..=63).contains(&text.len())
        && !text.starts_with('-')
        && text.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-')
}

/// The class of tenants for whom none is set.
pub const STANDARD_CLASS: &str = "standard";

/// What an operator calls a kind of tenants, such as those of a tariff, to tell their jobs apart in the metrics: 1 to 63 lower-case
/// letters, digits and hyphens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TenantClass(String);

/// A text that is no class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a class is 1 to 63 lower-case letters, digits and hyphens, and does not begin with a hyphen")]
pub struct TenantClassError;

impl TenantClass {
    /// The name.
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

/// What is set for a tenant.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tenant {
    /// Its name.
    pub name: String,
    /// Its class; none for [`STANDARD_CLASS`].
    pub class: Option<String>,
    /// What it may use.
    pub limits: TenantLimits,
}

/// What one tenant may use; where nothing is set, the service's own limits hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TenantLimits {
    /// Most of its jobs that may wait.
    pub max_queued: Option<u32>,
    /// Most of its jobs that may run at the same time.
    pub max_running: Option<u32>,
    /// Most of its requests in a minute, on each process that serves.
    pub requests_per_minute: Option<u32>,
}

/// Settings of a tenant to change. Of each field, `None` keeps the setting and `Some(None)` clears it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TenantChange {
    /// Its class.
    pub class: Option<Option<TenantClass>>,
    /// Most of its jobs that may wait.
    pub max_queued: Option<Option<u32>>,
    /// Most of its jobs that may run at the same time.
    pub max_running: Option<Option<u32>>,
    /// Most of its requests in a minute, on each process that serves.
    pub requests_per_minute: Option<Option<u32>>,
}

impl TenantChange {
    /// Sets these limits and clears the others.
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
    /// These limits, and the others where these say nothing.
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
    fn a_tenants_name_is_short_and_plain() {
        for name in ["shop", "shop-2", "2shops", &"x".repeat(63)] {
            assert_eq!(name.parse::<TenantName>().map(|name| name.to_string()), Ok(name.to_owned()));
        }
        for name in ["", "-shop", "Shop", "a b", "a/b", "ä", &"x".repeat(64)] {
            assert_eq!(name.parse::<TenantName>(), Err(TenantNameError), "{name}");
        }
    }
}
