//! Access control: tenants, their API keys, browser tokens, and scopes.
//!
//! A secret is shown once, when it is created; the store keeps only its hash. The jobs and all other data of a tenant are invisible to
//! other tenants.

mod ids;
mod tenant;

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use time::OffsetDateTime;
use utoipa::ToSchema;

pub use ids::{IdSource, SystemIds, random_bytes};
pub use tenant::{
    DEFAULT_TENANT, STANDARD_CLASS, Tenant, TenantChange, TenantClass, TenantClassError, TenantLimits, TenantName,
    TenantNameError,
};

/// The kind of a secret's holder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KeyKind {
    /// A tenant's own server, with an API key.
    Api,
    /// A page in a web browser, with a short-lived token.
    Browser,
}

impl KeyKind {
    const ALL: [Self; 2] = [Self::Api, Self::Browser];

    /// Returns the name used in the store.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Api => "api",
            Self::Browser => "browser",
        }
    }

    /// Returns the kind that a secret's prefix indicates.
    #[must_use]
    pub fn of_secret(secret: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| secret.starts_with(kind.prefix()))
    }

    /// Prefix of this kind's secrets, by which secret scanners recognise leaked secrets.
    fn prefix(self) -> &'static str {
        match self {
            Self::Api => "mm_key_",
            Self::Browser => "mm_tok_",
        }
    }
}

impl FromStr for KeyKind {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        Self::ALL.into_iter().find(|kind| kind.as_str() == text).ok_or(())
    }
}

/// A secret in clear text: the prefix of its kind, and 64 hexadecimal digits of [`random_bytes`].
pub struct Secret(String);

impl Secret {
    /// Creates a random secret.
    #[must_use]
    pub fn new(kind: KeyKind, ids: &dyn IdSource) -> Self {
        Self(format!("{}{}", kind.prefix(), hex::encode(random_bytes(ids))))
    }

    /// Returns the clear text, to be shown to the holder once.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// Returns the hash that the store keeps.
    #[must_use]
    pub fn hash(&self) -> SecretHash {
        SecretHash::of(&self.0)
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(hidden)")
    }
}

/// The hash of a secret, by which the store finds its key. SHA-256 without salt is enough, since secrets are random.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct SecretHash(String);

impl SecretHash {
    /// Hashes a secret that a client sent.
    #[must_use]
    pub fn of(secret: &str) -> Self {
        Self(hex::encode(Sha256::digest(secret.as_bytes())))
    }

    /// Returns the SHA-256 hash in hexadecimal.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl From<SecretHash> for String {
    fn from(hash: SecretHash) -> Self {
        hash.0
    }
}

/// An API key or browser token to create.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewKey {
    /// The key's tenant.
    pub tenant: TenantName,
    /// The kind of the holder.
    pub kind: KeyKind,
    /// What the key is for, in the operator's words.
    pub label: String,
    /// The key's scopes.
    pub scopes: Scopes,
    /// The only origin whose pages may use the key; none for no restriction.
    pub origin: Option<String>,
    /// Maximum upload size in bytes; none for the service's limit.
    pub max_bytes: Option<u64>,
    /// Lifetime in seconds; none for a key that never expires.
    pub life_s: Option<u64>,
    /// The key that created this one, if any. This key becomes invalid when its parent is revoked or expires.
    pub parent: Option<String>,
}

/// A query for API keys. The newest keys come first.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct KeyQuery {
    /// Only keys of this tenant.
    pub tenant: Option<TenantName>,
    /// Only the key with this id.
    pub id: Option<String>,
    /// Only keys older than the key with this id.
    pub before: Option<String>,
    /// Maximum number of keys.
    pub limit: u32,
}

/// A stored API key or browser token, without its secret.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AccessKey {
    /// The key's id: `key_` and a UUID.
    pub id: String,
    /// The key's tenant.
    pub tenant: TenantName,
    /// The kind of the holder.
    pub kind: KeyKind,
    /// What the key is for.
    pub label: String,
    /// The key's scopes.
    pub scopes: Scopes,
    /// The only origin whose pages may use the key; none for no restriction.
    pub origin: Option<String>,
    /// Maximum upload size in bytes; none for the service's limit.
    pub max_bytes: Option<u64>,
    /// When the key was created.
    pub created_at: OffsetDateTime,
    /// When the key expires.
    pub expires_at: Option<OffsetDateTime>,
    /// When the key was revoked.
    pub revoked_at: Option<OffsetDateTime>,
    /// When the key was last used, accurate to five minutes.
    pub last_used_at: Option<OffsetDateTime>,
}

