use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use time::OffsetDateTime;
use uuid::Uuid;

use super::{Scopes, TenantName};

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
    /// Seconds after which it is worth nothing; none for one that stays.
    pub life_s: Option<u64>,
    /// The key that it was made with, without which it is worth nothing.
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
    /// When it is worth nothing any more.
    pub expires_at: Option<OffsetDateTime>,
    /// When it was revoked.
    pub revoked_at: Option<OffsetDateTime>,
    /// When it was last used, give or take some minutes.
    pub last_used_at: Option<OffsetDateTime>,
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
}
