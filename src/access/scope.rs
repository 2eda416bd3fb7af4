use std::collections::BTreeSet;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

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