/// A permission of an API key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
pub enum Scope {
    /// Read jobs and download their files.
    #[serde(rename = "jobs:read")]
    JobsRead,
    /// Submit, cancel and delete jobs, and change process profiles.
    #[serde(rename = "jobs:write")]
    JobsWrite,
    /// Manage webhook endpoints.
    #[serde(rename = "webhooks")]
    Webhooks,
    /// Create short-lived tokens for browsers.
    #[serde(rename = "tokens")]
    Tokens,
    /// Read the metrics of the whole service.
    #[serde(rename = "metrics")]
    Metrics,
    /// Manage the tenants and keys of the whole service.
    #[serde(rename = "admin")]
    Admin,
}

/// The error of a text that is not a scope.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown scope '{name}'; the scopes are {}", Scope::ALL.map(Scope::as_str).join(", "))]
pub struct ScopeError {
    name: String,
}

impl Scope {
    /// Every scope.
    pub const ALL: [Self; 6] =
        [Self::JobsRead, Self::JobsWrite, Self::Webhooks, Self::Tokens, Self::Metrics, Self::Admin];

    /// Returns the name used in JSON, in the store and on the command line.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::JobsRead => "jobs:read",
            Self::JobsWrite => "jobs:write",
            Self::Webhooks => "webhooks",
            Self::Tokens => "tokens",
            Self::Metrics => "metrics",
            Self::Admin => "admin",
        }
    }

    /// Whether a browser token may have this scope.
    #[must_use]
    pub fn is_for_browsers(self) -> bool {
        matches!(self, Self::JobsRead | Self::JobsWrite)
    }
}

impl fmt::Display for Scope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for Scope {
    type Err = ScopeError;

    fn from_str(text: &str) -> Result<Self, ScopeError> {
        Self::ALL.into_iter().find(|scope| scope.as_str() == text).ok_or_else(|| ScopeError { name: text.to_owned() })
    }
}

/// A set of scopes. Its text form is the names with commas between.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Scopes(BTreeSet<Scope>);

impl Scopes {
    /// Returns every scope that concerns one tenant only: all but `metrics` and `admin`, which concern the whole service.
    #[must_use]
    pub fn of_a_tenant() -> Self {
        Scope::ALL.into_iter().filter(|scope| !matches!(scope, Scope::Metrics | Scope::Admin)).collect()
    }

    /// Whether the set contains the scope.
    #[must_use]
    pub fn has(&self, scope: Scope) -> bool {
        self.0.contains(&scope)
    }

    /// Iterates over the scopes in order.
    pub fn iter(&self) -> impl Iterator<Item = Scope> + '_ {
        self.0.iter().copied()
    }
}

impl FromIterator<Scope> for Scopes {
    fn from_iter<T: IntoIterator<Item = Scope>>(scopes: T) -> Self {
        Self(scopes.into_iter().collect())
    }
}

impl fmt::Display for Scopes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.iter().map(Scope::as_str).collect();
        f.write_str(&names.join(","))
    }
}

impl FromStr for Scopes {
    type Err = ScopeError;

    fn from_str(text: &str) -> Result<Self, ScopeError> {
        text.split(',').map(str::trim).filter(|name| !name.is_empty()).map(Scope::from_str).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_random_and_its_debug_output_hides_it() {
        let (first, second) = (Secret::new(KeyKind::Api, &SystemIds), Secret::new(KeyKind::Api, &SystemIds));
        assert_ne!(first.reveal(), second.reveal());
        assert!(first.reveal().starts_with("mm_key_") && first.reveal().len() == 7 + 64, "{}", first.reveal());
        assert!(!format!("{first:?}").contains(&first.reveal()[7..]));
        assert_eq!(first.hash(), SecretHash::of(first.reveal()));
        assert!(!first.hash().as_str().contains(&first.reveal()[7..]));
    }

    #[test]
    fn scopes_are_parsed_from_their_text_and_an_unknown_scope_is_named() {
        let scopes: Scopes = "jobs:write, jobs:read".parse().expect("scopes");
        assert_eq!(scopes.to_string(), "jobs:read,jobs:write");
        assert!(scopes.has(Scope::JobsRead) && !scopes.has(Scope::Metrics));
        let error = "jobs:read,jobs:fly".parse::<Scopes>().expect_err("no scope");
        assert!(error.to_string().starts_with("unknown scope 'jobs:fly'; the scopes are jobs:read, "), "{error}");
    }

    #[test]
    fn the_scopes_of_a_tenant_exclude_those_of_the_whole_service() {
        let own = Scopes::of_a_tenant();
        assert!(own.has(Scope::JobsWrite) && !own.has(Scope::Metrics) && !own.has(Scope::Admin));
    }

    #[test]
    fn a_scope_has_the_same_name_in_json_and_in_text() {
        for scope in Scope::ALL {
            assert_eq!(serde_json::to_value(scope).expect("JSON"), scope.as_str());
        }
    }
}
