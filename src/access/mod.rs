//! Who may ask for what: tenants, their API keys, browser tokens, and scopes.
//!
//! A secret is shown once, when it is made; the store keeps its hash. Everything that belongs to a tenant, jobs above all, is invisible
//! to every other one.

mod key;
mod scope;
mod tenant;

pub use key::{AccessKey, KeyKind, KeyQuery, NewKey, Secret, Token, random_hex};
pub use scope::{Scope, ScopeError, Scopes};
pub use tenant::{
    DEFAULT_TENANT, STANDARD_CLASS, Tenant, TenantChange, TenantClass, TenantClassError, TenantLimits, TenantName,
    TenantNameError,
};
