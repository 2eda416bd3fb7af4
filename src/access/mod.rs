//! Who may ask for what: tenants, their API keys, browser tokens, and scopes.
//!
//! A secret is shown once, when it is made; the store keeps its hash. Everything that belongs to a tenant, jobs above all, is invisible
//! to every other one.

mod tenant;

use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use time::OffsetDateTime;
use utoipa::ToSchema;
use uuid::Uuid;

pub use tenant::{
    DEFAULT_TENANT, STANDARD_CLASS, Tenant, TenantChange, TenantClass, TenantClassError, TenantLimits, TenantName,
    TenantNameError,
};

/// Who holds a secret.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KeyKind {
    /// A tenant's own server.
    Api,
    /// A page in somebody's browser, for a while.
    Browser,
}

impl KeyKind {
    const ALL: [Self; 2] = [Self::Api, Self::Browser];

    /// The name in the store.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Api => "api",
            Self::Browser => "browser",
        }
    }

    /// The kind that a secret says it is of.
    #[must_use]
    pub fn of_secret(secret: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| secret.starts_with(kind.prefix()))
    }

    /// What its secrets begin with, so that programs that search for leaked secrets find them.
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

/// What nobody can guess: 244 bits of the operating system's random numbers, as 64 hexadecimal digits.
#[must_use]
pub fn random_hex() -> String {
    format!("{}{}", Uuid::new_v4().simple(), Uuid::new_v4().simple())
}

/// A secret as its holder shows it: a prefix that tells the kind, and [`random_hex`].
pub struct Secret(String);

impl Secret {
    /// A new one.
    #[must_use]
    pub fn new(kind: KeyKind) -> Self {
        Self(format!("{}{}", kind.prefix(), random_hex()))
    }

    /// The text to hand to its holder, once.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// What the store keeps of it.
    #[must_use]
    pub fn token(&self) -> Token {
        Token::of(&self.0)
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(hidden)")
    }
}

/// The hash by which a secret is looked up. A plain one is enough, since no secret can be guessed.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Token(String);

impl Token {
    /// Of whatever a client showed.
    #[must_use]
    pub fn of(shown: &str) -> Self {
        Self(hex::encode(Sha256::digest(shown.as_bytes())))
    }

    /// SHA-256 in hexadecimal.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl From<Token> for String {
    fn from(token: Token) -> Self {
        token.0
    }
}

/// A key to make.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewKey {
    /// Whose it is.
    pub tenant: TenantName,
    /// Who holds it.
    pub kind: KeyKind,
    /// What it is for, in the operator's words.
    pub label: String,
    /// What it allows.
    pub scopes: Scopes,
    /// The only origin whose pages may use it.
    pub origin: Option<String>,
    /// Largest upload in bytes.
    pub max_bytes: Option<u64>,
    /// Seconds after which it expires; none for one that does not.
    pub life_s: Option<u64>,
    /// The key that it was made with; it is invalid once that is revoked or expired.
    pub parent: Option<String>,
}

/// Which API keys to list: newest first.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct KeyQuery {
    /// Only those of this tenant.
    pub tenant: Option<TenantName>,
    /// Only the one with this id.
    pub id: Option<String>,
    /// Only keys older than the one with this id.
    pub before: Option<String>,
    /// At most so many.
    pub limit: u32,
}

/// A key as the store knows it, without its secret.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AccessKey {
    /// Its name: `key_` and a UUID.
    pub id: String,
    /// Whose it is.
    pub tenant: TenantName,
    /// Who holds it.
    pub kind: KeyKind,
    /// What it is for.
    pub label: String,
    /// What it allows.
    pub scopes: Scopes,
    /// The only origin whose pages may use it.
    pub origin: Option<String>,
    /// Largest upload in bytes.
    pub max_bytes: Option<u64>,
    /// When it was made.
    pub created_at: OffsetDateTime,
    /// When it expires.
    pub expires_at: Option<OffsetDateTime>,
    /// When it was revoked.
    pub revoked_at: Option<OffsetDateTime>,
    /// When it was last used, give or take some minutes.
    pub last_used_at: Option<OffsetDateTime>,
}

/// What a key allows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
pub enum Scope {
    /// Look at jobs, download their files.
    #[serde(rename = "jobs:read")]
    JobsRead,
    /// Submit, cancel and delete jobs.
    #[serde(rename = "jobs:write")]
    JobsWrite,
    /// Manage webhook endpoints.
    #[serde(rename = "webhooks")]
    Webhooks,
    /// Make short-lived tokens for browsers.
    #[serde(rename = "tokens")]
    Tokens,
    /// Read the metrics of the whole service.
    #[serde(rename = "metrics")]
    Metrics,
    /// Manage the tenants and keys of the whole service.
    #[serde(rename = "admin")]
    Admin,
}

/// A text that is no scope.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{name}' is no scope; scopes are {}", Scope::ALL.map(Scope::as_str).join(", "))]
pub struct ScopeError {
    name: String,
}

impl Scope {
    /// Every scope.
    pub const ALL: [Self; 6] =
        [Self::JobsRead, Self::JobsWrite, Self::Webhooks, Self::Tokens, Self::Metrics, Self::Admin];

    /// The name used in JSON, in the store and on the command line.
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

    /// Whether a token that a page holds may have it.
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

/// A set of scopes, written as their names with commas between.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Scopes(BTreeSet<Scope>);

impl Scopes {
    /// Every scope that concerns one tenant only. `metrics` and `admin` concern the whole service.
    #[must_use]
    pub fn of_a_tenant() -> Self {
        Scope::ALL.into_iter().filter(|scope| !matches!(scope, Scope::Metrics | Scope::Admin)).collect()
    }

    /// Whether the scope is among them.
    #[must_use]
    pub fn has(&self, scope: Scope) -> bool {
        self.0.contains(&scope)
    }

    /// The scopes in order.
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
    fn a_secret_is_new_each_time_and_shows_itself_only_when_asked() {
        let (one, other) = (Secret::new(KeyKind::Api), Secret::new(KeyKind::Api));
        assert_ne!(one.reveal(), other.reveal());
        assert!(one.reveal().starts_with("mm_key_") && one.reveal().len() == 7 + 64, "{}", one.reveal());
        assert!(!format!("{one:?}").contains(&one.reveal()[7..]));
        assert_eq!(one.token(), Token::of(one.reveal()));
        assert!(!one.token().as_str().contains(&one.reveal()[7..]));
    }

    #[test]
    fn scopes_are_read_back_from_their_text_and_an_unknown_one_is_named() {
        let scopes: Scopes = "jobs:write, jobs:read".parse().expect("scopes");
        assert_eq!(scopes.to_string(), "jobs:read,jobs:write");
        assert!(scopes.has(Scope::JobsRead) && !scopes.has(Scope::Metrics));
        let error = "jobs:read,jobs:fly".parse::<Scopes>().expect_err("no scope");
        assert!(error.to_string().starts_with("'jobs:fly' is no scope; scopes are jobs:read, "), "{error}");
    }

    #[test]
    fn a_tenants_scopes_reach_nothing_of_the_whole_service() {
        let own = Scopes::of_a_tenant();
        assert!(own.has(Scope::JobsWrite) && !own.has(Scope::Metrics) && !own.has(Scope::Admin));
    }

    #[test]
    fn scopes_have_one_name_in_json_and_elsewhere() {
        for scope in Scope::ALL {
            assert_eq!(serde_json::to_value(scope).expect("JSON"), scope.as_str());
        }
    }
}
