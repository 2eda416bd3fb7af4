use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::{IntoParams, ToSchema};

use super::authenticate::{Caller, MayManageWebhooks};
use super::extract::{ApiPath, ApiQuery, is_name, page_limit, unknown_cursor};
use super::job::job_id;
use super::problem::{Problem, ProblemCode, shown};
use super::state::ApiState;
use super::webhook_endpoints::find;
use crate::jobs::{Delivery, DeliveryAttempt, DeliveryQuery, DeliveryStatus, JobId, Page, RedeliveryResult};

/// A message on its way to one receiver.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookDelivery)]
pub(super) struct DeliveryView {
    /// Its name.
    #[schema(example = "whd_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    id: String,
    /// The message, as the receiver sees it in the header `webhook-id`. It is the same each time.
    webhook_id: String,
    /// What the message tells: `job.succeeded`, `job.failed`, `job.canceled`, or `ping` for a test.
    r#type: String,
    /// The job that it tells of.
    #[schema(value_type = Option<String>)]
    job: Option<JobId>,
    /// The endpoint; null where the job named its own address.
    endpoint: Option<String>,
    /// The address that the job named.
    callback_url: Option<String>,
    /// How it stands.
    status: DeliveryStatus,
    /// When the message was made.
    #[serde(with = "crate::jobs::timestamp")]
    created_at: OffsetDateTime,
    /// When it is tried next.
    #[serde(with = "crate::jobs::timestamp::option")]
    next_attempt_at: Option<OffsetDateTime>,
    /// The last tries, oldest first.
    attempts: Vec<DeliveryAttempt>,
}

/// A page of deliveries.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookDeliveries)]
pub(super) struct DeliveriesView {
    /// The deliveries, newest first.
    deliveries: Vec<DeliveryView>,
    /// The cursor of the next page; none on the last.
    #[schema(required)]
    next: Option<String>,
}

impl From<Delivery> for DeliveryView {
    fn from(delivery: Delivery) -> Self {
        Self {
            id: delivery.id,
            webhook_id: delivery.message,
            r#type: delivery.kind,
            job: delivery.job,
            endpoint: delivery.endpoint,
            callback_url: delivery.url,
            status: delivery.status,
            created_at: delivery.created_at,
            next_attempt_at: (delivery.status == DeliveryStatus::Pending).then_some(delivery.next_at),
            attempts: delivery.attempts,
        }
    }
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct PageQuery {
    /// Where to go on: `next` of the page before.
    cursor: Option<String>,
    /// Deliveries on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct DeliveriesQuery {
    /// Only those that tell of this job.
    job: Option<String>,
    /// Where to go on: `next` of the page before.
    cursor: Option<String>,
    /// Deliveries on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
}

/// The page of those deliveries of the caller's that `which` names.
async fn page(
    state: &ApiState,
    caller: &Caller,
    query: PageQuery,
    which: DeliveryQuery,
) -> Result<Json<DeliveriesView>, Problem> {
    if query.cursor.as_ref().is_some_and(|cursor| !is_name(cursor, "whd")) {
        return Err(unknown_cursor());
    }
    let tenant = caller.tenant.to_string();
    let which = DeliveryQuery { tenant, before: query.cursor, limit: page_limit(query.limit)?, ..which };
    let Page { items, next } = state.store.deliveries(which).await?;
    Ok(Json(DeliveriesView { deliveries: items.into_iter().map(DeliveryView::from).collect(), next }))
}

/// Deliveries to an endpoint, newest first.
///
/// They are known for 30 days.
#[utoipa::path(
    get, path = "/v1/webhook-endpoints/{id}/deliveries", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id"), PageQuery),
    responses(
        (status = 200, description = "A page of deliveries", body = DeliveriesView),
        (status = 400, description = "A query that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such endpoint", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_of_endpoint(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Json<DeliveriesView>, Problem> {
    let endpoint = Some(find(&state, &caller, &id).await?.id);
    page(&state, &caller, query, DeliveryQuery { endpoint, ..DeliveryQuery::default() }).await
}

/// Deliveries to endpoints and to the jobs' own callback addresses, newest first.
///
/// They are known for 30 days.
#[utoipa::path(
    get, path = "/v1/webhook-deliveries", tag = "webhooks",
    params(DeliveriesQuery),
    responses(
        (status = 200, description = "A page of deliveries", body = DeliveriesView),
        (status = 400, description = "A query that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such job", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_deliveries(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
    ApiQuery(query): ApiQuery<DeliveriesQuery>,
) -> Result<Json<DeliveriesView>, Problem> {
    let DeliveriesQuery { job, cursor, limit } = query;
    let job = job.as_deref().map(job_id).transpose()?;
    page(&state, &caller, PageQuery { cursor, limit }, DeliveryQuery { job, ..DeliveryQuery::default() }).await
}

/// Send a message again.
///
/// It is due at once, with the same `webhook-id`, whatever became of it before. One that was given up gets all of its tries anew.
#[utoipa::path(
    post, path = "/v1/webhook-deliveries/{id}/redeliver", tag = "webhooks",
    params(("id" = String, Path, description = "The delivery's id")),
    responses(
        (status = 202, description = "It is on its way", body = DeliveryView),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such delivery", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "Its endpoint is disabled", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn redeliver(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
    ApiPath(id): ApiPath<String>,
) -> Result<Response, Problem> {
    if !is_name(&id, "whd") {
        return Err(not_found(&id));
    }
    match state.store.redeliver(caller.tenant.as_str(), &id).await? {
        RedeliveryResult::Due => accepted(&state, &caller, id).await,
        RedeliveryResult::Disabled => Err(disabled()),
        RedeliveryResult::Unknown => Err(not_found(&id)),
    }
}

/// Test a webhook endpoint.
///
/// It gets a message of the type `ping`, like any other message: signed, and sent again if it fails.
#[utoipa::path(
    post, path = "/v1/webhook-endpoints/{id}/test", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id")),
    responses(
        (status = 202, description = "It is on its way", body = DeliveryView),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such endpoint", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The endpoint is disabled", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn test_endpoint(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
    ApiPath(id): ApiPath<String>,
) -> Result<Response, Problem> {
    let endpoint = find(&state, &caller, &id).await?;
    match state.store.send_ping(caller.tenant.as_str(), &endpoint.id).await? {
        Some(delivery) => accepted(&state, &caller, delivery).await,
        None => Err(disabled()),
    }
}

/// The answer with a delivery that is due now.
async fn accepted(state: &ApiState, caller: &Caller, id: String) -> Result<Response, Problem> {
    let query =
        DeliveryQuery { tenant: caller.tenant.to_string(), id: Some(id.clone()), limit: 1, ..Default::default() };
    let found = state.store.deliveries(query).await?.items.pop().ok_or_else(|| not_found(&id))?;
    Ok((StatusCode::ACCEPTED, Json(DeliveryView::from(found))).into_response())
}

fn disabled() -> Problem {
    Problem::new(ProblemCode::WebhookDisabled, "The endpoint is disabled. Enable it first.")
}

fn not_found(id: &str) -> Problem {
    Problem::new(ProblemCode::WebhookNotFound, format!("There is no webhook delivery '{}'.", shown(id)))
}
