//! Routes of webhook deliveries: the delivery log, redelivery, and test messages.
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::{IntoParams, ToSchema};

use super::authenticate::{Caller, RequireWebhooks};
use super::extract::{ApiPath, ApiQuery, invalid_cursor, is_id, page_limit};
use super::job::job_id;
use super::problem::{Problem, ProblemCode, truncated};
use super::state::ApiState;
use super::webhook_endpoints::find;
use crate::jobs::{Delivery, DeliveryAttempt, DeliveryQuery, DeliveryStatus, JobId, Page, RedeliveryResult};

/// The delivery of a message to one receiver.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookDelivery)]
pub(super) struct DeliveryView {
    /// The delivery's id.
    #[schema(example = "whd_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    id: String,
    /// The message's id, sent in the header `webhook-id`; the same in every attempt.
    webhook_id: String,
    /// The event: `job.succeeded`, `job.failed`, `job.canceled`, or `ping` for a test.
    r#type: String,
    /// The job that the message is about.
    #[schema(value_type = Option<String>)]
    job: Option<JobId>,
    /// The endpoint, or `null` for a delivery to a job's `callback_url`.
    endpoint: Option<String>,
    /// The job's `callback_url`, or `null` for a delivery to an endpoint.
    callback_url: Option<String>,
    /// The delivery's status.
    status: DeliveryStatus,
    /// When the message was created.
    #[serde(with = "crate::jobs::timestamp")]
    created_at: OffsetDateTime,
    /// When the next attempt is due.
    #[serde(with = "crate::jobs::timestamp::option")]
    next_attempt_at: Option<OffsetDateTime>,
    /// The latest attempts, oldest first.
    attempts: Vec<DeliveryAttempt>,
}

/// One page of deliveries.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookDeliveries)]
pub(super) struct DeliveriesView {
    /// The deliveries, newest first.
    deliveries: Vec<DeliveryView>,
    /// The cursor of the next page, or `null` on the last page.
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
    /// The `next` value of the previous page.
    cursor: Option<String>,
    /// Number of deliveries per page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct DeliveriesQuery {
    /// Only deliveries about this job.
    job: Option<String>,
    /// The `next` value of the previous page.
    cursor: Option<String>,
    /// Number of deliveries per page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
}

/// Returns a page of the caller's deliveries that match `filter`.
async fn page(
    state: &ApiState,
    caller: &Caller,
    query: PageQuery,
    filter: DeliveryQuery,
) -> Result<Json<DeliveriesView>, Problem> {
    if query.cursor.as_ref().is_some_and(|cursor| !is_id(cursor, "whd")) {
        return Err(invalid_cursor());
    }
    let tenant = caller.tenant.to_string();
    let filter = DeliveryQuery { tenant, before: query.cursor, limit: page_limit(query.limit)?, ..filter };
    let Page { items, next } = state.store.deliveries(filter).await?;
    Ok(Json(DeliveriesView { deliveries: items.into_iter().map(DeliveryView::from).collect(), next }))
}

/// List the deliveries of an endpoint, newest first.
///
/// Deliveries are kept for 30 days.
#[utoipa::path(
    get, path = "/v1/webhook-endpoints/{id}/deliveries", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id"), PageQuery),
    responses(
        (status = 200, description = "A page of deliveries", body = DeliveriesView),
        (status = 400, description = "The query is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Endpoint not found", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_of_endpoint(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<PageQuery>,
) -> Result<Json<DeliveriesView>, Problem> {
    let endpoint = Some(find(&state, &caller, &id).await?.id);
    page(&state, &caller, query, DeliveryQuery { endpoint, ..DeliveryQuery::default() }).await
}

/// List all deliveries, newest first.
///
/// Lists deliveries to endpoints and to the callback URLs of jobs. Deliveries are kept for 30 days.
#[utoipa::path(
    get, path = "/v1/webhook-deliveries", tag = "webhooks",
    params(DeliveriesQuery),
    responses(
        (status = 200, description = "A page of deliveries", body = DeliveriesView),
        (status = 400, description = "The query is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Job not found", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn list_deliveries(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
    ApiQuery(query): ApiQuery<DeliveriesQuery>,
) -> Result<Json<DeliveriesView>, Problem> {
    let DeliveriesQuery { job, cursor, limit } = query;
    let job = job.as_deref().map(job_id).transpose()?;
    page(&state, &caller, PageQuery { cursor, limit }, DeliveryQuery { job, ..DeliveryQuery::default() }).await
}

/// Redeliver a message.
///
/// Sends the message again immediately, with the same `webhook-id`, whatever the delivery's status. A failed delivery gets its full number
/// of attempts again.
#[utoipa::path(
    post, path = "/v1/webhook-deliveries/{id}/redeliver", tag = "webhooks",
    params(("id" = String, Path, description = "The delivery's id")),
    responses(
        (status = 202, description = "The delivery is due now", body = DeliveryView),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Delivery not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The delivery's endpoint is disabled", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn redeliver(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
    ApiPath(id): ApiPath<String>,
) -> Result<Response, Problem> {
    if !is_id(&id, "whd") {
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
/// Sends the endpoint a message of type `ping`. The message is signed and retried like any other.
#[utoipa::path(
    post, path = "/v1/webhook-endpoints/{id}/test", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id")),
    responses(
        (status = 202, description = "The delivery is due now", body = DeliveryView),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Endpoint not found", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The endpoint is disabled", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn test_endpoint(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
    ApiPath(id): ApiPath<String>,
) -> Result<Response, Problem> {
    let endpoint = find(&state, &caller, &id).await?;
    match state.store.send_ping(caller.tenant.as_str(), &endpoint.id).await? {
        Some(delivery) => accepted(&state, &caller, delivery).await,
        None => Err(disabled()),
    }
}

/// Responds with a delivery that is due now.
async fn accepted(state: &ApiState, caller: &Caller, id: String) -> Result<Response, Problem> {
    let query =
        DeliveryQuery { tenant: caller.tenant.to_string(), id: Some(id.clone()), limit: 1, ..Default::default() };
    let delivery = state.store.deliveries(query).await?.items.pop().ok_or_else(|| not_found(&id))?;
    Ok((StatusCode::ACCEPTED, Json(DeliveryView::from(delivery))).into_response())
}

fn disabled() -> Problem {
    Problem::new(ProblemCode::WebhookDisabled, "The endpoint is disabled. Enable it first.")
}

fn not_found(id: &str) -> Problem {
    Problem::new(ProblemCode::WebhookNotFound, format!("There is no webhook delivery '{}'.", truncated(id)))
}
