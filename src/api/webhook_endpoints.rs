//! Webhook endpoints and their secrets, and the secret of callbacks.

use std::time::Duration;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use utoipa::ToSchema;

use super::authenticate::{Caller, MayManageWebhooks};
use super::extract::{ApiJson, ApiPath, is_name};
use super::problem::{Problem, ProblemCode, shown};
use super::state::ApiState;
use crate::jobs::{Endpoint, EndpointChange, JobEvent, NewEndpoint, Secrets};
use crate::webhooks::{TargetPolicy, new_secret};

/// How long an old secret signs beside a new one.
const OVERLAP: Duration = Duration::from_secs(24 * 3600);
/// Most endpoints of a tenant.
const MAX_ENDPOINTS: u32 = 20;
/// Longest description, in characters.
const DESCRIPTION_CHARS: usize = 200;

/// An endpoint to make.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = NewWebhookEndpoint)]
pub(super) struct NewView {
    /// An https address, to which messages are posted.
    #[schema(format = "uri", max_length = 2048, example = "https://shop.example/hooks/meshmend")]
    url: String,
    /// What to tell it of; everything where it is left out.
    #[schema(min_items = 1)]
    events: Option<Vec<JobEvent>>,
    /// What it is for, in your own words: at most 200 characters on one line.
    #[serde(default)]
    #[schema(max_length = 200, pattern = r"^[^\u0000-\u001f\u007f-\u009f]*$")]
    description: String,
}

/// What to change of an endpoint; what is left out stays.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = WebhookEndpointChange)]
pub(super) struct ChangeView {
    /// An https address, to which messages are posted.
    #[schema(format = "uri", max_length = 2048)]
    url: Option<String>,
    /// What to tell it of.
    #[schema(min_items = 1)]
    events: Option<Vec<JobEvent>>,
    /// What it is for.
    #[schema(max_length = 200, pattern = r"^[^\u0000-\u001f\u007f-\u009f]*$")]
    description: Option<String>,
    /// Whether to tell it of anything. Disabling it gives up what waits for it.
    enabled: Option<bool>,
}

/// Somebody who is told of your jobs.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = WebhookEndpoint)]
pub(super) struct EndpointView {
    /// Its name.
    #[schema(example = "we_019a3c5e7b1f7c3e8d2a4b6c8d0e2f4a")]
    id: String,
    /// Where messages are posted.
    url: String,
    /// What it is told of.
    events: Vec<JobEvent>,
    /// What it is for.
    description: String,
    /// When it was made.
    #[serde(with = "crate::jobs::timestamp")]
    created_at: OffsetDateTime,
    /// Whether it is told of anything.
    enabled: bool,
    /// When it was disabled: by you, since the receiver answered 410, or since every delivery failed for 5 days.
    #[serde(with = "crate::jobs::timestamp::option")]
    disabled_at: Option<OffsetDateTime>,
    /// Why.
    disabled_reason: Option<String>,
    /// When its deliveries began to fail; null where the last one was taken.
    #[serde(with = "crate::jobs::timestamp::option")]
    failing_since: Option<OffsetDateTime>,
    /// What its messages are signed with, as libraries for Standard Webhooks take it; only in the answer that makes it.
    #[serde(skip_serializing_if = "Option::is_none")]
    secret: Option<String>,
    /// Until when the secret before the present one signs too.
    #[serde(with = "crate::jobs::timestamp::option")]
    previous_secret_until: Option<OffsetDateTime>,
}

/// A tenant's endpoints.
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

/// The answer that shows an endpoint's secret.
fn with_secret(status: StatusCode, endpoint: Endpoint) -> Response {
    let secret = Some(endpoint.secrets.current.reveal().to_owned());
    let view = EndpointView { secret, ..endpoint.into() };
    (status, [(header::CACHE_CONTROL, "no-store")], Json(view)).into_response()
}

fn clean_url(reach: TargetPolicy, text: &str) -> Result<String, Problem> {
    reach.read(text).map(String::from).map_err(|error| Problem::invalid_field("url", format!("`url` {error}.")))
}

