//! Routes of API keys, and of browser tokens created with them.

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::{IntoParams, ToSchema};

use super::authenticate::{RequireAdmin, RequireTokens};
use super::extract::{ApiJson, ApiPath, ApiQuery, invalid_cursor, is_id, page_limit, whole};
use super::problem::{Problem, ProblemCode, truncated};
use super::state::ApiState;
use crate::access::{AccessKey, KeyKind, KeyQuery, NewKey, Scope, Scopes, Secret, TenantName};
use crate::jobs::Page;

/// Longest label, in characters.
const LABEL_CHARS: usize = 200;
/// Allowed lifetime of a key that expires, in seconds: 30 s to ten years.
const LIFE_S: std::ops::RangeInclusive<u64> = 30..=315_360_000;

/// An API key to create.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = NewApiKey)]
pub(super) struct NewKeyBody {
    /// The key's tenant: 1 to 63 lower-case letters, digits and hyphens. A tenant's first key creates the tenant.
    #[schema(min_length = 1, max_length = 63, pattern = "^[a-z0-9][a-z0-9-]*$", example = "shop")]
    tenant: String,
    /// The key's scopes. Defaults to all scopes except `metrics` and `admin`.
    scopes: Option<Vec<Scope>>,
    /// What the key is for, in your own words: at most 200 characters on one line.
    #[serde(default)]
    #[schema(max_length = 200, pattern = r"^[^\u0000-\u001f\u007f-\u009f]*$")]
    label: String,
    /// Seconds until the key expires. By default the key never expires.
    #[serde(default, deserialize_with = "whole")]
    #[schema(minimum = 30, maximum = 315_360_000)]
    expires_in_s: Option<u64>,
}

/// An API key.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ApiKey)]
pub(super) struct KeyView {
    /// The key's id.
    #[schema(example = "key_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    id: String,
    /// The key's tenant.
    tenant: String,
    /// What the key is for.
    label: String,
    /// The key's scopes.
    scopes: Vec<Scope>,
    /// When the key was created.
    #[serde(with = "time::serde::rfc3339")]
    created_at: OffsetDateTime,
    /// When the key expires, or `null` if it never does.
    #[serde(with = "time::serde::rfc3339::option")]
    #[schema(required)]
    expires_at: Option<OffsetDateTime>,
    /// When the key was revoked, or `null` if it was not.
    #[serde(with = "time::serde::rfc3339::option")]
    #[schema(required)]
    revoked_at: Option<OffsetDateTime>,
    /// When the key was last used, accurate to five minutes, or `null` if it was never used.
    #[serde(with = "time::serde::rfc3339::option")]
    #[schema(required)]
    last_used_at: Option<OffsetDateTime>,
    /// The secret, to be sent as `Authorization: Bearer`. Only in the response that creates the key.
    #[serde(skip_serializing_if = "Option::is_none")]
    secret: Option<String>,
}

impl From<AccessKey> for KeyView {
    fn from(key: AccessKey) -> Self {
        Self {
            id: key.id,
            tenant: key.tenant.to_string(),
            label: key.label,
            scopes: key.scopes.iter().collect(),
            created_at: key.created_at,
            expires_at: key.expires_at,
            revoked_at: key.revoked_at,
            last_used_at: key.last_used_at,
            secret: None,
        }
    }
}

/// One page of API keys.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ApiKeys)]
pub(super) struct KeysView {
    /// The keys, newest first, including revoked and expired ones.
    keys: Vec<KeyView>,
    /// The cursor of the next page, or `null` on the last page.
    #[schema(required)]
    next: Option<String>,
}

/// Query parameters of the list of API keys.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct KeysQuery {
    /// Only keys of this tenant.
    tenant: Option<String>,
    /// The `next` value of the previous page.
    cursor: Option<String>,
    /// Number of keys per page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
}

