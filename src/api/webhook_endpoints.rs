//! Routes of webhook endpoints and their secrets, and of the secret for callbacks.

use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::ToSchema;

use super::authenticate::{Caller, RequireWebhooks};
use super::extract::{ApiJson, ApiPath, is_id};
use super::problem::{Problem, ProblemCode, truncated};
use super::state::ApiState;
use crate::jobs::{Endpoint, EndpointChange, JobEvent, NewEndpoint, Secrets};
use crate::webhooks::{TargetPolicy, new_secret};

/// How long the previous secret stays valid after a rotation.
const SECRET_OVERLAP: Duration = Duration::from_secs(24 * 3600);
/// Maximum number of endpoints of a tenant.
const MAX_ENDPOINTS: u32 = 20;
/// Longest description, in characters.
const DESCRIPTION_CHARS: usize = 200;

/// A webhook endpoint to create.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = NewWebhookEndpoint)]
pub(super) struct NewEndpointBody {
    /// The https URL that receives the messages.
    #[schema(format = "uri", max_length = 2048, example = "https://shop.example/hooks/meshmend")]
    url: String,
    /// The events to send. Defaults to all events.
    #[schema(min_items = 1)]
    events: Option<Vec<JobEvent>>,
    /// What the endpoint is for, in your own words: at most 200 characters on one line.
    #[serde(default)]
    #[schema(max_length = 200, pattern = r"^[^\u0000-\u001f\u007f-\u009f]*$")]
    description: String,
}

/// Changes to a webhook endpoint. An omitted field keeps its value.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = WebhookEndpointChange)]
pub(super) struct ChangeEndpointBody {
    /// The https URL that receives the messages.
    #[schema(format = "uri", max_length = 2048)]
    url: Option<String>,
    /// The events to send.
    #[schema(min_items = 1)]
    events: Option<Vec<JobEvent>>,
    /// What the endpoint is for.
    #[schema(max_length = 200, pattern = r"^[^\u0000-\u001f\u007f-\u009f]*$")]
    description: Option<String>,
    /// Whether the endpoint receives messages. Disabling it drops its pending messages.
    enabled: Option<bool>,
}

/// A URL that receives messages about your jobs.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookEndpoint)]
pub(super) struct EndpointView {
    /// The endpoint's id.
    #[schema(example = "we_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    id: String,
    /// The https URL that receives the messages.
    url: String,
    /// The events that are sent.
    events: Vec<JobEvent>,
    /// What the endpoint is for.
    description: String,
    /// When the endpoint was created.
    #[serde(with = "crate::jobs::timestamp")]
    created_at: OffsetDateTime,
    /// Whether the endpoint receives messages.
    enabled: bool,
    /// When the endpoint was disabled: by you, because the receiver answered 410, or because every delivery failed for 5 days.
    #[serde(with = "crate::jobs::timestamp::option")]
    disabled_at: Option<OffsetDateTime>,
    /// Why the endpoint was disabled.
    disabled_reason: Option<String>,
    /// When its deliveries began to fail, or `null` if the last delivery succeeded.
    #[serde(with = "crate::jobs::timestamp::option")]
    failing_since: Option<OffsetDateTime>,
    /// The secret that signs the messages, in the format of the Standard Webhooks libraries. Only in the response that creates or rotates
    /// the secret.
    #[serde(skip_serializing_if = "Option::is_none")]
    secret: Option<String>,
    /// Until when the previous secret also signs messages.
    #[serde(with = "crate::jobs::timestamp::option")]
    previous_secret_until: Option<OffsetDateTime>,
}

/// The webhook endpoints of a tenant.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookEndpoints)]
pub(super) struct EndpointsView {
    /// The endpoints, oldest first.
    endpoints: Vec<EndpointView>,
}

impl From<Endpoint> for EndpointView {
    fn from(endpoint: Endpoint) -> Self {
        let (disabled_at, disabled_reason) = endpoint.disabled.unzip();
        Self {
            id: endpoint.id,
            url: endpoint.url,
            events: endpoint.events,
            description: endpoint.description,
            created_at: endpoint.created_at,
            enabled: disabled_at.is_none(),
            disabled_at,
            disabled_reason,
            failing_since: endpoint.failing_since,
            secret: None,
            previous_secret_until: endpoint.secrets.previous.map(|(_, until)| until),
        }
    }
}

/// Responds with an endpoint and its secret.
fn with_secret(status: StatusCode, endpoint: Endpoint) -> Response {
    let secret = Some(endpoint.secrets.current.reveal().to_owned());
    let view = EndpointView { secret, ..endpoint.into() };
    (status, [(header::CACHE_CONTROL, "no-store")], Json(view)).into_response()
}

