//! Routes of tenants and their settings.
use axum::Json;
use axum::extract::State;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::authenticate::RequireAdmin;
use super::extract::{ApiJson, ApiPath, ApiQuery, invalid_cursor, page_limit, whole};
use super::problem::{Problem, ProblemCode, truncated};
use super::state::ApiState;
use crate::access::{STANDARD_CLASS, Tenant, TenantChange, TenantName};
use crate::jobs::Page;

/// A tenant and its settings. The service's own limit applies where a limit is `null`.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Tenant)]
pub(super) struct TenantView {
    /// The tenant's name.
    #[schema(example = "shop")]
    id: String,
    /// The class under which the metrics count the tenant's jobs. `standard` by default.
    class: String,
    /// Maximum number of queued jobs.
    #[schema(required)]
    max_queued: Option<u32>,
    /// Maximum number of running jobs.
    #[schema(required)]
    max_running: Option<u32>,
    /// Maximum number of requests per minute to each server process.
    #[schema(required)]
    requests_per_minute: Option<u32>,
}

impl From<Tenant> for TenantView {
    fn from(tenant: Tenant) -> Self {
        Self {
            id: tenant.name,
            class: tenant.class.unwrap_or_else(|| STANDARD_CLASS.to_owned()),
            max_queued: tenant.limits.max_queued,
            max_running: tenant.limits.max_running,
            requests_per_minute: tenant.limits.requests_per_minute,
        }
    }
}

/// One page of tenants.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Tenants)]
pub(super) struct TenantsView {
    /// The tenants, sorted by name.
    tenants: Vec<TenantView>,
    /// The cursor of the next page, or `null` on the last page.
    #[schema(required)]
    next: Option<String>,
}

/// Tenant settings to change. An omitted field keeps its value; `null` clears it.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = TenantChange)]
pub(super) struct ChangeTenantBody {
    /// The class under which the metrics count the tenant's jobs: 1 to 63 lower-case letters, digits and hyphens.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 63, pattern = "^[a-z0-9][a-z0-9-]*$", example = "gold")]
    class: Option<Option<String>>,
    /// Maximum number of queued jobs.
    #[serde(default, deserialize_with = "present_number")]
    #[schema(value_type = Option<u32>, maximum = 2_147_483_647)]
    max_queued: Option<Option<u32>>,
    /// Maximum number of running jobs.
    #[serde(default, deserialize_with = "present_number")]
    #[schema(value_type = Option<u32>, maximum = 2_147_483_647)]
    max_running: Option<Option<u32>>,
    /// Maximum number of requests per minute to each server process.
    #[serde(default, deserialize_with = "present_number")]
    #[schema(value_type = Option<u32>, minimum = 1, maximum = 2_147_483_647)]
    requests_per_minute: Option<Option<u32>>,
}

/// Deserializes a field that is present: `null` becomes `Some(None)`.
fn present<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Option<String>>, D::Error> {
    Option::deserialize(from).map(Some)
}

/// Deserializes a number that is present, of at most 31 bits as the schema's format `int32` demands.
fn present_number<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Option<u32>>, D::Error> {
    let Some(number) = whole(from)? else { return Ok(Some(None)) };
    let max = i32::MAX.unsigned_abs();
    let small = u32::try_from(number).ok().filter(|&number| number <= max);
    small.map(|number| Some(Some(number))).ok_or_else(|| D::Error::custom(format!("{number} is larger than {max}")))
}

/// Query parameters of the list of tenants.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct PageQuery {
    /// The `next` value of the previous page.
    cursor: Option<String>,
    /// Number of tenants per page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
}

/// List tenants, sorted by name.
///
/// Lists every tenant that has an API key or settings. Requires the scope `admin`.
#[utoipa::path(
    get, path = "/v1/tenants", tag = "access",
    params(PageQuery),
    responses(
        (status = 200, description = "A page of tenants", body = TenantsView),
        (status = 400, description = "The query is malformed", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_tenants(
    State(state): State<ApiState>,
    RequireAdmin(_caller): RequireAdmin,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Json<TenantsView>, Problem> {
    if query.cursor.as_ref().is_some_and(|cursor| cursor.parse::<TenantName>().is_err()) {
        return Err(invalid_cursor());
    }
    let Page { items, next } = state.store.tenants(query.cursor.as_deref(), page_limit(query.limit)?).await?;
    Ok(Json(TenantsView { tenants: items.into_iter().map(TenantView::from).collect(), next }))
}

/// Get a tenant.
///
/// Requires the scope `admin`.
#[utoipa::path(
    get, path = "/v1/tenants/{id}", tag = "access",
    params(("id" = String, Path, description = "The tenant's name")),
    responses(
        (status = 200, description = "The tenant", body = TenantView),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Tenant not found", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_tenant(
    State(state): State<ApiState>,
    RequireAdmin(_caller): RequireAdmin,
    ApiPath(id): ApiPath<String>,
) -> Result<Json<TenantView>, Problem> {
    // A text that is no tenant's name need not reach the database.
    let tenant = if id.parse::<TenantName>().is_ok() { state.store.tenant(&id).await? } else { None };
    let not_found = || {
        let detail = format!("There is no tenant '{}' with a key or settings.", truncated(&id));
        Problem::new(ProblemCode::TenantNotFound, detail)
    };
    tenant.map(|tenant| Json(tenant.into())).ok_or_else(not_found)
}

/// Change a tenant's settings.
///
/// An omitted field keeps its value. `null` clears a setting, so that the service's own limit applies. Creates the settings of a tenant
/// that has none. Requires the scope `admin`.
#[utoipa::path(
    patch, path = "/v1/tenants/{id}", tag = "access",
    params(("id" = String, Path, description = "The tenant's name")),
    request_body = ChangeTenantBody,
    responses(
        (status = 200, description = "The tenant with all its settings", body = TenantView),
        (status = 400, description = "The body or the path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "The name is invalid, or a value is out of range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn change_tenant(
    State(state): State<ApiState>,
    RequireAdmin(_caller): RequireAdmin,
    ApiPath(id): ApiPath<String>,
    ApiJson(requested): ApiJson<ChangeTenantBody>,
) -> Result<Json<TenantView>, Problem> {
    let name: TenantName = id.parse().map_err(|error| {
        Problem::invalid_value(format!("The tenant name '{}' in the path is invalid: {error}.", truncated(&id)))
    })?;
    let class = requested.class.map(|class| class.map(|text| text.parse()).transpose()).transpose();
    let class = class.map_err(|error| Problem::invalid_value(format!("`class` is invalid: {error}.")))?;
    if requested.requests_per_minute == Some(Some(0)) {
        return Err(Problem::invalid_value("`requests_per_minute` must be at least 1, or null; got 0."));
    }
    let change = TenantChange {
        class,
        max_queued: requested.max_queued,
        max_running: requested.max_running,
        requests_per_minute: requested.requests_per_minute,
    };
    let tenant = state.store.change_tenant(&name, change).await?;
    tracing::info!(of_tenant = tenant.name, "changed tenant settings");
    Ok(Json(tenant.into()))
}