/// Create an API key.
///
/// The key may belong to any tenant. The response contains the `secret`, which is never shown again. Requires the scope `admin`.
#[utoipa::path(
    post, path = "/v1/keys", tag = "access",
    request_body = NewKeyBody,
    responses(
        (status = 201, description = "The created key with its secret", body = KeyView, headers(("Location" = String, description = "The key's path"))),
        (status = 400, description = "The body is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "A value is out of range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn create_key(
    State(state): State<ApiState>,
    RequireAdmin(_caller): RequireAdmin,
    ApiJson(requested): ApiJson<NewKeyBody>,
) -> Result<Response, Problem> {
    let tenant = tenant_name("tenant", &requested.tenant).map_err(Problem::invalid_value)?;
    if requested.label.chars().count() > LABEL_CHARS || requested.label.chars().any(char::is_control) {
        return Err(Problem::invalid_value(format!("`label` must be at most {LABEL_CHARS} characters on one line.")));
    }
    if let Some(life_s) = requested.expires_in_s.filter(|life_s| !LIFE_S.contains(life_s)) {
        let (least, most) = LIFE_S.into_inner();
        return Err(Problem::invalid_value(format!(
            "`expires_in_s` must be a whole number from {least} to {most}; got {life_s}."
        )));
    }
    let scopes: Scopes = requested.scopes.map_or_else(Scopes::of_a_tenant, |scopes| scopes.into_iter().collect());
    let secret = Secret::new(KeyKind::Api, state.ids.as_ref());
    let new = NewKey {
        tenant,
        kind: KeyKind::Api,
        label: requested.label,
        scopes,
        origin: None,
        max_bytes: None,
        life_s: requested.expires_in_s,
        parent: None,
    };
    let key = state.store.create_key(new, &secret.hash()).await?;
    tracing::info!(created_key_id = key.id, of_tenant = key.tenant.as_str(), scopes = %key.scopes, "created API key");
    let headers = [(header::CACHE_CONTROL, "no-store".to_owned()), (header::LOCATION, format!("/v1/keys/{}", key.id))];
    let view = KeyView { secret: Some(secret.reveal().to_owned()), ..key.into() };
    Ok((StatusCode::CREATED, headers, Json(view)).into_response())
}

/// List API keys, newest first.
///
/// Lists the keys of all tenants or of one, without their secrets. Browser tokens are not listed. Requires the scope `admin`.
#[utoipa::path(
    get, path = "/v1/keys", tag = "access",
    params(KeysQuery),
    responses(
        (status = 200, description = "A page of keys", body = KeysView),
        (status = 400, description = "The query is malformed", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_keys(
    State(state): State<ApiState>,
    RequireAdmin(_caller): RequireAdmin,
    ApiQuery(requested): ApiQuery<KeysQuery>,
) -> Result<Json<KeysView>, Problem> {
    if requested.cursor.as_ref().is_some_and(|cursor| !is_id(cursor, "key")) {
        return Err(invalid_cursor());
    }
    let tenant =
        requested.tenant.map(|name| tenant_name("tenant", &name)).transpose().map_err(Problem::invalid_request)?;
    let query = KeyQuery { tenant, id: None, before: requested.cursor, limit: page_limit(requested.limit)? };
    let Page { items, next } = state.store.keys(query).await?;
    Ok(Json(KeysView { keys: items.into_iter().map(KeyView::from).collect(), next }))
}

/// Get an API key.
///
/// The response does not contain the secret. Requires the scope `admin`.
#[utoipa::path(
    get, path = "/v1/keys/{id}", tag = "access",
    params(("id" = String, Path, description = "The key's id")),
    responses(
        (status = 200, description = "The key", body = KeyView),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "API key not found", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_key(
    State(state): State<ApiState>,
    RequireAdmin(_caller): RequireAdmin,
    ApiPath(id): ApiPath<String>,
) -> Result<Json<KeyView>, Problem> {
    find(&state, &id).await.map(|key| Json(key.into()))
}

/// Revoke an API key.
///
/// The key and all browser tokens created with it become invalid. The key remains in the list. Requires the scope `admin`.
#[utoipa::path(
    delete, path = "/v1/keys/{id}", tag = "access",
    params(("id" = String, Path, description = "The key's id")),
    responses(
        (status = 204, description = "The key is revoked, now or earlier"),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "API key not found", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn revoke_key(
    State(state): State<ApiState>,
    RequireAdmin(_caller): RequireAdmin,
    ApiPath(id): ApiPath<String>,
) -> Result<StatusCode, Problem> {
    let key = find(&state, &id).await?;
    if state.store.revoke_key(&key.id).await? {
        tracing::info!(revoked_key_id = key.id, of_tenant = key.tenant.as_str(), "revoked API key");
    }
    Ok(StatusCode::NO_CONTENT)
}

/// Returns the API key with this id.
async fn find(state: &ApiState, id: &str) -> Result<AccessKey, Problem> {
    let not_found = || Problem::new(ProblemCode::KeyNotFound, format!("There is no API key '{}'.", truncated(id)));
    if !is_id(id, "key") {
        return Err(not_found());
    }
    let query = KeyQuery { id: Some(id.to_owned()), limit: 1, ..KeyQuery::default() };
    state.store.keys(query).await?.items.pop().ok_or_else(not_found)
}

/// Parses a tenant's name.
fn tenant_name(field: &str, text: &str) -> Result<TenantName, String> {
    text.parse().map_err(|error| format!("`{field}` '{}' is invalid: {error}.", truncated(text)))
}

/// Default lifetime of a browser token, in seconds.
const TOKEN_LIFE_S: u64 = 3600;
/// Longest lifetime of a browser token, in seconds.
const LONGEST_TOKEN_LIFE_S: u64 = 24 * 3600;
/// Shortest lifetime of a browser token, in seconds.
const SHORTEST_TOKEN_LIFE_S: u64 = 30;

/// A browser token to create.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = NewBrowserToken)]
pub(super) struct NewTokenBody {
    /// The origin of the page, such as `https://shop.example`. The token is invalid for other origins.
    #[schema(
        max_length = 255,
        pattern = "^https?://[A-Za-z0-9._-]+(:[0-9]{1,5})?/?$",
        example = "https://shop.example"
    )]
    origin: String,
    /// The token's scopes. Defaults to both. The token only ever gives access to jobs submitted with it.
    #[schema(value_type = Option<Vec<BrowserScope>>)]
    scopes: Option<Vec<Scope>>,
    /// Maximum upload size in bytes. Defaults to the service's limit.
    #[serde(default, deserialize_with = "whole")]
    #[schema(minimum = 1)]
    max_bytes: Option<u64>,
    /// Seconds until the token expires.
    #[serde(default, deserialize_with = "whole")]
    #[schema(minimum = 30, maximum = 86400, default = 3600)]
    expires_in_s: Option<u64>,
}

/// A scope of a browser token.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes the scopes in the OpenAPI document; the allowed ones depend on the key")]
enum BrowserScope {
    /// Read jobs and download their files.
    #[schema(rename = "jobs:read")]
    JobsRead,
    /// Submit, cancel and delete jobs.
    #[schema(rename = "jobs:write")]
    JobsWrite,
}

/// A token for web pages of one origin.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct BrowserToken {
    /// The token's id, which the service's log shows for jobs submitted with it.
    id: String,
    /// The secret, to be sent as `Authorization: Bearer`. This response alone shows it.
    token: String,
    /// The page's origin.
    origin: String,
    /// The token's scopes.
    scopes: Vec<Scope>,
    /// Maximum upload size in bytes.
    max_bytes: u64,
    /// When the token expires.
    #[serde(with = "crate::jobs::timestamp::option")]
    expires_at: Option<OffsetDateTime>,
}

/// Create a browser token.
///
/// For uploads from a storefront's own pages. The shop's server creates a token with its API key and gives it to the page. The page then
/// uploads directly to this service (CORS). The token is valid for one origin, a limited time and a maximum upload size. The token gives access
/// only to jobs submitted with it.
#[utoipa::path(
    post, path = "/v1/browser-tokens", tag = "access",
    request_body = NewTokenBody,
    responses(
        (status = 201, description = "The created token", body = BrowserToken),
        (status = 400, description = "The body is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "A value is out of range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn make_token(
    State(state): State<ApiState>,
    RequireTokens(caller): RequireTokens,
    ApiJson(requested): ApiJson<NewTokenBody>,
) -> Result<Response, Problem> {
    let origin = normalize_origin(&requested.origin).ok_or_else(|| {
        let message = "`origin` must be a scheme, a host and optionally a port, such as https://shop.example.";
        Problem::invalid_field("origin", message)
    })?;
    let scopes = match requested.scopes {
        None => [Scope::JobsRead, Scope::JobsWrite].into_iter().collect::<Scopes>(),
        Some(scopes) => scopes.into_iter().collect(),
    };
    if let Some(scope) = scopes.iter().find(|scope| !scope.is_for_browsers() || !caller.has_scope(*scope)) {
        let message = format!("`scopes` contains `{scope}`, which this key can't give to a token.");
        return Err(Problem::invalid_field("scopes", message));
    }
    let life_s = requested.expires_in_s.unwrap_or(TOKEN_LIFE_S);
    if !(SHORTEST_TOKEN_LIFE_S..=LONGEST_TOKEN_LIFE_S).contains(&life_s) {
        let message = format!(
            "`expires_in_s` must be a whole number from {SHORTEST_TOKEN_LIFE_S} to {LONGEST_TOKEN_LIFE_S}; got {life_s}."
        );
        return Err(Problem::invalid_field("expires_in_s", message));
    }
    if requested.max_bytes == Some(0) {
        return Err(Problem::invalid_field("max_bytes", "`max_bytes` must be at least 1; got 0."));
    }
    let max_bytes = requested.max_bytes.unwrap_or(u64::MAX).min(caller.max_bytes(state.config.limits.max_bytes));
    let secret = Secret::new(KeyKind::Browser, state.ids.as_ref());
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
    let key = state.store.create_key(new, &secret.hash()).await?;
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

/// Normalizes an origin to the form that browsers send: lower case, no default port, no path.
fn normalize_origin(text: &str) -> Option<String> {
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
    fn an_origin_is_normalized_to_the_form_that_browsers_send() {
        for (origin, normalized) in [
            ("https://Shop.example/", Some("https://shop.example")),
            ("https://shop.example:443", Some("https://shop.example")),
            ("http://localhost:3000", Some("http://localhost:3000")),
            ("https://shop.example/cart", None),
            ("shop.example", None),
            ("ftp://shop.example", None),
            ("https://", None),
            ("https://a b", None),
        ] {
            assert_eq!(normalize_origin(origin).as_deref(), normalized, "{origin}");
        }
    }
}
