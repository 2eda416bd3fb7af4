//! API keys, and browser tokens made with them.

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::{IntoParams, ToSchema};

use super::authenticate::{MayAdminister, MayMakeTokens};
use super::extract::{ApiJson, ApiPath, ApiQuery, is_name, page_limit, unknown_cursor, whole};
use super::problem::{Problem, ProblemCode, shown};
use super::state::ApiState;
use crate::access::{AccessKey, KeyKind, KeyQuery, NewKey, Scope, Scopes, Secret, TenantName};
use crate::jobs::Page;

/// Longest label, in characters.
const LABEL_CHARS: usize = 200;
/// Shortest and longest life of a key that expires, in seconds: up to ten years.
const LIFE_S: std::ops::RangeInclusive<u64> = 30..=315_360_000;

/// A key to make.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = NewApiKey)]
pub(super) struct NewView {
    /// The tenant that it belongs to: lower-case letters, digits and hyphens. A tenant is made by its first key.
    #[schema(min_length = 1, max_length = 63, pattern = "^[a-z0-9][a-z0-9-]*$", example = "shop")]
    tenant: String,
    /// What it allows; everything of one tenant, but neither `metrics` nor `admin`, where it is left out.
    scopes: Option<Vec<Scope>>,
    /// What it is for, in your own words: at most 200 characters on one line.
    #[serde(default)]
    #[schema(max_length = 200, pattern = r"^[^\u0000-\u001f\u007f-\u009f]*$")]
    label: String,
    /// Seconds until it expires; never where it is left out.
    #[serde(default, deserialize_with = "whole")]
    #[schema(minimum = 30, maximum = 315_360_000)]
    expires_in_s: Option<u64>,
}