/// The events without those that are named twice.
fn clean_events(mut events: Vec<JobEvent>) -> Result<Vec<JobEvent>, Problem> {
    events.sort_unstable();
    events.dedup();
    if events.is_empty() {
        Err(Problem::invalid_field("events", "`events` must name at least one event."))
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
    Problem::new(ProblemCode::WebhookNotFound, format!("There is no webhook endpoint '{}'.", shown(id)))
}

/// Whether there may be an endpoint of that name.
fn check_name(id: &str) -> Result<(), Problem> {
    if is_name(id, "we") { Ok(()) } else { Err(not_found(id)) }
}

/// One of the caller's endpoints.
pub(super) async fn find(state: &ApiState, caller: &Caller, id: &str) -> Result<Endpoint, Problem> {
    check_name(id)?;
    state.store.endpoint(caller.tenant.as_str(), id).await?.ok_or_else(|| not_found(id))
}

/// Make a webhook endpoint.
///
/// It is told of jobs that end by POST: a `WebhookMessage`, signed in the form of the Standard Webhooks specification, at least once.
/// What it does not answer in time with a status of 200 to 299 is sent again over some days; if it answers 410 it is told no more. The
/// `secret` is shown here and never again.
#[utoipa::path(
    post, path = "/v1/webhook-endpoints", tag = "webhooks",
    request_body = NewView,
    responses(
        (status = 201, description = "The endpoint", body = EndpointView, headers(("Location" = String, description = "Its address"))),
        (status = 400, description = "A body that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "There are as many as may be", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "An address that can't be used, or a value out of its range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn create_endpoint(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
    ApiJson(asked): ApiJson<NewView>,
) -> Result<Response, Problem> {
    let new = NewEndpoint {
        tenant: caller.tenant.to_string(),
        url: clean_url(state.config.webhook_targets, &asked.url)?,
        description: clean_description(asked.description)?,
        events: clean_events(asked.events.unwrap_or_else(|| JobEvent::ALL.to_vec()))?,
        secret: new_secret(state.random.as_ref()),
    };
    let Some(endpoint) = state.store.create_endpoint(new, MAX_ENDPOINTS).await? else {
        let detail =
            format!("There are {MAX_ENDPOINTS} webhook endpoints, which is as many as may be. Delete one first.");
        return Err(Problem::new(ProblemCode::TooManyWebhooks, detail));
    };
    tracing::info!(id = endpoint.id, "a webhook endpoint was made");
    let location = [(header::LOCATION, format!("/v1/webhook-endpoints/{}", endpoint.id))];
    Ok((location, with_secret(StatusCode::CREATED, endpoint)).into_response())
}

/// Webhook endpoints.
#[utoipa::path(
    get, path = "/v1/webhook-endpoints", tag = "webhooks",
    responses(
        (status = 200, description = "The endpoints", body = EndpointsView),
    )
)]
pub(super) async fn list_endpoints(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
) -> Result<Json<EndpointsView>, Problem> {
    let endpoints = state.store.endpoints(caller.tenant.as_str()).await?;
    Ok(Json(EndpointsView { endpoints: endpoints.into_iter().map(EndpointView::from).collect() }))
}

/// One webhook endpoint.
#[utoipa::path(
    get, path = "/v1/webhook-endpoints/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id")),
    responses(
        (status = 200, description = "The endpoint", body = EndpointView),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such endpoint", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn get_endpoint(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
    ApiPath(id): ApiPath<String>,
) -> Result<Json<EndpointView>, Problem> {
    Ok(Json(find(&state, &caller, &id).await?.into()))
}

