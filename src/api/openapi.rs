use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::state::ApiState;
use super::{artifacts, capabilities, events, health, jobs, submit, uploads};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "meshmend",
        description = "Repairs broken 3D models, proves that the result is printable, and gives an honest account of \
                       what changed. Or only looks, and tells what is wrong where.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    tags(
        (name = "jobs", description = "Send a model, follow its job, download the result"),
        (name = "uploads", description = "Send a large file, or one from a browser, before its job"),
        (name = "service", description = "What the service can do and how it is"),
    ),
    components(schemas(super::Problem, crate::jobs::JobReport)),
)]
struct Document;

/// Every documented address with its handler.
pub(super) fn routes() -> OpenApiRouter<ApiState> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(submit::submit_job, jobs::list_jobs))
        .routes(routes!(jobs::get_job, jobs::delete_job))
        .routes(routes!(jobs::cancel_job))
        .routes(routes!(events::job_events))
        .routes(routes!(artifacts::get_artifact))
        .routes(routes!(uploads::announce_upload))
        .routes(routes!(uploads::put_upload))
        .routes(routes!(capabilities::get_capabilities))
        .routes(routes!(health::livez))
        .routes(routes!(health::readyz))
        .routes(routes!(health::get_metrics))
        .routes(routes!(health::list_problems))
        .routes(routes!(health::get_problem))
}

/// The OpenAPI document (3.1), as kept in `openapi/openapi.json`.
#[must_use]
pub fn document() -> utoipa::openapi::OpenApi {
    routes().into_openapi()
}