/// An API key.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ApiKey)]
pub(super) struct KeyView {
    /// Its name.
    #[schema(example = "key_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    id: String,
    /// The tenant that it belongs to.
    tenant: String,
    /// What it is for.
    label: String,
    /// What it allows.
    scopes: Vec<Scope>,
    /// When it was made.
    #[serde(with = "time::serde::rfc3339")]
    created_at: OffsetDateTime,
    /// When it expires; null where it does not.
    #[serde(with = "time::serde::rfc3339::option")]
    #[schema(required)]
    expires_at: Option<OffsetDateTime>,
    /// When it was revoked; null where it was not.
    #[serde(with = "time::serde::rfc3339::option")]
    #[schema(required)]
    revoked_at: Option<OffsetDateTime>,
    /// When it was last used, to within five minutes; null where it never was.
    #[serde(with = "time::serde::rfc3339::option")]
    #[schema(required)]
    last_used_at: Option<OffsetDateTime>,
    /// The secret, to be sent as `Authorization: Bearer`; only in the answer that makes the key.
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

/// A page of keys.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ApiKeys)]
pub(super) struct KeysView {
    /// The keys, newest first, revoked and expired ones among them.
    keys: Vec<KeyView>,
    /// The cursor of the next page; none on the last.
    #[schema(required)]
    next: Option<String>,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct KeysQuery {
    /// Only keys of this tenant.
    tenant: Option<String>,
    /// Where to go on: `next` of the page before.
    cursor: Option<String>,
    /// Keys on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
}

/// Make an API key.
///
/// Of any tenant. The `secret` is shown here and never again. The key that asks needs the scope `admin`.
#[utoipa::path(
    post, path = "/v1/keys", tag = "access",
    request_body = NewView,
    responses(
        (status = 201, description = "The key with its secret", body = KeyView, headers(("Location" = String, description = "Its address"))),
        (status = 400, description = "A body that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "A value that is out of its range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn create_key(
    State(state): State<ApiState>,
    MayAdminister(_caller): MayAdminister,
    ApiJson(asked): ApiJson<NewView>,
) -> Result<Response, Problem> {
    let tenant = tenant_name("tenant", &asked.tenant).map_err(Problem::invalid_value)?;
    if asked.label.chars().count() > LABEL_CHARS || asked.label.chars().any(char::is_control) {
        return Err(Problem::invalid_value(format!("`label` must be at most {LABEL_CHARS} characters on one line.")));
    }
    if let Some(life_s) = asked.expires_in_s.filter(|life_s| !LIFE_S.contains(life_s)) {
        let (least, most) = LIFE_S.into_inner();
        return Err(Problem::invalid_value(format!(
            "`expires_in_s` is {life_s}; it must be between {least} and {most}."
        )));
    }
    let scopes: Scopes = asked.scopes.map_or_else(Scopes::of_a_tenant, |scopes| scopes.into_iter().collect());
    let secret = Secret::new(KeyKind::Api);
    let new = NewKey {
        tenant,
        kind: KeyKind::Api,
        label: asked.label,
        scopes,
        origin: None,
        max_bytes: None,
        life_s: asked.expires_in_s,
        parent: None,
    };
    let key = state.store.create_key(new, &secret.token()).await?;
    tracing::info!(created_key_id = key.id, of_tenant = key.tenant.as_str(), scopes = %key.scopes, "an API key was made");
    let headers = [(header::CACHE_CONTROL, "no-store".to_owned()), (header::LOCATION, format!("/v1/keys/{}", key.id))];
    let view = KeyView { secret: Some(secret.reveal().to_owned()), ..key.into() };
    Ok((StatusCode::CREATED, headers, Json(view)).into_response())
}

/// List API keys.
///
/// Of all tenants or of one, newest first, without their secrets. Browser tokens are not listed. The key needs the scope `admin`.
#[utoipa::path(
    get, path = "/v1/keys", tag = "access",
    params(KeysQuery),
    responses(
        (status = 200, description = "A page of keys", body = KeysView),
        (status = 400, description = "A query that can't be understood", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_keys(
    State(state): State<ApiState>,
    MayAdminister(_caller): MayAdminister,
    ApiQuery(asked): ApiQuery<KeysQuery>,
) -> Result<Json<KeysView>, Problem> {
    if asked.cursor.as_ref().is_some_and(|cursor| !is_name(cursor, "key")) {
        return Err(unknown_cursor());
    }
    let tenant = asked.tenant.map(|name| tenant_name("tenant", &name)).transpose().map_err(Problem::invalid_request)?;
    let query = KeyQuery { tenant, id: None, before: asked.cursor, limit: page_limit(asked.limit)? };
    let Page { items, next } = state.store.keys(query).await?;
    Ok(Json(KeysView { keys: items.into_iter().map(KeyView::from).collect(), next }))
}

/// One API key.
///
/// Without its secret. The key that asks needs the scope `admin`.
#[utoipa::path(
    get, path = "/v1/keys/{id}", tag = "access",
    params(("id" = String, Path, description = "The key's id")),
    responses(
        (status = 200, description = "The key", body = KeyView),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such key", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_key(
    State(state): State<ApiState>,
    MayAdminister(_caller): MayAdminister,
    ApiPath(id): ApiPath<String>,
) -> Result<Json<KeyView>, Problem> {
    find(&state, &id).await.map(|key| Json(key.into()))
}

/// Revoke an API key.
///
/// It is refused from then on, and so are the browser tokens made with it. Its record stays in the list. The key that asks needs the scope
/// `admin`.
#[utoipa::path(
    delete, path = "/v1/keys/{id}", tag = "access",
    params(("id" = String, Path, description = "The key's id")),
    responses(
        (status = 204, description = "The key is revoked, by this request or an earlier one"),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such key", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn revoke_key(
    State(state): State<ApiState>,
    MayAdminister(_caller): MayAdminister,
    ApiPath(id): ApiPath<String>,
) -> Result<StatusCode, Problem> {
    let key = find(&state, &id).await?;
    if state.store.revoke_key(&key.id).await? {
        tracing::info!(revoked_key_id = key.id, of_tenant = key.tenant.as_str(), "an API key was revoked");
    }
    Ok(StatusCode::NO_CONTENT)
}

async fn find(state: &ApiState, id: &str) -> Result<AccessKey, Problem> {
    let not_found =
        || Problem::new(ProblemCode::KeyNotFound, format!("There is no API key with the id '{}'.", shown(id)));
    if !is_name(id, "key") {
        return Err(not_found());
    }
    let query = KeyQuery { id: Some(id.to_owned()), limit: 1, ..KeyQuery::default() };
    state.store.keys(query).await?.items.pop().ok_or_else(not_found)
}

fn tenant_name(field: &str, text: &str) -> Result<TenantName, String> {
    text.parse().map_err(|error| format!("`{field}` is '{}', which can't be used: {error}.", shown(text)))
}

/// How long a token lives where nothing is said, and at most, in seconds.
const TOKEN_LIFE_S: u64 = 3600;
const LONGEST_TOKEN_LIFE_S: u64 = 24 * 3600;
const SHORTEST_TOKEN_LIFE_S: u64 = 30;

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
    let life_s = asked.expires_in_s.unwrap_or(TOKEN_LIFE_S);
    if !(SHORTEST_TOKEN_LIFE_S..=LONGEST_TOKEN_LIFE_S).contains(&life_s) {
        let message = format!(
            "`expires_in_s` must be a whole number from {SHORTEST_TOKEN_LIFE_S} to {LONGEST_TOKEN_LIFE_S}; got {life_s}."
        );
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