/// Validates and normalizes a URL.
fn clean_url(targets: TargetPolicy, text: &str) -> Result<String, Problem> {
    targets.read(text).map(String::from).map_err(|error| Problem::invalid_field("url", format!("`url` {error}.")))
}

/// Sorts the events and removes duplicates.
fn clean_events(mut events: Vec<JobEvent>) -> Result<Vec<JobEvent>, Problem> {
    events.sort_unstable();
    events.dedup();
    if events.is_empty() {
        Err(Problem::invalid_field("events", "`events` must contain at least one event."))
    } else {
        Ok(events)
    }
}

fn clean_description(text: String) -> Result<String, Problem> {
    if text.chars().count() > DESCRIPTION_CHARS || text.chars().any(char::is_control) {
        return Err(Problem::invalid_field("description", "`description` must be at most 200 characters on one line."));
    }
    Ok(text)
}

fn not_found(id: &str) -> Problem {
    Problem::new(ProblemCode::WebhookNotFound, format!("There is no webhook endpoint '{}'.", truncated(id)))
}

/// Checks that the id has the form of an endpoint's id.
fn check_id(id: &str) -> Result<(), Problem> {
    if is_id(id, "we") { Ok(()) } else { Err(not_found(id)) }
}

/// Returns the caller's endpoint with this id.
pub(super) async fn find(state: &ApiState, caller: &Caller, id: &str) -> Result<Endpoint, Problem> {
    check_id(id)?;
    state.store.endpoint(caller.tenant.as_str(), id).await?.ok_or_else(|| not_found(id))
}

/// Create a webhook endpoint.
///
/// When a job ends, the service sends the endpoint a POST with a `WebhookMessage`, signed as the Standard Webhooks specification says.
/// Each message is delivered at least once. A delivery without a timely response of status 200 to 299 is retried over several days. A
/// response of 410 disables the endpoint. The response to this request contains the `secret`, which is never truncated again.
#[utoipa::path(
    post, path = "/v1/webhook-endpoints", tag = "webhooks",
    request_body = NewEndpointBody,
    responses(
        (status = 201, description = "The created endpoint", body = EndpointView, headers(("Location" = String, description = "The endpoint's path"))),
        (status = 400, description = "The body is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The maximum number of endpoints exists", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "The URL is not allowed, or a value is out of range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn create_endpoint(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
    ApiJson(requested): ApiJson<NewEndpointBody>,
) -> Result<Response, Problem> {
    let new = NewEndpoint {
        tenant: caller.tenant.to_string(),
        url: clean_url(state.config.webhook_targets, &requested.url)?,
        description: clean_description(requested.description)?,
        events: clean_events(requested.events.unwrap_or_else(|| JobEvent::ALL.to_vec()))?,
        secret: new_secret(state.ids.as_ref()),
    };
    let Some(endpoint) = state.store.create_endpoint(new, MAX_ENDPOINTS).await? else {
        let detail = format!("You already have {MAX_ENDPOINTS} webhook endpoints, the maximum. Delete one first.");
        return Err(Problem::new(ProblemCode::TooManyWebhooks, detail));
    };
    tracing::info!(id = endpoint.id, "created webhook endpoint");
    let location = [(header::LOCATION, format!("/v1/webhook-endpoints/{}", endpoint.id))];
    Ok((location, with_secret(StatusCode::CREATED, endpoint)).into_response())
}

/// List webhook endpoints.
#[utoipa::path(
    get, path = "/v1/webhook-endpoints", tag = "webhooks",
    responses(
        (status = 200, description = "The endpoints", body = EndpointsView),
    )
)]
pub(super) async fn list_endpoints(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
) -> Result<Json<EndpointsView>, Problem> {
    let endpoints = state.store.endpoints(caller.tenant.as_str()).await?;
    Ok(Json(EndpointsView { endpoints: endpoints.into_iter().map(EndpointView::from).collect() }))
}

/// Get a webhook endpoint.
#[utoipa::path(
    get, path = "/v1/webhook-endpoints/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id")),
    responses(
        (status = 200, description = "The endpoint", body = EndpointView),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Endpoint not found", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_endpoint(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
    ApiPath(id): ApiPath<String>,
) -> Result<Json<EndpointView>, Problem> {
    Ok(Json(find(&state, &caller, &id).await?.into()))
}

