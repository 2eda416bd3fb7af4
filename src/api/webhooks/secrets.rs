use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use time::OffsetDateTime;
use utoipa::ToSchema;

use super::OVERLAP;
use crate::api::caller::MayManageWebhooks;
use crate::api::problem::Problem;
use crate::api::state::ApiState;
use crate::jobs::Secrets;
use crate::webhooks::new_secret;

/// What calls to the jobs' own callback addresses are signed with.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::api) struct WebhookSecret {
    /// The secret, as libraries for Standard Webhooks take it.
    secret: String,
    /// Until when the secret before this one signs too.
    #[serde(with = "crate::jobs::timestamp::option")]
    previous_until: Option<OffsetDateTime>,
}

fn answer(secrets: Secrets) -> Response {
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
pub(in crate::api) async fn get_secret(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
) -> Result<Response, Problem> {
    Ok(answer(state.store.callback_secrets(caller.tenant.as_str(), &new_secret()).await?))
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
pub(in crate::api) async fn rotate_secret(
    State(state): State<ApiState>,
    MayManageWebhooks(caller): MayManageWebhooks,
) -> Result<Response, Problem> {
    Ok(answer(state.store.rotate_callback_secret(caller.tenant.as_str(), &new_secret(), OVERLAP).await?))
}
