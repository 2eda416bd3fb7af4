use axum::Json;
use axum::extract::State;
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::authenticate::MayAdminister;
use super::extract::{ApiJson, ApiPath, ApiQuery, page_limit, unknown_cursor, whole};
use super::problem::{Problem, ProblemCode, shown};
use super::state::ApiState;
use crate::access::{STANDARD_CLASS, Tenant, TenantChange, TenantName};
use crate::jobs::Page;

/// A tenant and its settings. A limit that is null is the service's own.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Tenant)]
pub(super) struct TenantView {
    /// The tenant's name.
    #[schema(example = "shop")]
    id: String,
    /// The class that the metrics count its jobs under; `standard` where none is set.
    class: String,
    /// Most of its jobs that may wait.
    #[schema(required)]
    max_queued: Option<u32>,
    /// Most of its jobs that may run at the same time.
    #[schema(required)]
    max_running: Option<u32>,
    /// Most of its requests in a minute, on each process that serves.
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

/// A page of tenants.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Tenants)]
pub(super) struct TenantsView {
    /// The tenants, by name.
    tenants: Vec<TenantView>,
    /// The cursor of the next page; none on the last.
    #[schema(required)]
    next: Option<String>,
}

/// Settings of a tenant to change. A field that is left out stays, and null clears it.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = TenantChange)]
pub(super) struct ChangeView {
    /// The class that the metrics count its jobs under: lower-case letters, digits and hyphens.
    #[serde(default, deserialize_with = "present")]
    #[schema(value_type = Option<String>, min_length = 1, max_length = 63, pattern = "^[a-z0-9][a-z0-9-]*$", example = "gold")]
    class: Option<Option<String>>,
    /// Most of its jobs that may wait.
    #[serde(default, deserialize_with = "present_number")]
    #[schema(value_type = Option<u32>, maximum = 2_147_483_647)]
    max_queued: Option<Option<u32>>,
    /// Most of its jobs that may run at the same time.
    #[serde(default, deserialize_with = "present_number")]
    #[schema(value_type = Option<u32>, maximum = 2_147_483_647)]
    max_running: Option<Option<u32>>,
    /// Most of its requests in a minute, on each process that serves.
    #[serde(default, deserialize_with = "present_number")]
    #[schema(value_type = Option<u32>, minimum = 1, maximum = 2_147_483_647)]
    requests_per_minute: Option<Option<u32>>,
}

/// A field that is there, null among its values.
fn present<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Option<String>>, D::Error> {
    Option::deserialize(from).map(Some)
}

fn present_number<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Option<u32>>, D::Error> {
    let Some(number) = whole(from)? else { return Ok(Some(None)) };
    // The document calls it a number of 32 bits with a sign.
    let most = i32::MAX.unsigned_abs();
    let small = u32::try_from(number).ok().filter(|&number| number <= most);
    small.map(|number| Some(Some(number))).ok_or_else(|| D::Error::custom(format!("{number} is larger than {most}")))
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct PageQuery {
    /// Where to go on: `next` of the page before.
    cursor: Option<String>,
    /// Tenants on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
}

/// List the tenants.
///
/// Every tenant that has an API key or settings, by name. The key needs the scope `admin`.
#[utoipa::path(
    get, path = "/v1/tenants", tag = "access",
    params(PageQuery),
    responses(
        (status = 200, description = "A page of tenants", body = TenantsView),
        (status = 400, description = "A query that can't be understood", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_tenants(
    State(state): State<ApiState>,
    MayAdminister(_caller): MayAdminister,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Json<TenantsView>, Problem> {
    if query.cursor.as_ref().is_some_and(|cursor| cursor.parse::<TenantName>().is_err()) {
        return Err(unknown_cursor());
    }
    let Page { items, next } = state.store.tenants(query.cursor.as_deref(), page_limit(query.limit)?).await?;
    Ok(Json(TenantsView { tenants: items.into_iter().map(TenantView::from).collect(), next }))
}

/// One tenant.
///
/// The key needs the scope `admin`.
#[utoipa::path(
    get, path = "/v1/tenants/{id}", tag = "access",
    params(("id" = String, Path, description = "The tenant's name")),
    responses(
        (status = 200, description = "The tenant", body = TenantView),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such tenant", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_tenant(
    State(state): State<ApiState>,
    MayAdminister(_caller): MayAdminister,
    ApiPath(id): ApiPath<String>,
) -> Result<Json<TenantView>, Problem> {
    // A text that is no tenant's name need not reach the database.
    let found = if id.parse::<TenantName>().is_ok() { state.store.tenant(&id).await? } else { None };
    let not_found = || {
        let detail = format!("There is no tenant '{}' with a key or settings.", shown(&id));
        Problem::new(ProblemCode::TenantNotFound, detail)
    };
    found.map(|tenant| Json(tenant.into())).ok_or_else(not_found)
}

/// Change the settings of a tenant.
///
/// A field that is left out stays, and null clears it: then the service's own limit holds. A tenant without settings gets its first. The
/// key needs the scope `admin`.
#[utoipa::path(
    patch, path = "/v1/tenants/{id}", tag = "access",
    params(("id" = String, Path, description = "The tenant's name")),
    request_body = ChangeView,
    responses(
        (status = 200, description = "The tenant with all its settings", body = TenantView),
        (status = 400, description = "A body or a path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "A name or a value that is out of its range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn change_tenant(
    State(state): State<ApiState>,
    MayAdminister(_caller): MayAdminister,
    ApiPath(id): ApiPath<String>,
    ApiJson(asked): ApiJson<ChangeView>,
) -> Result<Json<TenantView>, Problem> {
    let name: TenantName = id.parse().map_err(|error| {
        Problem::invalid_value(format!("The tenant '{}' in the path can't be used: {error}.", shown(&id)))
    })?;
    let class = asked.class.map(|class| class.map(|text| text.parse()).transpose()).transpose();
    let class = class.map_err(|error| Problem::invalid_value(format!("`class` can't be used: {error}.")))?;
    if asked.requests_per_minute == Some(Some(0)) {
        return Err(Problem::invalid_value("`requests_per_minute` is 0; it must be at least 1, or null."));
    }
    let change = TenantChange {
        class,
        max_queued: asked.max_queued,
        max_running: asked.max_running,
        requests_per_minute: asked.requests_per_minute,
    };
    let tenant = state.store.change_tenant(&name, change).await?;
    tracing::info!(of_tenant = tenant.name, "the settings of a tenant were changed");
    Ok(Json(tenant.into()))
}