/// Change a webhook endpoint.
///
/// `enabled: true` enables a disabled endpoint again. To resend messages dropped in the meantime, use `redeliver` on their deliveries.
#[utoipa::path(
    patch, path = "/v1/webhook-endpoints/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id")),
    request_body = ChangeEndpointBody,
    responses(
        (status = 200, description = "The endpoint", body = EndpointView),
        (status = 400, description = "The body or the path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Endpoint not found", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "The URL is not allowed, or a value is out of range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn change_endpoint(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
    ApiPath(id): ApiPath<String>,
    ApiJson(requested): ApiJson<ChangeEndpointBody>,
) -> Result<Json<EndpointView>, Problem> {
    check_id(&id)?;
    let change = EndpointChange {
        url: requested.url.map(|url| clean_url(state.config.webhook_targets, &url)).transpose()?,
        description: requested.description.map(clean_description).transpose()?,
        events: requested.events.map(clean_events).transpose()?,
        enabled: requested.enabled,
    };
    let changed = state.store.change_endpoint(caller.tenant.as_str(), &id, change).await?;
    changed.map(|endpoint| Json(endpoint.into())).ok_or_else(|| not_found(&id))
}

/// Delete a webhook endpoint and its delivery log.
#[utoipa::path(
    delete, path = "/v1/webhook-endpoints/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id")),
    responses(
        (status = 204, description = "The endpoint was deleted"),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Endpoint not found", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn delete_endpoint(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
    ApiPath(id): ApiPath<String>,
) -> Result<StatusCode, Problem> {
    check_id(&id)?;
    let was_deleted = state.store.delete_endpoint(caller.tenant.as_str(), &id).await?;
    if was_deleted { Ok(StatusCode::NO_CONTENT) } else { Err(not_found(&id)) }
}

/// Rotate the secret of a webhook endpoint.
///
/// For 24 hours each message carries two signatures, one with the old and one with the new secret. A receiver accepts the message if
/// either is valid.
#[utoipa::path(
    post, path = "/v1/webhook-endpoints/{id}/rotate", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id")),
    responses(
        (status = 200, description = "The endpoint with its new secret", body = EndpointView),
        (status = 400, description = "The path is malformed", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "Endpoint not found", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn rotate_endpoint(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
    ApiPath(id): ApiPath<String>,
) -> Result<Response, Problem> {
    check_id(&id)?;
    let rotated = state
        .store
        .rotate_endpoint(caller.tenant.as_str(), &id, &new_secret(state.ids.as_ref()), SECRET_OVERLAP)
        .await?;
    rotated.map(|endpoint| with_secret(StatusCode::OK, endpoint)).ok_or_else(|| not_found(&id))
}

/// The secret that signs the messages to the callback URLs of jobs.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct WebhookSecret {
    /// The secret, in the format of the Standard Webhooks libraries.
    secret: String,
    /// Until when the previous secret also signs messages.
    #[serde(with = "crate::jobs::timestamp::option")]
    previous_until: Option<OffsetDateTime>,
}

/// Responds with the secret for callbacks.
fn secret_response(secrets: Secrets) -> Response {
    let secret = secrets.current.reveal().to_owned();
    let body = WebhookSecret { secret, previous_until: secrets.previous.map(|(_, until)| until) };
    ([(header::CACHE_CONTROL, "no-store")], Json(body)).into_response()
}

/// Get the secret for callbacks.
///
/// This secret signs the messages to the `callback_url` of jobs. The service creates the secret on the first request or the first callback.
#[utoipa::path(
    get, path = "/v1/webhook-secret", tag = "webhooks",
    responses(
        (status = 200, description = "The secret", body = WebhookSecret),
    )
)]
pub(super) async fn get_secret(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
) -> Result<Response, Problem> {
    Ok(secret_response(state.store.callback_secrets(caller.tenant.as_str(), &new_secret(state.ids.as_ref())).await?))
}

/// Rotate the secret for callbacks.
///
/// For 24 hours each message carries two signatures, one with the old and one with the new secret. A receiver accepts the message if
/// either is valid.
#[utoipa::path(
    post, path = "/v1/webhook-secret/rotate", tag = "webhooks",
    responses(
        (status = 200, description = "The new secret", body = WebhookSecret),
    )
)]
pub(super) async fn rotate_secret(
    State(state): State<ApiState>,
    RequireWebhooks(caller): RequireWebhooks,
) -> Result<Response, Problem> {
    Ok(secret_response(
        state
            .store
            .rotate_callback_secret(caller.tenant.as_str(), &new_secret(state.ids.as_ref()), SECRET_OVERLAP)
            .await?,
    ))
}
