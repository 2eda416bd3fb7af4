use axum::extract::FromRequestParts;
use axum::http::header;
use axum::http::request::Parts;

use super::problem::{Problem, ProblemCode};
use super::state::ApiState;
use crate::access::{AccessKey, KeyKind, Scope, TenantLimits, TenantName};
use crate::jobs::Job;

/// Who asks: made by `admit` for every request that needs one.
#[derive(Debug, Clone)]
pub(super) struct Caller {
    /// On whose behalf.
    pub tenant: TenantName,
    /// With which key; none where the service is open.
    pub key: Option<AccessKey>,
    /// What the tenant may use.
    pub limits: TenantLimits,
}

impl Caller {
    /// Whether the caller may do what the scope is for.
    pub fn may(&self, scope: Scope) -> bool {
        self.key.as_ref().is_none_or(|key| key.scopes.has(scope))
    }

    /// Whether the job exists for the caller: a page sees what was submitted with its own token and nothing else.
    pub fn sees(&self, job: &Job) -> bool {
        job.tenant == self.tenant.as_str()
            && self.only_made_by().is_none_or(|key| job.made_by.as_deref() == Some(key.as_str()))
    }

    /// The key with which a job must have been submitted for the caller to see it.
    pub fn only_made_by(&self) -> Option<String> {
        self.key.as_ref().filter(|key| key.kind == KeyKind::Browser).map(|key| key.id.clone())
    }

    /// The largest upload that the caller may send, where the service takes `most` bytes.
    pub fn max_bytes(&self, most: u64) -> u64 {
        self.key.as_ref().and_then(|key| key.max_bytes).map_or(most, |own| own.min(most))
    }

    fn must(self, scope: Scope) -> Result<Self, Problem> {
        if self.may(scope) {
            return Ok(self);
        }
        let detail = format!("The key does not allow this: it lacks the scope '{scope}'.");
        Err(Problem::new(ProblemCode::Forbidden, detail))
    }
}

/// Extractors that give the caller to handlers which need a scope, and answer for those who lack it.
macro_rules! callers {
    ($($(#[$doc:meta])* $name:ident: $scope:expr;)*) => {$(
        $(#[$doc])*
        pub(super) struct $name(pub Caller);

        impl FromRequestParts<ApiState> for $name {
            type Rejection = Problem;

            async fn from_request_parts(parts: &mut Parts, _: &ApiState) -> Result<Self, Problem> {
                let caller = parts.extensions.get::<Caller>().cloned();
                // Nobody comes here but through `admit`; who does is not let in.
                let caller = caller.ok_or_else(|| Problem::new(ProblemCode::Unauthorized, "Nobody asked."))?;
                caller.must($scope).map(Self)
            }
        }
    )*};
}

/// Who may manage tenants and keys. A key is needed even where the service is open: keys made meanwhile would outlast that.
pub(super) struct MayAdminister(pub Caller);

impl FromRequestParts<ApiState> for MayAdminister {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &ApiState) -> Result<Self, Problem> {
        let caller = parts.extensions.get::<Caller>().cloned().filter(|caller| caller.key.is_some());
        let caller = caller.ok_or_else(|| {
            let detail = "This address needs a key with the scope 'admin', also on a service that asks for no keys.";
            Problem::new(ProblemCode::Unauthorized, detail).with_header(header::WWW_AUTHENTICATE, "Bearer")
        })?;
        caller.must(Scope::Admin).map(Self)
    }
}

callers! {
    /// Who may look at jobs.
    MayRead: Scope::JobsRead;
    /// Who may submit, cancel and delete jobs.
    MayWrite: Scope::JobsWrite;
    /// Who may manage webhook endpoints.
    MayManageWebhooks: Scope::Webhooks;
    /// Who may make tokens for browsers.
    MayMakeTokens: Scope::Tokens;
    /// Who may read the service's metrics.
    MayReadMetrics: Scope::Metrics;
}
