use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::ToSchema;

use super::caller::MayMakeTokens;
use super::extract::{ApiJson, whole};
use super::problem::Problem;
use super::state::ApiState;
use crate::access::{KeyKind, NewKey, Scope, Scopes, Secret};

/// How long a token lives where nothing is said, and at most, in seconds.
const LIFE_S: u64 = 3600;
const LONGEST_S: u64 = 24 * 3600;
const SHORTEST_S: u64 = 30;

/// What a token for a page is to allow.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = NewBrowserToken)]
pub(super) struct NewToken {
    /// The origin of the page, such as `https://shop.example`: the token is worth nothing elsewhere.
    #[schema(
        max_length = 255,
        pattern = "^https?://[A-Za-z0-9._-]+(:[0-9]{1,5})?/?$",
        example = "https://shop.example"
    )]
    origin: String,
    /// What it allows; both where it is left out. Either way it reaches only jobs submitted with it.
    #[schema(value_type = Option<Vec<BrowserScope>>)]
    scopes: Option<Vec<Scope>>,
    /// Largest upload in bytes; that of the service where it is left out.
    #[serde(default, deserialize_with = "whole")]
    #[schema(minimum = 1)]
    max_bytes: Option<u64>,
    /// Seconds until it expires.
    #[serde(default, deserialize_with = "whole")]
    #[schema(minimum = 30, maximum = 86400, default = 3600)]
    expires_in_s: Option<u64>,
}

/// What a token for a page may allow.
#[derive(ToSchema)]
#[expect(
    dead_code,
    reason = "it describes the scopes in the OpenAPI document; which may be asked for depends on the key"
)]
enum BrowserScope {
    /// Look at jobs, download their files.
    #[schema(rename = "jobs:read")]
    JobsRead,
    /// Submit, cancel and delete jobs.
    #[schema(rename = "jobs:write")]
    JobsWrite,
}

/// A token for a page.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct BrowserToken {
    /// Its name, as jobs submitted with it have it in the service's log.
    id: String,
    /// The secret, to be sent as `Authorization: Bearer`. It is not shown again.
    token: String,
    /// The page's origin.
    origin: String,
    /// What it allows.
    scopes: Vec<Scope>,
    /// Largest upload in bytes.
    max_bytes: u64,
    /// When it expires.
    #[serde(with = "crate::jobs::timestamp::option")]
    expires_at: Option<OffsetDateTime>,
}

/// Make a token for a page.
///
/// For a storefront's own pages: its server asks for a token with its key, and gives it to the page, which uploads with it straight
/// to this service (CORS). The token holds for one origin, for a while, up to a size, and sees only jobs submitted with it.
#[utoipa::path(
    post, path = "/v1/browser-tokens", tag = "access",
    request_body = NewToken,
    responses(
        (status = 201, description = "The token", body = BrowserToken),
        (status = 400, description = "A body that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "A value that is out of its range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn make_token(
    State(state): State<ApiState>,
    MayMakeTokens(caller): MayMakeTokens,
    ApiJson(asked): ApiJson<NewToken>,
) -> Result<Response, Problem> {
    let origin = clean_origin(&asked.origin).ok_or_else(|| {
        let message = "`origin` must be a scheme, a host and perhaps a port, such as https://shop.example.";
        Problem::invalid_field("origin", message)
    })?;
    let scopes = match asked.scopes {
        None => [Scope::JobsRead, Scope::JobsWrite].into_iter().collect::<Scopes>(),
        Some(scopes) => scopes.into_iter().collect(),
    };
    if let Some(scope) = scopes.iter().find(|scope| !scope.is_for_browsers() || !caller.may(*scope)) {
        return Err(Problem::invalid_field("scopes", format!("A token of this key can't have the scope `{scope}`.")));
    }
    let life_s = asked.expires_in_s.unwrap_or(LIFE_S);
    if !(SHORTEST_S..=LONGEST_S).contains(&life_s) {
        let message = format!("`expires_in_s` must be a whole number from {SHORTEST_S} to {LONGEST_S}; got {life_s}.");
        return Err(Problem::invalid_field("expires_in_s", message));
    }
    if asked.max_bytes == Some(0) {
        return Err(Problem::invalid_field("max_bytes", "`max_bytes` must be at least 1; got 0."));
    }
    let max_bytes = asked.max_bytes.unwrap_or(u64::MAX).min(caller.max_bytes(state.config.limits.max_bytes));
    let secret = Secret::new(KeyKind::Browser);
    let new = NewKey {
        tenant: caller.tenant,
        kind: KeyKind::Browser,
        label: String::new(),
        scopes,
        origin: Some(origin.clone()),
        max_bytes: Some(max_bytes),
        life_s: Some(life_s),
        parent: caller.key.map(|key| key.id),
    };
    let key = state.store.create_key(new, &secret.token()).await?;
    let token = BrowserToken {
        id: key.id,
        token: secret.reveal().to_owned(),
        origin,
        scopes: key.scopes.iter().collect(),
        max_bytes,
        expires_at: key.expires_at,
    };
    Ok((StatusCode::CREATED, [(header::CACHE_CONTROL, "no-store")], Json(token)).into_response())
}

/// An origin as browsers send it: scheme and host in lower case, a port where it is not the scheme's own, nothing behind.
fn clean_origin(text: &str) -> Option<String> {
    let lower = text.to_ascii_lowercase();
    let (scheme, host) = lower.split_once("://").filter(|(scheme, _)| ["http", "https"].contains(scheme))?;
    let host = host.strip_suffix('/').unwrap_or(host);
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-._:[]".contains(c);
    let standard = if scheme == "http" { ":80" } else { ":443" };
    let host = host.strip_suffix(standard).unwrap_or(host);
    (!host.is_empty() && host.len() <= 255 && host.chars().all(is_plain)).then(|| format!("{scheme}://{host}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_is_written_as_browsers_send_it() {
        for (given, clean) in [
            ("https://Shop.example/", Some("https://shop.example")),
            ("https://shop.example:443", Some("https://shop.example")),
            ("http://localhost:3000", Some("http://localhost:3000")),
            ("https://shop.example/cart", None),
            ("shop.example", None),
            ("ftp://shop.example", None),
            ("https://", None),
            ("https://a b", None),
        ] {
            assert_eq!(clean_origin(given).as_deref(), clean, "{given}");
        }
    }
}