/// Change a webhook endpoint.
///
/// `enabled: true` makes one work again that was disabled; what was given up meanwhile can be sent by its delivery's `redeliver`.
#[utoipa::path(
    patch, path = "/v1/webhook-endpoints/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id")),
    request_body = ChangeView,
    responses(
        (status = 200, description = "The endpoint", body = EndpointView),
        (status = 400, description = "A body or a path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such endpoint", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "An address that can't be used, or a value out of its range", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn change_endpoint(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
    ApiPath(id): ApiPath<String>,
    ApiJson(asked): ApiJson<ChangeView>,
) -> Result<Json<EndpointView>, Problem> {
    check_name(&id)?;
    let change = EndpointChange {
        url: asked.url.map(|url| clean_url(state.config.webhook_targets, &url)).transpose()?,
        description: asked.description.map(clean_description).transpose()?,
        events: asked.events.map(clean_events).transpose()?,
        enabled: asked.enabled,
    };
    let changed = state.store.change_endpoint(caller.tenant.as_str(), &id, change).await?;
    changed.map(|endpoint| Json(endpoint.into())).ok_or_else(|| not_found(&id))
}

/// Delete a webhook endpoint, and the log of its deliveries.
#[utoipa::path(
    delete, path = "/v1/webhook-endpoints/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id")),
    responses(
        (status = 204, description = "It is gone"),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such endpoint", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn delete_endpoint(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
    ApiPath(id): ApiPath<String>,
) -> Result<StatusCode, Problem> {
    check_name(&id)?;
    let found = state.store.delete_endpoint(caller.tenant.as_str(), &id).await?;
    if found { Ok(StatusCode::NO_CONTENT) } else { Err(not_found(&id)) }
}

/// A new secret for a webhook endpoint.
///
/// For 24 hours both sign: each message then has two signatures, and a receiver takes it if one is right.
#[utoipa::path(
    post, path = "/v1/webhook-endpoints/{id}/rotate", tag = "webhooks",
    params(("id" = String, Path, description = "The endpoint's id")),
    responses(
        (status = 200, description = "The endpoint with its new secret", body = EndpointView),
        (status = 400, description = "A path that can't be understood", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such endpoint", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn rotate_endpoint(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
    ApiPath(id): ApiPath<String>,
) -> Result<Response, Problem> {
    check_name(&id)?;
    let rotated =
        state.store.rotate_endpoint(caller.tenant.as_str(), &id, &new_secret(state.random.as_ref()), OVERLAP).await?;
    rotated.map(|endpoint| with_secret(StatusCode::OK, endpoint)).ok_or_else(|| not_found(&id))
}

/// What calls to the jobs' own callback addresses are signed with.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct WebhookSecret {
    /// The secret, as libraries for Standard Webhooks take it.
    secret: String,
    /// Until when the secret before this one signs too.
    #[serde(with = "crate::jobs::timestamp::option")]
    previous_until: Option<OffsetDateTime>,
}

fn secret_answer(secrets: Secrets) -> Response {
    let secret = secrets.current.reveal().to_owned();
    let body = WebhookSecret { secret, previous_until: secrets.previous.map(|(_, until)| until) };
    ([(header::CACHE_CONTROL, "no-store")], Json(body)).into_response()
}

/// The secret of callbacks.
///
/// What is sent to the `callback_url` of a job is signed with it. It is made when it is first asked for, or first needed.
#[utoipa::path(
    get, path = "/v1/webhook-secret", tag = "webhooks",
    responses(
        (status = 200, description = "The secret", body = WebhookSecret),
    )
)]
pub(super) async fn get_secret(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
) -> Result<Response, Problem> {
    Ok(secret_answer(state.store.callback_secrets(caller.tenant.as_str(), &new_secret(state.random.as_ref())).await?))
}

/// A new secret for callbacks.
///
/// For 24 hours both sign: each message then has two signatures, and a receiver takes it if one is right.
#[utoipa::path(
    post, path = "/v1/webhook-secret/rotate", tag = "webhooks",
    responses(
        (status = 200, description = "The new secret", body = WebhookSecret),
    )
)]
pub(super) async fn rotate_secret(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
) -> Result<Response, Problem> {
    Ok(secret_answer(
        state.store.rotate_callback_secret(caller.tenant.as_str(), &new_secret(state.random.as_ref()), OVERLAP).await?,
    ))
}
